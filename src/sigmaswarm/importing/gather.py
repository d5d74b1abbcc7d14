"""Evaluate the expressions of a drive's columns for the batches of a log. Unusable rows are left out and counted."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from shlex import quote

import numpy as np
import polars as pl
from scipy.sparse.csgraph import connected_components

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Mask
from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import SECOND, Nanoseconds
from sigmaswarm.importing.expressions import (
    ROW,
    Expression,
    compile_expression,
    time_expression,
    with_row_numbers,
)
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.opening import Plan
from sigmaswarm.importing.quantities import MAX_QUARTILE_RATIO
from sigmaswarm.importing.source import ImportProgress, Limits, Log, Part, Role
from sigmaswarm.importing.table_columns import MAX_DAMAGED_SHARE, NO_NUMBER, NO_VALUE, is_huge, is_placeholder
from sigmaswarm.wording import count_of, printable, quoted, rows_left_out

MAX_FAULTS = 3  # largest number of faults in one message
# Largest number of rows without a time that count as lines of a header or a footer
MAX_TIMELESS_ROWS = 10
# Smallest distance of a placeholder from the median of the other values, in units of their 1% to 99% range
MIN_PLACEHOLDER_DISTANCE = 10
# Smallest 5% quantile of the magnitude of a specific force with gravity, relative to its upper quartile
MIN_FORCE = 0.3
# Smallest share of the rows of a column of a sensor in which another column of this sensor has a value
MIN_COMMON_ROWS = 0.7
# A number with a unit
_UNIT = re.compile(r"[+-]?\d*[.,]?\d+ ?(?!e[+-]?\d)([A-Za-z°µμ%][\w/²³°^*·.-]*)")
MAX_ROW_STEPS = 3.0  # largest step between the rows of a slower sensor, in median steps


def _is_every_nth(known: Mask) -> bool:
    """Return True if a column has values in every n-th row (n > 1), even if some of these values are missing."""
    steps = np.diff(np.flatnonzero(known))
    return len(steps) > 0 and 1 < float(np.median(steps)) >= float(steps.max()) / MAX_ROW_STEPS


@dataclass
class PartColumns:
    """Columns of a part: ``t``, ns, and others. A value is null where the log has none."""

    part: Part
    expressions: dict[str, Expression]
    rows: list[pl.DataFrame] = field(default_factory=list[pl.DataFrame])
    seen: int = 0
    unkept: int = 0  # number of rows for which ``keep`` is false
    timeless: int = 0  # number of rows without a time
    # For each column of the table: the placeholder of missing values, and its count
    placeholders: dict[str, tuple[float, int]] = field(default_factory=dict[str, tuple[float, int]])
    counted: bool = False  # True if the time is computed from row numbers alone
    # If the time is computed from row numbers: names and cells of the columns that may be clocks
    clocks: tuple[str, ...] = ()
    others: list[pl.DataFrame] = field(default_factory=list[pl.DataFrame])

    def add(self, frame: pl.DataFrame, log: Log) -> None:
        frame = frame.with_columns(pl.col(pl.String).str.strip_chars())
        self.others += [frame.select(self.clocks)] if self.clocks else []
        frame = with_row_numbers(frame, self.seen)
        self._require_numbers(frame, log)
        self.seen += len(frame)
        frame = self._without_placeholders(frame)
        try:
            if (keep := self.expressions.get("keep")) is not None:
                kept = frame.filter(keep.truth.fill_null(False))
                self.unkept += len(frame) - len(kept)
                frame = kept
            values = {
                n: e.polars.cast(pl.Float64) for n, e in self.expressions.items() if n not in ("t", "keep")
            }
            time = time_expression(self.part.columns["t"], frame)
            rows = frame.lazy().select(t=time, **values).collect()
        except pl.exceptions.PolarsError as error:  # a list instead of a number, a text that is not a date
            reason = printable(" ".join(str(error).split("\n")[0].split()), 160)
            raise InputError(
                f"{log.path}, {self.part.table}: the columns can't be converted to numbers ({reason}); map other "
                "columns"
            ) from None
        usable = rows.filter(pl.col("t").is_not_null())
        self.timeless += len(rows) - len(usable)
        self.rows += [usable] if len(usable) else []

    @property
    def duration(self) -> float:
        """Sum of the forward steps of the time, s, which wraps of a counter hardly change."""
        steps = pl.concat(self.rows)["t"].diff() if self.rows else pl.Series([0])
        return float(steps.filter(steps > 0).sum()) / SECOND

    def omissions(self, role: Role) -> Iterator[str]:
        """Yield sentences on rows and values that are left out."""
        table = printable(self.part.table)
        if self.unkept:
            keep = f"since {self.part.columns['keep']} is not true"
            yield f"{role}: {self.unkept} of {self.seen} rows of {table} are left out, {keep}"
        if self.timeless:
            yield f"{role}: {rows_left_out(self.timeless, f' of {table}')}, since the time is missing"
        for name, (value, count) in self.placeholders.items():
            are = "is" if count == 1 else "are"
            values = f"{count_of(count, 'value')} of {printable(name)} {are} left out"
            yield f"{role}: {table}: {values}, since {value:g} is a placeholder"

    def finish(self) -> tuple[Nanoseconds, dict[str, Array]]:
        """Return the times (n,), ns, and the columns (n,), NaN where the log has no value."""
        if not self.rows:
            return np.zeros(0, np.int64), {}
        whole = pl.concat(self.rows)
        self.rows.clear()
        columns = {name: whole[name].fill_null(np.nan) for name in whole.columns[1:]}
        time = whole["t"].to_numpy().astype(np.int64)
        return time, {name: column.to_numpy().astype(np.float64) for name, column in columns.items()}

    def separated(self, required: Collection[str]) -> "list[PartColumns]":
        """Return a part for each group of columns with values in the same rows, since two sensors may share a table.

        The part with the most rows is the first. Optional columns that belong to no required column stay in it.
        """
        if not self.rows:
            return [self]
        whole = pl.concat(self.rows)
        self.rows, names = [whole], whole.columns[1:]
        filled = whole.select(pl.col(names).is_finite().fill_null(False))
        if not names or all(filled.select(pl.all().all()).row(0)):
            return [self]
        known = filled.cast(pl.Float64).to_numpy()
        common = known.T @ known  # number of rows with both columns
        rows = np.diag(common)
        steady = np.array([_is_every_nth(column > 0) for column in known.T], dtype=np.bool_)
        sparser = np.where(np.less.outer(rows, rows), steady[:, None], steady)
        most, fewest = np.maximum.outer(rows, rows), np.minimum.outer(rows, rows)
        # a column with gaps belongs to the sensor of the other column; one in every n-th row may be a slower sensor
        shared = np.where(sparser, most, fewest)
        group = connected_components(common >= np.maximum(MIN_COMMON_ROWS * shared, 1))[1]
        own = {k: [n for n, g in zip(names, group, strict=True) if g == k] for k in group}
        sensors = [some for some in own.values() if not {*required}.isdisjoint(some)]
        count = dict(zip(names, rows, strict=True))
        if len(sensors) < 2 or any(not count[name] for name in names if name in required):
            return [self]
        sensors.sort(key=lambda some: -int(count[some[0]]))
        sensors[0] += [n for n in names if not any(n in some for some in sensors)]
        self.rows, *others = [
            [whole.select("t", *some).filter(pl.any_horizontal(pl.col(some).is_finite()))] for some in sensors
        ]
        return [self, *(PartColumns(self.part, self.expressions, rows) for rows in others)]

    def _require_numbers(self, frame: pl.DataFrame, log: Log) -> None:
        texts = {c for e in self.expressions.values() for c in e.numbers if frame.schema[c] == pl.String}
        timeless = self._few_timeless(frame) if texts else None
        for name in sorted(texts, key=log.tables[self.part.table].columns.index):
            cells = frame[name]
            empty = cells.str.to_lowercase().is_in(NO_VALUE) | cells.str.contains(NO_NUMBER)
            wrong = cells.cast(pl.Float64, strict=False).is_null() & ~empty
            wrong = wrong & ~timeless if timeless is not None else wrong
            if wrong.fill_null(False).any():
                i = int(wrong.fill_null(False).arg_max() or 0)
                stated = [_UNIT.fullmatch(str(frame[other][i])) for other in sorted(texts)]
                if units := "|".join(dict.fromkeys(re.escape(cell[1]) for cell in stated if cell)):
                    edit = f"sed -E 's#([0-9]) ?({units})#\\1#g' {quote(self.part.table)} > new.csv"
                    raise InputError(
                        f"{log.path}, {printable(self.part.table)}, column {printable(name)}: {quoted(cells[i])} has a "
                        f"unit; write the units to the header, and remove them from the cells, for example with: {edit}"
                    )
                raise InputError(
                    f"{log.path}, {printable(self.part.table)}, row {self.seen + i + 1} of the data, "
                    f"column {printable(name)}: {quoted(cells[i])} is not a number; correct or delete "
                    "the row, or map the column with utc(...) for dates, or dms(...) for degrees and minutes"
                )

    def _few_timeless(self, frame: pl.DataFrame) -> pl.Series | None:
        """Mark rows without a time, such as a repeated header or lines below the table.

        Return None if there are many.
        """
        try:
            times = frame.select(time_expression(self.part.columns["t"], frame)).to_series()
        except pl.exceptions.PolarsError:
            return None
        few = times.null_count() <= max(MAX_TIMELESS_ROWS, MAX_DAMAGED_SHARE * len(frame))
        return times.is_null() if few else None

    def _without_placeholders(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Set placeholders such as -999 to null if they are far from the other values, or equal in both coordinates."""
        used = {n: e.numbers for n, e in self.expressions.items() if n not in ("t", "keep")}
        names = [c for c in sorted(set().union(*used.values())) if not frame.schema[c].is_nested()]
        numbers = frame.select(pl.col(names).cast(pl.Float64, strict=False))
        marks = {s.name: mark for s in numbers if (mark := is_placeholder(s).fill_null(False)).any()}
        alone = {name: mark & _far(numbers[name], mark) for name, mark in marks.items()}
        for first, second in (("lat", "lon"), ("x", "y")):
            pair = [c for n in (first, second) for c in used.get(n, ()) if len(used[n]) == 1]
            if len(pair) == 2 and all(c in alone for c in pair):
                both = marks[pair[0]] & (numbers[pair[0]] == numbers[pair[1]]).fill_null(False)
                alone |= {c: alone[c] | both for c in pair}
        forces = [c for n in ("ax", "ay", "az") for c in used.get(n, ()) if len(used[n]) == 1 and c in names]
        if len(forces) == 3:  # a working sensor measures gravity, so zeros show a failed bus
            squares = pl.sum_horizontal(pl.col(forces).pow(2), ignore_nulls=False)
            size = numbers.select(squares.sqrt()).to_series()
            least, low, high = (size.filter(size > 0).quantile(q) or 0.0 for q in (0.05, 0.25, 0.75))
            if least > MIN_FORCE * high and high < MAX_QUARTILE_RATIO * low:
                alone[forces[0]] = alone.get(forces[0], False) | (size == 0).fill_null(False)
        for column in used.get("speed", frozenset()) & {*names} if "lat" in used else ():
            invalid = (numbers[column] == -1).fill_null(False)  # phones write -1 for an unknown speed
            marked = invalid | alone.get(column, False)
            if not (numbers[column].filter(~marked) < -0.5).any():
                alone[column] = marked
        for column, mark in alone.items():
            if count := int(mark.sum()):
                value = float(numbers[column].filter(mark)[0])
                self.placeholders[column] = (value, self.placeholders.get(column, (value, 0))[1] + count)
                frame = frame.with_columns(pl.when(~mark).then(pl.col(column)).alias(column))
        return frame


def _far(numbers: pl.Series, marked: pl.Series) -> pl.Series:
    """Mark values that are far from the median of the values not yet ``marked``, relative to their 1% to 99% range."""
    rest = numbers.filter(~marked).drop_nulls().drop_nans()
    if not len(rest):
        return is_huge(numbers).fill_null(False)
    low, middle, high = (float(rest.quantile(q) or 0.0) for q in (0.01, 0.5, 0.99))
    return ((numbers - middle).abs() > MIN_PLACEHOLDER_DISTANCE * (high - low) + 1e-9).fill_null(False)


def gather(log: Log, parts: Sequence[Part], progress: ImportProgress, limits: Limits) -> list[PartColumns]:
    gathered: list[PartColumns] = []
    wanted: dict[str, set[str]] = {}
    for part in parts:
        columns = log.tables[part.table].columns
        texts = {name: compile_expression(text, (*columns, ROW)) for name, text in part.columns.items()}
        used = {c for expression in texts.values() for c in expression.columns}
        counted = texts["t"].columns == frozenset((ROW,)) and ROW not in columns
        clocks = tuple(c for c in columns if counted and read_name(c).meaning in (None, "t"))
        wanted.setdefault(part.table, set()).update({*clocks, *used} & {*columns})
        gathered.append(PartColumns(part, texts, counted=counted, clocks=clocks))
    for table, rows, done in log.batches(wanted):
        for columns in gathered:
            if columns.part.table == table:
                columns.add(rows, log)
                limits.check_rows(columns.seen, log.path, table)
        progress(done)
    return gathered


Gathered = dict[Role, list[PartColumns]]


def gather_all(plan: Plan, progress: ImportProgress = lambda done: None) -> Gathered:
    """Read the columns of all roles of a plan with tables. ``progress`` receives the fraction that has been read."""
    gathered: Gathered = {}
    sizes = {path: _size(path) for path in plan.logs}
    total, before = sum(sizes.values()), 0
    for path, log in plan.logs.items():
        mine: list[Role] = [role for role in plan.recipe.roles if plan.request.home(role) == path]
        share = _share(progress, before / total, sizes[path] / total)
        read = iter(
            gather(log, [part for role in mine for part in plan.parts(role)], share, plan.request.limits)
        )
        gathered |= {role: [next(read) for _ in plan.parts(role)] for role in mine}
        before += sizes[path]
    return gathered


def durations(gathered: Mapping[Role, Sequence[PartColumns]]) -> dict[Role, float]:
    """Return the durations of IMU and fixes, s."""
    return {role: parts[0].duration for role, parts in gathered.items() if role in ("imu", "gps")}


def joined_faults(faults: Sequence[str]) -> str:
    return "; and ".join(faults[:MAX_FAULTS])


def _share(progress: ImportProgress, begin: float, part: float) -> ImportProgress:
    return lambda done: progress(begin + part * done)


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]
    return max(sum(f.stat().st_size for f in files), 1)
