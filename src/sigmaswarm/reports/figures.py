"""Draw charts with matplotlib, as PNG, as SVG files and as SVG for pages.

The same chart gives the same bytes. The global state of pyplot is not touched.
"""

import re
import warnings
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Iterator
from dataclasses import replace
from functools import singledispatch
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis as MatplotlibAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import Formatter

from sigmaswarm.errors import InputError
from sigmaswarm.files import whole_file, write_whole
from sigmaswarm.reports.views.charts import (
    Axis,
    Band,
    Bars,
    Boxes,
    Chart,
    Curve,
    Direction,
    Intervals,
    Look,
    Points,
    Rule,
    Span,
    Symbol,
)
from sigmaswarm.wording import visible

Legend = Literal["none", "inside", "below"]

_DASHES = {"solid": "-", "dash": "--", "dashdot": "-.", "dot": ":", "none": "none"}
_SYMBOLS: dict[Symbol, str] = {
    "": "none",
    "dot": ".",
    "circle": "o",
    "ring": "o",
    "diamond": "D",
    "triangle-up": "^",
    "triangle-right": ">",
    "tick": "|",
}


def figure_of(
    *charts: Chart,
    size: tuple[float, float],
    columns: int | None = None,
    legend: Legend = "inside",
    legend_columns: int = 6,
    **shared: bool,
) -> Figure:
    """Draw charts next to each other, or in so many columns, on a figure of that size in inches.

    A legend below serves all charts and has the names of the first one. ``sharex`` and ``sharey`` are matplotlib's.
    """
    columns = columns or len(charts)
    figure, axes = new_figure(*size, -(-len(charts) // columns), columns, **shared)
    for ax in axes[len(charts) :]:
        ax.remove()
    for ax, chart in zip(axes, charts, strict=False):
        draw(ax, chart)
        if legend == "inside" and ax.get_legend_handles_labels()[0]:
            ax.legend(frameon=False, fontsize=8)
    if legend == "below":
        named = axes[0].get_legend_handles_labels()
        figure.legend(*named, frameon=False, fontsize=8, ncols=legend_columns, loc="outside lower center")
    return figure


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **kw: object
) -> tuple[Figure, list[Axes]]:
    """A figure of that size in inches, with a list of its axes."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **kw).ravel().tolist()  # pyright: ignore
    for ax in axes:
        ax.grid(True, color="0.9", lw=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _plain(figure: Figure) -> None:
    """Have titles and legends drawn as they are: names of drives are no formulas, and no commands to a terminal."""
    for text in _texts(figure):
        text.set_parse_math(False)
        text.set_text(visible(text.get_text()))


def _texts(artist: Artist) -> Iterator[Text]:
    """All texts but those of axes, which may have powers; to ask for an axis's would make all its ticks."""
    if isinstance(artist, Text):
        yield artist
    if not isinstance(artist, MatplotlibAxis):
        for child in artist.get_children():
            yield from _texts(child)


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG, with nothing in it that changes from one run to the next."""
    _plain(figure)
    with whole_file(path) as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # a name may have letters that the font lacks
        figure.dpi = 130  # `savefig` would draw it twice, once for the layout, which a drawing makes anyway
        FigureCanvasAgg(figure).print_png(file, metadata={"Software": None})  # pyright: ignore[reportArgumentType]
    return path


def save_both(figure: Figure, stem: Path) -> list[Path]:
    """Write a PNG and an SVG."""
    path = stem.with_name(f"{stem.name}.svg")
    write_whole(path, _svg(figure))
    return [save(figure, stem.with_name(f"{stem.name}.png")), path]


SVG_WIDTH = 3.4
"""Inches: width of a chart of a page; the page scales it, to 1.2 times on a phone and to 1.8 times on a screen."""
ROW_HEIGHT = 0.22
"""Inches: height of a category in it."""


def svg(chart: Chart) -> str:
    """Return a chart without its title as an SVG element that is as wide as its container."""
    named = {name for mark in chart.marks if (name := getattr(mark, "name", ""))}
    height = 0.5 + ROW_HEIGHT * len(chart.y.categories) if chart.y.categories else 2.4
    with rc_context({"font.size": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7}):
        figure = figure_of(
            replace(chart, title=""),
            size=(SVG_WIDTH, height + 0.16 * -(-len(named) // 2)),
            legend="below" if named else "none",
            legend_columns=2,
        )
        text = _svg(figure, **{"svg.fonttype": "none"})
    return re.sub(
        r'(<svg[^>]*?) height="[^"]*"([^>]*?) width="[^"]*"', r"\1\2", text[text.index("<svg") :], count=1
    )


def _svg(figure: Figure, **settings: str) -> str:
    """Draw an SVG with no date in it; marks with a hover text get it as a title element."""
    _plain(figure)
    file = StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    look: dict[Any, Any] = {"svg.hashsalt": "sigmaswarm", **settings}
    with rc_context(look), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(file, format="svg", metadata=metadata)
    return re.sub(
        r'<g id="hover-([^"]*)">',
        lambda found: f"<g><title>{escape(urlsafe_b64decode(found[1]).decode())}</title>",
        file.getvalue(),
    )


def check_file(path: Path, suffix: str = ".png") -> None:
    """Raise `InputError` where a file of that type cannot be written, before any work is done."""
    if path.suffix != suffix:
        raise InputError(f"{path}: can't tell the format; end the name in {suffix}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")


def look(of: Look) -> dict[str, Any]:
    """A look as the keywords of `Axes.plot`."""
    hollow = {"mfc": "none", "mec": of.color} if of.symbol == "ring" else {}
    symbol = {"marker": _SYMBOLS[of.symbol], "ms": of.size, **hollow} if of.symbol else {}
    return {"color": of.color, "lw": of.width, "ls": _DASHES[of.dash], "alpha": of.opacity, **symbol}


def draw(ax: Axes, chart: Chart) -> None:
    """Draw a chart's marks, title and axes."""
    for mark in chart.marks:
        _mark(mark, ax)
    ax.set_title(chart.title, loc="left")
    if chart.equal:
        ax.set(aspect="equal", adjustable="datalim")
    _axis(ax, chart.x, "x", widen=chart.equal)
    _axis(ax, chart.y, "y", widen=chart.equal)
    texts = [m for m in chart.marks if isinstance(m, Bars) and m.texts]
    if texts:  # room for what stands at the ends of the bars
        (ax.set_xmargin if texts[0].along == "x" else ax.set_ymargin)(0.25)


def _axis(ax: Axes, axis: Axis, direction: Direction, *, widen: bool) -> None:
    """Equal axes may widen a range to fill the frame."""
    low, high = axis.range
    ax.set(**{f"{direction}label": axis.title, f"{direction}scale": axis.scale})
    if axis.categories:
        n = len(axis.categories)
        getattr(ax, f"set_{direction}ticks")(range(n), axis.categories, fontsize=8)
        low, high = (n - 0.4, -0.6) if direction == "y" else (-0.6, n - 0.4)
    elif axis.plain:
        numbers = ax.xaxis if direction == "x" else ax.yaxis
        numbers.set_major_formatter("{x:g}")
        numbers.set_minor_formatter("{x:g}")
    elif axis.scale == "log" and not axis.ticks:  # powers of ten overlap where bars differ by less than that
        numbers = ax.xaxis if direction == "x" else ax.yaxis
        numbers.set_major_formatter("{x:g}")
        numbers.set_minor_formatter(_Between())
    elif axis.ticks:
        getattr(ax, f"set_{direction}ticks")(axis.ticks, [f"{tick:g}" for tick in axis.ticks], minor=False)
    if low is not None or high is not None:
        getattr(ax, f"set_{direction}lim")(low, high, **({"auto": True} if widen else {}))


class _Between(Formatter):
    """Numbers between powers of ten, 2 and 5 times one, where an axis has no more than about one power to show."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        low, high = sorted(self.axis.get_view_interval())  # pyright: ignore
        digit = f"{x:e}"[0] if 0 < high < 15 * low else ""
        return f"{x:g}" if digit in ("2", "5") else ""


@singledispatch
def _mark(mark: Any, ax: Axes) -> None:
    raise TypeError(mark)


def _named(name: str) -> dict[str, Any]:
    return {"label": name} if name else {}


@_mark.register
def _(mark: Curve, ax: Axes) -> None:
    y = np.asarray(mark.y, np.float64)
    ax.plot(mark.x, np.where(np.isinf(y), np.nan, y), **look(mark.look), **_named(mark.name))


@_mark.register
def _(mark: Points, ax: Axes) -> None:
    """One by one where they differ."""
    plain = look(mark.look) | {"ls": "none"}
    if not mark.colors and not mark.symbols and not mark.hovers:
        ax.plot(mark.x, mark.y, **plain, **_named(mark.name))
    else:
        for i, (x, y) in enumerate(zip(mark.x, mark.y, strict=True)):
            color = {"color": mark.colors[i]} if mark.colors else {}
            symbol = {"marker": _SYMBOLS[mark.symbols[i]]} if mark.symbols else {}
            hover = (
                {"gid": f"hover-{urlsafe_b64encode(mark.hovers[i].encode()).decode()}"} if mark.hovers else {}
            )
            ax.plot(x, y, **plain | color | symbol | hover, **_named(mark.name if i == 0 else ""))
    for text, x, y in zip(mark.texts, mark.x, mark.y, strict=bool(mark.texts)):
        place = {"xytext": (-6, 0), "textcoords": "offset points", "ha": "right", "va": "center"}
        ax.annotate(text, (float(x), float(y)), fontsize=8, **place)  # pyright: ignore[reportArgumentType]


@_mark.register
def _(mark: Band, ax: Axes) -> None:
    shade = {"color": mark.look.color, "alpha": mark.look.opacity, "lw": 0}
    ax.fill_between(mark.x, mark.low, mark.high, **shade, **_named(mark.name))  # pyright: ignore


@_mark.register
def _(mark: Bars, ax: Axes) -> None:
    color = list(mark.colors) or mark.look.color
    shade = {
        "color": color,
        "alpha": mark.look.opacity,
        "edgecolor": mark.look.color if mark.look.width else "none",
    }
    shade |= {"lw": mark.look.width}
    if mark.along == "x":
        ax.barh(mark.at, mark.values, mark.width, **shade)  # pyright: ignore
    else:
        ax.bar(mark.at, mark.values, mark.width, **shade)  # pyright: ignore
    for text, at, value in zip(mark.texts, mark.at, mark.values, strict=bool(mark.texts)):
        end, align = ((value, at), "center") if mark.along == "x" else ((at, value), "bottom")
        ax.annotate(f" {text}", end, va=align, fontsize=8)  # pyright: ignore[reportArgumentType]


@_mark.register
def _(mark: Intervals, ax: Axes) -> None:
    lines = ax.hlines if mark.along == "x" else ax.vlines
    shade = {"color": mark.look.color, "lw": mark.look.width, "alpha": mark.look.opacity}
    lines(mark.at, mark.low, mark.high, **shade, **_named(mark.name))  # pyright: ignore


@_mark.register
def _(mark: Boxes, ax: Axes) -> None:
    parts = ("whislo", "q1", "med", "q3", "whishi")
    numbers = zip(mark.low, mark.first, mark.median, mark.third, mark.high, strict=True)
    drawn = ax.bxp(
        [dict(zip(parts, box, strict=True)) for box in numbers],
        positions=list(mark.at),
        orientation="horizontal" if mark.along == "x" else "vertical",
        widths=0.5,
        showfliers=False,
        patch_artist=True,
        medianprops={"color": "k"},
        boxprops={"facecolor": mark.look.color, "alpha": mark.look.opacity},
        manage_ticks=False,
    )
    if mark.name:
        drawn["boxes"][0].set_label(mark.name)


@_mark.register
def _(mark: Rule, ax: Axes) -> None:
    line = ax.axvline if mark.axis == "x" else ax.axhline
    line(mark.at, **look(mark.look), **_named(mark.name))
    if mark.label:
        place, across = ((mark.at, 0.98), ax.get_xaxis_transform()) if mark.axis == "x" else (
            (0.01, mark.at), ax.get_yaxis_transform())  # fmt: skip
        ax.annotate(
            mark.label, place, xycoords=across, fontsize=8, va="bottom" if mark.axis == "y" else "top"
        )


@_mark.register
def _(mark: Span, ax: Axes) -> None:
    stripe = ax.axvspan if mark.axis == "x" else ax.axhspan
    stripe(mark.low, mark.high, color=mark.look.color, alpha=mark.look.opacity, lw=0)
