"""Evidence about roll, pitch and accelerometer biases from the last few seconds before a start.

The mean specific force, minus the acceleration that the fixes and the gyro show, is

    forward:  accelerometer bias - g pitch        left:  accelerometer bias + g roll - v (vertical gyro bias)

with the speed v. Only these sums are observable at the start. The gyro shows the changes of roll and pitch in the
seconds before the start. If e = roll + i pitch is the tilt at the start and psi the turn since an earlier time, the
tilt at the earlier time is

    exp(-i psi) (e - integral of (rates - biases) exp(i psi))
"""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached

GRAVITY = 9.81  # m/s2
FORWARD_STD = 0.15  # m/s2, standard deviation of changes of bias and slope that the gyro does not show
LEFT_STD = 0.05  # m/s2, standard deviation of the mean lateral acceleration minus its modeled part
SPEED_ERROR = 0.3  # m/s, standard deviation of an alignment's speed, which is multiplied by the turn rate
FORCE, VARIANCE, TURN, DRIFT, MEAN_SPEED, ASSUMED, ASSUMED_VARIANCE, CHANGE = 0, 2, 4, 6, 8, 9, 10, 11
"""Indices of `TiltEvidence.numbers`."""
NUMBERS = 16  # length of `TiltEvidence.numbers`
TIME, X, Y, TURNED, GAINED, ROLLED, PITCHED, LATERAL_SPEED = range(8)
"""Columns of the fixes of a window: time (s), position (m) and the integrals of the IMU's axes at the fix.

The integrals are those of yaw rate (rad), forward acceleration (m/s), rates about the forward and left axes (rad), and
lateral acceleration (m/s).
"""


@dataclass(frozen=True, eq=False)
class TiltEvidence:
    """Evidence about tilts and accelerometer biases from one alignment.

    ``numbers`` (16,) have the order of the last members of InsGpsGyro in exported C code. FORCE and VARIANCE are the
    mean specific force, forward and left, and its variance, in m/s2 and (m/s2)^2. TURN and DRIFT (s) are the changes of
    the mean tilt, real and imaginary part, per unit of the tilt at the start and per unit of the gyro's biases about
    the forward and left axes. The next entry is the mean speed, m/s. The alignment's mean is valid for the forward
    force ASSUMED, and the alignment's covariance includes the variance of this force, ASSUMED_VARIANCE. CHANGE is the
    change of x, y, vx, vy, theta per m/s2 of forward force.
    """

    numbers: Array

    def with_bias(self, known: float) -> "TiltEvidence":
        """Return the evidence for the raw yaw rate. ``known`` (rad/s) was subtracted from it before the alignment."""
        numbers = self.numbers.copy()
        numbers[FORCE + 1] -= numbers[MEAN_SPEED] * known
        return TiltEvidence(numbers)


@cached(error_model="numpy")
def mean_forces(
    fixes: Array,
    n: int,
    taken: float,
    speed: float,
    slope: float,
    variance: float,
    posterior: float,
    tilt: Array,
) -> None:
    """Compute the mean specific forces of a window and their dependence on tilts and biases.

    ``taken`` is the gyro bias subtracted before the fit, rad/s. ``speed`` (m/s, at the last fix) and ``slope`` (b,
    m/s2) are results of the fit. ``variance`` and ``posterior`` are the variances of b (see `alignment_fit`) without
    and with its prior. ``tilt`` is `TiltEvidence.numbers`, which initially contains only CHANGE.
    """
    last, end = n - 1, fixes[n - 1, TIME]
    span = end - fixes[0, TIME]
    # From a fix to the last fix, in the axes of the car at the last fix: rotation about x and y (rad), and the time
    # integral of the car's forward direction (s)
    x, y, forward, left = 0.0, 0.0, 0.0, 0.0
    lean_x, lean_y, rate, turned_speed = 0.0, 0.0, 0.0, 0.0
    for k in range(n - 2, -1, -1):
        dt = fixes[k + 1, TIME] - fixes[k, TIME]
        middle = 0.5 * (fixes[k, TIME] + fixes[k + 1, TIME]) - end
        angle = 0.5 * (fixes[k, TURNED] + fixes[k + 1, TURNED]) - fixes[last, TURNED] - taken * middle
        c, s, share = np.cos(angle), np.sin(angle), dt / span
        roll, pitch = fixes[k + 1, ROLLED] - fixes[k, ROLLED], fixes[k + 1, PITCHED] - fixes[k, PITCHED]
        dx, dy = c * roll - s * pitch, c * pitch + s * roll
        middle_x, middle_y = x + 0.5 * dx, y + 0.5 * dy
        ahead, aside = forward + 0.5 * c * dt, left + 0.5 * s * dt
        tilt[TURN] += share * c
        tilt[TURN + 1] -= share * s
        lean_x += share * (c * middle_x + s * middle_y)
        lean_y += share * (c * middle_y - s * middle_x)
        tilt[DRIFT] += share * (c * ahead + s * aside)
        tilt[DRIFT + 1] += share * (c * aside - s * ahead)
        x += dx
        y += dy
        forward += c * dt
        left += s * dt
        v = speed + 0.5 * (fixes[k, GAINED] + fixes[k + 1, GAINED]) - fixes[last, GAINED] + slope * middle
        part = (fixes[k + 1, TURNED] - fixes[k, TURNED] - taken * dt) / span
        tilt[MEAN_SPEED] += share * v
        rate += part
        turned_speed += v * part
    lateral = (fixes[last, LATERAL_SPEED] - fixes[0, LATERAL_SPEED]) / span - turned_speed
    tilt[FORCE] = -slope * variance / posterior - GRAVITY * lean_y
    tilt[FORCE + 1] = lateral - tilt[MEAN_SPEED] * taken + GRAVITY * lean_x
    tilt[VARIANCE] = variance
    tilt[VARIANCE + 1] = LEFT_STD * LEFT_STD + SPEED_ERROR * rate * SPEED_ERROR * rate
    tilt[ASSUMED] = -slope - GRAVITY * lean_y
    tilt[ASSUMED_VARIANCE] = posterior
