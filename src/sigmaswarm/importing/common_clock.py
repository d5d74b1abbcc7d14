"""Choose a time column that the tables of IMU and fixes share, if their guessed times do not overlap."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.expressions import time_expression
from sigmaswarm.importing.names import is_time, read_name
from sigmaswarm.importing.source import Part, Role
from sigmaswarm.importing.time_units import column_time

Roles = dict[Role, tuple[Part, ...]]


def on_common_clock(roles: Roles, samples: Mapping[str, pl.DataFrame]) -> tuple[Roles, list[str]]:
    """Return the roles and notes; if the tables' times do not overlap, both use a shared column whose times overlap."""
    imu, gps = ((*parts, Part("", {}))[0] for parts in (roles.get("imu", ()), roles.get("gps", ())))
    if not {"t"} <= imu.columns.keys() & gps.columns.keys() or imu.table == gps.table:
        return roles, []
    rows = samples[imu.table], samples[gps.table]
    if _overlap(rows, (imu.columns["t"], gps.columns["t"])):
        return roles, []
    for column in rows[0].columns:
        name = read_name(column)
        if column not in rows[1].columns or not is_time(name.plain):
            continue
        text, other = (
            column_time(name, rows[0], "imu").expression,
            column_time(name, rows[1], "gps").expression,
        )
        if text and text == other and _overlap(rows, (text, text)):
            apart = f"{imu.columns['t']} and {gps.columns['t']} do not overlap"
            note = f"the time of IMU and fixes is {column}, since {apart}"
            both: tuple[Role, ...] = ("imu", "gps")
            return {**roles, **{r: (_at(roles[r][0], text), *roles[r][1:]) for r in both}}, [note]
    return roles, []


def _at(part: Part, time: str) -> Part:
    return replace(part, columns={**part.columns, "t": time})


def _overlap(rows: tuple[pl.DataFrame, pl.DataFrame], texts: tuple[str, str]) -> bool:
    (first, last), (begin, end) = (_span(*table) for table in zip(rows, texts, strict=True))
    return min(last, end) - max(first, begin) > 0.5 * min(last - first, end - begin)


def _span(rows: pl.DataFrame, text: str) -> tuple[float, float]:
    """Return the first and the last time, ns; NaN if they cannot be computed."""
    try:
        times = rows.select(time_expression(text, rows).alias("t"))["t"].drop_nulls().to_numpy()
    except (InputError, pl.exceptions.PolarsError):
        times = np.zeros(0)
    return (float(times.min()), float(times.max())) if len(times) else (math.nan, math.nan)
