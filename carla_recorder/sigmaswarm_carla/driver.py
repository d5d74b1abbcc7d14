"""Follow a plan with throttle, brake and steering wheel."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import NamedTuple

from .geometry import interpolate, wrap
from .options import BRAKE_GAIN, STANDSTILL_TIME, TICK
from .plans import Plan, allowed_speed
from .routes import SPACING

_THROTTLE = 6.5  # m/s2, acceleration at full throttle; measured in CARLA: 6.3 to 7.0
_FULL_BRAKE = ((0.0, 4.4), (4.5, 4.4), (10.0, 6.1), (14.0, 7.4))
"""Speed (m/s) and deceleration of the stock brakes (m/s2) measured in CARLA."""


class Control(NamedTuple):
    """Throttle and brake, 0 to 1, and the angle of the front wheels, rad, left positive."""

    throttle: float
    brake: float
    angle: float


class Driver:
    """Follow a plan at 100 Hz, with feedforward of curvature and acceleration and feedback of the errors.

    Parameters
    ----------
    plan : the plan to follow
    wheelbase : m
    rng : generator of the random deviations from the plan: RMS 0.07 m to the side and 0.4% of the speed

    Attributes
    ----------
    way : distance along the path, m
    off : offset from the path, m, left positive
    """

    def __init__(self, plan: Plan, wheelbase: float, rng: random.Random) -> None:
        self.plan, self.wheelbase = plan, wheelbase
        waves = [
            (rng.uniform(110, 260), rng.uniform(0, 2 * math.pi), rng.uniform(0, 2 * math.pi))
            for _ in range(3)
        ]

        def sway(way: float, which: int) -> float:
            return sum(math.sin(2 * math.pi * way / w[0] + w[which]) for w in waves) / math.sqrt(3)

        self._offset: Callable[[float], float] = lambda way: 0.1 * sway(way, 1)  # m
        self._allowed = allowed_speed(plan, lambda way: 0.006 * sway(way, 2))
        self._leg, self._leg_end = 0, plan.legs[0].length
        self._nearest = 0
        self._speed = self._acceleration = self._missing = 0.0
        self._hold = STANDSTILL_TIME
        self.way = self.off = 0.0

    @property
    def arrived(self) -> bool:
        """True after all legs."""
        return self._leg >= len(self.plan.legs)

    def step(self, x: float, y: float, heading: float, speed: float) -> Control:
        """Return the controls for a tick, from position (m east and north), heading (rad) and speed (m/s)."""
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
        """Return the angle of the wheels (rad) with which an offset from the path decays as a damped oscillation."""
        path, v = self.plan.path, max(speed, 1.0)
        i = self._nearest
        course = wrap(heading - path.heading[i] - (self.way - i * SPACING) * path.curvature[i])
        ahead = min(int((self.way + 0.12 * v) / SPACING), len(path.x) - 1)
        frequency = min(1.5, v / 5.0)
        curvature = path.curvature[ahead]
        curvature -= (frequency / v) ** 2 * (self.off - self._offset(self.way))
        curvature -= 2 * 0.8 * frequency / v * course
        return math.atan(self.wheelbase * curvature)

    def _press(self, speed: float, angle: float) -> Control:
        """Choose the pedals. The planned speed increases with the leg's acceleration, up to the allowed speed."""
        leg = self.plan.legs[self._leg]
        profile = self._allowed[self._leg]
        place = max(self.way - self._leg_end + leg.length, 0.0) / SPACING
        k = min(int(place), len(profile) - 2)
        part = min(place - k, 1.0)
        a, b = profile[k], profile[k + 1]
        allowed = math.sqrt(max(a * a + (b * b - a * a) * part, 0.0))
        stopping = leg.wait > 0 and self._leg_end - self.way < 3.0 and allowed < 3.0
        before = self._speed
        if stopping:  # the speed depends on time; as a function of distance, it would reach 0 too late
            self._speed = max(min(before, allowed + 1.0) - leg.braking * TICK, 0.0)
        else:
            self._speed = max(min(before + leg.acceleration * TICK, allowed), 0.0)
        wanted = (self._speed - before) / TICK
        self._speed = min(max(self._speed, speed - 1.5), speed + 1.5)  # in case the car can't follow the plan
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
        coast = -1.58 * min(speed / 10.0, 1.0)
        if acceleration >= coast:
            return Control(min((acceleration - coast) / (_THROTTLE - coast), 1.0), 0.0, angle)
        full = BRAKE_GAIN * interpolate(_FULL_BRAKE, speed)
        return Control(0.0, min((coast - acceleration) / (full + coast), 1.0), angle)
