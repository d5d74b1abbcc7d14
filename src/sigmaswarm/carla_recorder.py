"""Record the paper's drives from a CARLA server, as folders that sigmaswarm reads.

This file needs only Python 3.8 or later and the `carla` package of the server's version: copy it beside an old
CARLA and run it there, or use `sigmaswarm record-carla`, which runs it.

    python carla_recorder.py --out drives --maneuver brake turns --environment clear rain --runs 5

It drives a Tesla Model 3 in synchronous mode at 100 Hz, with an IMU at 100 Hz and GNSS at 5 Hz; truth comes
from the world's snapshots. CARLA's axes (left-handed: x east, y south; body x forward, y right) become
sigmaswarm's (east-north-up; forward-left-up) in `polar` and `axial`, and nowhere else.

The file's order: figures and errors, the route in the map, the maneuver's plan, the driver, the server, geodesy,
one drive, all drives, the files, the sweep of the brakes, the command line.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import queue
import random
import re
import shutil
import signal
import socket
import struct
import sys
import time
import zlib
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Callable, Dict, Generator, List, NamedTuple, Sequence, Tuple

# -- Figures -----------------------------------------------------------------------------------------------

RATE = 100
"""Hz, of ticks and IMU."""
TICK = 1.0 / RATE
GPS_EVERY = 20
"""Ticks from fix to fix: 5 Hz. CARLA's own sensor_tick does not keep in step with the frames (carla#3653)."""
SUBSTEP = 0.001
"""s, of the physics; with CARLA's default the gyro is wrong."""
SETTLE = 100
"""Ticks that the car gets to come to rest on its springs."""
GARBAGE = 3
"""Samples after listen() that are nonsense (carla#8970)."""
STAND = 1.0
"""s, that a drive begins with at standstill."""
STUCK = 20.0
"""s without a meter gained, after which a route is given up."""
GRAVITY = 9.81
KMH = 1 / 3.6
METERS_PER_DEGREE = math.pi * 6378137.0 / 180.0
"""Of latitude, on CARLA's sphere."""
ROLE = "sigmaswarm"
"""Role name of all that is spawned here, so that a later call finds what a broken one left behind."""
CAR = "vehicle.tesla.model3"
DRY = 0.85
"""Friction that stock tires are taken to have, unless a sweep of the brakes has measured it."""
BRAKE_GAIN = 2.0
"""On max_brake_torque: stock brakes need 2.7 s from 50 km/h, the paper 2 s."""


class Environment(NamedTuple):
    """Friction of tire on road (sources: sigmaswarm.simulation.environments), and what CARLA is to show."""

    friction: float
    physics: str
    weather: Dict[str, float]


ENVIRONMENTS = {
    "clear": Environment(DRY, "dry", {"sun_altitude_angle": 60.0}),
    "night": Environment(DRY, "dry", {"sun_altitude_angle": -30.0}),
    "rain": Environment(
        0.65,
        "wet",
        {"cloudiness": 90.0, "precipitation": 80.0, "precipitation_deposits": 60.0, "wetness": 80.0,
         "sun_altitude_angle": 45.0},
    ),
    "fog": Environment(DRY, "dry", {"cloudiness": 60.0, "fog_density": 70.0, "sun_altitude_angle": 30.0}),
    "slippery": Environment(0.25, "snow", {"cloudiness": 80.0, "wetness": 30.0, "sun_altitude_angle": 30.0}),
}  # fmt: skip
MANEUVERS = ("cruise", "turns", "accelerate", "brake", "outages")


class RecorderError(Exception):
    """Recording can't go on; the message says why and what to do."""


class LostConnection(RecorderError):
    """The server was there and is gone."""


class FailedRun(RecorderError):
    """This drive went wrong; another route may go well."""


@dataclass(frozen=True)
class Options:
    """What to record.

    Attributes
    ----------
    out : folder for the drive folders
    host, port : of the server
    maneuvers, environments : names
    runs : drives of each maneuver in each environment
    seed : decides routes, driver and noise
    map : town to load; empty to take the one that is there
    accel_noise, gyro_noise : m/s2, rad/s, standard deviation of each sample
    gyro_bias : rad/s, the constant bias of a run is drawn evenly from +- this
    gps_noise : m per axis
    timeout : s, to wait for an answer
    patience : s, to wait for a server that was lost
    resume : keep the drives that are there
    brake_sweep : measure first what friction the tires really have
    """

    out: Path
    host: str = "127.0.0.1"
    port: int = 2000
    maneuvers: Tuple[str, ...] = MANEUVERS
    environments: Tuple[str, ...] = tuple(ENVIRONMENTS)
    runs: int = 20
    seed: int = 0
    map: str = ""
    accel_noise: float = 0.001
    gyro_noise: float = 0.001
    gyro_bias: float = 0.001
    gps_noise: float = 0.56
    timeout: float = 20.0
    patience: float = 120.0
    resume: bool = False
    brake_sweep: bool = False

    def figures(self) -> Dict[str, Any]:
        """Return what drives in one folder must have in common."""
        names = ("seed", "accel_noise", "gyro_noise", "gyro_bias", "gps_noise")
        return {name: getattr(self, name) for name in names}


def polar(v: Any) -> Tuple[float, float, float]:
    """Turn a place, velocity or force from CARLA's axes into sigmaswarm's."""
    return v.x, -v.y, v.z


def axial(v: Any) -> Tuple[float, float, float]:
    """Turn an angular rate from CARLA's axes into sigmaswarm's."""
    return -v.x, v.y, -v.z


def heading_of(rotation: Any) -> float:
    """Heading of a CARLA rotation, rad counter-clockwise from east, in (-pi, pi]."""
    return _wrap(-math.radians(rotation.yaw))


def _wrap(angle: float) -> float:
    return math.pi - (math.pi - angle) % (2 * math.pi)


# -- The route in the map ----------------------------------------------------------------------------------

SPACING = 0.5
"""m, between two points of a path."""
RUN_OUT = 30.0
"""m of road behind a maneuver's end, for the driver's preview and for stops that take longer."""
STRAIGHT = math.radians(3.0)
"""The most by which the heading of a straight stretch may change."""


class Turn(NamedTuple):
    """A bend of a path: m along it where it begins and ends, and rad by which it turns, left positive."""

    start: float
    end: float
    angle: float


@dataclass(frozen=True)
class Path2D:
    """A way along lanes: east and north m, heading rad (not wrapped), curvature 1/m, every `SPACING` m."""

    x: List[float]
    y: List[float]
    heading: List[float]
    curvature: List[float]
    climb: float
    start: Any  # the waypoint at its beginning

    @property
    def length(self) -> float:
        """In m."""
        return (len(self.x) - 1) * SPACING

    @property
    def turns(self) -> List[Turn]:
        """All bends tighter than 40 m of radius that turn by more than 30 degrees."""
        found: List[Turn] = []
        bent = [i for i, c in enumerate(self.curvature) if abs(c) > 1 / 40]
        while bent:
            last = 0
            while (
                last + 1 < len(bent)
                and (bent[last + 1] - bent[last]) * SPACING < 3.0
                and (self.curvature[bent[last + 1]] * self.curvature[bent[0]] > 0)
            ):
                last += 1
            first, end = bent[0], bent[last]
            angle = self.heading[min(end + 4, len(self.x) - 1)] - self.heading[max(first - 4, 0)]
            if abs(angle) > math.radians(30):
                found.append(Turn(first * SPACING, end * SPACING, angle))
            bent = bent[last + 1 :]
        return found

    @property
    def bend(self) -> float:
        """Largest change of heading from the beginning, rad."""
        return max(abs(h - self.heading[0]) for h in self.heading)


class Need(NamedTuple):
    """What a maneuver needs of a route: how long, straight or not, and whether a path will do."""

    what: str
    length: float
    straight: bool
    fits: Callable[[Path2D], bool]


WALKS = 4000
"""Walks after which a map is taken not to have what is looked for."""


def find_path(town: Any, need: Need, rng: random.Random) -> Path2D:
    """Find a path in a `carla.Map`, a random one of those that fit.

    Walks from all places of the map, in random order: straight on where the need is straight, else six times
    with a random choice at each junction.
    """
    starts = [w for w in town.generate_waypoints(10.0) if not w.is_junction]
    rng.shuffle(starts)
    walks = 1 if need.straight else 6
    longest = 0.0
    for start in starts[: WALKS // walks]:
        for _ in range(walks):
            path = _walk(start, need, rng)
            longest = max(longest, path.length)
            if path.length >= need.length and path.climb < 0.04 and need.fits(path):
                return path
    longest_is = f"; the longest straight stretch is {longest:.0f} m" if need.straight else ""
    raise RecorderError(
        f"the map {town.name} has no {need.what}{longest_is}; load another one, say --map Town06, or leave "
        "this maneuver out"
    )


def _walk(start: Any, need: Need, rng: random.Random) -> Path2D:
    """Walk from a waypoint until the way is long enough, ends, or a straight one bends."""
    points, gone, here = [start], 0.0, start
    heading = heading_of(start.transform.rotation)
    while gone < need.length + 2.0:
        ways = here.next(1.0)
        if not ways:
            break
        there = ways[0]
        if len(ways) > 1:
            there = min(ways, key=_turning) if need.straight else rng.choice(ways)
        if need.straight and abs(_wrap(heading_of(there.transform.rotation) - heading)) > STRAIGHT:
            break
        a, b = here.transform.location, there.transform.location
        gone += math.hypot(b.x - a.x, b.y - a.y)
        here = there
        points.append(here)
    return _resample(points)


def _turning(way: Any) -> float:
    """By how much a branch turns over its first 15 m, rad."""
    there = way
    for _ in range(15):
        there = (there.next(1.0) or [there])[0]
    before, after = (heading_of(w.transform.rotation) for w in (way, there))
    return abs(_wrap(after - before))


def _resample(points: Sequence[Any]) -> Path2D:
    """Points of waypoints, about 1 m apart, as a path with equal spacing."""
    places = [polar(p.transform.location) for p in points]
    headings = [heading_of(points[0].transform.rotation)]
    for p in points[1:]:
        headings.append(headings[-1] + _wrap(heading_of(p.transform.rotation) - headings[-1]))
    way, climb = [0.0], 0.0
    for a, b in zip(places, places[1:]):
        step = max(math.hypot(b[0] - a[0], b[1] - a[1]), 1e-6)
        climb = max(climb, abs(b[2] - a[2]) / step if step > 0.5 else 0.0)
        way.append(way[-1] + step)
    x, y, heading = [], [], []
    i = 0
    for k in range(int(way[-1] / SPACING) + 1):
        while i < len(way) - 2 and way[i + 1] < k * SPACING:
            i += 1
        w = 0.0 if len(way) < 2 else (k * SPACING - way[i]) / (way[i + 1] - way[i])
        j = min(i + 1, len(way) - 1)
        x.append(places[i][0] * (1 - w) + places[j][0] * w)
        y.append(places[i][1] * (1 - w) + places[j][1] * w)
        heading.append(headings[i] * (1 - w) + headings[j] * w)
    # The curvature's mean over 3 m: lanes in junctions often begin with a kink.
    n, half = len(x) - 1, 3
    curvature = [
        (heading[min(k + half, n)] - heading[max(k - half, 0)])
        / max((min(k + half, n) - max(k - half, 0)) * SPACING, SPACING)
        for k in range(n + 1)
    ]
    return Path2D(x, y, heading, curvature, climb, points[0])


# -- The maneuver's plan -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Leg:
    """A piece of a route.

    Attributes
    ----------
    length : m
    speed : m/s, the fastest allowed
    acceleration, braking : m/s2, both positive
    lateral : m/s2, in bends
    wait : s, standstill at its end; 0 drives on
    ease : s, over which accelerations build up
    """

    length: float
    speed: float
    acceleration: float
    braking: float
    lateral: float = 3.0
    wait: float = 0.0
    ease: float = 0.6


@dataclass(frozen=True)
class Plan:
    """A route and how to drive it.

    Attributes
    ----------
    path : the route
    legs : that make it up
    target : the paper's figures, units in the names
    start : m, where the maneuver itself begins, after the warm-up
    outages : (start, length) s, the former after the maneuver's beginning
    """

    path: Path2D
    legs: List[Leg]
    target: Dict[str, float]
    start: float = 0.0
    outages: List[Tuple[float, float]] = field(default_factory=list)

    @property
    def length(self) -> float:
        """Of all legs, m."""
        return sum(leg.length for leg in self.legs)


def plan_maneuver(name: str, friction: float, town: Any, rng: random.Random) -> Plan:
    """Draw one of the paper's maneuvers and find a route for it.

    Figures are those of `sigmaswarm.simulation.maneuvers`: what the paper asks for, or as much as the friction
    allows. A maneuver begins with at least 30 m at 5 m/s or more, so that a filter can align.
    """
    hard = 0.9 * friction * GRAVITY
    easy = min(2.5, 0.5 * friction * GRAVITY)
    if name in ("turns", "outages"):
        return _plan_bends(name, hard, easy, friction, town, rng)
    start = 0.0
    if name == "cruise":
        kmh = rng.uniform(85, 95) if friction > 0.4 else rng.uniform(60, 70)
        speed = kmh * KMH
        push = 1.4 * easy  # straight stretches are rarely long
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
    length = sum(leg.length for leg in legs)
    path = find_path(town, _straight(length), rng)
    return Plan(path, legs, target, start)


def _is_straight(path: Path2D) -> bool:
    return path.bend < STRAIGHT


def _straight(length: float) -> Need:
    """Need a straight stretch of so many m, and something to run out on."""
    length += RUN_OUT
    return Need(f"straight stretch of {length:.0f} m", length, True, _is_straight)


def _plan_bends(name: str, hard: float, easy: float, friction: float, town: Any, rng: random.Random) -> Plan:
    """Plan the maneuvers that turn at junctions: `turns` and `outages`."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    quarter = (math.radians(70), math.radians(110))
    before = 35.0 + 1.15 * (34 * KMH) ** 2 / 2 / easy  # m, to pull away and align

    def fits(path: Path2D) -> bool:
        bends = path.turns
        if len(bends) < 2 or bends[0].start < before:
            return False
        both = all(quarter[0] < abs(t.angle) < quarter[1] for t in bends[:2])
        opposite = bends[0].angle * side > 0 > bends[1].angle * side
        return both and opposite and bends[1].end + 40.0 + RUN_OUT < path.length

    calm = {"acceleration": easy, "braking": easy}
    if name == "turns":
        need = Need("two turns of 90 degrees, one to each side", before + 240.0, False, fits)
        path = find_path(town, need, rng)
        second = path.turns[1]
        length = second.end + rng.uniform(30, 40)
        grip = min(4.0, 0.7 * friction * GRAVITY)
        legs = [Leg(length, 40 * KMH, lateral=grip, **calm)]
        target = {"left_deg": 90.0, "right_deg": -90.0, "peak_lateral_ms2": 4.0}
        return Plan(path, legs, target, path.turns[0].start - 10.0)
    need = Need("way with two turns of 90 degrees", before + 320.0, False, fits)
    path = find_path(town, need, rng)
    first, second = path.turns[:2]
    grip = min(3.5, 0.7 * friction * GRAVITY)
    legs = [
        Leg(first.end, 40 * KMH, lateral=grip, **calm),
        Leg(second.start - first.end, 55 * KMH, min(3.0, hard), min(4.5, 0.8 * hard), grip, ease=0.2),
        Leg(path.length - RUN_OUT - second.start, 45 * KMH, lateral=grip, **calm),
    ]
    windows = [
        (rng.uniform(5.0, 6.0), rng.uniform(3.0, 4.8)),
        (rng.uniform(15.0, 16.0), rng.uniform(3.0, 4.8)),
    ]
    windows = [(round(at, 2), round(long, 2)) for at, long in windows]
    target = {f"outage_{i + 1}_s": long for i, (_, long) in enumerate(windows)}
    return Plan(path, legs, target, first.start - 10.0, windows)


def allowed_speed(plan: Plan, sway: Callable[[float], float]) -> List[List[float]]:
    """Fastest speed at each point of each leg, m/s, that lets the car slow down in time for what comes."""
    profiles: List[List[float]] = []
    end, after = plan.length, math.inf
    for leg in reversed(plan.legs):
        start = end - leg.length
        ways = [min(start + k * SPACING, end) for k in range(math.ceil(leg.length / SPACING) + 1)]
        speed: List[float] = []
        for way in ways:
            bend = abs(plan.path.curvature[min(round(way / SPACING), len(plan.path.x) - 1)])
            speed.append(min(leg.speed, math.sqrt(leg.lateral / max(bend, 1e-6))) * (1 + sway(way)))
        speed[-1] = 0.0 if leg.wait > 0 else min(speed[-1], after)
        for k in range(len(speed) - 2, -1, -1):
            speed[k] = min(speed[k], math.sqrt(speed[k + 1] ** 2 + 2 * leg.braking * SPACING))
        profiles.insert(0, speed)
        end, after = start, speed[0]
    return profiles


# -- The driver --------------------------------------------------------------------------------------------

_THROTTLE = 6.5
"""m/s2, of full throttle: measured 6.3-7.0 in CARLA."""
_FULL_BRAKE = ((0.0, 4.4), (4.5, 4.4), (10.0, 6.1), (14.0, 7.4))
"""m/s and m/s2, of stock brakes, as measured in CARLA."""


class Control(NamedTuple):
    """Throttle and brake, 0 to 1, and the wheels' angle, rad, left positive."""

    throttle: float
    brake: float
    angle: float


class Driver:
    """Follow a plan, looking at 100 Hz: feedforward of curvature and acceleration, feedback of what is off.

    Parameters
    ----------
    plan : what to drive
    wheelbase : m
    brake_gain : by which the brakes are stronger than CARLA's
    rng : sways the driver by 0.1 m and 0.6% of speed, no two runs alike
    """

    def __init__(self, plan: Plan, wheelbase: float, brake_gain: float, rng: random.Random) -> None:
        self.plan, self.wheelbase, self.brake_gain = plan, wheelbase, brake_gain
        waves = [
            (rng.uniform(110, 260), rng.uniform(0, 2 * math.pi), rng.uniform(0, 2 * math.pi))
            for _ in range(3)
        ]

        def sway(way: float, which: int) -> float:
            return sum(math.sin(2 * math.pi * way / w[0] + w[which]) for w in waves) / math.sqrt(3)

        def offset(way: float) -> float:
            return 0.1 * sway(way, 1)  # m

        self._offset = offset
        self._allowed = allowed_speed(plan, lambda way: 0.006 * sway(way, 2))
        self._leg, self._leg_end = 0, plan.legs[0].length
        self._nearest = 0
        self._speed = self._acceleration = self._missing = 0.0
        self._hold = STAND
        self.way = 0.0
        """m, that the car has come along its path."""
        self.off = 0.0
        """m, that it is beside its path, left positive."""

    @property
    def arrived(self) -> bool:
        """Whether all legs are driven."""
        return self._leg >= len(self.plan.legs)

    def look(self, x: float, y: float, heading: float, speed: float) -> Control:
        """Say what to do; called once a tick, with east and north (m), heading (rad) and speed (m/s)."""
        self._locate(x, y)
        angle = self._steer(heading, speed)
        while not self.arrived and not self.plan.legs[self._leg].wait and self.way >= self._leg_end:
            self._next_leg()
        if self._hold > 0 or self.arrived:
            self._hold -= TICK
            return Control(0.0, 1.0, angle)
        return self._press(speed, angle)

    def _next_leg(self) -> None:
        self._leg += 1
        if not self.arrived:
            self._leg_end += self.plan.legs[self._leg].length

    def _locate(self, x: float, y: float) -> None:
        path = self.plan.path
        while self._nearest < len(path.x) - 2:
            i = self._nearest + 1
            ahead = (x - path.x[i]) * math.cos(path.heading[i]) + (y - path.y[i]) * math.sin(path.heading[i])
            if ahead < 0:
                break
            self._nearest = i
        i = self._nearest
        cos, sin = math.cos(path.heading[i]), math.sin(path.heading[i])
        dx, dy = x - path.x[i], y - path.y[i]
        self.way, self.off = i * SPACING + dx * cos + dy * sin, dy * cos - dx * sin

    def _steer(self, heading: float, speed: float) -> float:
        """Angle of the wheels, rad: lets an offset die like a second-order system."""
        path, v = self.plan.path, max(speed, 1.0)
        i = self._nearest
        course = _wrap(heading - path.heading[i] - (self.way - i * SPACING) * path.curvature[i])
        ahead = min(int((self.way + 0.12 * v) / SPACING), len(path.x) - 1)
        frequency = min(1.5, v / 5.0)
        curvature = path.curvature[ahead]
        curvature -= (frequency / v) ** 2 * (self.off - self._offset(self.way))
        curvature -= 2 * 0.8 * frequency / v * course
        return math.atan(self.wheelbase * curvature)

    def _press(self, speed: float, angle: float) -> Control:
        """Pedals: the planned speed grows as the leg says and never exceeds what the way ahead allows."""
        leg = self.plan.legs[self._leg]
        profile = self._allowed[self._leg]
        place = max(self.way - self._leg_end + leg.length, 0.0) / SPACING
        k = min(int(place), len(profile) - 2)
        part = min(place - k, 1.0)
        a, b = profile[k], profile[k + 1]
        allowed = math.sqrt(max(a * a + (b * b - a * a) * part, 0.0))
        stopping = leg.wait > 0 and self._leg_end - self.way < 3.0 and allowed < 3.0
        before = self._speed
        if stopping:  # the last of a stop by time: along the way it would take forever
            self._speed = max(min(before, allowed + 1.0) - leg.braking * TICK, 0.0)
        else:
            self._speed = max(min(before + leg.acceleration * TICK, allowed), 0.0)
        wanted = (self._speed - before) / TICK
        self._speed = min(max(self._speed, speed - 1.5), speed + 1.5)  # of a car that can't follow
        if stopping and self._speed <= 0.05 and speed < 0.2:
            self._hold, self._speed, self._acceleration, self._missing = leg.wait, 0.0, 0.0, 0.0
            self._next_leg()
            return Control(0.0, 1.0, angle)
        slew = 8.0 / leg.ease * TICK
        self._acceleration += min(max(wanted - self._acceleration, -slew), slew)
        lag = self._speed - speed
        self._missing = min(max(self._missing + 0.8 * lag * TICK, -1.5), 1.5)
        return self._pedals(self._acceleration + 3.0 * lag + self._missing, speed, angle)

    def _pedals(self, acceleration: float, speed: float, angle: float) -> Control:
        """The pedals for an acceleration, m/s2."""
        coast = -1.58 * min(speed / 10.0, 1.0)
        if acceleration >= coast:
            return Control(min((acceleration - coast) / (_THROTTLE - coast), 1.0), 0.0, angle)
        full = self.brake_gain * _interpolate(_FULL_BRAKE, speed)
        return Control(0.0, min((coast - acceleration) / (full + coast), 1.0), angle)


def _interpolate(table: Sequence[Tuple[float, float]], x: float) -> float:
    """Linear interpolation in a table of (x, y), constant beyond both ends."""
    if x <= table[0][0]:
        return table[0][1]
    for (x0, y0), (x1, y1) in zip(table, table[1:]):
        if x <= x1:
            return y0 + (y1 - y0) * (x - x0) / (x1 - x0)
    return table[-1][1]


# -- The server --------------------------------------------------------------------------------------------

_KEEP: List[Any] = []
"""Objects of a broken connection: their destructors would wait for a server that is gone."""


def reachable(host: str, port: int, seconds: float) -> bool:
    """Whether something accepts connections there, within some seconds."""
    try:
        socket.create_connection((host, port), seconds).close()
    except OSError:
        return False
    return True


def number_of(version: str) -> str:
    """Return the numbers of a version such as 0.9.14-2-gabc: what client and server must have in common."""
    found = re.match(r"\d+\.\d+\.\d+", version)
    return found.group() if found else version


def import_carla() -> Any:
    """Import the client; RecorderError where it is not installed."""
    try:
        return import_module("carla")
    except ImportError as error:
        raise RecorderError(
            f"the CARLA client can't be imported ({error}); pip install carla==VERSION, the server's version: "
            "0.9.14 needs Python 3.8, 0.9.15 3.8 to 3.10, 0.9.16 3.10 to 3.12"
        ) from None


def connect(carla: Any, options: Options) -> Any:
    """Return a client whose version the server shares: another one can kill this process in its next call."""
    place = f"{options.host}:{options.port}"
    if not reachable(options.host, options.port, options.timeout):
        raise RecorderError(
            f"no CARLA server at {place}; start one (./CarlaUE4.sh -RenderOffScreen), or name --host and --port"
        )
    client = carla.Client(options.host, options.port)
    client.set_timeout(options.timeout)
    try:
        server = client.get_server_version()
    except RuntimeError as error:
        raise RecorderError(
            f"what listens at {place} does not answer as CARLA does ({_line(error)}); "
            "name the server's --port, or give it time with --timeout"
        ) from None
    mine = client.get_client_version()
    if number_of(mine) != number_of(server):
        raise RecorderError(
            f"the server at {place} is CARLA {server}, the client {mine}, and they would not understand each "
            f"other; pip install carla=={number_of(server)}"
        )
    return client


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())


SETTINGS: Dict[str, Any] = {
    "synchronous_mode": True,
    "no_rendering_mode": True,
    "fixed_delta_seconds": TICK,
    "substepping": True,
    "max_substep_delta_time": SUBSTEP,
    "max_substeps": round(TICK / SUBSTEP),
}
"""What the server is set to while we record."""


def _same(found: Any, wanted: Any) -> bool:
    return found is not None and abs(found - wanted) < 1e-9


class Session:
    """A server made ready, and made as it was before when the `with` block ends, whatever happens in it.

    Attributes
    ----------
    world, town : CARLA's world and map
    version : the server's
    geodesy : how its latitudes and longitudes become m
    """

    def __init__(self, options: Options, before: Dict[str, Any]) -> None:
        """`before` carries the server's original settings from one session to the next."""
        self.options, self._before = options, before
        self.actors: List[Any] = []
        self.carla = import_carla()
        self.client = connect(self.carla, options)
        self.version = str(self.client.get_server_version())

    def __enter__(self) -> Session:
        with self.trouble():
            self._load_map()
            self.world = self.client.get_world()
            self.town = self.world.get_map()
            self.geodesy = Geodesy.probe(self.carla, self.town)
            settings = self.world.get_settings()
            if not self._before:  # else a lost connection was taken up again, and the world is not as it was
                self._before.update(settings=self._as_before(settings), weather=self.world.get_weather())
        try:
            with self.trouble():
                self._apply_settings()
                self.tick()  # a world that nobody ticks does not tell its actors
                self._remove_leftovers()
        except BaseException:
            self.restore()
            raise
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        if isinstance(error, LostConnection):
            _KEEP.extend([self, *self.actors])
            return
        trouble = self.restore()
        if trouble and kind is None:
            raise RecorderError(trouble)
        if trouble:
            print(f"warning: {trouble}", file=sys.stderr)

    @contextmanager
    def trouble(self) -> Generator[None, None, None]:
        """Tell the client's errors apart from our own."""
        try:
            yield
        except RuntimeError as error:
            raise LostConnection(f"the server stopped answering: {_line(error)}") from None

    def _load_map(self) -> None:
        wanted = self.options.map
        if not wanted:
            return
        names = [str(name) for name in self.client.get_available_maps()]
        if wanted not in [name.split("/")[-1] for name in names]:
            known = ", ".join(sorted(name.split("/")[-1] for name in names))
            raise RecorderError(f"the server has no map {wanted!r}; it has {known}")
        if self.client.get_world().get_map().name.split("/")[-1] != wanted:
            self.client.set_timeout(max(self.options.timeout, 120.0))
            self.client.load_world(wanted)
            self.client.set_timeout(self.options.timeout)

    def _as_before(self, settings: Any) -> Any:
        """Return the settings to restore: CARLA's own where a recorder that was killed has left ours."""
        if not all(_same(getattr(settings, name), value) for name, value in SETTINGS.items()):
            return settings
        print(
            "warning: the server still has the settings of a recording that was killed; it gets CARLA's defaults",
            file=sys.stderr,
        )
        return self.carla.WorldSettings()

    def _apply_settings(self) -> None:
        settings = self.world.get_settings()
        for name, value in SETTINGS.items():
            setattr(settings, name, value)
        self.world.apply_settings(settings)
        found = self.world.get_settings()
        for name, value in SETTINGS.items():
            if not _same(getattr(found, name), value):
                raise RecorderError(
                    f"the server did not take {name} = {value}, it has {getattr(found, name)}; restart it "
                    "without other clients"
                )

    def _remove_leftovers(self) -> None:
        """Remove what a broken call has left in the world, sensors first."""
        left = [a for a in self.world.get_actors() if a.attributes.get("role_name") == ROLE]
        for actor in sorted(left, key=lambda a: not a.type_id.startswith("sensor")):
            actor.destroy()

    def show_weather(self, environment: str) -> None:
        """Set the sky. It changes no physics (carla#655)."""
        self.world.set_weather(self.carla.WeatherParameters(**ENVIRONMENTS[environment].weather))

    def tick(self) -> int:
        """One frame further."""
        return int(self.world.tick(self.options.timeout))

    def spawn(self, blueprint: str, attributes: Dict[str, str], transform: Any, parent: Any = None) -> Any:
        """Spawn an actor that is removed at the end at the latest."""
        definition = self.world.get_blueprint_library().find(blueprint)
        for name, value in {"role_name": ROLE, **attributes}.items():
            if definition.has_attribute(name):
                definition.set_attribute(name, value)
        actor = self.world.spawn_actor(definition, transform, attach_to=parent)
        self.actors.append(actor)
        return actor

    def clear(self) -> None:
        """Remove all actors: sensors stop, then go, then the car; else the server may crash."""
        sensors = [a for a in self.actors if a.type_id.startswith("sensor")]
        for sensor in sensors:
            if sensor.is_listening:
                sensor.stop()
        if sensors:
            self.tick()
        for actor in [*sensors, *(a for a in self.actors if a not in sensors)]:
            actor.destroy()
        self.actors.clear()

    def restore(self) -> str:
        """Make the world as it was before; returns what could not be done, or nothing."""
        if not reachable(self.options.host, self.options.port, 2.0):
            _KEEP.extend([self, *self.actors])
            return "the server is gone: its settings and weather could not be restored"
        failed: List[str] = []
        steps: Dict[str, Callable[[], Any]] = {
            "actors": self.clear,
            "weather": lambda: self.world.set_weather(self._before["weather"]),
            "settings": lambda: self.world.apply_settings(self._before["settings"]),
        }
        for what, step in steps.items():
            try:
                step()
            except RuntimeError as error:
                failed.append(f"{what} ({_line(error)})")
        if not failed:
            self._before.clear()
        return f"could not restore the server's {', '.join(failed)}; restart it" if failed else ""


# -- Geodesy -----------------------------------------------------------------------------------------------


class Geodesy:
    """From CARLA's latitudes and longitudes back to m: the inverse of the map's own formula, by Newton's method.

    The formula is not WGS-84, and differs from version to version (0.9.16 even mirrors north and south,
    carla#9389), so it is not written down here but asked of the client.
    """

    def __init__(self, locate: Callable[[float, float], Tuple[float, float]]) -> None:
        """`locate` gives (lat, lon), deg, to CARLA's x, y, m."""
        self._locate = locate
        self.origin = locate(0.0, 0.0)
        self.east = locate(100.0, 0.0)
        self.south = locate(0.0, 100.0)
        (lat, lon), (lat_x, lon_x), (lat_y, lon_y) = self.origin, self.east, self.south
        self._rows = ((lat_x - lat) / 100, (lat_y - lat) / 100), ((lon_x - lon) / 100, (lon_y - lon) / 100)
        (a, b), (c, d) = self._rows
        per_meter = 1 / METERS_PER_DEGREE
        if not 0.5 * per_meter**2 < abs(a * d - b * c) < 50 * per_meter**2:
            raise RecorderError(
                f"the map's geodesy makes no sense: {self.origin}, {self.east}, {self.south} deg at (0, 0), "
                "(100, 0), (0, 100) m; its OpenDRIVE needs a georeference"
            )

    @classmethod
    def probe(cls, carla: Any, town: Any) -> Geodesy:
        """Ask a `carla.Map`."""

        def locate(x: float, y: float) -> Tuple[float, float]:
            found = town.transform_to_geolocation(carla.Location(x=x, y=y, z=0.0))
            return found.latitude, found.longitude

        return cls(locate)

    def place(self, lat: float, lon: float) -> Tuple[float, float]:
        """East and north, m, of a latitude and longitude, deg."""
        (a, b), (c, d) = self._rows
        determinant = a * d - b * c
        x = y = 0.0
        for _ in range(6):
            x, y = _single(x), _single(y)  # the client's places are single floats
            at = self._locate(x, y)
            e, f = lat - at[0], lon - at[1]
            dx, dy = (d * e - b * f) / determinant, (a * f - c * e) / determinant
            x, y = x + dx, y + dy
        return x, -y

    def degrees(self, meters: float) -> Tuple[float, float]:
        """Standard deviations of latitude and longitude, deg, for one in m."""
        (a, b), (c, d) = self._rows
        return meters * math.hypot(a, b), meters * math.hypot(c, d)

    def report(self) -> Dict[str, Any]:
        """Return what was probed: (lat, lon), deg."""
        return {"at_0_0": self.origin, "at_100_0": self.east, "at_0_100": self.south,
                "latitude_grows_south": self.south[0] > self.origin[0]}  # fmt: skip


def _single(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


# -- One drive ---------------------------------------------------------------------------------------------


class Row(NamedTuple):
    """One tick: time s; specific force m/s2 and angular rate rad/s; place m, velocity m/s and heading rad."""

    t: float
    force: Tuple[float, float, float]
    rate: Tuple[float, float, float]
    place: Tuple[float, float, float]
    velocity: Tuple[float, float, float]
    heading: float


@dataclass
class Recording:
    """What has been recorded of a drive so far."""

    name: str
    rows: List[Row] = field(default_factory=list)
    fixes: List[Tuple[float, float, float]] = field(default_factory=list)  # s, m east, m north
    first_frame: int = 0


class Physics(NamedTuple):
    """The car's physics: what counts for driving, and the whole of it for the record."""

    wheelbase: float  # m
    ahead: float  # m, of the car's origin, where the IMU is, to the rear axle
    steer: float  # rad, at full lock
    tire_friction: float
    dump: Dict[str, Any]


def seed_of(*names: object) -> int:
    """Return a seed that belongs to these names alone, positive and below 2**31."""
    return zlib.crc32("/".join(str(name) for name in names).encode()) % 2147483647 + 1


def edit_physics(session: Session, car: Any, tire_friction: float | None, share: float = 1.0) -> Physics:
    """Set the tires' friction (or a share of the stock's), stronger brakes and even steering; read them back."""
    physics = car.get_physics_control()
    wheels = list(physics.wheels)
    for wheel in wheels:
        wheel.tire_friction = tire_friction if tire_friction is not None else share * wheel.tire_friction
        wheel.max_brake_torque *= BRAKE_GAIN
    physics.wheels = wheels
    physics.steering_curve = [session.carla.Vector2D(0.0, 1.0), session.carla.Vector2D(200.0, 1.0)]
    car.apply_physics_control(physics)
    settle(session, car, SETTLE // 5)
    found = car.get_physics_control()
    for wanted, got in zip(wheels, found.wheels):
        for name in ("tire_friction", "max_brake_torque"):
            if abs(getattr(got, name) - getattr(wanted, name)) > 1e-3 * getattr(wanted, name):
                raise RecorderError(
                    f"the server did not take {name} = {getattr(wanted, name):g} for a wheel, it has "
                    f"{getattr(got, name):g}; this CARLA's physics can't be edited"
                )
    wheelbase, ahead = axles(found.wheels, car.get_transform())
    steer = math.radians(found.wheels[0].max_steer_angle)
    return Physics(wheelbase, ahead, steer, found.wheels[0].tire_friction, plain(found))


def axles(wheels: Sequence[Any], car: Any) -> Tuple[float, float]:
    """Return the wheelbase, and by how much the car's origin is ahead of the rear axle, m.

    CARLA tells the wheels' places in the world, in cm, front wheels first. Where that makes no car, the real
    one's measures are returned.
    """
    heading, (x, y, _) = heading_of(car.rotation), polar(car.location)
    places = [polar(wheel.position) for wheel in wheels]
    along = [(px / 100 - x) * math.cos(heading) + (py / 100 - y) * math.sin(heading) for px, py, _ in places]
    front, rear = (along[0] + along[1]) / 2, (along[2] + along[3]) / 2
    return (front - rear, -rear) if 2.0 < front - rear < 4.0 and 0.5 < -rear < 3.0 else (2.875, 1.44)


def plain(value: Any) -> Any:
    """Return a CARLA record as dictionaries and lists."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    names = [n for n in dir(value) if not n.startswith("_")]
    found = {n: getattr(value, n) for n in names}
    fields = {n: plain(v) for n, v in found.items() if not callable(v)}
    if fields:
        return fields
    return [plain(v) for v in value] if hasattr(value, "__iter__") else str(value)


class Sensors:
    """IMU and GNSS on a car, each frame's data waited for."""

    def __init__(self, session: Session, car: Any, name: str, rng: random.Random) -> None:
        o = session.options
        lat, lon = session.geodesy.degrees(o.gps_noise)
        self.bias = [rng.uniform(-o.gyro_bias, o.gyro_bias) for _ in range(3)]
        imu = {f"noise_{kind}_stddev_{axis}": repr(value) for kind, value in
               (("accel", o.accel_noise), ("gyro", o.gyro_noise)) for axis in "xyz"}  # fmt: skip
        imu.update({f"noise_gyro_bias_{axis}": repr(v) for axis, v in zip("xyz", self.bias)})
        gnss = {"noise_lat_stddev": repr(lat), "noise_lon_stddev": repr(lon)}
        self.seeds = {sensor: seed_of(o.seed, name, sensor) for sensor in ("imu", "gnss")}
        self._timeout = o.timeout
        self._queues: Dict[str, queue.Queue[Any]] = {}
        self._actors: Dict[str, Any] = {}
        for sensor, attributes in (("imu", imu), ("gnss", gnss)):
            attributes = {**attributes, "noise_seed": str(self.seeds[sensor]), "sensor_tick": "0.0"}
            self._queues[sensor] = queue.Queue()
            self._actors[sensor] = session.spawn(
                f"sensor.other.{sensor}", attributes, session.carla.Transform(), car
            )
        for sensor, actor in self._actors.items():
            actor.listen(self._queues[sensor].put)

    def awake(self, tick: Callable[[], int]) -> int:
        """Tick until both answer, which may take some frames after listen(), and on past the garbage."""
        end, wait = time.monotonic() + self._timeout, 0.05
        while True:
            frame = tick()
            silent = [sensor for sensor in self._queues if self._get(sensor, frame, wait) is None]
            if not silent:
                break
            if time.monotonic() > end:
                raise self._silence(silent[0], frame)
            wait *= 2
        for _ in range(GARBAGE):
            frame = tick()
            for sensor in self._queues:
                self.read(sensor, frame)
        return frame

    def read(self, sensor: str, frame: int) -> Any:
        """Return a sensor's data of a frame, waiting for it."""
        data = self._get(sensor, frame, self._timeout)
        if data is None:
            raise self._silence(sensor, frame)
        return data

    def _silence(self, sensor: str, frame: int) -> RecorderError:
        return RecorderError(
            f"the sensor {sensor} did not answer for frame {frame} within {self._timeout:g} s; restart the "
            "server, or give it more time with --timeout"
        )

    def _get(self, sensor: str, frame: int, seconds: float) -> Any:
        """Return a sensor's data of a frame, or None if there is none in time; older data is thrown away."""
        end = time.monotonic() + seconds
        while True:
            try:
                data = self._queues[sensor].get(timeout=max(end - time.monotonic(), 0.001))
            except queue.Empty:
                return None
            if data.frame == frame:
                return data
            if data.frame > frame:
                raise RecorderError(
                    f"the sensor {sensor} skipped frame {frame} and sent {data.frame}; restart the server"
                )


def place_car(session: Session, path: Path2D) -> Any:
    """Spawn the car where a path begins; FailedRun where something is in the way."""
    at = path.start.transform
    location = session.carla.Location(x=at.location.x, y=at.location.y, z=at.location.z + 0.5)
    try:
        return session.spawn(CAR, {}, session.carla.Transform(location, at.rotation))
    except RuntimeError as error:
        if "spawn" not in str(error).lower():
            raise
        raise FailedRun(
            f"the car can't be spawned at {location.x:.0f}, {location.y:.0f} m ({_line(error)}); remove what "
            "is in the way"
        ) from None


def settle(session: Session, car: Any, ticks: int = SETTLE) -> None:
    """Let the car come to rest."""
    for _ in range(ticks):
        car.apply_control(session.carla.VehicleControl(brake=1.0))
        session.tick()


def control(session: Session, car: Any, physics: Physics, told: Control) -> None:
    """Hand the driver's wishes to the car; CARLA steers right with positive numbers."""
    steer = min(max(-told.angle / physics.steer, -1.0), 1.0)
    car.apply_control(session.carla.VehicleControl(throttle=told.throttle, steer=steer, brake=told.brake))


def drive(
    session: Session, recording: Recording, plan: Plan, car: Any, physics: Physics, rng: random.Random,
    show: Callable[[float], None],
) -> Sensors:  # fmt: skip
    """Drive a plan and record it; what is recorded stays in `recording` whatever happens."""
    sensors = Sensors(session, car, recording.name, rng)
    driver = Driver(plan, physics.wheelbase, BRAKE_GAIN, rng)
    still = session.carla.VehicleControl(brake=1.0)
    car.apply_control(still)
    frame = sensors.awake(session.tick)
    recording.first_frame = frame + 1
    state, began = _state(session, car, frame), None
    furthest, since = 0.0, 0.0  # m and s
    while not driver.arrived:
        x, y = state.place[:2]
        speed = math.hypot(*state.velocity[:2])
        told = driver.look(x, y, state.heading, speed)
        control(session, car, physics, told)
        now = session.tick()
        if now != frame + 1:
            raise RecorderError(
                f"frame {frame + 1} of {recording.name} is missing: the server went from {frame} to {now}; let "
                "no other client tick it"
            )
        frame = now
        t = round((frame - recording.first_frame) * TICK, 6)
        imu, fix = sensors.read("imu", frame), sensors.read("gnss", frame)
        state = _state(session, car, frame)._replace(
            t=t, force=polar(imu.accelerometer), rate=axial(imu.gyroscope)
        )
        if not all(map(math.isfinite, (*state.force, *state.rate))):
            raise FailedRun(f"{recording.name}: the IMU gave no finite number at t = {t} s")
        recording.rows.append(state)
        if began is None and driver.way >= plan.start:
            began = t
        hidden = began is not None and any(0 <= t - began - at < long for at, long in plan.outages)
        if (frame - recording.first_frame) % GPS_EVERY == 0 and not hidden:
            recording.fixes.append((t, *session.geodesy.place(fix.latitude, fix.longitude)))
            if len(recording.fixes) == STAND * RATE / GPS_EVERY:
                check_fixes(recording, session.options.gps_noise)
        if driver.way > furthest + 1.0:
            furthest, since = driver.way, t
        if abs(driver.off) > 4.0 or t - since > STUCK:
            trouble = "got stuck" if t - since > STUCK else "left its route"
            raise FailedRun(
                f"{recording.name}: the car {trouble} after {driver.way:.0f} m, at {x:.0f}, {y:.0f} m east and north"
            )
        show(t)
    return sensors


def _state(session: Session, car: Any, frame: int) -> Row:
    """Truth of a frame, from the world's snapshot."""
    snapshot = session.world.get_snapshot()
    if snapshot.frame != frame:
        raise RecorderError(
            f"the world's snapshot is of frame {snapshot.frame}, not {frame}; let no other client tick the server"
        )
    if abs(snapshot.timestamp.delta_seconds - TICK) > 1e-6:
        raise RecorderError(
            f"the server's step is {snapshot.timestamp.delta_seconds:g} s, not {TICK:g} s; restart it without "
            "other clients"
        )
    seen = snapshot.find(car.id)
    if seen is None:
        raise RecorderError(f"the car is gone from frame {frame}; let no other client remove it")
    place = seen.get_transform()
    nothing = (0.0, 0.0, 0.0)
    velocity = polar(seen.get_velocity())
    return Row(0.0, nothing, nothing, polar(place.location), velocity, heading_of(place.rotation))


def check_fixes(recording: Recording, noise: float) -> None:
    """Refuse fixes that do not lie where the car was: then the server's geodesy is not the client's."""
    places = {row.t: row.place for row in recording.rows}
    off = sorted(math.hypot(x - places[t][0], y - places[t][1]) for t, x, y in recording.fixes)
    if off and off[len(off) // 2] > 3 * noise + 0.5:
        raise RecorderError(
            f"the fixes of {recording.name} lie {off[len(off) // 2]:.1f} m beside the car: the server's geodesy "
            "is not its client's; use client and server of one build"
        )


# -- All drives --------------------------------------------------------------------------------------------


def record(options: Options) -> int:
    """Record all drives that are wanted and missing; returns how many were recorded.

    Raises
    ------
    RecorderError
        With all complete drives in `options.out`, and what there is of an incomplete one in its folder
        ``incomplete``.
    """
    journal = Journal(options)
    names = [(m, e, r) for m in options.maneuvers for e in options.environments for r in range(options.runs)]
    wanted = [name for name in names if not (options.out / drive_name(*name)).exists()]
    progress = Progress(len(wanted))
    try:
        _record(options, journal, wanted, progress)
    finally:
        progress.clear()
    return progress.done


def _record(
    options: Options, journal: Journal, wanted: List[Tuple[str, str, int]], progress: Progress
) -> None:
    """Record what is wanted, through as many sessions as it takes."""
    checked, lost = False, 0
    before: Dict[str, Any] = {}
    while wanted or (options.brake_sweep and not journal.friction):
        try:
            with Session(options, before) as session:
                journal.note(server=session.version, map=session.town.name, geodesy=session.geodesy.report())
                if not checked:
                    check_routes(session, wanted)
                    checked = True
                if options.brake_sweep and not journal.friction:
                    journal.note(friction=sweep_brakes(session, progress))
                while wanted:
                    with session.trouble():
                        record_one(session, journal, progress, *wanted[0])
                    del wanted[0]
                    progress.done, lost = progress.done + 1, 0
        except LostConnection as error:
            lost += 1
            here = f"{progress.done} drives of this call are complete in {options.out}"
            if lost > 3 or not _wait_for(options):
                _put_in_order(options, before)
                raise RecorderError(f"{error}; {here}; restart the server and repeat with --resume") from None
            progress.say(f"warning: {error}; the server is back, going on")


def check_routes(session: Session, wanted: Sequence[Tuple[str, str, int]]) -> None:
    """Refuse a map that lacks a route for one of the drives, before any of them."""
    for maneuver, friction in sorted({(m, ENVIRONMENTS[e].friction) for m, e, _ in wanted}):
        with session.trouble():
            plan_maneuver(maneuver, friction, session.town, random.Random(0))


def _wait_for(options: Options) -> bool:
    """Wait for a lost server to come back."""
    end = time.monotonic() + options.patience
    while time.monotonic() < end:
        if reachable(options.host, options.port, 1.0):
            time.sleep(min(1.0, options.patience / 10))
            return True
        time.sleep(0.2)
    return False


def _put_in_order(options: Options, before: Dict[str, Any]) -> None:
    """Restore a server that we give up on, if it still answers."""
    if reachable(options.host, options.port, 1.0):
        with suppress(RecorderError), Session(options, before):
            pass


def drive_name(maneuver: str, environment: str, run: int) -> str:
    """Return the name of a drive, which is also that of its folder."""
    return f"{maneuver}-{environment}-{run:02d}"


def record_one(
    session: Session, journal: Journal, progress: Progress, maneuver: str, environment: str, run: int
) -> None:
    """Record one drive; where it fails for its route, on another one."""
    options, name = session.options, drive_name(maneuver, environment, run)
    session.show_weather(environment)
    for attempt in range(4):
        rng = random.Random(seed_of(options.seed, name, "driver", attempt))
        recording = Recording(name)
        try:
            where = ENVIRONMENTS[environment]
            plan = plan_maneuver(maneuver, where.friction, session.town, rng)
            car = place_car(session, plan.path)
            settle(session, car)
            physics = edit_physics(session, car, journal.tire_friction(where.friction), where.friction / DRY)
            sensors = drive(session, recording, plan, car, physics, rng, lambda t: progress.show(name, t))
            check_fixes(recording, options.gps_noise)
            journal.note(physics={environment: physics.dump})
            about = describe(session, recording, plan, physics, sensors, maneuver, environment, run)
            write_drive(options.out / name, recording, about, options)
            session.clear()
            return
        except FailedRun as error:
            keep_incomplete(recording, options)
            session.clear()
            if attempt == 3:
                raise RecorderError(f"{error} (four routes tried)") from None
            progress.say(f"warning: {error}; trying another route")
        except BaseException:
            keep_incomplete(recording, options)
            raise


def describe(
    session: Session, recording: Recording, plan: Plan, physics: Physics, sensors: Sensors, maneuver: str,
    environment: str, run: int,
) -> Dict[str, Any]:  # fmt: skip
    """Return what drive.toml says, under the names that `sigmaswarm simulate` uses."""
    o, where = session.options, ENVIRONMENTS[environment]
    began = next((row.t for row in recording.rows if _passed(row, plan)), 0.0)
    about: Dict[str, Any] = {
        "frame": "enu",
        "source": f"CARLA {session.version}",
        "vehicle": CAR,
    }
    figures = {"accel_noise_density": o.accel_noise / math.sqrt(RATE),
               "gyro_noise_density": o.gyro_noise / math.sqrt(RATE), "gps_std_m": o.gps_noise}  # fmt: skip
    about.update({key: value for key, value in figures.items() if value > 0})
    about["carla"] = {
        "map": session.town.name,
        "first_frame": recording.first_frame,
        "tire_friction": physics.tire_friction,
        "brake_gain": BRAKE_GAIN,
        "substep_s": SUBSTEP,
        "imu_seed": sensors.seeds["imu"],
        "gnss_seed": sensors.seeds["gnss"],
        "velocity_against_positions_ms": velocity_check(recording.rows),
    }
    about["imu_noise"] = {"grade": "carla", "gyro_bias": list(axial(_Vector(*sensors.bias)))}
    about["gps_noise"] = {"grade": "carla", "white_std_m": o.gps_noise}
    about["imu_place"] = {"ahead_of_rear_axle_m": round(physics.ahead, 4)}
    about["scenario"] = {
        "maneuver": maneuver,
        "environment": environment,
        "physics": where.physics,
        "friction": where.friction,
        "seed": o.seed,
        "run": run,
        "imu_rate_hz": float(RATE),
        "gps_rate_hz": RATE / GPS_EVERY,
        "outages": [[round(began + at, 3), round(began + at + long, 3)] for at, long in plan.outages],
    }
    about["target"] = plan.target
    about["achieved"] = achieved(maneuver, recording, began)
    return about


class _Vector(NamedTuple):
    x: float
    y: float
    z: float


def _passed(row: Row, plan: Plan) -> bool:
    """Whether the car has come to where its maneuver begins."""
    i = min(round(plan.start / SPACING), len(plan.path.x) - 1)
    heading = plan.path.heading[i]
    dx, dy = row.place[0] - plan.path.x[i], row.place[1] - plan.path.y[i]
    return abs(dx) + abs(dy) < 20.0 and dx * math.cos(heading) + dy * math.sin(heading) >= 0


def velocity_check(rows: Sequence[Row]) -> float:
    """RMS difference of the snapshot's velocity and its positions' central difference, m/s.

    CARLA may give the velocity of the centre of mass and the position of the car's origin; then this is large.
    """
    total = 0.0
    for a, b, c in zip(rows, rows[1:], rows[2:]):
        east, north = ((c.place[i] - a.place[i]) / (c.t - a.t) for i in (0, 1))
        total += (east - b.velocity[0]) ** 2 + (north - b.velocity[1]) ** 2
    return round(math.sqrt(total / max(len(rows) - 2, 1)), 6)


def achieved(maneuver: str, recording: Recording, began: float) -> Dict[str, float]:
    """Return what was achieved, under the target's names."""
    rows = recording.rows
    own = [row for row in rows if row.t >= began]
    speeds = [math.hypot(*row.velocity[:2]) for row in rows]
    figures: Dict[str, float] = {}
    if maneuver == "cruise":
        figures["distance_m"] = _length(own)
        figures["speed_kmh"] = sum(math.hypot(*row.velocity[:2]) for row in own) / len(own) / KMH
    elif maneuver == "turns":
        yaw = [0.0]
        for a, b in zip(own, own[1:]):
            yaw.append(yaw[-1] + _wrap(b.heading - a.heading))
        extreme = max(yaw, key=abs)
        first, second = math.degrees(extreme), math.degrees(yaw[-1] - extreme)
        figures["left_deg"], figures["right_deg"] = max(first, second), min(first, second)
        tenths = zip(own, own[RATE // 10 :])
        figures["peak_lateral_ms2"] = max(
            abs(_wrap(b.heading - a.heading)) * 10 * math.hypot(*a.velocity[:2]) for a, b in tenths
        )
    elif maneuver == "outages":
        times = [fix[0] for fix in recording.fixes]
        gaps = sorted(zip(times, times[1:]), key=lambda pair: pair[0] - pair[1])[:2]
        figures.update({f"outage_{i + 1}_s": b - a for i, (a, b) in enumerate(sorted(gaps))})
    else:
        fast = (60 if maneuver == "accelerate" else 50) * KMH
        figures["speed_kmh"] = min(max(speeds), fast) / KMH
        figures["time_s"] = _time_between(speeds if maneuver == "accelerate" else speeds[::-1], fast)
    figures["total_distance_m"] = _length(rows)
    figures["top_speed_kmh"] = max(speeds) / KMH
    return {key: round(value, 4) for key, value in figures.items() if math.isfinite(value)}


def _length(rows: Sequence[Row]) -> float:
    return sum(math.hypot(b.place[0] - a.place[0], b.place[1] - a.place[1]) for a, b in zip(rows, rows[1:]))


def _time_between(speeds: Sequence[float], fast: float) -> float:
    """Seconds from the last standstill to the first time at `fast`, m/s, after it; NaN if never."""
    best = math.nan
    stood = None
    for i, speed in enumerate(speeds):
        if speed <= 0.1:
            stood = i
        elif speed >= fast and stood is not None:
            best = (i - stood) * TICK if math.isnan(best) else min(best, (i - stood) * TICK)
            stood = None
    return best


class Progress:
    """Say on standard error how far it is: a line that changes on a terminal, a line a drive elsewhere."""

    def __init__(self, total: int) -> None:
        self.total, self.done = total, 0
        self._began = self._shown = time.monotonic()
        self._name = ""
        self._live = sys.stderr.isatty()

    def show(self, name: str, t: float) -> None:
        """Say that `t` s of a drive are recorded."""
        now = time.monotonic()
        if now - self._shown < 0.5 and name == self._name:
            return
        rest = ""
        if self.done:
            minutes = (now - self._began) / self.done * (self.total - self.done) / 60
            rest = f", about {minutes:.0f} min to go" if minutes >= 1 else ", less than a minute to go"
        line = f"drive {self.done + 1} of {self.total}: {name}"
        if self._live:
            print(f"\r\033[K{line}, {t:.0f} s{rest}", end="", file=sys.stderr, flush=True)
        elif name != self._name:
            print(line + rest, file=sys.stderr, flush=True)
        self._shown, self._name = now, name

    def say(self, text: str) -> None:
        """Say something on a line of its own."""
        self.clear()
        print(text, file=sys.stderr, flush=True)

    def clear(self) -> None:
        """Take the line that changes away."""
        if self._live:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


# -- The files ---------------------------------------------------------------------------------------------


class Journal:
    """recording.json in the output folder: options, versions, geodesy, physics, measured friction."""

    def __init__(self, options: Options) -> None:
        self._file = options.out / "recording.json"
        self._held: Dict[str, Any] = {"options": options.figures()}
        there = sorted(path.parent.name for path in options.out.glob("*/imu.csv"))
        if there and not options.resume:
            raise RecorderError(
                f"{options.out}: holds {there[0]} already; name another folder, or keep what is there with --resume"
            )
        if self._file.exists():
            self._read(options, there)

    def _read(self, options: Options, there: Sequence[str]) -> None:
        try:
            held = json.loads(self._file.read_text(encoding="utf-8"))
            made = dict(held["options"])
        except (ValueError, KeyError, TypeError):
            raise RecorderError(f"{self._file}: is no journal of a recording; name another folder") from None
        for key, value in options.figures().items():
            if there and made.get(key) != value:
                raise RecorderError(
                    f"{self._file}: the drives there were made with {key} {made.get(key)}, not {value}; name "
                    "another folder, or the same options"
                )
        if there and options.brake_sweep and not held.get("friction"):
            raise RecorderError(
                f"{self._file}: the drives there were made without --brake-sweep; name another folder, or leave it out"
            )
        self._held = {**held, "options": options.figures()}

    @property
    def friction(self) -> List[List[float]]:
        """Pairs of tire_friction and measured friction, or nothing."""
        return self._held.get("friction", [])

    def tire_friction(self, friction: float) -> float | None:
        """Return the tire_friction that was measured to give a friction; None without a measurement."""
        if not self.friction:
            return None
        table = sorted((measured, tire) for tire, measured in self.friction)
        return _interpolate(table, friction)

    def note(self, **entries: Any) -> None:
        """Keep something; dictionaries are merged."""
        for key, value in entries.items():
            old = self._held.get(key)
            self._held[key] = {**old, **value} if isinstance(old, dict) and isinstance(value, dict) else value
        self._file.parent.mkdir(parents=True, exist_ok=True)
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps(self._held, indent=2) + "\n", encoding="utf-8")
        new.replace(self._file)


def write_drive(folder: Path, recording: Recording, about: Dict[str, Any], options: Options) -> None:
    """Write a drive's folder, whole or not at all."""
    new = folder.parent / f".{folder.name}.new"
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    rows = recording.rows
    _write_csv(new / "imu.csv", "t,ax,ay,az,gx,gy,gz", ((r.t, *r.force, *r.rate) for r in rows))
    std = (options.gps_noise,) * 2 if options.gps_noise > 0 else ()
    header = "t,x,y,std_x,std_y" if std else "t,x,y"
    _write_csv(new / "gps.csv", header, ((*fix, *std) for fix in recording.fixes))
    _write_csv(
        new / "truth.csv",
        "t,x,y,vx,vy,theta",
        ((r.t, *r.place[:2], *r.velocity[:2], r.heading) for r in rows),
    )
    (new / "drive.toml").write_text(toml(about), encoding="utf-8")
    new.rename(folder)


def _write_csv(path: Path, header: str, rows: Any) -> None:
    lines = [header, *(",".join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def keep_incomplete(recording: Recording, options: Options) -> None:
    """Keep what there is of a drive that did not come to its end, where no command takes it for a drive."""
    if not recording.rows:
        return
    parent = options.out / "incomplete"
    number = len(list(parent.glob(f"{recording.name}-*"))) if parent.exists() else 0
    about = {"frame": "enu", "source": "CARLA, incomplete"}
    write_drive(parent / f"{recording.name}-{number}", recording, about, options)


def toml(content: Dict[str, Any], table: str = "") -> str:
    """Return a dictionary of scalars, lists and tables as TOML."""
    lines = [f"{key} = {_toml_value(v)}" for key, v in content.items() if not isinstance(v, dict)]
    text = "\n".join(lines) + "\n"
    for key, value in content.items():
        if isinstance(value, dict):
            name = f"{table}{key}"
            text += f"\n[{name}]\n{toml(dict(value), f'{name}.')}"
    return text


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_toml_value(v) for v in value)}]"
    return repr(value)


# -- The sweep of the brakes -------------------------------------------------------------------------------

SWEEP = (3.5, 2.0, 1.0, 0.5, 0.25)
"""tire_friction of all wheels; what it is worth depends on CARLA's road and version."""


def sweep_brakes(session: Session, progress: Progress) -> List[List[float]]:
    """Brake hard with each tire_friction; returns pairs of it and the friction that it gave."""
    found: List[List[float]] = []
    guess = 0.4
    for tire_friction in SWEEP:
        easy = min(0.4 * guess * GRAVITY, 2.5)
        speed = max(min(10.0, 15.0 * easy), 3.0)  # what 15 s of it give
        away = 1.2 * speed**2 / 2 / easy + 10.0
        legs = [Leg(away, speed, easy, 20.0)]
        rng = random.Random(seed_of(session.options.seed, "sweep", tire_friction))
        with session.trouble():
            path = find_path(session.town, _straight(away + 1.5 * speed**2 / guess / GRAVITY), rng)
            measured = _brake(session, Plan(path, legs, {}), tire_friction, rng)
        found.append([tire_friction, round(measured, 4)])
        progress.say(f"tire_friction {tire_friction:g} brakes with {measured:.3f} g")
        guess = max(0.5 * measured, 0.02)
    return found


def _brake(session: Session, plan: Plan, tire_friction: float, rng: random.Random) -> float:
    """Friction, from how the speed falls from 90% to 30% under full brakes."""
    car = place_car(session, plan.path)
    settle(session, car)
    physics = edit_physics(session, car, tire_friction)
    driver = Driver(plan, physics.wheelbase, BRAKE_GAIN, rng)
    state = _state(session, car, session.tick())
    fast, falling = 0.0, [0.0, 0.0]
    for tick in range(RATE * 120):
        speed = math.hypot(*state.velocity[:2])
        told = driver.look(*state.place[:2], state.heading, speed)
        if driver.arrived:
            fast = fast or speed
            falling = [tick if speed > share * fast else at for share, at in zip((0.9, 0.3), falling)]
            if speed < 0.2 * fast:
                break
        control(session, car, physics, told)
        state = _state(session, car, session.tick())
    session.clear()
    if not falling[1] > falling[0] > 0:
        raise RecorderError(f"the sweep of the brakes found no stop with tire_friction {tire_friction:g}")
    return 0.6 * fast / ((falling[1] - falling[0]) * TICK) / GRAVITY


# -- The command line --------------------------------------------------------------------------------------


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(
        description="Record the paper's maneuvers from a CARLA server, as drive folders with truth.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    p.add_argument("--out", type=Path, required=True, help="folder in which the drive folders are made")
    p.add_argument("--host", default=Options.host, help="of the CARLA server")
    p.add_argument("--port", type=int, default=Options.port, help="of the CARLA server")
    p.add_argument("--maneuver", nargs="+", default=MANEUVERS, metavar="NAME",
                   help=", ".join(MANEUVERS))  # fmt: skip
    p.add_argument("--environment", nargs="+", default=tuple(ENVIRONMENTS),
                   metavar="NAME", help=", ".join(ENVIRONMENTS))  # fmt: skip
    p.add_argument(
        "--runs", type=int, default=Options.runs, help="drives of each maneuver in each environment"
    )
    p.add_argument("--seed", type=int, default=Options.seed, help="decides routes, driver and noise")
    p.add_argument("--map", default=Options.map, help="town to load; the one that is there if not given")
    p.add_argument("--accel-noise", type=float, default=Options.accel_noise, help="m/s2, of each sample")
    p.add_argument("--gyro-noise", type=float, default=Options.gyro_noise, help="rad/s, of each sample")
    p.add_argument(
        "--gyro-bias", type=float, default=Options.gyro_bias, help="rad/s, drawn from +- this for a run"
    )
    p.add_argument("--gps-noise", type=float, default=Options.gps_noise, help="m per axis, of each fix")
    p.add_argument("--timeout", type=float, default=Options.timeout, help="s, to wait for an answer")
    p.add_argument("--patience", type=float, default=Options.patience, help="s, to wait for a lost server")
    p.add_argument(
        "--resume", action="store_true", help="keep the drives that are there, record what is missing"
    )
    p.add_argument("--brake-sweep", action="store_true",
                   help="measure first which tire_friction gives which friction, and use it")  # fmt: skip
    return p


def options_of(arguments: Sequence[str]) -> Options:
    """Return the options that a command line names."""
    given = vars(parser().parse_args(arguments))
    maneuvers, environments = (tuple(dict.fromkeys(given.pop(key))) for key in ("maneuver", "environment"))
    for what, names, known in (
        ("maneuver", maneuvers, MANEUVERS),
        ("environment", environments, tuple(ENVIRONMENTS)),
    ):
        for name in names:
            if name not in known:
                raise RecorderError(f"no {what} is called {name!r}; there are {', '.join(known)}")
    options = Options(maneuvers=maneuvers, environments=environments, **given)
    if options.runs < 1:
        raise RecorderError(f"--runs is {options.runs}; choose 1 or more")
    for name in ("accel_noise", "gyro_noise", "gyro_bias", "gps_noise"):
        if not 0 <= getattr(options, name) < math.inf:
            raise RecorderError(f"--{name.replace('_', '-')} is {getattr(options, name)}; choose 0 or more")
    if not (options.timeout > 0 and options.patience >= 0):
        raise RecorderError("--timeout and --patience are in s and not negative")
    return options


def main(arguments: Sequence[str]) -> int:
    """Run the command line; returns the exit code: 0 done, 2 told in one line, 130 interrupted."""

    def end(*_: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    try:
        options = options_of(arguments)
        count = record(options)
    except RecorderError as error:
        print(f"sigmaswarm: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nsigmaswarm: interrupted; repeat the command with --resume to go on", file=sys.stderr)
        return 130
    except OSError as error:
        print(f"sigmaswarm: {error.filename or 'a file'}: {error.strerror or error}", file=sys.stderr)
        return 2
    print(f"recorded {count} drive{'' if count == 1 else 's'} to {options.out}")
    print(f"next: sigmaswarm tune {options.out} --out tuned --objective truth-pose")
    return 0


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # the 0.9.16 client may abort when the interpreter tears it down
