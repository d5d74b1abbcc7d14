"""Draw charts with matplotlib as PNG and SVG.

A chart that is drawn twice gives identical files. The functions do not use pyplot's global state.
"""

import re
import warnings
from base64 import urlsafe_b64decode, urlsafe_b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import Formatter
from numpy.typing import ArrayLike

from sigmaswarm.errors import InputError
from sigmaswarm.files import atomic_file, write_atomically
from sigmaswarm.reports.style import Look
from sigmaswarm.wording import escape_controls


@dataclass(frozen=True, eq=False)
class Chart:
    """A plot: ``draw`` draws marks and labels on matplotlib's axes.

    ``rows``, the number of names along the vertical axis, determines the height on a page. A page shows at most two
    ``broad`` charts in a row.
    """

    title: str
    draw: Callable[[Axes], None]
    rows: int = 0
    broad: bool = False


def curve(ax: Axes, x: ArrayLike, y: ArrayLike, look: Look, name: str = "") -> None:
    """Draw a line through points, with gaps at NaN and inf."""
    values = np.asarray(y, np.float64)
    ax.plot(x, np.where(np.isinf(values), np.nan, values), **look.line, label=name)


def band(ax: Axes, x: ArrayLike, low: ArrayLike, high: ArrayLike, look: Look, name: str = "") -> None:
    ax.fill_between(x, low, high, color=look.color, alpha=look.opacity, lw=0, label=name)


def name_rows(ax: Axes, names: Sequence[str]) -> None:
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.set_ylim(len(names) - 0.4, -0.6)


def show_time(ax: Axes, name: str = "time t, s") -> None:
    """Label the time axis without offset or powers of ten, since users pass these times to `split --at`."""
    ax.set_xlabel(name)
    ax.ticklabel_format(axis="x", style="plain", useOffset=False)


def logarithmic(axis: Axis) -> None:
    """Use a logarithmic scale with plain numbers; a range with few powers of ten gets additional labels."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})  # pyright: ignore
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(_Between())


class _Between(Formatter):
    """Label 2 and 5 times each power of ten on an axis that spans a factor of less than 15."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        low, high = sorted(self.axis.get_view_interval())  # pyright: ignore
        digit = f"{x:e}"[0] if 0 < high < 15 * low else ""
        return f"{x:g}" if digit in ("2", "5") else ""


def as_map(ax: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    """Use the same scale for east and north. A range may grow to fill the frame."""
    ax.set(aspect="equal", adjustable="datalim", xlabel="east, m", ylabel="north, m")
    ax.set_xlim(*x, auto=True)
    ax.set_ylim(*y, auto=True)


def short_number(value: float) -> str:
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def hover_id(text: str) -> str:
    """Encode a hover text as the identifier of an artist; `_svg` replaces it by a title element."""
    return f"hover-{urlsafe_b64encode(text.encode()).decode()}"


def figure_of(
    *charts: Chart,
    size: tuple[float, float],
    columns: int | None = None,
    legend: Literal["none", "inside", "below"] = "inside",
    **shared: Any,
) -> Figure:
    """Draw charts on a figure, in rows of ``columns`` charts (by default one row); ``size`` is in inches.

    A legend "below" the charts contains only the names of the first chart. ``shared`` contains the values of
    matplotlib's ``sharex`` and ``sharey``.
    """
    columns = columns or len(charts)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    grid: Any = figure.subplots(-(-len(charts) // columns), columns, squeeze=False, **shared)
    axes: list[Axes] = grid.ravel().tolist()
    for ax in axes[len(charts) :]:
        ax.remove()
    for ax, chart in zip(axes, charts, strict=False):
        ax.grid(True, color="0.9", lw=0.6)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        chart.draw(ax)
        ax.set_title(chart.title, loc="left")
        if legend == "inside" and ax.get_legend_handles_labels()[0]:
            ax.legend(frameon=False, fontsize=8)
    if legend == "below":
        _legend_below(figure, 6)
    return figure


def _legend_below(figure: Figure, columns: int) -> None:
    named = figure.axes[0].get_legend_handles_labels()
    figure.legend(*named, frameon=False, fontsize=8, ncols=columns, loc="outside lower center")


def _plain(artist: Artist) -> None:
    """Draw texts literally, since names of drives are not formulas.

    Tick labels are not changed, since they may contain powers of ten, and since the creation of ticks is slow.
    """
    if isinstance(artist, Text):
        artist.set_parse_math(False)
        artist.set_text(escape_controls(artist.get_text()))
    for child in () if isinstance(artist, Axis) else artist.get_children():
        _plain(child)


def save(figure: Figure, path: Path) -> Path:
    _plain(figure)
    with atomic_file(path) as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # the font may lack letters of a name
        figure.dpi = 130  # `savefig` would draw the figure twice and compute the layout twice
        FigureCanvasAgg(figure).print_png(file, metadata={"Software": None})
    return path


def save_both(figure: Figure, stem: Path) -> list[Path]:
    path = stem.with_name(f"{stem.name}.svg")
    write_atomically(path, _svg(figure))
    return [save(figure, stem.with_name(f"{stem.name}.png")), path]


def svg(chart: Chart) -> str:
    """Return a chart without its title, as an SVG element that is as wide as its container.

    Sizes are in inches. The page enlarges the chart by a factor of 1.2 on a phone and 1.8 on a large screen.
    """
    with rc_context({"font.size": 8, "axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7}):
        figure = figure_of(replace(chart, title=""), size=(3.4, 2.4), legend="none")
        names = set(figure.axes[0].get_legend_handles_labels()[1])
        columns = 2 if max(map(len, names), default=0) <= 22 else 1
        height = 0.5 + 0.22 * chart.rows if chart.rows else 2.4
        figure.set_size_inches(3.4, height + 0.16 * -(-len(names) // columns))
        if names:
            _legend_below(figure, columns)
        text = _svg(figure, **{"svg.fonttype": "none"})
    sized = r'(<svg[^>]*?) height="[^"]*"([^>]*?) width="[^"]*"'
    return re.sub(sized, r"\1\2", text[text.index("<svg") :], count=1)


def _svg(figure: Figure, **settings: str) -> str:
    """Return a figure as SVG without a date; hover texts become title elements."""
    _plain(figure)
    file = StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    look: dict[Any, Any] = {"svg.hashsalt": "sigmaswarm", **settings}
    with rc_context(look), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        FigureCanvasSVG(figure).print_svg(file, metadata=metadata)  # `savefig` would draw twice
    return re.sub(
        r'<g id="hover-([^"]*)">',
        lambda found: f"<g><title>{escape(urlsafe_b64decode(found[1]).decode())}</title>",
        file.getvalue(),
    )


def check_file(path: Path, suffix: str = ".png") -> None:
    if path.suffix != suffix:
        raise InputError(f"{path}: unknown format; choose a name that ends in {suffix}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; specify a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; create it first")
