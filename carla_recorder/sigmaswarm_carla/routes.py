"""Search for a path for a maneuver in CARLA's map."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from .geometry import heading_of, polar, wrap
from .options import RecorderError

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
        "leave this maneuver out"
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
