"""The car: spawn it, edit its physics, and follow a plan with throttle, brake and steering wheel."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from .geometry import heading_of, interpolate, polar, wrap
from .options import BRAKE_GAIN, STANDSTILL_TIME, TICK, FailedRun, RecorderError
from .plans import SPACING, Path2D, Plan, allowed_speed
from .server import Session, one_line

CAR = "vehicle.tesla.model3"
SETTLE_TICKS = 100  # ticks after which a spawned car is at rest on its springs


class Physics(NamedTuple):
    """The car's physics: the values for driving, and CARLA's whole record for recording.json."""

    wheelbase: float  # m
    ahead: float  # m, from the rear axle to the car's origin, where the IMU is
    steer: float  # rad, largest angle of the front wheels
    tire_friction: float
    dump: dict[str, Any]


def edit_physics(session: Session, car: Any, tire_friction: float | None, share: float = 1.0) -> Physics:
    """Set the friction of the tires, the torque of the brakes and a steering limit that does not depend on speed.

    Check that the server applies the values.

    If `tire_friction` is None, the friction is `share` times the friction of the stock tires.
    """
    physics = car.get_physics_control()
    wheels = list(physics.wheels)
    for wheel in wheels:
        wheel.tire_friction = tire_friction if tire_friction is not None else share * wheel.tire_friction
        wheel.max_brake_torque *= BRAKE_GAIN
    physics.wheels = wheels
    physics.steering_curve = [session.carla.Vector2D(0.0, 1.0), session.carla.Vector2D(200.0, 1.0)]
    car.apply_physics_control(physics)
    settle(session, car, SETTLE_TICKS // 5)
    found = car.get_physics_control()
    for wanted, got in zip(wheels, found.wheels):
        for name in ("tire_friction", "max_brake_torque"):
            if abs(getattr(got, name) - getattr(wanted, name)) > 1e-3 * getattr(wanted, name):
                raise RecorderError(
                    f"a wheel has {name} = {getattr(got, name):g} instead of {getattr(wanted, name):g}: this "
                    "build of CARLA ignores changes of the physics; use another build"
                )
    wheelbase, ahead = axles(found.wheels, car.get_transform())
    steer = math.radians(found.wheels[0].max_steer_angle)
    return Physics(wheelbase, ahead, steer, found.wheels[0].tire_friction, plain(found))


def axles(wheels: Sequence[Any], car: Any) -> tuple[float, float]:
    """Return the wheelbase and the distance from the rear axle to the car's origin, m.

    CARLA states the positions of the wheels in the world in cm, front wheels first. If they are implausible, return the
    values of the real car.
    """
    heading, (x, y, _) = heading_of(car.rotation), polar(car.location)
    places = [polar(wheel.position) for wheel in wheels]
    along = [(px / 100 - x) * math.cos(heading) + (py / 100 - y) * math.sin(heading) for px, py, _ in places]
    front, rear = (along[0] + along[1]) / 2, (along[2] + along[3]) / 2
    return (front - rear, -rear) if 2.0 < front - rear < 4.0 and 0.5 < -rear < 3.0 else (2.875, 1.44)


def plain(value: Any) -> Any:
    """Convert a CARLA object to dictionaries and lists."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    found = {n: getattr(value, n) for n in dir(value) if not n.startswith("_")}
    fields = {n: plain(v) for n, v in found.items() if not callable(v)}
    if fields:
        return fields
    return [plain(v) for v in value] if hasattr(value, "__iter__") else str(value)


def place_car(session: Session, path: Path2D) -> Any:
    """Spawn the car at the beginning of a path; raise FailedRun if an obstacle is there."""
    at = path.start.transform
    location = session.carla.Location(x=at.location.x, y=at.location.y, z=at.location.z + 0.5)
    try:
        return session.spawn(CAR, {}, session.carla.Transform(location, at.rotation))
    except RuntimeError as error:
        if "spawn" not in str(error).lower():
            raise
        raise FailedRun(
            f"the car can't be spawned at {location.x:.0f}, {location.y:.0f} m ({one_line(error)}); remove "
            "the obstacle"
        ) from None


def settle(session: Session, car: Any, ticks: int = SETTLE_TICKS) -> None:
    """Tick with full brakes until the car is at rest."""
    for _ in range(ticks):
        car.apply_control(session.carla.VehicleControl(brake=1.0))
        session.tick()


def control(session: Session, car: Any, physics: Physics, wanted: Control) -> None:
    """Apply the controls. CARLA's positive steering is to the right."""
    steer = min(max(-wanted.angle / physics.steer, -1.0), 1.0)
    car.apply_control(session.carla.VehicleControl(throttle=wanted.throttle, steer=steer, brake=wanted.brake))


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
