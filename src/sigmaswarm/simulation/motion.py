"""Compute the motion of a point of the car's body from the recorded states of the car, and add vibration.

The body pitches and rolls about its center of gravity. Attitude: yaw, then pitch (positive nose down), then roll
(positive left side up), each about the new body axis. A left turn rolls the body to the right, so gravity increases the
measured lateral acceleration. The angles of the body are the sums of the angles of the road and of the suspension. The
equations are exact rigid-body kinematics.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from sigmaswarm.arrays import Array
from sigmaswarm.simulation.dynamics import GRAVITY, PEAK_KAPPA, RECORDED, ROLL, STEER, STEP, Vehicle

LeverArm = tuple[float, float, float]

# Vibration: white-noise densities from differences of neighboring samples at 5 to 16 m/s in two public recordings of
# real cars: rtklibexplorer's GNSS_IMU (Colorado, consumer MEMS) and comma2k19 (chip of a phone). These densities are 3
# to 8 times the Colorado densities at standstill, and 6 to 34 times those in the data sheet of an MPU-6050. Bumps and
# spectra are not modeled. Roll and pitch rates have no part below the frequency of the springs: white noise would
# rotate the body by degrees in a minute, and gravity would appear as acceleration.
FORCE_DENSITY = (0.06, 0.025, 0.04)  # m/s2/sqrt(Hz) forward, left, up, density at `FULL_SPEED` and above
# rad/s/sqrt(Hz), same axes; in the only recording of the pitch rate its density is 0.010
RATE_DENSITY = (0.002, 0.003, 0.0005)
FULL_SPEED = 5.0  # m/s; vibration is proportional to speed below this speed
BODY_FREQUENCY = 1.0  # Hz, natural frequency of the body on its springs; an assumption


@dataclass(frozen=True)
class Motion:
    """Motion of a point of the body, without errors."""

    position: Array  # (n, 3) m east, north, up
    velocity: Array  # (n, 3) m/s
    rotation: Array  # (n, 3, 3), from body to local axes
    yaw: Array  # (n,) rad, not wrapped
    specific_force: Array  # (n, 3) m/s2, in the body frame; an ideal IMU measures it
    angular_rate: Array  # (n, 3) rad/s, in the body frame


def sample(record: Array, times: Array) -> Array:
    """Interpolate the record (n, 21 or 30) linearly at times (k,), s."""
    index = np.clip(times / STEP, 0, len(record) - 1)
    before = np.minimum(index.astype(np.intp), len(record) - 2)
    weight = (index - before)[:, None]
    return record[before] * (1 - weight) + record[before + 1] * weight


def _rotation(yaw: Array, pitch: Array, roll: Array) -> Array:
    """Return R_z(yaw) R_y(pitch) R_x(roll), shape (n, 3, 3)."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    cr, sr = np.cos(roll), np.sin(roll)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def motion_at(rows: Array, vehicle: Vehicle, lever_arm: LeverArm | Array) -> Motion:
    """Return the motion of the point at ``lever_arm`` (m forward, left, up) from the center of gravity.

    ``rows`` are recorded states of `dynamics` (n, 21), or with the road of `terrain` (n, 30).
    """
    arm = np.array(lever_arm)
    x, y, yaw, vx, vy, r1 = rows.T[:STEER]
    roll, f1, pitch, p1, ax, ay, r2, f2, p2 = rows.T[ROLL:PEAK_KAPPA]
    body = np.array([roll, f1, f2, pitch, p1, p2])
    body *= np.repeat([vehicle.roll_gain, -vehicle.pitch_gain], 3)[:, None]
    height, climb, climb_rate = np.zeros((3, len(rows)))
    if rows.shape[1] > RECORDED:
        body, (height, climb, climb_rate) = body + rows.T[RECORDED:-3], rows.T[-3:]
    roll, f1, f2, pitch, p1, p2 = body
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
    east = np.cos(yaw) * ax - np.sin(yaw) * ay
    north = np.sin(yaw) * ax + np.cos(yaw) * ay
    force = np.column_stack([east, north, climb_rate + GRAVITY])
    velocity = np.cross(rate, arm)
    center = np.column_stack([x, y, height])
    moving = np.column_stack(
        [np.cos(yaw) * vx - np.sin(yaw) * vy, np.sin(yaw) * vx + np.cos(yaw) * vy, climb]
    )
    return Motion(
        position=center + rotation @ arm,
        velocity=moving + np.einsum("nij,nj->ni", rotation, velocity),
        rotation=rotation,
        yaw=yaw,
        specific_force=np.einsum("nji,nj->ni", rotation, force)
        + np.cross(rate_change, arm)
        + np.cross(rate, velocity),
        angular_rate=rate,
    )


def vibrate(motion: Motion, rate: float, strength: float, rng: np.random.Generator) -> Motion:
    """Add vibration to specific force and angular rate, sampled at ``rate`` Hz; strength 1 is that of real cars."""
    speed = np.linalg.norm(motion.velocity, axis=1, keepdims=True)
    level = strength * np.sqrt(rate) * np.minimum(speed / FULL_SPEED, 1.0)
    shaking = rng.standard_normal((2, *motion.specific_force.shape)) * level
    kept = math.exp(-2 * math.pi * BODY_FREQUENCY / rate)
    # first-order high pass
    shaking[1, :, :2] = lfilter([kept, -kept], [1.0, -kept], shaking[1, :, :2], axis=0)
    return replace(
        motion,
        specific_force=motion.specific_force + shaking[0] * FORCE_DENSITY,
        angular_rate=motion.angular_rate + shaking[1] * RATE_DENSITY,
    )
