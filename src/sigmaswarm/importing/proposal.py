"""Propose mappings for unrecognized columns by their names, values and units.

None of these is reliable evidence of signs and units, so a proposal is shown but never applied.
"""

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import polars as pl

from sigmaswarm.importing.completion import Beginnings
from sigmaswarm.importing.expressions import compile_expression, is_valid_expression
from sigmaswarm.importing.opening import Plan
from sigmaswarm.importing.quantities import RATE, in_units, increments
from sigmaswarm.importing.source import Log, Role, texts_of
from sigmaswarm.importing.table_columns import column_numbers
from sigmaswarm.importing.times import rising_time, sample_rate, span_of_table, time_of_rows
from sigmaswarm.importing.unnamed import columns_by_units, columns_by_values
from sigmaswarm.importing.word_meanings import propose_columns

IMU_RATES = (10, 20, 25, 40, 50, 100, 104, 125, 200, 208, 250, 400, 416, 500, 800, 1000)  # Hz, usual rates
MAX_LONGER = 0.03  # largest relative difference between the durations of IMU and fixes


@dataclass(frozen=True)
class Proposal:
    tables: Mapping[Role, str]  # the chosen table, if a log has several
    columns: Mapping[Role, Mapping[str, str]]  # expressions of a drive's columns

    @property
    def maps(self) -> list[str]:
        return [
            f"{f'{role}.' if name == 't' else ''}{name}={text}"
            for role, columns in self.columns.items()
            for name, text in columns.items()
        ]

    @property
    def settings(self) -> dict[str, Mapping[str, str]]:
        """The proposal as settings of `import_log`, with the role of each column."""
        maps = {
            f"{role}.{name}": text for role, texts in self.columns.items() for name, text in texts.items()
        }
        return {"maps": maps, "tables": {**self.tables}}

    @property
    def options(self) -> str:
        """The proposal as options, quoted so that a shell does not run text from a log's header."""
        tables = [f"--{role}-table {shlex.quote(table)}" for role, table in self.tables.items()]
        return " ".join([*tables, *["--map"] * bool(self.maps), *map(shlex.quote, self.maps)])


@dataclass(frozen=True)
class _Sensor:
    """The table of a role, with its known columns and the proposed ones, as expressions."""

    role: Role
    log: Log
    table: str  # "" if it is unknown
    rows: pl.DataFrame  # first rows of the table
    known: Mapping[str, str]
    proposed: Mapping[str, str]
    key: str = ""  # a column that the expressions use, and that the role's rows therefore fill
    chosen: bool = False  # True if the proposal chooses the table

    @property
    def columns(self) -> dict[str, str]:
        return {**self.known, **self.proposed}

    def shares_table(self, other: "_Sensor") -> bool:
        return (self.log.path, self.table) == (other.log.path, other.table)

    def in_table(self, first: Beginnings) -> "_Sensor":
        """Return the sensor in the only table of its log if the table is unknown, as for columns mapped by the user."""
        tables = first[self.log.path]
        return self if self.table or len(tables) != 1 else replace(self, table=next(iter(tables)))

    def with_time(self, time: str) -> "_Sensor":
        return replace(self, proposed={"t": time, **self.proposed})


def propose(plan: Plan, first: Beginnings) -> Proposal | None:
    """Propose columns of IMU and fixes that the recipe lacks. Return None if there are none."""
    imu, gps = (_with_columns("imu", plan, first), _with_columns("gps", plan, first))
    imu, gps = (_with_own_time(one, (imu, gps)) if one.proposed else one for one in (imu, gps))
    if time := _time_by_rows(imu, gps, first):
        shared = gps.in_table(first).shares_table(imu.in_table(first)) and "t" not in gps.columns
        imu, gps = imu.with_time(time), gps.with_time(time) if shared else gps
    found = {one.role: one.proposed for one in (imu, gps) if one.proposed}
    return Proposal({one.role: one.table for one in (imu, gps) if one.chosen}, found) if found else None


def _with_columns(role: Role, plan: Plan, first: Beginnings) -> _Sensor:
    """Find columns by names or, if the recipe has no columns of the role, also by values, increments or units."""
    log, parts = plan.log(role), plan.parts(role)
    there, known = first[log.path], texts_of(parts)
    frames = {table: there[table] for table in [p.table for p in parts if p.table in there] or there}
    names = {table: frame.columns for table, frame in frames.items()}

    def by(find: Callable[[pl.DataFrame], dict[str, str]]) -> tuple[str, dict[str, str]] | None:
        found = ((table, find(frame)) for table, frame in frames.items() if not known)
        return next((one for one in found if one[1]), None)

    proposed = (
        by(lambda frame: columns_by_values(frame, role))
        or propose_columns(names, role, known)
        or by(lambda frame: increments(frame.columns) if role == "imu" else {})
        or by(lambda frame: columns_by_units(frame, role))
    )
    table, columns = proposed or (parts[0].table if parts else "", {})
    rows = there.get(table, pl.DataFrame())
    sensor = _Sensor(role, log, table, rows, known, {}, _key({**known, **columns}, rows.columns))
    if proposed is None:
        return sensor
    rest = _elsewhere(names, table, {**known, **columns}) if role == "imu" and not parts else {}
    chosen = not parts and len(there) > 1 and not rest
    return replace(sensor, proposed=in_units(rows, role, columns) | rest, chosen=chosen)


def _with_own_time(sensor: _Sensor, both: Sequence[_Sensor]) -> _Sensor:
    """Add the time of the table, and write the rate into expressions of increments."""
    keys: dict[Role, str] = {one.role: one.key for one in both if one.shares_table(sensor) and one.key}
    if "t" not in sensor.known and len(sensor.rows):
        time = time_of_rows(sensor.rows, sensor.role, keys, "imu" if "imu" in keys else sensor.role)
        sensor = sensor.with_time(time.expression) if time and time.expression else sensor
    rate = sample_rate(sensor.rows, sensor.columns.get("t")) or 0.0
    proposed = {name: text.replace(RATE, f"{rate:.6g}") for name, text in sensor.proposed.items()}
    return replace(sensor, proposed=proposed)


def _time_by_rows(imu: _Sensor, gps: _Sensor, first: Beginnings) -> str:
    """Return the time of an IMU without a time: an unnamed clock, or the row number and the duration of the fixes."""
    table, places = (one.in_table(first).table for one in (imu, gps))
    rows = first[imu.log.path].get(table, pl.DataFrame())
    timed = "t" in imu.columns or not (table and places and {"ax", "gz"} <= imu.columns.keys())
    if timed or time_of_rows(rows, "imu", {}, "imu") is not None:
        return ""
    if time := rising_time(rows, "imu"):
        return time
    steps = (column_numbers(values).diff().drop_nulls() for values in rows)
    counted = any(len(of) and (of > 0).all() for of in steps)  # a counter is better than row numbers
    return "" if counted else _time_of_fixes(imu.log, table, gps.log, places, gps.columns.get("t", ""))


def _time_of_fixes(log: Log, table: str, fixes: Log, places: str, time: str) -> str:
    """Return the IMU's time as an expression of its row number, at a usual rate that fits the duration of the fixes."""
    if not time or not log.tables[table].columns:
        return ""
    count = sum(len(rows) for _, rows, _ in log.batches({table: log.tables[table].columns[:1]}))
    begin, end = span_of_table(fixes, places, time)
    if not count or not 0 < end - begin < math.inf:
        return ""
    rate = min(IMU_RATES, key=lambda r: abs(math.log(count / r / (end - begin))))
    begins = f"{begin:.10g} + " if begin else ""
    return f"{begins}row/{rate}" if abs(count / rate - (end - begin)) < MAX_LONGER * (end - begin) else ""


def _key(texts: Mapping[str, str], columns: Sequence[str]) -> str:
    for name in ("ax", "gz", "lat", "x"):
        if name in texts and is_valid_expression(texts[name], columns):
            return next(iter(compile_expression(texts[name], columns).columns), "")
    return ""


def _elsewhere(names: Mapping[str, Sequence[str]], table: str, known: Mapping[str, str]) -> dict[str, str]:
    """Find missing IMU columns in another table. Return {} if several tables have columns of these names."""
    others = {other: columns for other, columns in names.items() if other != table}
    if {"ax", "ay", "gz"} <= known.keys() or (proposed := propose_columns(others, "imu", known)) is None:
        return {}
    chosen, texts = proposed
    rest = [columns for other, columns in names.items() if other != chosen]
    return {} if any(is_valid_expression(t, columns) for t in texts.values() for columns in rest) else texts
