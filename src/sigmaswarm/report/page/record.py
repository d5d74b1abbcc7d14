"""What a page shows, whatever folder it was made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sigmaswarm.report.tracks import Tracks
from sigmaswarm.scoring.evaluation import method_names

Cell = str | float | None
"""None: it can't be said."""


@dataclass(frozen=True)
class Figure:
    """A number of the summary: what it is, the number with its unit, and what to hold it against."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table; a unit, if it has one."""

    title: str
    unit: str = ""


@dataclass(frozen=True)
class Table:
    """A table that readers can sort.

    Attributes
    ----------
    caption : str
    columns : tuple of Column, length n
    rows : tuple of tuple of Cell, each of length n
    strong : frozenset of int
        The rows that matter most.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    strong: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Chart:
    """A plot: what plotly.js takes for its traces and its layout, of JSON types."""

    title: str
    traces: tuple[Mapping[str, Any], ...]
    layout: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True)
class Section:
    """A piece of the evidence: text first, then tables, plots and tracks, where it has them."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    charts: tuple[Chart, ...] = ()
    tracks: tuple[Tracks, ...] = ()


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
    names : mapping of method to str
        What the methods are called in the tracks.
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
    names: Mapping[str, str] = field(default_factory=method_names)
