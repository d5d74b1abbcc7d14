"""Static logs of the simulator's IMU grades, with planted noise."""

import math
from dataclasses import dataclass

import numpy as np

from sigmaswarm.drives.tables import Imu
from sigmaswarm.simulation.dynamics import GRAVITY
from sigmaswarm.simulation.motion import Motion
from sigmaswarm.simulation.sensors import IMU_GRADES, ImuGrade, Triad, measure_imu

GRADES = [name for name in IMU_GRADES if name not in ("ideal", "carla")]
"""Grades of real sensors."""
AXES = ("ax", "ay", "az", "gx", "gy", "gz")


@dataclass(frozen=True)
class Planted:
    """White noise including that of the quantization (unit/sqrt(Hz)), and random walk of the bias (unit/sqrt(s))."""

    white: float
    walk: float


def static_log(grade: str | ImuGrade, seconds: float, interval: float = 0.01, seed: int = 0) -> Imu:
    """Simulate the samples of a resting sensor."""
    count = round(seconds / interval)
    still = np.zeros((count, 3))
    gravity = still + np.array([0.0, 0.0, GRAVITY])
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
    motion = Motion(still, still, rotation, np.zeros(count), gravity, still)
    chosen = IMU_GRADES[grade] if isinstance(grade, str) else grade
    return measure_imu(np.arange(count) * interval, motion, chosen, np.random.default_rng(seed))


def planted(grade: str, axis: str, interval: float = 0.01) -> Planted:
    """Return the specified noise of an axis."""
    known = IMU_GRADES[grade]
    triad: Triad = known.accel if axis[0] == "a" else known.gyro
    rounding = triad.resolution**2 / 12 * interval
    walk = triad.bias_std * math.sqrt(2 / known.bias_time)
    return Planted(math.sqrt(triad.noise_density**2 + rounding), walk)
