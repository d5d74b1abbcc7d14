"""Charts: marks, which are numbers and looks, on two axes. `reports/figures.py` makes PNG and SVG of them.

Along an axis with categories the numbers are their indices: 0 is the first one, at the top of a vertical axis.
"""

from base64 import urlsafe_b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import Formatter
from numpy.typing import NDArray

Values = Sequence[float] | NDArray[np.floating[Any]] | NDArray[np.integer[Any]]
"""Numbers along an axis; NaN and inf leave a gap."""
Direction = Literal["x", "y"]
Dash = Literal["solid", "dash", "dashdot", "dot", "none"]
Symbol = Literal["", "dot", "circle", "ring", "diamond", "triangle-up", "triangle-right", "tick"]

DASHES = {"solid": "-", "dash": "--", "dashdot": "-.", "dot": ":", "none": "none"}
SYMBOLS: dict[Symbol, str] = {
    "": "none",
    "dot": ".",
    "circle": "o",
    "ring": "o",
    "diamond": "D",
    "triangle-up": "^",
    "triangle-right": ">",
    "tick": "|",
}
SMALL: dict[str, Any] = {"fontsize": 8}


def short_number(value: float) -> str:
    """Format the number at a bar: three digits, and no powers of ten."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


@dataclass(frozen=True)
class Look:
    """How a mark is drawn.

    Attributes
    ----------
    color : str, #rrggbb
    width : float
        Line width in points.
    dash : str
        ``none`` draws no line.
    symbol : str
        Marker of each point; a ring is hollow, a tick a short line across the axis of categories.
    size : float
        Marker size in points.
    opacity : float
    """

    color: str
    width: float = 1.2
    dash: Dash = "solid"
    symbol: Symbol = ""
    size: float = 4.0
    opacity: float = 1.0

    @property
    def line(self) -> dict[str, Any]:
        """Keywords of `Axes.plot`."""
        hollow = {"mfc": "none", "mec": self.color} if self.symbol == "ring" else {}
        symbol = {"marker": SYMBOLS[self.symbol], "ms": self.size, **hollow} if self.symbol else {}
        return {
            "color": self.color,
            "lw": self.width,
            "ls": DASHES[self.dash],
            "alpha": self.opacity,
            **symbol,
        }


class Mark(Protocol):
    """An element of a chart."""

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        ...


@dataclass(frozen=True, eq=False)
class Curve:
    """A line through points, with markers where its look has a symbol; ``name`` is its text in the legend."""

    x: Values
    y: Values
    look: Look
    name: str = ""

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        y = np.asarray(self.y, np.float64)
        ax.plot(self.x, np.where(np.isinf(y), np.nan, y), **self.look.line, **_named(self.name))


@dataclass(frozen=True, eq=False)
class Points:
    """Markers.

    Attributes
    ----------
    x, y : sequence of float, length n
    look : Look
    name : str
        Text in the legend.
    colors, symbols, texts, hovers : tuple of str, length n or 0
        Own color and symbol of each point, text left of it, and text under the pointer on a page.
    """

    x: Values
    y: Values
    look: Look
    name: str = ""
    colors: tuple[str, ...] = ()
    symbols: tuple[Symbol, ...] = ()
    texts: tuple[str, ...] = ()
    hovers: tuple[str, ...] = ()

    def draw(self, ax: Axes) -> None:
        """Draw the mark, point by point where they differ."""
        plain = self.look.line | {"ls": "none"}
        if not (self.colors or self.symbols or self.hovers):
            ax.plot(self.x, self.y, **plain, **_named(self.name))
            return
        for i, (x, y) in enumerate(zip(self.x, self.y, strict=True)):
            own = {"color": self.colors[i]} if self.colors else {}
            own |= {"marker": SYMBOLS[self.symbols[i]]} if self.symbols else {}
            own |= {"gid": hover_id(self.hovers[i])} if self.hovers else {}
            ax.plot(x, y, **plain | own, **_named(self.name if i == 0 else ""))
        for text, x, y in zip(self.texts, self.x, self.y, strict=bool(self.texts)):
            place: dict[str, Any] = {"xytext": (-6, 0), "textcoords": "offset points", "ha": "right"}
            ax.annotate(text, (float(x), float(y)), va="center", **place, **SMALL)


def hover_id(text: str) -> str:
    """Return the identifier that carries a hover text into an SVG, see `figures`."""
    return f"hover-{urlsafe_b64encode(text.encode()).decode()}"


@dataclass(frozen=True, eq=False)
class Band:
    """The area between two curves; its look gives color and opacity."""

    x: Values
    low: Values
    high: Values
    look: Look
    name: str = ""

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        shade: dict[str, Any] = {"color": self.look.color, "alpha": self.look.opacity, "lw": 0}
        ax.fill_between(self.x, self.low, self.high, **shade, **_named(self.name))


@dataclass(frozen=True, eq=False)
class Bars:
    """Bars from zero along ``along``, at positions ``at`` on the other axis; each may have a color and a text."""

    along: Direction
    at: Values
    values: Values
    look: Look
    colors: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    width: float = 0.8

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        look = self.look
        shade: dict[str, Any] = {"color": list(self.colors) or look.color, "alpha": look.opacity}
        shade |= {"lw": look.width, "edgecolor": look.color if look.width else "none"}
        (ax.barh if self.along == "x" else ax.bar)(self.at, self.values, self.width, **shade)
        for text, at, value in zip(self.texts, self.at, self.values, strict=bool(self.texts)):
            end, align = ((value, at), "center") if self.along == "x" else ((at, value), "bottom")
            ax.annotate(f" {text}", end, va=align, **SMALL)


@dataclass(frozen=True, eq=False)
class Intervals:
    """Lines along ``along`` from low to high, at positions ``at`` on the other axis; NaN is left out."""

    along: Direction
    at: Values
    low: Values
    high: Values
    look: Look
    name: str = ""

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        shade: dict[str, Any] = {
            "color": self.look.color,
            "lw": self.look.width,
            "alpha": self.look.opacity,
        }
        lines = ax.hlines if self.along == "x" else ax.vlines
        lines(self.at, self.low, self.high, **shade, **_named(self.name))


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes along ``along`` from the first to the third quartile, a line at the median, whiskers from low to high."""

    along: Direction
    at: Values
    low: Values
    first: Values
    median: Values
    third: Values
    high: Values
    look: Look
    name: str = ""

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        parts = ("whislo", "q1", "med", "q3", "whishi")
        numbers = zip(self.low, self.first, self.median, self.third, self.high, strict=True)
        drawn = ax.bxp(
            [dict(zip(parts, box, strict=True)) for box in numbers],
            positions=list(self.at),
            orientation="horizontal" if self.along == "x" else "vertical",
            widths=0.5,
            showfliers=False,
            patch_artist=True,
            medianprops={"color": "k"},
            boxprops={"facecolor": self.look.color, "alpha": self.look.opacity},
            manage_ticks=False,
        )
        if self.name:
            drawn["boxes"][0].set_label(self.name)


@dataclass(frozen=True)
class Rule:
    """A line across the chart where ``axis`` has the value ``at``, with a name in the legend or a label at the line."""

    axis: Direction
    at: float
    look: Look
    name: str = ""
    label: str = ""

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        vertical = self.axis == "x"
        (ax.axvline if vertical else ax.axhline)(self.at, **self.look.line, **_named(self.name))
        if self.label:
            place = (self.at, 0.98) if vertical else (0.01, self.at)
            across = ax.get_xaxis_transform() if vertical else ax.get_yaxis_transform()
            behind = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1}
            align = "top" if vertical else "bottom"
            ax.annotate(self.label, place, xycoords=across, va=align, bbox=behind, **SMALL)


@dataclass(frozen=True)
class Span:
    """A stripe across the chart where ``axis`` has values from low to high."""

    axis: Direction
    low: float
    high: float
    look: Look

    def draw(self, ax: Axes) -> None:
        """Draw the mark."""
        stripe = ax.axvspan if self.axis == "x" else ax.axhspan
        stripe(self.low, self.high, color=self.look.color, alpha=self.look.opacity, lw=0)


def _named(name: str) -> dict[str, Any]:
    return {"label": name} if name else {}


@dataclass(frozen=True)
class Axis:
    """An axis of a chart.

    Attributes
    ----------
    title : str
        With its unit: ``time, s``.
    scale : {"linear", "log"}
    range : (float or None, float or None)
        Limits; None: as far as the marks reach.
    categories : tuple of str
        Names of the positions 0, 1, ...
    ticks : tuple of float
        Positions of its numbers; empty: automatic.
    plain : bool
        Write numbers in full rather than as powers of ten.
    """

    title: str = ""
    scale: Literal["linear", "log"] = "linear"
    range: tuple[float | None, float | None] = (None, None)
    categories: tuple[str, ...] = ()
    ticks: tuple[float, ...] = ()
    plain: bool = False

    def draw(self, ax: Axes, direction: Direction, *, widen: bool) -> None:
        """Set up the axis; ``widen``: equal axes may extend a range to fill the frame."""
        low, high = self.range
        ax.set(**{f"{direction}label": self.title, f"{direction}scale": self.scale})
        numbers = ax.xaxis if direction == "x" else ax.yaxis
        if self.categories:
            n = len(self.categories)
            numbers.set_ticks(range(n), self.categories, **SMALL)
            low, high = (n - 0.4, -0.6) if direction == "y" else (-0.6, n - 0.4)
        elif self.plain:
            numbers.set_major_formatter("{x:g}")
            numbers.set_minor_formatter("{x:g}")
        elif self.ticks:
            numbers.set_ticks(self.ticks, [f"{tick:g}" for tick in self.ticks])
        elif self.scale == "log":  # powers of ten would overlap where the marks span less than one
            numbers.set_major_formatter("{x:g}")
            numbers.set_minor_formatter(_Between())
        if low is not None or high is not None:
            limits = ax.set_xlim if direction == "x" else ax.set_ylim
            limits(low, high, **({"auto": True} if widen else {}))


class _Between(Formatter):
    """Format 2 and 5 times a power of ten, where an axis spans little more than one power."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        low, high = sorted(self.axis.get_view_interval())  # pyright: ignore
        digit = f"{x:e}"[0] if 0 < high < 15 * low else ""
        return f"{x:g}" if digit in ("2", "5") else ""


@dataclass(frozen=True, eq=False)
class Chart:
    """A plot.

    Attributes
    ----------
    title : str
    marks : tuple of Mark
        Drawn in this order.
    x, y : Axis
    equal : bool
        Both axes have the same scale.
    broad : bool
        A page shows at most two of these in a row.
    """

    title: str
    marks: tuple[Mark, ...]
    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    equal: bool = False
    broad: bool = False

    @property
    def names(self) -> list[str]:
        """Entries of the legend."""
        return [name for mark in self.marks if (name := getattr(mark, "name", ""))]

    def draw(self, ax: Axes) -> None:
        """Draw the marks, the title and the axes."""
        for mark in self.marks:
            mark.draw(ax)
        ax.set_title(self.title, loc="left")
        if self.equal:
            ax.set(aspect="equal", adjustable="datalim")
        self.x.draw(ax, "x", widen=self.equal)
        self.y.draw(ax, "y", widen=self.equal)
        for mark in self.marks:
            if isinstance(mark, Bars) and mark.texts:  # room for the texts at the ends of the bars
                (ax.set_xmargin if mark.along == "x" else ax.set_ymargin)(0.25)
