"""Compare the recorded speed and course with the positions, and leave out columns that contradict the positions."""

import math
import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.positions import MAX_SPEED, MIN_SPEED, Say, Values
from sigmaswarm.importing.source import Part
from sigmaswarm.importing.units import factor_of, scaled

UNITS = ("mm/s", "cm/s", "km/h", "ft/s", "mph", "knots")
# Largest ratio of the recorded speed to that of the positions, or of the speed of the positions to the recorded speed
MAX_SPEED_RATIO = 1.5
# Largest ratio of the 90% to the 10% quantile of the speed ratio; a wrong unit is a constant factor
MAX_RATIO_SPREAD = 2.0
# m/s, lowest speed at which positions are compared with a recorded speed; low, since robots are slow
MIN_COMPARED_SPEED = 0.2
MIN_MOVING_SHARE = 0.3  # smallest fraction of the recorded path that the compared stretches must contain
# rad, largest median difference of a recorded course from the course of the positions. A course that lags in turns, or
# that is computed from noisy positions, differs by less.
MAX_COURSE_ERROR = np.radians(40)
MIN_STRETCHES = 5  # smallest number of stretches for a contradiction
_SPEED = ("speed", "course", "vx", "vy")


def without_wrong_velocity(time: Array, values: Values, role: str, parts: Iterable[Part], say: Say) -> Values:
    """Return the columns (n,); leave out speed and course if the positions x, y contradict one of them.

    ``parts``: the role's parts, whose expressions the messages quote. Rows with NaN are not compared.
    """
    recorded, compared = values, {name: c for name, c in values.items() if name in ("x", "y", *_SPEED)}
    known = np.all([np.isfinite(column) for column in compared.values()], axis=0)
    time, values = time[known], {name: column[known] for name, column in compared.items()}
    texts = {name: text for part in parts for name, text in part.columns.items() if name in _SPEED}
    slowest = MIN_SPEED if "speed" not in values and "vx" not in values else MIN_COMPARED_SPEED
    begin, end = _stretches(time, values["x"], values["y"], slowest)
    speed, course = values.get("speed"), values.get("course")
    if speed is None and course is None and "vx" in values and "vy" in values:
        speed, course = np.hypot(values["vx"], values["vy"]), np.arctan2(values["vy"], values["vx"])
    if speed is not None and course is not None:
        course = np.where(speed < 0, course + np.pi, course)  # a vehicle in reverse
    if speed is not None and len(begin):  # the speed must show motion too, since positions at rest wander
        moves = np.concatenate([[0], np.cumsum(np.abs(speed) > MIN_COMPARED_SPEED)])
        both = moves[end + 1] - moves[begin] > 0.5 * (end + 1 - begin)
        largest = np.quantile(np.abs(speed), 0.9)  # limits the weight of single wrong speeds
        path = np.concatenate([[0], np.cumsum(np.minimum(np.abs(speed), largest))])
        enough = np.sum((path[end + 1] - path[begin])[both]) >= MIN_MOVING_SHARE * path[-1]
        begin, end = begin[both & enough], end[both & enough]
    wrong = ""
    if speed is not None and len(begin) < MIN_STRETCHES:
        usual = float(np.median(np.abs(speed))) if len(speed) else 0.0
        wrong = f"a median of {usual:.4g} m/s is not the speed of a vehicle" if usual > MAX_SPEED else ""
    elif (
        speed is not None
        and not 1 / MAX_SPEED_RATIO < (ratio := _ratio(time, values, speed, begin, end)) < MAX_SPEED_RATIO
    ):
        wrong = f"the speed is {ratio:.3g} times the speed from the positions (median){_remedy(ratio, texts, role)}"
    elif course is not None and len(begin) >= MIN_STRETCHES:
        dx, dy = (values[n][end] - values[n][begin] for n in ("x", "y"))
        apart = np.abs(wrap_angle(course[(begin + end) // 2] - np.arctan2(dy, dx)))
        if (middle := float(np.median(apart))) > MAX_COURSE_ERROR:
            wrong = f"the course differs from the course between the positions by {np.degrees(middle):.0f} deg (median)"
    if not wrong:
        return recorded
    stated = ", ".join(f"{name}={text}" for name, text in texts.items())
    are = "is" if len(texts) == 1 else "are"
    say(f"{role}: {stated or 'speed and course'} {are} left out, since {wrong}")
    return {name: column for name, column in recorded.items() if name not in _SPEED}


def _ratio(
    time: Array, values: Values, speed: Array, begin: NDArray[np.int64], end: NDArray[np.int64]
) -> float:
    """Return the median ratio of the logged speed to the speed computed from the positions; 1 if it varies too much."""
    sums = np.concatenate([[0.0], np.cumsum(np.abs(speed))])
    stated = (sums[end + 1] - sums[begin]) / (end + 1 - begin)
    moved = np.hypot(*(values[n][end] - values[n][begin] for n in ("x", "y"))) / (time[end] - time[begin])
    low, middle, high = np.quantile(stated / moved, (0.1, 0.5, 0.9))
    return float(middle) if high <= MAX_RATIO_SPREAD * low else 1.0


def _remedy(ratio: float, texts: dict[str, str], role: str) -> str:
    """Propose the unit whose factor is nearest to a ratio, if they differ by less than 10%."""
    unit = min(UNITS, key=lambda u: abs(np.log(ratio * factor_of(u))))
    speeds = {name: text for name, text in texts.items() if name != "course"}
    if abs(np.log(ratio * factor_of(unit))) > 0.1 or not speeds:
        return ""
    plain = {n: t if re.fullmatch(r"\w+|`[^`]+`", t) else f"({t})" for n, t in speeds.items()}
    maps = " ".join(f'"{role}.{name}={scaled(text, factor_of(unit))}"' for name, text in plain.items())
    return f"; if it is in {unit}, write --map {maps}"


def _stretches(
    time: Array, x: Array, y: Array, slowest: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first and the last rows of stretches in which the position moves clearly and steadily.

    A stretch is longer than 3 m and than ten times the noise between rows, and has at least five positions. No single
    step may make up most of the length, since a jump of a parked vehicle's fixes is not motion.
    """
    # repeated positions count once
    rows = np.flatnonzero(np.append(True, (np.diff(x) != 0) | (np.diff(y) != 0)))
    none = np.zeros(0, np.int64)
    if len(rows) < 4 * MIN_STRETCHES:
        return none, none
    x, y, time = x[rows], y[rows], time[rows]
    step = np.hypot(np.diff(x), np.diff(y))
    # 2.9 = 1.18 sqrt(6): median magnitude of x[i] - 2 x[i+1] + x[i+2] if x is white noise of variance 1 (Rayleigh)
    noise = float(np.median(np.hypot(np.diff(x, 2), np.diff(y, 2)))) / 2.9
    least = max(3.0, 10 * noise)
    steps = np.ceil(1.5 * least / max(float(np.quantile(step, 0.9)), 1e-3))
    apart, most = int(np.clip(steps, 4, len(rows) // MIN_STRETCHES)), len(rows) // MIN_STRETCHES

    def chord_of(apart: int) -> float:
        return float(np.quantile(np.hypot(x[apart:] - x[:-apart], y[apart:] - y[:-apart]), 0.9))

    noisy = chord_of(apart) < least  # at a high rate, most of each step is noise
    while noisy and apart < most and chord_of(apart) < 2 * least:
        apart = min(math.ceil(1.5 * apart), most)
    begin = np.arange(0, len(rows) - apart, apart)
    end = begin + apart
    chord = np.hypot(x[end] - x[begin], y[end] - y[begin])
    largest = np.maximum.reduceat(step[: end[-1]], begin)
    good = (chord > least) & (chord > slowest * (time[end] - time[begin])) & (largest < 0.6 * chord)
    return rows[begin[good]], rows[end[good]]
