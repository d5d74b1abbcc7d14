"""Find the rate of a counter of ticks from the motion of IMU and fixes, or from their duration."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.doctor.evidence import gather
from sigmaswarm.drives.drive import Drive
from sigmaswarm.importing.gather import ROW, PartColumns
from sigmaswarm.importing.rates import MIN_CONFIRMED, MIN_EXPLAINED, turn_ratio
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import Role
from sigmaswarm.importing.table_columns import scaled_column
from sigmaswarm.importing.ticks import Counter, closest_rate, time_of_ticks, usual_rate
from sigmaswarm.importing.time_units import FASTEST_IMU, SLOWEST_IMU

FIX_RATES = (0.1, 0.2, 0.5, 1, 2, 4, 5, 8, 10, 12.5, 16, 18, 20, 25, 50)  # Hz, usual rates of receivers
# Largest relative difference of turns and of accelerations at the right rate
MAX_TURN_ERROR, MAX_FORCE_ERROR = 0.08, 0.2
# Largest logarithm of a ratio of turns, or of durations, that does not contradict a unit
MAX_RATIO_ERROR = 0.2


@dataclass(frozen=True)
class DurationRate:
    """Rate of a counter, ticks per s, at which IMU and fixes have the same duration; 0 if no other rate is needed."""

    rate: float = 0.0
    factor: float = 1.0  # factor of the IMU's times
    remedy: str = ""


def wrong_tick(drive: Drive, counter: Counter, recipe: Recipe, other: DurationRate) -> str:
    """Describe a wrongly guessed unit of a counter, with which the motions of IMU and fixes differ; else return "".

    A counter of the IMU alone is refused only if the motion agrees at the rate that the durations show, since an IMU
    may also record longer or shorter than the receiver.
    """
    if not (counter.shared or other.rate):
        return ""
    share, ratio = turn_ratio(drive)
    if share > MIN_CONFIRMED and abs(math.log(max(ratio, 1e-9))) < MAX_RATIO_ERROR:
        return ""
    if counter.shared:
        factor, found = rate_by_motion(drive), scaled_column(recipe.roles["imu"][0].columns["t"])
        if factor is None or found is None or abs(math.log(factor)) < MAX_RATIO_ERROR:
            return ""
        remedy = shown_rate(counter.text, 1 / (found[1] * factor))
    else:
        if closest_rate(other.rate) != other.rate:
            return ""
        since = (drive.imu.time - drive.imu.time[0]) * other.factor
        share, ratio = turn_ratio(replace(drive, imu=replace(drive.imu, time=drive.gps.time[0] + since)))
        if share < MIN_EXPLAINED or abs(math.log(ratio)) > MAX_TURN_ERROR:
            return ""
        remedy = other.remedy
    return f"{counter.text}: the unit of the times is unknown; {remedy}"


def rate_by_motion(drive: Drive) -> float | None:
    """Return the factor of all times that makes turns and accelerations agree with the fixes; None if it is unclear.

    At a wrong rate, turns differ by the factor and accelerations by its square, unlike with a wrong unit of the gyro.
    A receiver has a usual rate, so a counter that IMU and fixes share has few possible rates.
    """
    step, interval = (float(np.median(np.diff(sensor.time))) for sensor in (drive.imu, drive.gps))
    possible = (1 / (rate * interval) for rate in FIX_RATES)
    possible = [k for k in possible if FASTEST_IMU < k * step < SLOWEST_IMU]
    fitting = [k for k in possible if _agrees(_at_rate(drive, k))]
    return fitting[0] if len(fitting) == 1 else None


def _at_rate(drive: Drive, factor: float) -> Drive:
    imu, gps = (replace(sensor, time=sensor.time * factor) for sensor in (drive.imu, drive.gps))
    return replace(drive, imu=imu, gps=gps, truth=None, odometer=None)


def _agrees(drive: Drive) -> bool:
    """Return True if turns and accelerations agree with the fixes, without regard to signs."""
    share, ratio = turn_ratio(drive)
    if share < MIN_EXPLAINED or abs(math.log(ratio)) > MAX_TURN_ERROR:
        return False
    mount = gather(drive).mount
    if mount is None or not any(mount.known):
        return False
    scales = [size for (size, _), known in zip(mount.scale, mount.known, strict=True) if known]
    return mount.unit == 1 and all(abs(size - 1) < MAX_FORCE_ERROR for size in scales)


def rate_by_duration(
    counter: Counter, gathered: Mapping[Role, Sequence[PartColumns]], recipe: Recipe
) -> DurationRate:
    """Return the rate of a counter at which IMU and fixes have the same duration, if the guessed rate differs."""
    scaled = scaled_column(recipe.roles["imu"][0].columns.get("t", ""))
    if not counter.text or counter.shared or scaled is None or "gps" not in gathered:
        return DurationRate()
    imu, gps = (gathered[role][0].duration for role in ("imu", "gps"))
    if not min(imu, gps) or abs(math.log(imu / gps)) < MAX_RATIO_ERROR:
        return DurationRate()
    rate = usual_rate(imu / gps / scaled[1], 0.01)
    remedy = (
        f"if IMU and fixes cover the same {gps:.0f} s, {counter.text} has about {rate:,.10g} ticks per s; write "
        f'--map "imu.t={time_of_ticks(counter.text, rate)}"'
    )
    return DurationRate(rate, 1 / (rate * scaled[1]), remedy)


def shown_rate(counter: str, rate: float) -> str:
    rate = usual_rate(rate)
    maps = " ".join(f'"{role}.t={time_of_ticks(counter, rate)}"' for role in ("imu", "gps"))
    unit = "rows" if counter == ROW else "ticks"
    return f"the motion of IMU and fixes agrees at {rate:,.10g} {unit} per s; write --map {maps}"
