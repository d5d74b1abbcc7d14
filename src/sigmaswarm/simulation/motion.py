"""From the car's recorded states to the motion of a point that is fixed to its body.

The body pitches and rolls about its centre of gravity while that moves in the plane, or on the road where that
is not flat. Attitude: yaw, then pitch (positive nose down), then roll (positive left side up), each about the
body's new axis; so positive lateral acceleration (a left turn) rolls the body to the right, and gravity leaks into
the sensor in the direction of the acceleration. The road's pitch and roll add to the suspension's. Everything here
is exact rigid-body kinematics, in closed form.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.simulation.dynamics import (
    AX,
    AY,
    GRAVITY,
    PITCH,
    PITCH_ACCEL,
    PITCH_RATE,
    RECORDED,
    ROLL,
    ROLL_ACCEL,
    ROLL_RATE,
    STEP,
    VX,
    VY,
    YAW,
    YAW_ACCEL,
    YAW_RATE,
    Vehicle,
    X,
    Y,
)
from sigmaswarm.simulation.terrain import (
    CLIMB,
    CLIMB_ACCEL,
    HEIGHT,
    ROAD_PITCH,
    ROAD_PITCH_ACCEL,
    ROAD_PITCH_RATE,
    ROAD_ROLL,
    ROAD_ROLL_ACCEL,
    ROAD_ROLL_RATE,
)

Array = NDArray[np.float64]
LeverArm = tuple[float, float, float]

_ROAD_ROLL = (ROAD_ROLL, ROAD_ROLL_RATE, ROAD_ROLL_ACCEL)
_ROAD_PITCH = (ROAD_PITCH, ROAD_PITCH_RATE, ROAD_PITCH_ACCEL)


@dataclass(frozen=True)
class Motion:
    """Motion of a point of the body, without errors.

    Attributes
    ----------
    position, velocity : ndarray, shape (n, 3)
        m and m/s east, north, up.
    rotation : ndarray, shape (n, 3, 3)
        From body to local axes.
    yaw : ndarray, shape (n,)
        rad, not wrapped.
    specific_force, angular_rate : ndarray, shape (n, 3)
        m/s2 and rad/s, in the body frame: what an ideal IMU there measures.
    """

    position: Array
    velocity: Array
    rotation: Array
    yaw: Array
    specific_force: Array
    angular_rate: Array


def sample(record: Array, times: Array) -> Array:
    """Rows of the record (n, 21 or 30) at any times (k,) in s, linearly between milliseconds."""
    place = np.clip(times / STEP, 0, len(record) - 1)
    before = np.minimum(place.astype(np.intp), len(record) - 2)
    weight = (place - before)[:, None]
    return record[before] * (1 - weight) + record[before + 1] * weight


def _rotation(yaw: Array, pitch: Array, roll: Array) -> Array:
    """R_z(yaw) R_y(pitch) R_x(roll), shape (n, 3, 3)."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    cr, sr = np.cos(roll), np.sin(roll)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def motion_at(rows: Array, vehicle: Vehicle, lever_arm: LeverArm) -> Motion:
    """Return the motion of a point of the body.

    Parameters
    ----------
    rows : ndarray, shape (n, 21) or (n, 30)
        Recorded states, see `sigmaswarm.simulation.dynamics`; with the road's, see `sigmaswarm.simulation.terrain`.
    vehicle : Vehicle
        Whose roll and pitch gains apply.
    lever_arm : tuple of float
        m forward, left, up of the centre of gravity.
    """
    arm = np.array(lever_arm)
    yaw = rows[:, YAW]
    r1, r2 = rows[:, YAW_RATE], rows[:, YAW_ACCEL]
    roll, f1, f2 = (vehicle.roll_gain * rows[:, i] for i in (ROLL, ROLL_RATE, ROLL_ACCEL))
    pitch, p1, p2 = (-vehicle.pitch_gain * rows[:, i] for i in (PITCH, PITCH_RATE, PITCH_ACCEL))
    level = np.zeros(len(yaw))
    height, climb, climb_rate = level, level, level
    if rows.shape[1] > RECORDED:
        roll, f1, f2 = (a + rows[:, i] for a, i in zip((roll, f1, f2), _ROAD_ROLL, strict=True))
        pitch, p1, p2 = (a + rows[:, i] for a, i in zip((pitch, p1, p2), _ROAD_PITCH, strict=True))
        height, climb, climb_rate = (rows[:, i] for i in (HEIGHT, CLIMB, CLIMB_ACCEL))
    cp, sp, cr, sr = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)

    # Angular rate of a yaw-pitch-roll sequence, and its derivative.
    rate = np.column_stack([f1 - r1 * sp, p1 * cr + r1 * cp * sr, -p1 * sr + r1 * cp * cr])
    rate_change = np.column_stack(
        [
            f2 - r2 * sp - r1 * p1 * cp,
            p2 * cr - p1 * f1 * sr + r2 * cp * sr - r1 * p1 * sp * sr + r1 * f1 * cp * cr,
            -p2 * sr - p1 * f1 * cr + r2 * cp * cr - r1 * p1 * sp * cr - r1 * f1 * cp * sr,
        ]
    )
    rotation = _rotation(yaw, pitch, roll)
    east = np.cos(yaw) * rows[:, AX] - np.sin(yaw) * rows[:, AY]
    north = np.sin(yaw) * rows[:, AX] + np.cos(yaw) * rows[:, AY]
    force = np.column_stack([east, north, climb_rate + GRAVITY])
    along = np.cross(rate, arm)
    center = np.column_stack([rows[:, X], rows[:, Y], height])
    moving = np.column_stack(
        [
            np.cos(yaw) * rows[:, VX] - np.sin(yaw) * rows[:, VY],
            np.sin(yaw) * rows[:, VX] + np.cos(yaw) * rows[:, VY],
            climb,
        ]
    )
    return Motion(
        position=center + rotation @ arm,
        velocity=moving + np.einsum("nij,nj->ni", rotation, along),
        rotation=rotation,
        yaw=yaw,
        specific_force=np.einsum("nji,nj->ni", rotation, force)
        + np.cross(rate_change, arm)
        + np.cross(rate, along),
        angular_rate=rate,
    )
