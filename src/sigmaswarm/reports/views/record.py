"""The vocabulary of views: cells, tables, sections, and the report that a page is made of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from sigmaswarm.reports.views.charts import Chart, Look
from sigmaswarm.scoring.tracks import Tracks

Range = tuple[float | None, float | None]
"""From and to, such as an interval; a table sorts it by where it begins."""
Cell = str | float | Range | None
"""None: it can't be said."""


@dataclass(frozen=True)
class Figure:
    """A number of the summary: what it is, the number with its unit, and what to hold it against."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes
    ----------
    title : str
    unit : str
        If it has one.
    number : callable, optional
        How a number, or each end of a range, is written; by default to four digits, a range's ends to three.
    printed : callable, optional
        The same for Markdown, LaTeX and CSV, where it differs.
    joined : bool
        In those it stands in the cell of the column before it: ``1.28 [1.26, 1.30]``.
    """

    title: str
    unit: str = ""
    number: Callable[[float], str] | None = None
    printed: Callable[[float], str] | None = None
    joined: bool = False

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes
    ----------
    caption : str
    columns : tuple of Column, length n
    rows : tuple of tuple of Cell, each of length n
    strong : frozenset of int
        The rows that matter most.
    note : str
        What has to be known to read it.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    strong: frozenset[int] = frozenset()
    note: str = ""


@dataclass(frozen=True)
class Line:
    """A series of the tracks: what people call it, how it is drawn, and whether it is shown from the start."""

    series: str
    label: str
    look: Look
    shown: bool = False


@dataclass(frozen=True, eq=False)
class TrackView:
    """Tracks to explore.

    Attributes
    ----------
    drives : tuple of Tracks
    lines : tuple of Line
        The first one is drawn on top, the last one below all others.
    main : str
        The series whose 3 sigma and NIS are shown first, and whose heading error sets the scale.
    """

    drives: tuple[Tracks, ...]
    lines: tuple[Line, ...]
    main: str


@dataclass(frozen=True)
class Section:
    """A piece of the evidence: text first, then tables, plots and tracks, where it has them."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    charts: tuple[Chart, ...] = ()
    tracks: TrackView | None = None


@dataclass(frozen=True)
class Report:
    """A whole page.

    Attributes
    ----------
    title : str
    lead : tuple of str
        The result in a sentence or a few.
    figures : tuple of Figure
    remarks : tuple of str
        What a reader should know before trusting the result.
    sections : tuple of Section
        The evidence; of all, only one has tracks.
    config, versions : mapping
        What was asked for, and of which software.
    command : str
        Repeats it; empty where no command can.
    command_note : str
        What the command can't say by itself.
    """

    title: str
    lead: tuple[str, ...]
    figures: tuple[Figure, ...] = ()
    remarks: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()
    config: Mapping[str, Any] = field(default_factory=dict[str, Any])
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    command: str = ""
    command_note: str = ""
