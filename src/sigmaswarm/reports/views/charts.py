"""The vocabulary of charts: marks, which are numbers and looks, on two axes. `reports/draw/` draws them.

Along an axis with categories the numbers count these: 0 is the first one, which stands on top of a vertical axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Values = Sequence[float] | NDArray[np.floating[Any]] | NDArray[np.integer[Any]]
"""Numbers along an axis; NaN and inf leave a gap."""
Direction = Literal["x", "y"]
Dash = Literal["solid", "dash", "dashdot", "dot", "none"]
Symbol = Literal["", "dot", "circle", "ring", "diamond", "triangle-up", "triangle-right", "tick"]


def short_number(value: float) -> str:
    """A number beside its bar: three digits, and no powers of ten."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


@dataclass(frozen=True)
class Look:
    """How a mark is drawn.

    Attributes
    ----------
    color : str, #rrggbb
    width : float
        Of the line, in points.
    dash : str
        ``none`` draws no line.
    symbol : str
        On each point; a ring is hollow, a tick a short line across the axis of categories.
    size : float
        Of the symbol, in points.
    opacity : float
    """

    color: str
    width: float = 1.2
    dash: Dash = "solid"
    symbol: Symbol = ""
    size: float = 4.0
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Curve:
    """A line from point to point, with symbols where its look has one; without a name it is not in the legend."""

    x: Values
    y: Values
    look: Look
    name: str = ""


@dataclass(frozen=True, eq=False)
class Points:
    """Symbols, each with a color, symbol, text and explanation of its own where these are given.

    Attributes
    ----------
    x, y : sequence of float, length n
    look : Look
        Of those that have none of their own.
    name : str
        In the legend.
    colors, symbols, texts, hovers : tuple of str, length n or 0
        A text stands left of its point; a hover is what a page tells of it under the pointer.
    """

    x: Values
    y: Values
    look: Look
    name: str = ""
    colors: tuple[str, ...] = ()
    symbols: tuple[Symbol, ...] = ()
    texts: tuple[str, ...] = ()
    hovers: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Band:
    """The area between two curves; its look gives color and opacity."""

    x: Values
    low: Values
    high: Values
    look: Look
    name: str = ""


@dataclass(frozen=True, eq=False)
class Bars:
    """Bars from zero along ``along``, at places on the other axis.

    Attributes
    ----------
    along : {"x", "y"}
    at, values : sequence of float, length n
    look : Look
    colors, texts : tuple of str, length n or 0
        Of each bar, the text at its end.
    width : float
        Of a bar, on the other axis.
    """

    along: Direction
    at: Values
    values: Values
    look: Look
    colors: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    width: float = 0.8


@dataclass(frozen=True, eq=False)
class Intervals:
    """Lines along ``along`` from low to high, at places on the other axis; what is NaN is left out."""

    along: Direction
    at: Values
    low: Values
    high: Values
    look: Look
    name: str = ""


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


@dataclass(frozen=True)
class Rule:
    """A line across the whole chart where an axis has the value ``at``.

    Attributes
    ----------
    axis : {"x", "y"}
    at : float
    look : Look
    name : str
        In the legend.
    label : str
        At the line.
    """

    axis: Direction
    at: float
    look: Look
    name: str = ""
    label: str = ""


@dataclass(frozen=True)
class Span:
    """A stripe across the whole chart, where an axis has values from low to high; below all other marks."""

    axis: Direction
    low: float
    high: float
    look: Look


Mark = Curve | Points | Band | Bars | Intervals | Boxes | Rule | Span


@dataclass(frozen=True)
class Axis:
    """An axis of a chart.

    Attributes
    ----------
    title : str
        With its unit: ``time, s``.
    scale : {"linear", "log"}
    range : (float or None, float or None)
        What it shows; None: as far as the marks go.
    categories : tuple of str
        Names of the places 0, 1, ...
    ticks : tuple of float
        Where it has numbers; empty: chosen when it is drawn.
    plain : bool
        Write numbers in full rather than as powers of ten.
    """

    title: str = ""
    scale: Literal["linear", "log"] = "linear"
    range: tuple[float | None, float | None] = (None, None)
    categories: tuple[str, ...] = ()
    ticks: tuple[float, ...] = ()
    plain: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """A plot: marks on two axes, the later ones above the earlier.

    Attributes
    ----------
    title : str
    marks : tuple of Mark
    x, y : Axis
    equal : bool
        A metre is as long on either axis.
    broad : bool
        On a page, at most two of these stand in a row.
    """

    title: str
    marks: tuple[Mark, ...]
    x: Axis = field(default_factory=Axis)
    y: Axis = field(default_factory=Axis)
    equal: bool = False
    broad: bool = False
