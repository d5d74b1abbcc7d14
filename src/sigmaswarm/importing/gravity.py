"""Find magnitude and direction of gravity in an IMU log, to detect wrong units and axes that are not the vehicle's."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import polars as pl

from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Imu
from sigmaswarm.errors import InputError
from sigmaswarm.importing.expressions import compile_expression
from sigmaswarm.importing.gather import with_row_numbers
from sigmaswarm.importing.mounting import AUTO
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.quantities import PER_G
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import Part
from sigmaswarm.importing.table_columns import DIMENSIONS, column_numbers, median_of
from sigmaswarm.importing.units import in_si

FORCES, RATES = ("ax", "ay", "az"), ("gx", "gy", "gz")
MIN_TILT = math.radians(20.0)  # rad, smallest reported tilt; larger than the slopes of roads
MAX_GRAVITY_ERROR = 0.5  # m/s2, largest deviation of a median magnitude from gravity
MAX_DEVIATION = 0.3  # largest relative deviation of the median specific force from gravity
MAX_FORCE = 3 * GRAVITY  # m/s2, largest median magnitude of a vehicle's specific force
MAX_RATE = math.radians(2000.0)  # rad/s, largest range of common gyros


def require_gravity_in_force(imu: Imu) -> None:
    """Reject an IMU with gravity in its angular rates instead of its accelerations."""
    if imu.az is None or imu.gx is None or imu.gy is None:
        return
    if np.median(np.linalg.norm((imu.ax, imu.ay, imu.az), axis=0)) > GRAVITY / 2:
        return
    quartiles = np.quantile(np.linalg.norm((imu.gx, imu.gy, imu.gz), axis=0), [0.25, 0.5, 0.75])
    for low, middle, high in (quartiles, np.degrees(quartiles)):  # the import may have assumed deg/s
        if abs(middle - GRAVITY) < MAX_GRAVITY_ERROR and high - low < 2 * MAX_GRAVITY_ERROR:
            raise InputError(
                f"gx, gy and gz contain gravity (median magnitude {middle:.3g}), and ax, ay and az do not, so the "
                "columns or files of accelerometer and gyro are exchanged; exchange their names"
            )


def impossible_rates(imu: Imu, parts: Sequence[Part]) -> dict[str, str]:
    """Return the expressions of the angular rates if these exceed the range of common gyros; otherwise {}."""
    texts = {n: text for part in parts for n, text in part.columns.items() if n in RATES}
    return texts if _largest_rate(imu) > MAX_RATE else {}


def _largest_rate(imu: Imu) -> float:
    return max(float(np.quantile(np.abs(v), 0.99)) for n in RATES if (v := getattr(imu, n)) is not None)


def wrong_scale(imu: Imu, parts: Sequence[Part], rates: Mapping[str, str]) -> list[str]:
    """Describe accelerations that are too large for a vehicle, and ``rates`` (`impossible_rates`), with the remedy."""
    force, faults = [v for v in (imu.ax, imu.ay, imu.az) if v is not None], list[str]()

    def add(texts: Mapping[str, str], what: str, form: str) -> None:
        units = {text: read_name(text.strip("`")).unit for text in texts.values()}
        dimension = DIMENSIONS[next(iter(texts))]
        stated = {
            name: in_si(unit, text) if (unit := units[text]) and unit.dimension == dimension else text
            for name, text in texts.items()
        }
        # if the stated unit is already that of SI, it is wrong
        scaled = {
            name: form.format(text) if stated[name] == text else stated[name] for name, text in texts.items()
        }
        maps = " ".join(f'"imu.{name}={text}"' for name, text in scaled.items())
        scale = f"so their scale is wrong; specify it, for example --map {maps}"
        faults.append(f"{', '.join(texts.values())} {what}, {scale}")

    if (size := float(np.median(np.linalg.norm(force, axis=0)))) > MAX_FORCE:
        known = (*PER_G, GRAVITY**2)  # the latter for m/s2 that were read as g
        per = min(known, key=lambda k: abs(size / k - 1)) if len(force) == len(FORCES) else PER_G[0]
        texts = {n: text for part in parts for n, text in part.columns.items() if n in FORCES}
        add(texts, f"have a median magnitude of {size:.4g} m/s2", f"({{}})*9.80665/{per:g}")
    if rates:
        degrees = _largest_rate(imu) < math.degrees(MAX_RATE)
        add(rates, f"exceed {MAX_RATE:.3g} rad/s", "radians({})" if degrees else "radians(({})/131)")
    return faults


def tilted_mount(recipe: Recipe, rows: Mapping[str, pl.DataFrame], *, downward: bool) -> tuple[str, str]:
    """Return "auto" and a note if the specific force in the first rows is clearly not along +z; otherwise "" and "".

    ``downward``: True if another note reports that the z axis points down.
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
        f"the specific force points {math.degrees(tilt):.0f} deg away from +z, so the IMU is rotated relative to the "
        f"vehicle (medians of the first rows: {values} m/s2); --mount {AUTO} estimates the rotation from the log"
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
