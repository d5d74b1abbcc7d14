"""From a log's batches to a drive's columns: expressions evaluated, rows that can't be used left out and counted."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import polars as pl

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.importing.clocks import Nanoseconds, time_expression
from sigmaswarm.importing.expressions import compile_expression
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.quantities import PLACEHOLDERS
from sigmaswarm.importing.source import Part, Progress, Source
from sigmaswarm.wording import names_shown, quoted, shown

ROW = "row"
"""The number of a row, from 0, as a column of every table that has none of this name."""
FAR = 10
"""Times the spread of a column: farther from the others than this, a placeholder is no value."""
NO_VALUE = ("", "nan", "null", "none", "na", "n/a", "-")
"""Texts that mean a cell is empty."""


@dataclass
class Columns:
    """Columns of a part, gathered in chunks.

    Attributes
    ----------
    time : (n,) ns
    values : by name, each (n,); NaN where the log has none
    unkept, timeless : rows left out since ``keep`` is false, since they have no time
    placeholders : by column of the table, the marker of missing values, and its count
    """

    part: Part
    time: Nanoseconds = field(default_factory=lambda: np.zeros(0, np.int64))
    values: dict[str, Array] = field(default_factory=dict[str, Array])
    unkept: int = 0
    timeless: int = 0
    seen: int = 0
    placeholders: dict[str, tuple[float, int]] = field(default_factory=dict[str, tuple[float, int]])
    chunks: list[pl.DataFrame] = field(default_factory=list[pl.DataFrame])

    def add(self, frame: pl.DataFrame, source: Source) -> None:
        """Evaluate the part's expressions on some rows of its table."""
        frame = frame.with_columns(pl.col(pl.String).str.strip_chars())
        if ROW not in frame.columns:
            frame = frame.with_columns(pl.int_range(self.seen, self.seen + len(frame)).alias(ROW))
        _require_numbers(frame, self.part, source, self.seen)
        self.seen += len(frame)
        frame = self._without_placeholders(frame)
        try:
            rows = self._evaluated(frame)
        except pl.exceptions.PolarsError as error:  # a list where a number is wanted, a text that is no date
            said = shown(" ".join(str(error).split("\n")[0].split()), 160)
            raise InputError(
                f"{source.path}, {self.part.table}: its columns can't be made numbers ({said}); map others"
            ) from None
        usable = rows.filter(pl.col("t").is_not_null())
        self.timeless += len(rows) - len(usable)
        if len(usable):
            self.chunks.append(usable)

    def _without_placeholders(self, frame: pl.DataFrame) -> pl.DataFrame:
        """Null for placeholders: -999 or 1e10 far from all other values, or in both coordinates."""
        texts = {n: compile_expression(t, frame.columns).numbers for n, t in self.part.columns.items()}
        used = {c for n, columns in texts.items() if n not in ("t", "keep") for c in columns}
        numbers = {
            c: frame[c].cast(pl.Float64, strict=False)
            for c in sorted(used)
            if not frame.schema[c].is_nested()
        }
        marked = {c: values.is_in(PLACEHOLDERS).fill_null(False) for c, values in numbers.items()}
        alone = {c: mark & _far(numbers[c], mark) for c, mark in marked.items() if mark.any()}
        for first, second in (("lat", "lon"), ("x", "y")):
            pair = [next(iter(texts[n])) for n in (first, second) if len(texts.get(n, ())) == 1]
            if len(pair) == 2 and all(c in alone for c in pair):
                both = marked[pair[0]] & (numbers[pair[0]] == numbers[pair[1]]).fill_null(False)
                alone |= {c: alone[c] | both for c in pair}
        for column, mark in alone.items():
            if count := int(mark.sum()):
                value = float(numbers[column].filter(mark)[0])
                self.placeholders[column] = (value, self.placeholders.get(column, (value, 0))[1] + count)
                frame = frame.with_columns(pl.when(~mark).then(pl.col(column)).alias(column))
        return frame

    def _evaluated(self, frame: pl.DataFrame) -> pl.DataFrame:
        """The time and the values of the rows that are kept."""
        texts = dict(self.part.columns)
        keep, time = texts.pop("keep", None), texts.pop("t")
        if keep:
            kept = frame.filter(compile_expression(keep, frame.columns).truth.fill_null(False))
            self.unkept += len(frame) - len(kept)
            frame = kept
        expressions = [
            compile_expression(t, frame.columns).polars.cast(pl.Float64).alias(n) for n, t in texts.items()
        ]
        return frame.lazy().select(time_expression(time, frame).alias("t"), *expressions).collect()

    def finish(self) -> "Columns":
        """Put the chunks together."""
        if self.chunks:
            whole = pl.concat(self.chunks)
            self.chunks = []
            self.time = whole["t"].to_numpy().astype(np.int64)
            for name in whole.columns[1:]:
                self.values[name] = whole[name].fill_null(np.nan).to_numpy().astype(np.float64)
        return self


def _far(numbers: pl.Series, marked: pl.Series) -> pl.Series:
    """Where values are far from those that are not marked, by the spread of these."""
    rest = numbers.filter(~marked).drop_nulls().drop_nans()
    if not len(rest):
        return pl.zeros(len(numbers), dtype=pl.Boolean, eager=True)
    low, middle, high = (float(rest.quantile(q) or 0.0) for q in (0.01, 0.5, 0.99))
    return ((numbers - middle).abs() > FAR * (high - low) + 1e-9).fill_null(False)


def check_part(part: Part, source: Source, role: str) -> None:
    """Refuse a part whose table or columns the log does not have, or that has no time."""
    if part.table not in source.tables:
        there = names_shown(source.tables)
        raise InputError(f"{source.path}: has no {quoted(part.table)} for the {role}; there are {there}")
    if "t" not in part.columns:
        raise InputError(
            f"{source.path}: which column of {shown(part.table)} is the time of the {role} was not found; "
            "say it with --time"
        )
    columns = (*source.tables[part.table].columns, ROW)
    for text in part.columns.values():
        try:
            compile_expression(text, columns)
        except InputError as error:
            raise InputError(f"{source.path}, {shown(part.table)}: {error}") from None


def gather(
    source: Source, parts: Sequence[Part], progress: Progress, limits: Limits | None = None
) -> list[Columns]:
    """Read the log once and evaluate all parts."""
    limits = limits or Limits()
    gathered = [Columns(part) for part in parts]
    wanted: dict[str, set[str]] = {}
    for part in parts:
        columns = source.tables[part.table].columns
        for text in part.columns.values():
            used = compile_expression(text, (*columns, ROW)).columns
            wanted.setdefault(part.table, set()).update(used if ROW in columns else used - {ROW})
    for batch in source.batches(wanted):
        for columns in gathered:
            if columns.part.table == batch.table:
                columns.add(batch.rows, source)
                limits.check_rows(columns.seen, source.path, batch.table)
        progress(batch.done)
    return [columns.finish() for columns in gathered]


def _require_numbers(frame: pl.DataFrame, part: Part, source: Source, seen: int) -> None:
    """Refuse text where a number is needed, with its row."""
    used = (compile_expression(text, frame.columns).numbers for text in part.columns.values())
    texts = {n for names in used for n in names if frame.schema[n] == pl.String}
    for name in sorted(texts, key=source.tables[part.table].columns.index):
        said = frame[name]
        wrong = said.cast(pl.Float64, strict=False).is_null() & ~said.str.to_lowercase().is_in(NO_VALUE)
        if wrong.fill_null(False).any():
            i = int(wrong.fill_null(False).arg_max() or 0)
            raise InputError(
                f"{source.path}, {shown(part.table)}, row {seen + i + 1} of the data, column {shown(name)}: "
                f"{quoted(said[i])} is not a number; mend or delete the row, or use utc(...) where the column "
                "holds dates"
            )
