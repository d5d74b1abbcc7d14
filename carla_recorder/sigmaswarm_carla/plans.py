"""Plans of the paper's maneuvers: a path in CARLA's map, its legs, and the allowed speeds."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from .geometry import heading_of, polar, wrap
from .options import GRAVITY, KMH, RecorderError

SPACING = 0.5  # m between points of a path
RUN_OUT = 30.0  # m of road after the end of a maneuver, for the driver's preview and for longer braking
MAX_BEND = math.radians(3.0)  # rad, largest change of heading on a straight stretch
MAX_WALKS = 4000  # random walks after which a search for a path fails


class Turn(NamedTuple):
    """A bend of a path: beginning and end (m along the path), and angle (rad, left positive)."""

    start: float
    end: float
    angle: float


@dataclass(frozen=True)
class Path2D:
    """Points every `SPACING` m along lanes: m east and north, heading (rad, not wrapped), curvature (1/m)."""

    x: list[float]
    y: list[float]
    heading: list[float]
    curvature: list[float]
    climb: float  # largest slope (rise / distance)
    start: Any  # CARLA's waypoint at the beginning

    @property
    def length(self) -> float:
        return (len(self.x) - 1) * SPACING

    @property
    def turns(self) -> list[Turn]:
        """Bends of more than 30 degrees with a radius below 40 m."""
        bends: list[list[int]] = []  # first and last point
        for i, curvature in enumerate(self.curvature):
            if abs(curvature) <= 1 / 40:
                continue
            if bends and (i - bends[-1][1]) * SPACING < 3.0 and curvature * self.curvature[bends[-1][0]] > 0:
                bends[-1][1] = i
            else:
                bends.append([i, i])
        last = len(self.x) - 1
        angles = [self.heading[min(b + 4, last)] - self.heading[max(a - 4, 0)] for a, b in bends]
        turns = (Turn(a * SPACING, b * SPACING, angle) for (a, b), angle in zip(bends, angles))
        return [turn for turn in turns if abs(turn.angle) > math.radians(30)]

    @property
    def bend(self) -> float:
        """Largest difference from the initial heading, rad."""
        return max(abs(h - self.heading[0]) for h in self.heading)


class Need(NamedTuple):
    """Requirements for the path of a maneuver: description, length (m), whether it must be straight, and a test."""

    what: str
    length: float
    straight: bool
    fits: Callable[[Path2D], bool]


def straight(length: float) -> Need:
    """Require a straight path of a length (m) plus `RUN_OUT`."""

    def fits(path: Path2D) -> bool:
        return path.bend < MAX_BEND

    length += RUN_OUT
    return Need(f"straight stretch of {length:.0f} m", length, True, fits)


def find_path(town: Any, need: Need, rng: random.Random) -> Path2D:
    """Find a random path in a `carla.Map` that meets the requirements.

    Walks begin at the waypoints of the map, in random order. If the path must be straight, one walk from each waypoint
    goes straight ahead. Otherwise, six walks from each waypoint choose a random branch at each junction.

    Raises
    ------
    RecorderError
        If no path is found in `MAX_WALKS` walks.
    """
    starts = [w for w in town.generate_waypoints(10.0) if not w.is_junction]
    rng.shuffle(starts)
    walks = 1 if need.straight else 6
    longest = 0.0
    for start in starts[: MAX_WALKS // walks]:
        for _ in range(walks):
            path = _walk(start, need, rng)
            longest = max(longest, path.length)
            if path.length >= need.length and path.climb < 0.04 and need.fits(path):
                return path
    longest_is = f"; the longest straight stretch is {longest:.0f} m" if need.straight else ""
    raise RecorderError(
        f"the map {town.name} has no {need.what}{longest_is}; load another map, for example --map Town06, or "
        "omit this maneuver"
    )


def _walk(start: Any, need: Need, rng: random.Random) -> Path2D:
    """Walk from a waypoint until the path is long enough, the lane ends, or a straight path bends."""
    points, gone, here = [start], 0.0, start
    heading = heading_of(start.transform.rotation)
    while gone < need.length + 2.0:
        ways = here.next(1.0)
        if not ways:
            break
        there = ways[0]
        if len(ways) > 1:
            there = min(ways, key=_turning) if need.straight else rng.choice(ways)
        if need.straight and abs(wrap(heading_of(there.transform.rotation) - heading)) > MAX_BEND:
            break
        a, b = here.transform.location, there.transform.location
        gone += math.hypot(b.x - a.x, b.y - a.y)
        here = there
        points.append(here)
    return _resample(points)


def _turning(way: Any) -> float:
    """Return the change of heading (rad) over the first 15 m of a branch."""
    there = way
    for _ in range(15):
        there = (there.next(1.0) or [there])[0]
    return abs(wrap(heading_of(there.transform.rotation) - heading_of(way.transform.rotation)))


def _resample(points: Sequence[Any]) -> Path2D:
    """Interpolate waypoints, which are about 1 m apart, at distances of `SPACING`."""
    places = [polar(p.transform.location) for p in points]
    headings = [heading_of(points[0].transform.rotation)]
    for p in points[1:]:
        headings.append(headings[-1] + wrap(heading_of(p.transform.rotation) - headings[-1]))
    way, climb = [0.0], 0.0
    for a, b in zip(places, places[1:]):
        step = max(math.hypot(b[0] - a[0], b[1] - a[1]), 1e-6)
        climb = max(climb, abs(b[2] - a[2]) / step if step > 0.5 else 0.0)
        way.append(way[-1] + step)
    rows: list[tuple[float, ...]] = [(x, y, h) for (x, y, _), h in zip(places, headings)]
    resampled = rows[:1]
    i = 0
    for k in range(1, int(way[-1] / SPACING) + 1):
        while way[i + 1] < k * SPACING:
            i += 1
        w = (k * SPACING - way[i]) / (way[i + 1] - way[i])
        resampled.append(tuple(a * (1 - w) + b * w for a, b in zip(rows[i], rows[i + 1])))
    x, y, heading = (list(column) for column in zip(*resampled))
    # Average the curvature over 3 m, since lanes in junctions often begin with a kink.
    spans = [(max(k - 3, 0), min(k + 3, len(x) - 1)) for k in range(len(x))]
    curvature = [(heading[b] - heading[a]) / max((b - a) * SPACING, SPACING) for a, b in spans]
    return Path2D(x, y, heading, curvature, climb, points[0])


class Leg(NamedTuple):
    length: float  # m
    speed: float  # m/s, the speed limit
    acceleration: float  # m/s2
    braking: float  # m/s2, positive
    lateral: float = 3.0  # m/s2, in bends
    wait: float = 0.0  # s of standstill at the end of the leg; with 0 the car does not stop
    ease: float = 0.6  # s, shortest time in which the acceleration changes by 8 m/s2


@dataclass(frozen=True)
class Plan:
    """A path, its legs and GPS outages."""

    path: Path2D
    legs: list[Leg]
    target: dict[str, float]  # the paper's values, with units in the names
    start: float = 0.0  # m along the path, where the maneuver begins
    outages: list[tuple[float, float]] = field(default_factory=list)  # (s after the start, length in s)

    @property
    def length(self) -> float:
        return sum(leg.length for leg in self.legs)


def plan_maneuver(name: str, friction: float, town: Any, rng: random.Random) -> Plan:
    """Draw the random values of one of the paper's maneuvers, and find a path for the maneuver.

    As in `sigmaswarm.simulation.maneuvers`, the accelerations are the paper's, or the largest that friction allows.
    Before each maneuver, the car drives at least 30 m at 5 m/s or more, so that a filter can determine the heading.
    """
    hard = 0.9 * friction * GRAVITY
    easy = min(2.5, 0.5 * friction * GRAVITY)
    if name in ("turns", "outages"):
        return _plan_bends(name, hard, easy, friction, town, rng)
    if name == "cruise":
        kmh = rng.uniform(85, 95) if friction > 0.4 else rng.uniform(60, 70)
        speed = kmh * KMH
        push = 1.4 * easy  # for a short approach, since long straight roads are rare
        start = 1.1 * speed**2 / 2 / push + 25.0
        legs = [Leg(start, speed, push, easy), Leg(500.0, speed, push, easy)]
        target = {"distance_m": 500.0, "speed_kmh": round(kmh, 1)}
    elif name == "accelerate":
        warm, speed = (34 if friction > 0.4 else 27) * KMH, 60 * KMH
        push = min(speed / 5.1, hard)
        start = 1.15 * warm**2 / easy + 32.0
        legs = [
            Leg(start, warm, easy, easy, wait=rng.uniform(1.5, 2.5)),
            Leg(speed**2 / 2 / push + rng.uniform(60, 90), 1.03 * speed, push, easy, ease=0.15),
        ]
        target = {"speed_kmh": 60.0, "time_s": 5.0}
    else:
        speed, push = 1.03 * 50 * KMH, min(50 * KMH / 1.85, hard)
        start = 1.2 * speed**2 / 2 / easy + rng.uniform(40, 60)
        legs = [
            Leg(start, speed, easy, push),
            Leg(speed**2 / 2 / push, speed, easy, push, wait=rng.uniform(2.5, 3.5), ease=0.1),
            Leg(rng.uniform(20, 30), 30 * KMH, easy, easy),
        ]
        target = {"speed_kmh": 50.0, "time_s": 2.0}
    path = find_path(town, straight(sum(leg.length for leg in legs)), rng)
    return Plan(path, legs, target, start)


def _plan_bends(name: str, hard: float, easy: float, friction: float, town: Any, rng: random.Random) -> Plan:
    """Plan the maneuvers that turn at junctions: `turns` and `outages`."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    before = 35.0 + 1.15 * (34 * KMH) ** 2 / 2 / easy  # m, to accelerate and to determine the heading

    def fits(path: Path2D) -> bool:
        bends = path.turns
        if len(bends) < 2 or bends[0].start < before:
            return False
        quarters = all(math.radians(70) < abs(t.angle) < math.radians(110) for t in bends[:2])
        opposite = bends[0].angle * side > 0 > bends[1].angle * side
        return quarters and opposite and bends[1].end + 40.0 + RUN_OUT < path.length

    sharp = name == "turns"
    what = "path with two turns of 90 degrees, one to each side"
    path = find_path(town, Need(what, before + (240.0 if sharp else 320.0), False, fits), rng)
    first, second = path.turns[:2]
    grip = min(4.0 if sharp else 3.5, 0.7 * friction * GRAVITY)
    if sharp:
        legs = [Leg(second.end + rng.uniform(30, 40), 40 * KMH, easy, easy, grip)]
        target = {"left_deg": 90.0, "right_deg": -90.0, "peak_lateral_ms2": 4.0}
        return Plan(path, legs, target, first.start - 10.0)
    legs = [
        Leg(first.end, 40 * KMH, easy, easy, grip),
        Leg(second.start - first.end, 55 * KMH, min(3.0, hard), min(4.5, 0.8 * hard), grip, ease=0.2),
        Leg(path.length - RUN_OUT - second.start, 45 * KMH, easy, easy, grip),
    ]
    windows = [(round(rng.uniform(at, at + 1), 2), round(rng.uniform(3.0, 4.8), 2)) for at in (5.0, 15.0)]
    target = {f"outage_{i + 1}_s": long for i, (_, long) in enumerate(windows)}
    return Plan(path, legs, target, first.start - 10.0, windows)


def allowed_speed(plan: Plan, sway: Callable[[float], float]) -> list[list[float]]:
    """Return the allowed speed (m/s) at each point of each leg, from which the car can slow down in time."""
    profiles: list[list[float]] = []
    end, after = plan.length, math.inf
    for leg in reversed(plan.legs):
        start, speed = end - leg.length, []
        for k in range(math.ceil(leg.length / SPACING) + 1):
            way = min(start + k * SPACING, end)
            bend = abs(plan.path.curvature[min(round(way / SPACING), len(plan.path.x) - 1)])
            speed.append(min(leg.speed, math.sqrt(leg.lateral / max(bend, 1e-6))) * (1 + sway(way)))
        speed[-1] = 0.0 if leg.wait > 0 else min(speed[-1], after)
        for k in range(len(speed) - 2, -1, -1):
            speed[k] = min(speed[k], math.sqrt(speed[k + 1] ** 2 + 2 * leg.braking * SPACING))
        profiles.insert(0, speed)
        end, after = start, speed[0]
    return profiles
