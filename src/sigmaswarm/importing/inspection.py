"""Inspect a log: list its tables with rates and ranges of columns, and find the recipe of a drive."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing import convert
from sigmaswarm.importing.assemble import missing_columns
from sigmaswarm.importing.convert import complete_recipe
from sigmaswarm.importing.dates import SECOND
from sigmaswarm.importing.expressions import compile_expression, is_valid_expression, time_expression
from sigmaswarm.importing.gather import ROW, with_row_numbers
from sigmaswarm.importing.gravity import tilted_mount
from sigmaswarm.importing.guess import Z_DOWN
from sigmaswarm.importing.joining import EVER, without_overlap
from sigmaswarm.importing.opening import Request, opened
from sigmaswarm.importing.proposal import Proposal, check_proposal, propose_columns, reversed_forces
from sigmaswarm.importing.quantities import RATE, in_units, increments
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import ROLES, Fault, ImportProgress, Log, Part, Role
from sigmaswarm.importing.table_columns import column_numbers
from sigmaswarm.importing.times import rising_time, time_of, time_of_rows
from sigmaswarm.importing.unnamed import columns_by_units, columns_by_values

PREVIEW_ROWS = 5000  # number of first rows of a table from which ranges are computed
IMU_RATES = (10, 20, 25, 40, 50, 100, 104, 125, 200, 208, 250, 400, 416, 500, 800, 1000)  # Hz, usual rates
MAX_LONGER = 0.03  # largest relative difference between the durations of IMU and fixes
# Largest number of rows that are read if the rows of tables alternate; tables that begin later are shown without values
MAX_SCANNED_ROWS = 25_000


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

    ``proposal``: options of `sigmaswarm import` for unrecognized columns; ``settings``: the same options for
    `import_log`; ``evidence``: reasons for these options. ``works``: True if the import with these options succeeds, or
    if there is no proposal and no note states a fault of tables or columns. ``unread``: columns, by table, that neither
    recipe nor proposal reads. ``faults``: reasons not to use a column unchanged. ``rows``: first rows of each table.
    ``mount``: mounting that a note recommends.
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


Beginnings = Mapping[Path, Mapping[str, pl.DataFrame]]


def inspect_request(request: Request, progress: ImportProgress = lambda done: None) -> Inspection:
    """Read the beginning of each log; faults become notes, and nothing is written.

    A proposal is checked on the whole log; ``progress`` then receives the fraction that has been read, 0 to 1.
    """
    with opened(request) as (logs, guesses):
        try:
            recipe = complete_recipe(request, guesses)
            notes = convert.faults_left(request, recipe, logs, guesses)
        except InputError as error:
            recipe, notes = request.recipe, [str(error)]
        times = {
            (request.home(role), part.table): part.columns["t"]
            for role in ROLES
            for part in recipe.roles.get(role, ())
            if "t" in part.columns
        }
        first: Beginnings = {path: beginnings(log) for path, log in logs.items()}
        tables = [
            TablePreview(
                name, table.kind, table.rows, _rate(rows, times.get((path, name))), tuple(_ranges(rows))
            )
            for path, log in logs.items()
            for name, table in log.tables.items()
            for rows in [first[path][name]]
        ]
        proposal = _proposal(request, recipe, first, logs)
        if not notes and not proposal:
            notes = _obstacles(request, recipe, logs, guesses, first)
        works = not notes
        rows = {name: frame for tables_of in first.values() for name, frame in tables_of.items()}
        down = not recipe.mount and any(guess.downward for guess in guesses.values())
        mount, tilted = tilted_mount(recipe, first[request.home("imu")], downward=down)
        assumed = (tilted,) if tilted else convert.assumed_mounting(guesses, recipe)
        notes += (*convert.notes_of(request, logs, guesses, recipe), *assumed)
    if (
        down
        and works
        and not proposal
        and (forces := reversed_forces(recipe.roles["imu"], partial(_imported, request, progress)))
    ):
        proposal, down = forces, False
        notes = tuple(n for n in notes if f"--mount {Z_DOWN}" not in n)
    evidence = ""
    if proposal:
        proposal, evidence, works = check_proposal(proposal, partial(_imported, request, progress))
        if "row/" in proposal.columns.get("imu", {}).get("t", ""):
            evidence += (
                "; imu.t assumes a constant rate, and that the rows of the IMU begin and end with the fixes"
            )
    unread = _unread(tables, recipe, proposal)
    options, settings = (proposal.options, proposal.settings) if proposal else ("", {})
    faults = tuple(fault for guess in guesses.values() for fault in guess.faults)
    whole = tuple(tables), recipe, tuple(dict.fromkeys(notes))
    mount = mount or (Z_DOWN if down else "")
    return Inspection(*whole, options, evidence, works, unread, faults, rows, settings, mount)


def _obstacles(
    request: Request, recipe: Recipe, logs: Mapping[Path, Log], guesses: convert.Guesses, first: Beginnings
) -> list[str]:
    if missing := convert.missing_sensor(recipe, request, logs, guesses, ROLES):
        return [missing]
    completed, faults = convert.complete_all(request, logs, recipe, first)
    home = request.home("imu")
    parts = [part for role, part in completed[home] if role == "imu" and "t" in part.columns]
    spans = [_span(first[home][part.table], part.columns["t"]) for part in parts[1:] and parts]
    if without_overlap("imu", parts, spans):  # the first rows may end before the other table begins
        whole = (_batches_of(logs[home], part) for part in parts)
        ends = [
            [_span(rows, part.columns["t"]) for rows in batches]
            for part, batches in zip(parts, whole, strict=True)
        ]
        spans = [(min(low for low, _ in of), max(high for _, high in of)) for of in ends]
    if apart := without_overlap("imu", parts, spans):
        faults.append(f"{request.log}: {apart}")
    return faults or [f"{request.log}: {message}" for message in missing_columns(recipe)]


def _batches_of(log: Log, part: Part) -> Iterator[pl.DataFrame]:
    columns = log.tables[part.table].columns
    used = compile_expression(part.columns["t"], (*columns, ROW)).columns & {*columns}
    yield from (rows for _, rows, _ in log.batches({part.table: used or columns}))


def _span(rows: pl.DataFrame, time: str) -> tuple[float, float]:
    """Return the earliest and the latest time of the rows, s."""
    if rows.is_empty():
        return EVER
    numbered = with_row_numbers(rows)
    try:
        times = numbered.select(time_expression(time, numbered).alias("t"))["t"].drop_nulls()
    except pl.exceptions.PolarsError:  # a list, or a text that is not a date
        return EVER
    if not len(times):
        return EVER
    low, high = (float(v) / SECOND for v in (times.min(), times.max()))  # pyright: ignore[reportArgumentType]
    return low, high


def _unread(
    tables: Sequence[TablePreview], recipe: Recipe, proposal: Proposal | None
) -> dict[str, tuple[str, ...]]:
    parts = [part for role in recipe.roles.values() for part in role]
    unread: dict[str, tuple[str, ...]] = {}
    for preview in tables:
        names = [r.column for r in preview.ranges]
        texts = [
            text for part in parts if part.table in ("", preview.table) for text in part.columns.values()
        ]
        texts += [t for columns in (proposal.columns if proposal else {}).values() for t in columns.values()]
        known = (*names, ROW)
        read = {
            c
            for text in texts
            if is_valid_expression(text, known)
            for c in compile_expression(text, known).columns
        }
        unread |= {preview.table: left} if (left := tuple(c for c in names if c not in read)) else {}
    return unread


def _imported(request: Request, progress: ImportProgress, proposal: Proposal) -> Drive:
    choice = replace(request.choice, tables={**proposal.tables, **request.choice.tables})
    changed = replace(request, maps=[*proposal.maps, *request.maps], choice=choice)
    return convert.import_drive(changed, "proposal", progress, raw=True).drive


def _proposal(
    request: Request, recipe: Recipe, first: Beginnings, logs: Mapping[Path, Log]
) -> Proposal | None:
    tables: dict[Role, str] = {}
    found: dict[Role, Mapping[str, str]] = {}
    roles: tuple[Role, ...] = ("imu", "gps")
    # for each role: log, table, known columns, and proposed columns
    used: dict[Role, tuple[Path, str, Mapping[str, str], Mapping[str, str]]] = {}
    for role in roles:
        there = first[request.home(role)]
        parts = recipe.roles.get(role, ())
        known = {name: text for part in parts for name, text in part.columns.items()}
        chosen = [part.table for part in parts if part.table in there] or list(there)
        names = {table: there[table].columns for table in chosen}
        unnamed = ((table, columns_by_values(there[table], role)) for table in chosen)
        summed = ((table, increments(columns)) for table, columns in names.items() if role == "imu")
        stated = ((table, columns_by_units(there[table], role)) for table in chosen)
        by_values, by_sums, by_units = (
            None if known else next((f for f in found if f[1]), None) for found in (unnamed, summed, stated)
        )
        proposed = by_values or propose_columns(names, role, known) or by_sums or by_units
        table, columns = proposed or (parts[0].table if parts else "", {})
        used[role] = request.home(role), table, known, columns
        if proposed is None:
            continue
        rest = _elsewhere(names, table, {**known, **columns}) if role == "imu" and not parts else {}
        found[role] = in_units(there[table], role, columns) | rest
        if not parts and len(there) > 1 and not rest:
            tables[role] = table
    for role in found:
        path, table, known, _ = used[role]
        rows, keys = first[path][table], dict[Role, str]()
        for other in roles:
            if used[other][:2] == (path, table) and (key := _key({**used[other][2], **used[other][3]}, rows)):
                keys[other] = key
        if "t" not in known and len(rows):
            time = time_of_rows(rows, role, keys, "imu" if "imu" in keys else role)
            found[role] = ({"t": time.expression} if time and time.expression else {}) | {**found[role]}
        rate = _rate(rows, found[role].get("t", known.get("t"))) or 0.0
        found[role] = {name: text.replace(RATE, f"{rate:.6g}") for name, text in found[role].items()}
    path, table, known, _ = used["imu"]
    home, places, *_ = used["gps"]
    # columns that are mapped by hand belong to the only table
    table, places = table or _only(first[path]), places or _only(first[home])
    imu, fixes = {**known, **found.get("imu", {})}, {**used["gps"][2], **found.get("gps", {})}
    rows = first[path].get(table, pl.DataFrame())
    if (
        table
        and places
        and {"ax", "gz"} <= imu.keys()
        and "t" not in imu
        and time_of_rows(rows, "imu", {}, "imu") is None
    ):
        time = rising_time(rows, "imu")
        steps = [column_numbers(values).diff().drop_nulls() for values in rows]
        if not time and not any(
            len(of) and (of > 0).all() for of in steps
        ):  # a counter is better than row numbers
            time = _time_of_fixes(logs[path], table, logs[home], places, fixes.get("t", ""))
        shared = used["gps"][:2] == (path, table) and "t" not in fixes
        for role in ("imu", "gps")[: 1 + shared] if time else ():
            found[role] = {"t": time, **found.get(role, {})}
    return Proposal(tables, found) if found else None


def _only(tables: Mapping[str, pl.DataFrame]) -> str:
    return next(iter(tables)) if len(tables) == 1 else ""


def _time_of_fixes(log: Log, table: str, fixes: Log, places: str, time: str) -> str:
    """Return the IMU's time as an expression of its row number, at the usual rate with the duration of the fixes."""
    if not time or not log.tables[table].columns:
        return ""
    count = sum(len(rows) for _, rows, _ in log.batches({table: log.tables[table].columns[:1]}))
    spans = [_span(rows, time) for rows in _batches_of(fixes, Part(places, {"t": time}))]
    begin, end = min((low for low, _ in spans), default=0.0), max((high for _, high in spans), default=0.0)
    if not count or not 0 < end - begin < math.inf:
        return ""
    rate = min(IMU_RATES, key=lambda r: abs(math.log(count / r / (end - begin))))
    begins = f"{begin:.10g} + " if begin else ""
    return f"{begins}row/{rate}" if abs(count / rate - (end - begin)) < MAX_LONGER * (end - begin) else ""


def _key(texts: Mapping[str, str], rows: pl.DataFrame) -> str:
    """Return a column that a role's expressions use, and that the role's rows therefore fill; "" if there is none."""
    for name in ("ax", "gz", "lat", "x"):
        if name in texts and is_valid_expression(texts[name], rows.columns):
            return next(iter(compile_expression(texts[name], rows.columns).columns), "")
    return ""


def _elsewhere(names: Mapping[str, Sequence[str]], table: str, known: Mapping[str, str]) -> dict[str, str]:
    """Find missing IMU columns in another table; return {} if several tables have columns of these names."""
    others = {other: columns for other, columns in names.items() if other != table}
    if {"ax", "ay", "gz"} <= known.keys() or (proposed := propose_columns(others, "imu", known)) is None:
        return {}
    chosen, texts = proposed
    rest = [columns for other, columns in names.items() if other != chosen]
    return {} if any(is_valid_expression(t, columns) for t in texts.values() for columns in rest) else texts


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


def _rate(rows: pl.DataFrame, time: str | None) -> float | None:
    """Return the rate, Hz, from the median time step; None if the table has no time."""
    if len(rows) < 2 or (time := time or time_of(rows)) is None:
        return None
    try:
        numbered = with_row_numbers(rows)
        steps = numbered.select(time_expression(time, numbered).alias("t"))["t"].diff().drop_nulls()
    except pl.exceptions.PolarsError:  # a list, or a text that is not a date
        return None
    step = steps.filter(steps > 0).median()
    return SECOND / step if isinstance(step, int | float) and step > 0 else None


def _ranges(rows: pl.DataFrame) -> Iterator[Range]:
    for values in rows:
        filled = values.drop_nulls()
        example = str(filled.first() if len(filled) else "")
        numbers = column_numbers(filled)
        shape = (numbers.min(), numbers.median(), numbers.max()) if len(numbers) else (None, None, None)
        low, middle, high = (None if v is None else float(v) for v in shape)  # type: ignore[arg-type]
        yield Range(values.name, low, middle, high, example)
