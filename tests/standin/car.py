"""The car of the stand-in: sigmaswarm's car with CARLA's controls, in CARLA's axes."""

import math
from typing import Any

import numpy as np

from sigmaswarm.simulation import dynamics
from sigmaswarm.simulation.dynamics import STEP
from sigmaswarm.simulation.environments import MODEL_3_CARLA
from sigmaswarm.simulation.motion import motion_at
from sigmaswarm.simulation.sensors import carla_force

STOCK_FRICTION = 3.5
"""tire_friction of CARLA's tires."""
STOCK_BRAKE = 700.0
"""N m, max_brake_torque of each wheel."""

_ORIGIN = (0.0, 0.0, 0.0)


def stock_physics() -> list[Any]:
    """Return VehiclePhysicsControl as the server sends it: some values of the Model 3, and four wheels."""
    steer = (70.0, 70.0, 0.0, 0.0)
    wheels = [[STOCK_FRICTION, 0.25, s, 34.0, STOCK_BRAKE, 0.0, 3.0, 17.0, 1000.0, 3 * [0.0]] for s in steer]
    curve, steering = [[0.0, 500.0], [15000.0, 100.0]], [[0.0, 1.0], [120.0, 0.5]]
    engine = [curve, 15000.0, 1.0, 0.15, 2.0, 0.35]
    gears = [True, 0.0, 10.0, 4.0, [[9.0, 0.5, 0.65]]]
    return [*engine, *gears, 1845.0, 0.15, [0.45, 0.0, -0.25], steering, wheels, True]


class Car:
    """A Model 3 on a plane.

    Attributes
    ----------
    rows : list of ndarray, shape (20,)
        Records of `sigmaswarm.simulation.dynamics` at the last three ticks.
    motion : Motion
        Motion of the car's origin at the last three ticks.
    seen, felt : tuple
        Results of `_seen` and `_felt` at the last tick.
    """

    def __init__(self, x: float, y: float, yaw: float, grip: float = 0.85) -> None:
        """Place the car at CARLA's x, y (m) and yaw (deg), at rest; stock tires have the friction `grip`."""
        self.grip = grip
        self.physics = stock_physics()
        self.control = [0.0, 0.0, 1.0, False, False, False, 0]
        self.state = dynamics.start_state(x, -y, -math.radians(yaw), 0.0, MODEL_3_CARLA)
        self._stages = np.zeros((5, dynamics.STATES))
        self._see(3 * [self._drive(0, 0.0, -1.0)], 0.05)

    def _drive(self, steps: int, steer: float, pedal: float) -> np.ndarray:
        """Advance the state by some steps; return the row that the next step would record."""
        wheels = self.physics[-2]
        friction = self.grip * wheels[0][0] / STOCK_FRICTION
        brakes = MODEL_3_CARLA.full_brake * (wheels[0][4] / STOCK_BRAKE)
        car, row = MODEL_3_CARLA._replace(full_brake=brakes), np.empty(dynamics.RECORDED)
        for _ in range(steps):
            dynamics._advance(self.state, self._stages, row, steer, pedal, friction, car)
        dynamics._advance(self.state.copy(), self._stages, row, steer, pedal, friction, car)
        return row

    def _see(self, rows: list[np.ndarray], seconds: float) -> None:
        """Compute the visible state and the IMU measurement once per tick."""
        self.rows, self.seconds = rows, seconds
        self.motion = motion_at(np.array(rows), MODEL_3_CARLA, _ORIGIN)
        self.seen, self.felt = self._seen(), self._felt()

    def tick(self, seconds: float) -> None:
        """Advance by one tick with the present control."""
        throttle, steer, brake, hand_brake = self.control[:4]
        pedal = -1.0 if hand_brake else throttle - brake
        # In CARLA, the angle of the wheels decreases with the speed of the car.
        curve = np.array(self.physics[-3])
        share = np.interp(3.6 * self.state[dynamics.VX], curve[:, 0], curve[:, 1])
        angle = -steer * share * MODEL_3_CARLA.steer_max
        self._see([*self.rows[1:], self._drive(round(seconds / STEP), angle, pedal)], seconds)

    def told_physics(self) -> list[Any]:
        """Return the physics, with the positions of the wheels in the world, cm."""
        car, (x, y, yaw) = MODEL_3_CARLA, self.state[:3]
        along, across = (car.front, car.front, -car.rear, -car.rear), car.track / 2
        for i, wheel in enumerate(self.physics[-2]):
            forward, left = along[i], across if i % 2 == 0 else -across
            east = x + forward * math.cos(yaw) - left * math.sin(yaw)
            north = y + forward * math.sin(yaw) + left * math.cos(yaw)
            wheel[-1] = [100 * east, -100 * north, 34.0]
        return self.physics

    def truth(self) -> list[float]:
        """Return x east and y north (m), their rates (m/s) and the heading (rad) in double precision."""
        now = self.motion
        return [*now.position[-1, :2], *now.velocity[-1, :2], now.yaw[-1]]

    def _seen(self) -> tuple[Any, Any, Any, Any]:
        """Return position, rotation (pitch, yaw, roll), velocity and angular velocity (deg/s) in CARLA's axes."""
        now = self.motion
        (x, y, z), (vx, vy, vz), rotation = now.position[-1], now.velocity[-1], now.rotation[-1]
        pitch = math.degrees(math.asin(rotation[2, 0]))
        roll = math.degrees(math.atan2(rotation[2, 1], rotation[2, 2]))
        yaw = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0]))
        p, q, r = np.degrees(rotation @ now.angular_rate[-1])
        return (x, -y, z), (pitch, -yaw, roll), (vx, -vy, vz), (-p, q, -r)

    def _felt(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the specific force (m/s2) and the angular rate (rad/s) without noise, in CARLA's axes."""
        now = self.motion
        fx, fy, fz = carla_force(self.seconds * np.arange(3), now)[0]
        p, q, r = now.angular_rate[-1]
        return (fx, -fy, fz), (-p, q, -r)
