"""Simulate a maneuver, and compute the achieved values."""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.simulation import dynamics
from sigmaswarm.simulation.dynamics import GRAVITY, STEP, Vehicle
from sigmaswarm.simulation.environments import Environment, lookup
from sigmaswarm.simulation.maneuvers import KMH, MANEUVERS, AccelerationLimits, Maneuver, urban
from sigmaswarm.simulation.planning import DRIVER_STEP, SPACING, build_path, draw_sway, plan_speed

STANDSTILL_TIME = 1.0  # s of standstill at the beginning
URBAN_DURATION = 180.0  # s, default


@dataclass(frozen=True)
class Journey:
    """A driven maneuver."""

    maneuver: Maneuver
    path: Array  # (p, 4): east m, north m, heading rad, curvature 1/m
    record: Array  # (n, 21), states of the car at each millisecond (`dynamics`)
    start: float  # s, end of the warm-up
    outages: list[tuple[float, float]]  # (start, end), s, without fixes


def drive_maneuver(
    name: str,
    where: Environment,
    car: Vehicle,
    rng: np.random.Generator,
    duration: float | None = None,
    warm_up: bool = True,
) -> Journey:
    """Draw a maneuver and drive it; parameters are as in `simulate`."""
    road = AccelerationLimits(where.friction)
    seconds = URBAN_DURATION if duration is None else duration
    drawn = urban(road, rng, seconds) if name == "urban" else lookup(name, MANEUVERS, "maneuver")(road, rng)
    heading, sway = float(rng.uniform(-np.pi, np.pi)), draw_sway(rng)
    legs, first = (drawn.legs, drawn.first) if warm_up else (drawn.legs[drawn.first :], 0)
    path = build_path(legs, heading, sway)
    plan = plan_speed(legs, sway, stand=STANDSTILL_TIME if warm_up else None)
    if name == "urban":
        plan = plan[: round(seconds / DRIVER_STEP)]
    own = int(np.searchsorted(plan[:, 2], sum(leg.length for leg in legs[:first]))) * DRIVER_STEP
    start = dynamics.start_state(path[0, 0], path[0, 1], path[0, 2], plan[0, 0], car)
    record = dynamics.run_closed_loop(car, where.friction, start, path, SPACING, plan)
    outages = [(round(own + begin, 3), round(own + end, 3)) for begin, end in drawn.outages]
    return Journey(drawn, path, record, own, outages)


def time_between(speed: Array, slow: float, fast: float, rising: bool) -> float:
    """Return the shortest time (s) in which the speed changes from one value to another (m/s).

    The time runs from the last sample with the first speed to the first sample with the second speed. It is NaN if a
    speed is never reached.
    """
    speed = speed if rising else speed[::-1]
    begins, ends = np.flatnonzero(speed <= slow), np.flatnonzero(speed >= fast)
    before = np.searchsorted(begins, ends)
    steps = ends[before > 0] - begins[before[before > 0] - 1]
    return int(steps.min()) * STEP if len(steps) else np.nan


def achieved_figures(name: str, journey: Journey, fixes: Array) -> dict[str, float]:
    """Return the achieved values under the names of the targets; ``fixes`` (m,): times of the fixes, s."""
    record, first = journey.record, int(journey.start / STEP)
    along, across = np.abs(record[:, [dynamics.AX, dynamics.AY]]).T
    speed = np.hypot(record[:, dynamics.VX], record[:, dynamics.VY])
    top = float(speed.max()) / KMH
    own, moving = record[first:], record[speed > 2.0]
    if name == "cruise":
        figures = {"distance_m": _length(own), "speed_kmh": float(speed[first:].mean()) / KMH}
    elif name == "turns":
        left, right = _turned(own)
        figures = {"left_deg": left, "right_deg": right, "peak_lateral_ms2": float(across[first:].max())}
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
        "peak_longitudinal_ms2": float(along.max()),
        "peak_lateral_ms2": float(across.max()),
        "peak_acceleration_g": float(np.hypot(along, across).max()) / GRAVITY,
        "peak_slip_percent": 100 * float(moving[:, dynamics.PEAK_KAPPA].max(initial=0.0)),
        "peak_slip_angle_deg": float(np.degrees(np.arctan(moving[:, dynamics.PEAK_ALPHA].max(initial=0.0)))),
        "peak_friction_use": float(record[:, dynamics.FRICTION_USE].max()),
    }
    return {key: round(float(value), 4) for key, value in figures.items() if np.isfinite(value)}


def _gap(fixes: Array, start: float, end: float) -> float:
    """Return the time from the last fix before an outage to the first fix after it, s."""
    before, after = fixes[fixes < start], fixes[fixes >= end]
    return float(after[0] - before[-1]) if len(before) and len(after) else float("nan")


def _length(record: Array) -> float:
    return float(np.hypot(np.diff(record[:, dynamics.X]), np.diff(record[:, dynamics.Y])).sum())


def _turned(record: Array) -> tuple[float, float]:
    """Return the angles of the left and the right turn, deg."""
    yaw = np.degrees(record[:, dynamics.YAW])
    extreme = int(np.argmax(np.abs(yaw - yaw[0])))
    # Between the turns the heading is constant.
    middle = float(np.median(yaw[np.abs(yaw - yaw[extreme]) < 10.0]))
    first, second = middle - float(yaw[0]), float(yaw[-1]) - middle
    return (first, second) if first > 0 else (second, first)
