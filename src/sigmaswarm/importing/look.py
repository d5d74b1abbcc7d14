"""A first look at a log: its tables, their rates, their columns' ranges, and the recipe of a drive."""

import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import polars as pl

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.clocks import SECOND, time_expression
from sigmaswarm.importing.convert import (
    Request,
    complete_recipe,
    faults_left,
    guess_of,
    home_of,
    import_drive,
    open_logs,
)
from sigmaswarm.importing.guess import time_of
from sigmaswarm.importing.proposal import Proposal, judged, proposed
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import ROLES, Role, Source
from sigmaswarm.importing.times import numbers_of

SAMPLE = 5000
"""Rows of a table from which ranges are computed."""
LOOKED_AT = 25_000
"""Rows of all tables together, where they come mixed: one that is not met by then is shown without values."""


@dataclass(frozen=True)
class Range:
    """A column's values over the rows looked at: smallest, median, largest; None where it holds no numbers."""

    column: str
    low: float | None
    middle: float | None
    high: float | None
    example: str


@dataclass(frozen=True)
class Glance:
    """A table: its description, number of rows, Hz, and columns."""

    table: str
    kind: str
    rows: int | None
    rate: float | None
    ranges: tuple[Range, ...]


@dataclass(frozen=True)
class Look:
    """Content of the logs of a request, the recipe that would be used, and its assumptions.

    ``proposal``: options of `sigmaswarm import` for what was not recognized, and the ``evidence`` for them. ``unread``:
    by table, the columns that neither would read.
    """

    tables: tuple[Glance, ...]
    recipe: Recipe
    notes: tuple[str, ...]
    proposal: str = ""
    evidence: str = ""

    @property
    def unread(self) -> dict[str, tuple[str, ...]]:
        """See above."""
        parts = [part for role in self.recipe.roles.values() for part in role]
        said = "\n".join([self.proposal, *(text for part in parts for text in part.columns.values())])
        unread: dict[str, tuple[str, ...]] = {}
        for glance in self.tables:
            names = [r.column for r in glance.ranges]
            left = tuple(c for c in names if not re.search(rf"(?<![\w.]){re.escape(c)}(?![\w.])", said))
            if left:
                unread[glance.table] = left
        return unread


def look(request: Request) -> Look:
    """Look at the beginning of each log. Writes nothing, and a guess that fails is a note."""
    notes: list[str] = []
    with ExitStack() as stack:
        sources = open_logs(request, stack)
        guesses = {path: guess_of(source, request) for path, source in sources.items()}
        try:
            recipe = complete_recipe(request, guesses)
            notes += faults_left(request, recipe, guesses)
        except InputError as error:
            recipe, notes = request.recipe, [str(error)]
        times = {
            (home_of(role, request), part.table): part.columns["t"]
            for role in ROLES
            for part in recipe.roles.get(role, ())
            if "t" in part.columns
        }
        tables = [
            _glance(table, frame, source, times.get((path, table)))
            for path, source in sources.items()
            for table, frame in _beginnings(source).items()
        ]
        columns = {
            path: {
                name: {c: c for c in frame.columns} | _time(frame)
                for name, frame in _beginnings(source).items()
            }
            for path, source in sources.items()
        }
    for source in sources.values():
        notes += source.remarks
    for guess in guesses.values():
        notes += guess.said(mounted=bool(recipe.mount))
    proposal, evidence = _proposal(request, recipe, columns)
    return Look(tuple(tables), recipe, tuple(dict.fromkeys(notes)), proposal, evidence)


def _time(frame: pl.DataFrame) -> dict[str, str]:
    time = time_of(frame) if len(frame) else None
    return {} if time is None else {"t": time}


def _proposal(
    request: Request, recipe: Recipe, columns: Mapping[Path, Mapping[str, Mapping[str, str]]]
) -> tuple[str, str]:
    """The options that would read unrecognized columns, and how far they were checked; else empty."""
    tables: dict[Role, str] = {}
    found: dict[Role, Mapping[str, str]] = {}
    for role in ("imu", "gps"):
        there = columns[home_of(role, request)]
        parts = recipe.roles.get(role, ())
        known = {name: text for part in parts for name, text in part.columns.items()}
        chosen = {part.table: there[part.table] for part in parts if part.table in there} or there
        if (one := proposed(chosen, role, known)) is not None:
            found[role] = one[1]
            if not parts and len(there) > 1:
                tables[role] = one[0]
    if not found:
        return "", ""

    def make(proposal: Proposal) -> Drive:
        choice = replace(request.choice, tables={**proposal.tables, **request.choice.tables})
        asked = replace(request, maps=[*proposal.maps, *request.maps], choice=choice)
        return import_drive(asked, "proposal").drive

    proposal, evidence = judged(Proposal(tables, found), make)
    return proposal.options, evidence


def _beginnings(source: Source) -> dict[str, pl.DataFrame]:
    """The first rows of every table."""
    wanted = {name: table.columns for name, table in source.tables.items() if table.columns}
    rows: dict[str, pl.DataFrame] = {name: pl.DataFrame() for name in source.tables}
    mixed = getattr(source, "interleaved", False)
    for some in [wanted] if mixed else [{name: columns} for name, columns in wanted.items()]:
        seen = 0
        for batch in source.batches(some):
            seen += len(batch.rows)
            held = rows[batch.table]
            if len(held) < SAMPLE:
                new = batch.rows.head(SAMPLE - len(held))
                rows[batch.table] = pl.concat([held, new], how="vertical_relaxed") if len(held) else new
            if seen >= LOOKED_AT or all(len(rows[name]) >= SAMPLE for name in some):
                break
    return rows


def _glance(name: str, frame: pl.DataFrame, source: Source, time: str | None) -> Glance:
    table = source.tables[name]
    return Glance(name, table.kind, table.rows, _rate(frame, time), tuple(_ranges(frame)))


def _rate(frame: pl.DataFrame, time: str | None) -> float | None:
    """Hz, from the median step of the time; None without one."""
    time = time or (time_of(frame) if len(frame) else None)
    if time is None or len(frame) < 2:
        return None
    try:
        steps = frame.select(time_expression(time, frame).alias("t"))["t"].diff().drop_nulls()
    except pl.exceptions.PolarsError:  # a list, or a text that is no date
        return None
    step = steps.filter(steps > 0).median()
    return SECOND / step if isinstance(step, int | float) and step > 0 else None


def _ranges(frame: pl.DataFrame) -> Iterator[Range]:
    for name in frame.columns:
        values = frame[name].drop_nulls()
        example = str(values.first() if len(values) else "")
        numbers = numbers_of(values)
        if len(numbers):
            yield Range(name, *(float(v) for v in (numbers.min(), numbers.median(), numbers.max())), example)  # type: ignore
        else:
            yield Range(name, None, None, None, example)
