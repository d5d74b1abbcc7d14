"""Simulate hills: grade and bank of the road, for a car that follows the path and speed of a flat road.

The path in the plane is the path on a flat road, since the driver compensates for the slope. Slopes change the height
and the attitude of the car. The attitude also changes because gravity acts on the suspension. The slopes depend on the
distance s:

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
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import cont2discrete, lfilter, ss2tf

from sigmaswarm.arrays import Array
from sigmaswarm.simulation.dynamics import (
    AX,
    GRAVITY,
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
from sigmaswarm.simulation.environments import by_name
from sigmaswarm.simulation.planning import SPACING

# Columns after the record of the car: roll and pitch (rad) of the road and its height (m), each with two derivatives.
ROAD_ROLL, ROAD_PITCH, HEIGHT = range(RECORDED, RECORDED + 9, 3)

_KNOT_SPACING = 2.0  # m, between the knots of the splines
_PROFILE_MARGIN = 50.0  # m, length of the profiles beyond both ends of the path
_CURVATURE_SMOOTHING = 10.0  # m, standard deviation of the smoothing of the curvature for the bank


@dataclass(frozen=True)
class Terrain:
    """Statistics of the slopes of a road. Slopes are tangents; lengths are in m.

    Attributes
    ----------
    grade_std, grade_length, grade_limit : float
        Standard deviation, correlation length and bound (inf for none) of the slope along the road.
    bank_std, bank_length, bank_limit : float
        Standard deviation, correlation length and bound of the slope across the road.
    crossfall : float
        Mean slope down to the right, for drainage.
    superelevation : float
        Largest slope in bends, at the radius `banked_radius` (m). Wider and sharper bends have smaller slopes.
    """

    name: str
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
    """Draw the slopes of a road; ``curvature`` (p,), 1/m, is the curvature of the path at each `SPACING` m."""
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
