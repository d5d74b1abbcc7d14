"""Routes of the paper's maneuvers and of `urban` (minutes of mixed driving), their simulation, and the achieved values.

If friction does not allow the paper's target, the driver drives at the friction limit. The drive's metadata contain the
target and the achieved value.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.simulation import dynamics
from sigmaswarm.simulation.dynamics import GRAVITY, STEP, Vehicle
from sigmaswarm.simulation.environments import Environment, lookup
from sigmaswarm.simulation.planning import DRIVER_STEP, SPACING, Leg, build_path, draw_sway, plan_speed

KMH = 1 / 3.6  # m/s
QUARTER = math.pi / 2
HARD_EASE = 0.2  # s, time in which acceleration builds up in hard driving
_LIMIT = 0.96  # fraction of the friction limit that acceleration and braking use; the rest is for steering


@dataclass(frozen=True)
class AccelerationLimits:
    """Limits of the accelerations on a road of a given friction."""

    friction: float

    def hard(self, wanted: float) -> float:
        """Limit an acceleration (m/s2) to the friction of the road."""
        return min(wanted, _LIMIT * self.friction * GRAVITY)

    def easy(self, wanted: float) -> float:
        """Limit an acceleration (m/s2) to half of the friction limit, for everyday driving."""
        return min(wanted, 0.5 * self.friction * GRAVITY)


@dataclass(frozen=True)
class Maneuver:
    legs: list[Leg]
    target: dict[str, float]  # the paper's values, with units in the names
    # (start, end), s after the start of the maneuver itself, without fixes
    outages: list[tuple[float, float]]
    first: int = 0  # index of the first leg after the warm-up


def straight(road: AccelerationLimits, length: float, kmh: float) -> Leg:
    return Leg(length, kmh * KMH, road.easy(2.5), road.easy(2.5))


def turn(road: AccelerationLimits, angle: float, radius: float, kmh: float, lateral: float) -> list[Leg]:
    """Turn by an angle (rad, left positive): clothoid, arc, clothoid.

    The speed keeps the lateral acceleration below `lateral` (m/s2) and below 70% of the friction limit, as a margin for
    braking.
    """
    curvature = math.copysign(1 / radius, angle)
    bend = min(0.6 * radius, 0.8 * abs(angle) * radius)  # each clothoid turns by bend / (2 radius)
    grip = min(lateral, 0.7 * road.friction * GRAVITY)
    easy = road.easy(2.0)
    arc = Leg(radius * abs(angle) - bend, kmh * KMH, easy, easy, curvature, curvature, grip)
    into, out = replace(arc, length=bend, curvature=0.0), replace(arc, length=bend, curvature_end=0.0)
    return [into, arc, out]


def hard(length: float, speed: float, acceleration: float, braking: float, wait: float = 0.0) -> Leg:
    """Drive a straight leg with hard accelerations. Units: m, m/s, m/s2, m/s2, s."""
    return Leg(length, speed, acceleration, braking, wait=wait, ease=HARD_EASE, fading=0.0)


def warm_up(road: AccelerationLimits, kmh: float = 34.0) -> list[Leg]:
    """Drive at least 30 m at 5 m/s or more, so that a filter can start."""
    kmh = kmh if road.friction > 0.4 else 0.8 * kmh
    pull_away = 1.15 * (kmh * KMH) ** 2 / 2 / road.easy(2.5)
    return [straight(road, pull_away + 32.0, kmh)]


def cruise(road: AccelerationLimits, rng: np.random.Generator) -> Maneuver:
    """(i) Straight cruise for 500 m."""
    kmh = rng.uniform(85, 95) if road.friction > 0.4 else rng.uniform(60, 70)
    speed, push = kmh * KMH, road.easy(3.0)
    # Distance in which a car with the acceleration a (1 - f v), f = fading, reaches the speed.
    fading = 0.02
    pull_away = (-speed / fading - math.log(1 - fading * speed) / fading**2) / push
    legs = [Leg(pull_away + 25.0, speed, push, push, fading=fading), straight(road, 500.0, kmh)]
    return Maneuver(legs, {"distance_m": 500.0, "speed_kmh": round(kmh, 1)}, [], first=1)


def turns(road: AccelerationLimits, rng: np.random.Generator) -> Maneuver:
    """(ii) Sharp 90 degree turns at intersections, one to each side."""
    side = 1 if rng.random() < 0.5 else -1
    legs = warm_up(road)
    first = len(legs)
    for sign in (side, -side):
        radius = rng.uniform(9.0, 12.0) if sign > 0 else rng.uniform(7.0, 9.0)  # a left turn crosses the road
        legs += [*turn(road, sign * QUARTER, radius, 40.0, 4.0), straight(road, rng.uniform(35, 50), 40.0)]
    return Maneuver(legs, {"left_deg": 90.0, "right_deg": -90.0, "peak_lateral_ms2": 4.0}, [], first)


def accelerate(road: AccelerationLimits, rng: np.random.Generator) -> Maneuver:
    """(iii) 0-60 km/h in 5 s."""
    speed = 60 * KMH
    push = road.hard(speed / 4.95)
    (start,) = warm_up(road)
    halt = replace(start, length=start.length + 16.0, wait=rng.uniform(1.5, 2.5))
    # Slightly above 60 km/h, since the driver's speed sways.
    away = hard(speed**2 / 2 / push + rng.uniform(60, 90), 1.03 * speed, push, road.easy(2.5))
    return Maneuver([halt, away], {"speed_kmh": 60.0, "time_s": 5.0}, [], first=1)


def brake(road: AccelerationLimits, rng: np.random.Generator) -> Maneuver:
    """(iv) 50 km/h to 0 within 2 s, then continue."""
    speed = 1.02 * 50 * KMH
    push = road.hard(50 * KMH / 1.88)
    pull_away = 1.2 * speed**2 / 2 / road.easy(2.5)
    approach = Leg(pull_away + rng.uniform(50, 70), speed, road.easy(2.5), push)
    stop = hard(speed**2 / 2 / push, speed, road.easy(2.5), push, wait=rng.uniform(2.5, 3.5))
    away = straight(road, rng.uniform(20, 30), 30.0)
    return Maneuver([approach, stop, away], {"speed_kmh": 50.0, "time_s": 2.0}, [], first=1)


def outages(road: AccelerationLimits, rng: np.random.Generator) -> Maneuver:
    """(v) GPS outages of 3-5 s in a mix of cruise, turns, acceleration and braking."""
    side = 1 if rng.random() < 0.5 else -1
    legs = warm_up(road, 40.0)
    first = len(legs)
    legs += turn(road, side * QUARTER, rng.uniform(10, 13), 40.0, 3.5)
    legs += [hard(rng.uniform(70, 90), 55 * KMH, road.hard(3.0), road.hard(4.5))]
    legs += turn(road, -side * rng.uniform(0.4, 0.8), rng.uniform(35, 50), 50.0, 3.0)
    legs += [hard(rng.uniform(40, 60), 50 * KMH, road.easy(2.5), road.hard(4.5))]
    legs += turn(road, -side * QUARTER, rng.uniform(8, 11), 40.0, 3.5)
    legs += [straight(road, rng.uniform(70, 85), 50.0)]
    lengths = rng.uniform(3.0, 5.0, 2)
    begins = np.array([rng.uniform(9.0, 10.0), rng.uniform(20.0, 20.8)])
    windows = [(round(float(b), 3), round(float(b + n), 3)) for b, n in zip(begins, lengths, strict=True)]
    return Maneuver(
        legs, {f"outage_{i + 1}_s": round(e - b, 3) for i, (b, e) in enumerate(windows)}, windows, first
    )


def urban(road: AccelerationLimits, rng: np.random.Generator, duration: float = 180.0) -> Maneuver:
    """(vi) Minutes of mixed driving: streets, bends, intersections, lane changes, stops. `duration` is in s."""
    legs = warm_up(road, 40.0)
    first, spent = len(legs), 12.0
    while spent < duration + 20.0:
        block = _city_block(road, rng)
        legs += block
        spent += sum(leg.length / leg.speed + leg.wait for leg in block)
    return Maneuver(legs, {"duration_s": float(duration)}, [], first)


def _city_block(road: AccelerationLimits, rng: np.random.Generator) -> list[Leg]:
    kmh = float(rng.choice([30.0, 40.0, 50.0, 60.0], p=[0.25, 0.2, 0.4, 0.15]))
    push, slow = road.easy(rng.uniform(1.4, 2.8)), road.easy(rng.uniform(1.5, 3.2))
    street = Leg(rng.uniform(40, 160), kmh * KMH, push, slow)
    sign = 1 if rng.random() < 0.5 else -1
    kind = rng.choice(["turn", "light", "bend", "lane", "light and turn"], p=[0.35, 0.15, 0.2, 0.1, 0.2])
    corner = turn(road, sign * QUARTER, rng.uniform(7.5, 14.0), kmh, rng.uniform(2.0, 3.5))
    wait = rng.uniform(2.0, 9.0)
    if kind == "turn":
        return [street, *corner]
    if kind == "light":
        return [replace(street, wait=wait)]
    if kind == "light and turn":
        return [replace(street, wait=wait), straight(road, 8.0, 25.0), *corner]
    if kind == "bend":
        return [street, *turn(road, sign * rng.uniform(0.3, 1.2), rng.uniform(40.0, 120.0), kmh, 2.5)]
    # A lane change of about 3.5 m: out and back by the same angle.
    radius = max((kmh * KMH) ** 2, 40.0)
    angle = math.sqrt(3.5 / (1.8 * radius))  # a turn with its clothoids has the length 1.8 x angle x radius
    return [street, *turn(road, sign * angle, radius, kmh, 2.0), *turn(road, -sign * angle, radius, kmh, 2.0)]


# The first five are the paper's.
MANEUVERS: dict[str, Callable[[AccelerationLimits, np.random.Generator], Maneuver]] = {
    "cruise": cruise,
    "turns": turns,
    "accelerate": accelerate,
    "brake": brake,
    "outages": outages,
    "urban": urban,
}


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
    """Draw a maneuver and drive it. Parameters are as in `simulate`."""
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
    """Return the achieved values under the names of the targets. ``fixes`` (m,) contains the times of the fixes, s."""
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
