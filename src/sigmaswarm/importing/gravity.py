"""Find the direction of gravity in the first rows of an IMU log, to detect axes that are not those of the vehicle."""

import math
from collections.abc import Mapping

import numpy as np
import polars as pl

from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.errors import InputError
from sigmaswarm.importing.expressions import compile_expression
from sigmaswarm.importing.gather import with_row_numbers
from sigmaswarm.importing.mounting import AUTO
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.times import column_numbers, median_of

FORCES, RATES = ("ax", "ay", "az"), ("gx", "gy", "gz")
MIN_TILT = math.radians(20.0)  # larger than the slopes of roads
MAX_DEVIATION = 0.3  # relative deviation of the median specific force from gravity


def tilted_mount(recipe: Recipe, rows: Mapping[str, pl.DataFrame], *, downward: bool) -> tuple[str, str]:
    """Return "auto" and a note if gravity in the first rows is clearly not along +z; otherwise two empty texts.

    ``downward``: True if another note reports gravity along -z.
    """
    force = _median_force(recipe, rows)
    size = math.hypot(*force)
    if recipe.mount or not abs(size / GRAVITY - 1) < MAX_DEVIATION:
        return "", ""
    tilt = math.acos(max(min(force[2] / size, 1.0), -1.0))
    if tilt < MIN_TILT or (downward and tilt > math.pi - MIN_TILT):
        return "", ""
    values = ", ".join(f"{name} {value:.3g}" for name, value in zip(FORCES, force, strict=True))
    note = (
        f"gravity is {math.degrees(tilt):.0f} deg from +z, so the IMU is rotated relative to the vehicle (medians of "
        f"the first rows: {values} m/s2); --mount {AUTO} estimates the rotation from the log"
    )
    return AUTO, note


def _median_force(recipe: Recipe, rows: Mapping[str, pl.DataFrame]) -> tuple[float, float, float]:
    """Return the median specific force, m/s2, of an IMU with six axes; NaN if an axis is missing."""
    found = dict.fromkeys((*FORCES, *RATES), math.nan)
    for part in recipe.roles.get("imu", ()):
        frame = rows.get(part.table, pl.DataFrame())
        for name in found.keys() & part.columns.keys():
            found[name] = _median(part.columns[name], frame)
    ax, ay, az, *rates = found.values()
    return (ax, ay, az) if np.isfinite(rates).all() else (math.nan, math.nan, math.nan)


def _median(text: str, frame: pl.DataFrame) -> float:
    numbered = with_row_numbers(frame)
    try:
        values = numbered.select(compile_expression(text, numbered.columns).polars.alias("value"))["value"]
    except (InputError, pl.exceptions.PolarsError):
        return math.nan
    numbers = column_numbers(values.drop_nulls()).drop_nulls()
    return median_of(numbers) if len(numbers) else math.nan
