"""Motion of a point of the car's body, from the recorded states of the car: on hills, and with vibration.

The body pitches and rolls about its center of gravity. Attitude: yaw, then pitch (positive nose down), then roll
(positive left side up), each about the new body axis. A left turn rolls the body to the right, so gravity increases the
measured lateral acceleration. The angles of the body are the sums of the angles of the road and of the suspension. The
equations are exact rigid-body kinematics.

Hills: grade and bank of the road, for a car that follows the path and speed of a flat road. The path in the plane is
the path on a flat road, since the driver compensates for the slope. Slopes change the height and the attitude of the
car. The attitude also changes because gravity acts on the suspension. The slopes depend on the distance s:

    grade pitch p(s), bank roll f(s);  slope of the road ahead  -tan p,  to the left  tan f / cos p
    height' = slope ahead x vx + slope to the left x vy

Grade and bank are second-order Gauss-Markov processes along the path with the autocovariance std^2 (1 + d/L) exp(-d/L)
(R. G. Brown and P. Y. C. Hwang, "Introduction to Random Signals and Applied Kalman Filtering", ch. 3). Cubic splines
avoid jumps of the angular acceleration. The bank also has a crossfall to the right and a superelevation in bends.

Sources, cited after the values: [M] measured by `benchmarks/road_slopes.py`: KITTI's residential and hill drives,
rtklibexplorer's Colorado drive. [A] AASHTO, "A Policy on Geometric Design of Highways and Streets": cross slope,
superelevation in towns and in snow. [R] from memory or chosen, not verified.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import cont2discrete, lfilter, ss2tf

from sigmaswarm.arrays import Array
from sigmaswarm.simulation.dynamics import (
    AX,
    GRAVITY,
    PEAK_KAPPA,
    PITCH,
    PITCH_ACCEL,
    PITCH_RATE,
    RECORDED,
    ROLL,
    ROLL_ACCEL,
    ROLL_RATE,
    STEER,
    STEP,
    Vehicle,
)
from sigmaswarm.simulation.environments import Named, by_name
from sigmaswarm.simulation.planning import SPACING

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
    """Add vibration to specific force and angular rate, sampled at ``rate`` Hz. Strength 1 is that of real cars."""
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


# Columns after the record of the car: roll and pitch (rad) of the road and its height (m), each with two derivatives.
ROAD_ROLL, ROAD_PITCH, HEIGHT = range(RECORDED, RECORDED + 9, 3)

_KNOT_SPACING = 2.0  # m, between the knots of the splines
_PROFILE_MARGIN = 50.0  # m, length of the profiles beyond both ends of the path
_CURVATURE_SMOOTHING = 10.0  # m, standard deviation of the smoothing of the curvature for the bank


@dataclass(frozen=True)
class Terrain(Named):
    """Statistics of the slopes of a road. Slopes are tangents; lengths are in m.

    Attributes
    ----------
    grade_std, grade_length, grade_limit : float
        Standard deviation, correlation length and bound (inf for none) of the slope along the road.
    bank_std, bank_length, bank_limit : float
        Standard deviation, correlation length and bound of the slope across the road.
    crossfall : float
        Mean downward slope to the right, which drains the road.
    superelevation : float
        Largest slope in bends, at the radius `banked_radius` (m). Wider and sharper bends have smaller slopes.
    """

    grade_std: float = 0.0
    grade_length: float = 50.0
    grade_limit: float = math.inf
    bank_std: float = 0.0
    bank_length: float = 18.0
    bank_limit: float = math.inf
    crossfall: float = 0.0
    superelevation: float = 0.0
    banked_radius: float = 120.0
    source: str = ""


# In the order of difficulty for a planar filter; `banked_radius` is [R].
TERRAINS = by_name(
    Terrain("flat", source="a plane"),
    Terrain(
        "rolling",
        grade_std=0.025,  # [M] kitti-09-30-0018 1.7%, colorado-1 3.3%
        grade_length=50.0,  # [M] 56 m, colorado-1
        grade_limit=0.08,  # [M] 8.1%, colorado-1
        bank_std=0.018,  # [M] 1.8-2.0%
        bank_length=18.0,  # [M] 10-20 m
        bank_limit=0.06,  # [M] 5.8%, colorado-1
        crossfall=0.02,  # [A]
        superelevation=0.04,  # [A] in towns
        source="colorado-1 and kitti-09-30-0018, measured; AASHTO",
    ),
    Terrain(
        "hilly",
        grade_std=0.055,  # [M] kitti-09-30-0034 4.9%, -0033 6.6%
        grade_length=60.0,  # [M] 34 and 82 m
        grade_limit=0.14,  # [M] 13.6 and 14.9%
        bank_std=0.024,  # [M] 2.3 and 2.6%
        bank_length=18.0,  # [M] 14 and 20 m
        bank_limit=0.09,  # [M] 4.9 and 11.4%
        crossfall=0.02,  # [A]
        superelevation=0.06,  # [A] where it snows
        source="kitti-09-30-0033 and -0034, measured; AASHTO",
    ),
)


@dataclass(frozen=True)
class RoadProfile:
    """Pitch (positive downhill) and roll (positive left side up) of a road (rad), over distance (m)."""

    pitch: CubicSpline
    roll: CubicSpline


def _wander(rng: np.random.Generator, count: int, std: float, length: float, limit: float) -> Array:
    """Draw a second-order Gauss-Markov sequence at the knots, with smooth saturation near the limit."""
    keep = np.exp(-_KNOT_SPACING / length)
    settled = int(10 * length / _KNOT_SPACING)
    drawn = lfilter([1.0], [1.0, -2 * keep, keep**2], rng.standard_normal(settled + count))
    of_filter = np.sqrt((1 + keep**2) / (1 - keep**2) ** 3)  # stationary standard deviation
    values = np.asarray(drawn)[settled:] * (std / of_filter)
    if math.isinf(limit):
        return values
    if limit <= 0:
        return 0 * values
    # Above two thirds of the limit, a smooth curve approaches the limit.
    soft = limit / 3
    beyond = np.maximum(np.abs(values) - 2 * soft, 0.0)
    return np.sign(values) * (np.abs(values) - beyond + soft * np.tanh(beyond / soft))


def build_road_profile(curvature: Array, terrain: Terrain, rng: np.random.Generator) -> RoadProfile:
    """Draw the slopes of a road. ``curvature`` (p,), 1/m, is the curvature of the path at each `SPACING` m."""
    length = len(curvature) * SPACING
    at = np.arange(-_PROFILE_MARGIN, length + _PROFILE_MARGIN, _KNOT_SPACING)
    grade = _wander(rng, len(at), terrain.grade_std, terrain.grade_length, terrain.grade_limit)
    bank = _wander(rng, len(at), terrain.bank_std, terrain.bank_length, terrain.bank_limit)
    # Positive left side up; in a left bend the left side is lower.
    sharp = terrain.banked_radius * gaussian_filter1d(
        curvature, _CURVATURE_SMOOTHING / SPACING, mode="nearest"
    )
    lean = -terrain.superelevation * 2 * sharp / (1 + sharp**2)
    bank += terrain.crossfall + np.interp(at, np.arange(len(curvature)) * SPACING, lean)
    pitch = -np.arctan(grade)
    return RoadProfile(CubicSpline(at, pitch), CubicSpline(at, np.arctan(bank * np.cos(pitch))))


def add_slopes(record: Array, road: RoadProfile, car: Vehicle) -> Array:
    """Add the columns from ROAD_ROLL on, and effects on the suspension, to a record (n, 21) of a flat road."""
    *_, vx, vy, turn = record.T[:STEER]
    ax, ay = record.T[AX : AX + 2]
    vx_rate, vy_rate = ax + turn * vy, ay - turn * vx  # derivatives in the rotating body axes
    way = _integral(vx)
    (p, p1, p2), (f, f1, f2) = (  # with two derivatives in time
        (profile(way), profile(way, 1) * vx, profile(way, 2) * vx**2 + profile(way, 1) * vx_rate)
        for profile in (road.pitch, road.roll)
    )
    ahead, left = -np.tan(p), np.tan(f) / np.cos(p)
    ahead_rate = -p1 / np.cos(p) ** 2
    left_rate = f1 / (np.cos(f) ** 2 * np.cos(p)) + left * np.tan(p) * p1
    climb = ahead * vx + left * vy
    climb_rate = ahead_rate * vx + ahead * vx_rate + left_rate * vy + left * vy_rate

    tilted = np.column_stack([record, f, f1, f2, p, p1, p2, _integral(climb), climb, climb_rate])
    # Specific force in the axes of the road; the suspension responds to the difference from a flat road.
    up = climb_rate + GRAVITY
    forward = np.cos(p) * ax - np.sin(p) * up
    normal = np.sin(p) * ax + np.cos(p) * up
    across = np.cos(f) * ay + np.sin(f) * normal
    more = _swing(forward - ax, car.pitch_frequency, car.pitch_damping)
    tilted[:, [PITCH, PITCH_RATE, PITCH_ACCEL]] += more
    tilted[:, [ROLL, ROLL_RATE, ROLL_ACCEL]] += _swing(across - ay, car.roll_frequency, car.roll_damping)
    return tilted


def _integral(values: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2)]) * STEP


def _swing(target: Array, frequency: float, damping: float) -> Array:
    """Return the second-order response to a target, and the rate and acceleration of the response, shape (n, 3).

    The response starts at rest at the first target. The discretization is exact for a target that is linear between
    samples.
    """
    a, b = [[0.0, 1.0], [-(frequency**2), -2 * damping * frequency]], [[0.0], [frequency**2]]
    system = np.array(a), np.array(b), np.eye(2), np.zeros((2, 1))
    above, below = ss2tf(*cast(tuple[Any, ...], cont2discrete(system, STEP, method="foh"))[:4])
    value, rate = (np.asarray(lfilter(row, below, target - target[0])) for row in above)
    value += target[0]
    return np.column_stack([value, rate, frequency**2 * (target - value) - 2 * damping * frequency * rate])
