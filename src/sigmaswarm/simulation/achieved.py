"""What a simulated drive was after, and what came of it."""

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.simulation.dynamics import (
    AX,
    AY,
    FRICTION_USE,
    GRAVITY,
    PEAK_ALPHA,
    PEAK_KAPPA,
    STEP,
    VX,
    VY,
    YAW,
    X,
    Y,
)
from sigmaswarm.simulation.journey import Journey
from sigmaswarm.simulation.maneuvers import KMH

Array = NDArray[np.float64]


def time_between(speed: Array, slow: float, fast: float, rising: bool) -> float:
    """Seconds from one speed to the other, m/s; NaN if the drive never gets there.

    The clock starts with the last sample before the change and stops with the first one beyond it, as a
    stopwatch in the car would.
    """
    if rising:
        above = np.flatnonzero(speed >= fast)
        if len(above) == 0:
            return float("nan")
        end = int(above[0])
        below = np.flatnonzero(speed[:end] <= slow)
        return (end - int(below[-1])) * STEP if len(below) else float("nan")
    reached = np.flatnonzero(speed >= fast)
    if len(reached) == 0:
        return float("nan")
    # Of all descents from `fast` the steepest is the one that was meant.
    leaving = reached[np.append(np.diff(reached) > 1, True)]
    best = float("nan")
    for start in leaving:
        below = np.flatnonzero(speed[start:] <= slow)
        if len(below):
            best = float(np.nanmin([best, int(below[0]) * STEP]))
    return best


def achieved_figures(name: str, journey: Journey, fixes: Array) -> dict[str, float]:
    """Return what was achieved, under the target's names where there is one; units are in the names.

    Parameters
    ----------
    name : str
        Of the maneuver.
    journey : Journey
        As it was driven.
    fixes : ndarray, shape (m,)
        s, times of the fixes.
    """
    record, start = journey.record, journey.start
    speed = np.hypot(record[:, VX], record[:, VY])
    top = float(speed.max()) / KMH
    own = record[int(start / STEP) :]
    own_speed = speed[int(start / STEP) :]
    if name == "cruise":
        figures = {"distance_m": _length(own), "speed_kmh": float(own_speed.mean()) / KMH}
    elif name == "turns":
        left, right = _turned(own)
        figures = {"left_deg": left, "right_deg": right, "peak_lateral_ms2": float(np.abs(own[:, AY]).max())}
    elif name == "accelerate":
        figures = {"speed_kmh": min(top, 60.0), "time_s": time_between(speed, 0.1, 60 * KMH, rising=True)}
    elif name == "brake":
        figures = {"speed_kmh": min(top, 50.0), "time_s": time_between(speed, 0.1, 50 * KMH, rising=False)}
    elif name == "outages":
        figures = {f"outage_{i + 1}_s": _gap(fixes, *window) for i, window in enumerate(journey.outages)}
    else:
        figures = {"duration_s": len(record) * STEP}
    figures |= {
        "total_distance_m": _length(record),
        "top_speed_kmh": top,
        "peak_longitudinal_ms2": float(np.abs(record[:, AX]).max()),
        "peak_lateral_ms2": float(np.abs(record[:, AY]).max()),
        "peak_acceleration_g": float(np.hypot(record[:, AX], record[:, AY]).max()) / GRAVITY,
        "peak_slip_percent": 100 * float(record[speed > 2.0, PEAK_KAPPA].max(initial=0.0)),
        "peak_slip_angle_deg": float(np.degrees(np.arctan(record[speed > 2.0, PEAK_ALPHA].max(initial=0.0)))),
        "peak_friction_use": float(record[:, FRICTION_USE].max()),
    }
    return {key: round(float(value), 4) for key, value in figures.items() if np.isfinite(value)}


def _gap(fixes: Array, start: float, end: float) -> float:
    """Time between the last fix before an outage and the first one after it, s."""
    before, after = fixes[fixes < start], fixes[fixes >= end]
    return float(after[0] - before[-1]) if len(before) and len(after) else float("nan")


def _length(record: Array) -> float:
    return float(np.hypot(np.diff(record[:, X]), np.diff(record[:, Y])).sum())


def _turned(record: Array) -> tuple[float, float]:
    """Degrees of the left and of the right turn, from the headings before, between and after them."""
    yaw = np.degrees(record[:, YAW])
    extreme = int(np.argmax(np.abs(yaw - yaw[0])))
    # Between the turns the heading rests at the first turn's end; its median over the inner quarters is
    # robust.
    middle = float(np.median(yaw[np.abs(yaw - yaw[extreme]) < 10.0]))
    first, second = middle - float(yaw[0]), float(yaw[-1]) - middle
    return (first, second) if first > 0 else (second, first)
