"""Inspect a log: list its tables with rates and ranges of columns, and find the recipe of a drive."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.assemble import missing_columns
from sigmaswarm.importing.completion import (
    Beginnings,
    assumed_mounting,
    completed,
    notes_of,
    points_down,
    with_tables,
)
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.expressions import ROW, compile_expression, is_valid_expression, time_span
from sigmaswarm.importing.faults import faults_left, missing_sensor, with_rate_of_rows
from sigmaswarm.importing.guess import Z_DOWN
from sigmaswarm.importing.joining import without_overlap
from sigmaswarm.importing.mounting import tilted_mount
from sigmaswarm.importing.opening import Plan, Request, opened
from sigmaswarm.importing.proposal import Proposal, propose
from sigmaswarm.importing.proposal_check import check_proposal, reversed_forces
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import ROLES, Fault, ImportProgress, Log, Part
from sigmaswarm.importing.table_columns import column_numbers
from sigmaswarm.importing.times import EVER, sample_rate, span_of_table

PREVIEW_ROWS = 5000  # number of first rows of a table from which ranges are computed
# Largest number of rows that are read if the rows of tables alternate; tables that begin later are shown without values
MAX_SCANNED_ROWS = 25_000
MAX_CHECKED_BYTES = 300_000_000  # largest size of a log that is imported as a check


@dataclass(frozen=True)
class Range:
    """Smallest, median and largest value of a column in the first rows (None if not numeric), and its first value."""

    column: str
    low: float | None
    middle: float | None
    high: float | None
    example: str


@dataclass(frozen=True)
class TablePreview:
    """A table: its description, number of rows, rate (Hz), and columns."""

    table: str
    kind: str
    rows: int | None
    rate: float | None
    ranges: tuple[Range, ...]


@dataclass(frozen=True)
class Inspection:
    """Content of the logs of a request, the recipe that an import would use, and its assumptions.

    ``proposal`` contains options of `sigmaswarm import` for unrecognized columns, ``settings`` the same options for
    `import_log`, and ``evidence`` the reasons for them. ``works`` is True if the import with these options succeeds, or
    if there is no proposal and no note states a fault of tables or columns. ``unread`` contains, by table, the columns
    that neither recipe nor proposal reads. ``faults`` are reasons not to use a column unchanged. ``rows`` are the first
    rows of each table. ``mount`` is the mounting that a note recommends.
    """

    tables: tuple[TablePreview, ...]
    recipe: Recipe
    notes: tuple[str, ...]
    proposal: str = ""
    evidence: str = ""
    works: bool = False
    unread: Mapping[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])
    faults: tuple[Fault, ...] = ()
    rows: Mapping[str, pl.DataFrame] = field(
        default_factory=dict[str, pl.DataFrame], repr=False, compare=False
    )
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    mount: str = ""

    def numbers(self, table: str, column: str) -> Array:
        return column_numbers(self.rows[table][column]).to_numpy().astype(np.float64)


def inspect_request(request: Request, progress: ImportProgress = lambda done: None) -> Inspection:
    """Read the beginning of each log. Faults become notes, and nothing is written.

    A proposal is checked on the whole log. Without a proposal, logs of up to `MAX_CHECKED_BYTES` are imported as a
    check. ``progress`` then receives the fraction that has been read, 0 to 1.
    """
    with opened(request) as plan:
        try:
            plan = completed(plan)
            notes = faults_left(plan)
        except InputError as error:
            notes = [str(error)]
            plan = replace(plan, recipe=request.recipe)
        first = {path: beginnings(log) for path, log in plan.logs.items()}
        tables = tuple(_previews(plan, first))
        proposal = propose(plan, first)
        if not notes and not proposal:
            notes = _obstacles(plan, first)
        works = not notes
        down = bool(points_down(plan))
        mount, tilted = tilted_mount(plan.recipe, first[request.home("imu")], downward=down)
        notes += [*notes_of(plan), *([tilted] if tilted else assumed_mounting(plan))]
    make = partial(_imported, request, progress)
    others = proposal or Proposal({}, {})
    sound = down and works and "imu" not in others.columns
    if sound and (turned := reversed_forces(plan.parts("imu"), make)):
        down, proposal = False, replace(others, columns={**turned.columns, **others.columns})
        notes = [note for note in notes if f"--mount {Z_DOWN}" not in note]
    evidence = ""
    if works and not proposal and _size(plan) < MAX_CHECKED_BYTES:
        try:
            import_drive(request, "checked", progress)
        except InputError as error:
            notes, works = [*notes, str(error)], False
    if proposal:
        proposal, evidence, works = check_proposal(proposal, make)
        if not works and not proposal.maps:
            notes.append(evidence.partition("could not be checked: ")[2])
        if "row/" in proposal.columns.get("imu", {}).get("t", ""):
            evidence += (
                "; imu.t assumes a constant rate, and that the rows of the IMU begin and end with the fixes"
            )
    return Inspection(
        tables,
        plan.recipe,
        tuple(dict.fromkeys(notes)),
        proposal.options if proposal else "",
        evidence,
        works,
        _unread(tables, plan.recipe, proposal),
        tuple(fault for guess in plan.guesses.values() for fault in guess.faults),
        {name: frame for frames in first.values() for name, frame in frames.items()},
        proposal.settings if proposal else {},
        mount or (Z_DOWN if down else ""),
    )


def _size(plan: Plan) -> int:
    """Return the number of bytes of the logs."""
    files = (file for path in plan.logs for file in ([path] if path.is_file() else path.rglob("*")))
    return sum(file.stat().st_size for file in files if file.is_file())


def _previews(plan: Plan, first: Beginnings) -> Iterator[TablePreview]:
    times = {
        (plan.request.home(role), part.table): part.columns["t"]
        for role in ROLES
        for part in plan.parts(role)
        if "t" in part.columns
    }
    for path, log in plan.logs.items():
        for name, table in log.tables.items():
            rows = first[path][name]
            rate = sample_rate(rows, times.get((path, name)))
            yield TablePreview(name, table.kind, table.rows, rate, tuple(_ranges(rows)))


def _obstacles(plan: Plan, first: Beginnings) -> list[str]:
    """Return the faults of tables and columns with which an import would fail."""
    if missing := missing_sensor(plan, ROLES):
        return [missing]
    whole, faults = with_tables(plan, first)
    faults = with_rate_of_rows(faults, plan)
    log, of_log = plan.log("imu"), f"{plan.request.log}: "
    parts = [part for part in whole.parts("imu") if "t" in part.columns]
    spans = [time_span(p.columns["t"], first[log.path][p.table]) or EVER for p in parts[1:] and parts]
    if without_overlap("imu", parts, spans):  # the first rows may end before the other table begins
        spans = [span_of_table(log, part.table, part.columns["t"]) for part in parts]
    if apart := without_overlap("imu", parts, spans):
        faults.append(f"{of_log}{apart}")
    return faults or [f"{of_log}{message}" for message in missing_columns(plan.recipe)]


def _unread(
    tables: Sequence[TablePreview], recipe: Recipe, proposal: Proposal | None
) -> dict[str, tuple[str, ...]]:
    parts = [part for role in recipe.roles.values() for part in role]
    parts += [Part("", columns) for columns in (proposal.columns if proposal else {}).values()]
    unread: dict[str, tuple[str, ...]] = {}
    for preview in tables:
        names = [r.column for r in preview.ranges]
        texts = [
            text for part in parts if part.table in ("", preview.table) for text in part.columns.values()
        ]
        valid = [text for text in texts if is_valid_expression(text, (*names, ROW))]
        read = {column for text in valid for column in compile_expression(text, (*names, ROW)).columns}
        unread |= {preview.table: left} if (left := tuple(c for c in names if c not in read)) else {}
    return unread


def _imported(request: Request, progress: ImportProgress, proposal: Proposal) -> Drive:
    choice = replace(request.choice, tables={**proposal.tables, **request.choice.tables})
    changed = replace(request, maps=[*proposal.maps, *request.maps], choice=choice)
    return import_drive(changed, "proposal", progress, raw=True).drive


def beginnings(log: Log) -> dict[str, pl.DataFrame]:
    wanted = {name: table.columns for name, table in log.tables.items() if table.columns}
    rows: dict[str, pl.DataFrame] = {name: pl.DataFrame() for name in log.tables}
    for some in [wanted] if log.mixed else [{name: columns} for name, columns in wanted.items()]:
        seen = 0
        for table, batch, _ in log.batches(some):
            seen += len(batch)
            before = rows[table]
            new = batch.head(max(PREVIEW_ROWS - len(before), 0))
            rows[table] = pl.concat([before, new], how="vertical_relaxed") if len(before) else new
            if seen >= MAX_SCANNED_ROWS or all(len(rows[name]) >= PREVIEW_ROWS for name in some):
                break
    return rows


def _ranges(rows: pl.DataFrame) -> Iterator[Range]:
    for values in rows:
        filled = values.drop_nulls()
        example = str(filled.first() if len(filled) else "")
        numbers = column_numbers(filled)
        shape = (numbers.min(), numbers.median(), numbers.max()) if len(numbers) else (None, None, None)
        low, middle, high = (None if v is None else float(v) for v in shape)  # type: ignore[arg-type]
        yield Range(values.name, low, middle, high, example)
