"""Spawn the car, edit its physics, and control it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from .driver import Control
from .geometry import heading_of, polar
from .options import BRAKE_GAIN, FailedRun, RecorderError
from .routes import Path2D
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
