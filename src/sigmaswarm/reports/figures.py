"""Draw charts with matplotlib, as PNG, as SVG files and as SVG for pages.

The same chart gives the same bytes. The global state of pyplot is not touched.
"""

import re
import warnings
from base64 import urlsafe_b64decode
from collections.abc import Iterator
from dataclasses import replace
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any, Literal

from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis as MatplotlibAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from sigmaswarm.errors import InputError
from sigmaswarm.files import whole_file, write_whole
from sigmaswarm.reports.views.charts import Chart
from sigmaswarm.wording import visible

Legend = Literal["none", "inside", "below"]


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
        chart.draw(ax)
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
    """Draw titles and legends literally: names of drives are no formulas."""
    for text in _texts(figure):
        text.set_parse_math(False)
        text.set_text(visible(text.get_text()))


def _texts(artist: Artist) -> Iterator[Text]:
    """All texts except those of axes, which may have powers and whose ticks are expensive to create."""
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
LONG_NAME = 22
"""Characters of a name above which the legend has one column."""
ROW_HEIGHT = 0.22
"""Inches: height of a category in it."""


def svg(chart: Chart) -> str:
    """Return a chart without its title as an SVG element that is as wide as its container."""
    named = set(chart.names)
    columns = 2 if max(map(len, named), default=0) <= LONG_NAME else 1
    height = 0.5 + ROW_HEIGHT * len(chart.y.categories) if chart.y.categories else 2.4
    with rc_context({"font.size": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7}):
        figure = figure_of(
            replace(chart, title=""),
            size=(SVG_WIDTH, height + 0.16 * -(-len(named) // columns)),
            legend="below" if named else "none",
            legend_columns=columns,
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
