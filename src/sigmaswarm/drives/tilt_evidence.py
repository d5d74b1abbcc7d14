"""Evidence about roll, pitch and accelerometer biases from the last few seconds before a start.

The mean specific force, minus the acceleration that the fixes and the gyro show, is

    forward:  accelerometer bias - g pitch        left:  accelerometer bias + g roll - v gyro bias about up

Only these sums are observable at the start. The gyro shows the changes of roll and pitch since then: with the tilt
e = roll + i pitch at the start and the turn psi since an earlier time, the tilt at this time is

    exp(-i psi) (e - integral of (rates - biases) exp(i psi))
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.tables import Array

Complex = NDArray[np.complex128]
GRAVITY = 9.81  # m/s2
FORWARD_STD = 0.15  # m/s2, mean change of bias and slope in a window, beyond the gyro's
LEFT_STD = 0.05  # m/s2, other lateral accelerations in the mean of a window
NUMBERS = 16  # length of `TiltEvidence.numbers`
SPEED_ERROR = 0.3  # m/s, error of an alignment's speed, which multiplies the turn rate


@dataclass(frozen=True, eq=False)
class TiltEvidence:
    """Evidence about tilts and accelerometer biases from one alignment.

    ``force`` and ``variance`` (2,), forward and left, are in m/s2 and (m/s2)^2. ``turn`` and ``drift`` (s) are the
    changes of the mean tilt per unit of the tilt at the start and of the gyro's biases about forward and left.
    ``speed`` is the mean speed, m/s. The alignment's mean is valid for the forward force ``assumed``, and its
    covariance includes ``assumed_variance``; ``change`` (5,) is the change of x, y, vx, vy, theta per m/s2.
    """

    force: Array
    variance: Array
    turn: complex
    drift: complex
    speed: float
    assumed: float
    assumed_variance: float
    change: Array

    @property
    def numbers(self) -> list[float]:
        """All values, in the order of C's InsGpsGyro."""
        turns = self.turn.real, self.turn.imag, self.drift.real, self.drift.imag
        return [
            *self.force,
            *self.variance,
            *turns,
            self.speed,
            self.assumed,
            self.assumed_variance,
            *self.change,
        ]

    def with_bias(self, known: float) -> "TiltEvidence":
        """Return the evidence for the original gyro, before a known bias about up, rad/s, was subtracted."""
        return replace(self, force=self.force - [0.0, self.speed * known])


@dataclass(frozen=True, eq=False)
class Motion:
    """Integrals of the IMU's axes at the fixes of a window, (f,) each, without the gyro bias ``taken``, rad/s."""

    time: Array  # s
    turned: Array  # rad
    leaned: Complex  # rad about forward + i rad about left, in the axes of the IMU
    gained: Array  # m/s forward
    lateral: Array  # m/s to the left
    taken: float

    def evidence(
        self, speed: float, slope: float, variance: float, posterior: float, change: Array
    ) -> TiltEvidence:
        """Return the evidence.

        ``speed``: at the last fix, m/s. ``slope`` and ``posterior``: mean and variance of b in the fit; ``variance``:
        that without its prior; ``change`` (5,): of the start per unit of b.
        """
        dt, span = np.diff(self.time), self.time[-1] - self.time[0]
        turn: Complex = np.exp(1j * _until_middle(self.turned))
        leaned, waited = (_since_middle(turn * each) for each in (np.diff(self.leaned), dt + 0j))
        weight = dt / span / turn
        speeds = speed + _until_middle(self.gained) + slope * _until_middle(self.time)
        rate, mean_speed = np.diff(self.turned) / span, float(speeds @ dt / span)
        left = (self.lateral[-1] - self.lateral[0]) / span - float(speeds @ rate) - mean_speed * self.taken
        tilt = GRAVITY * np.sum(weight * leaned)
        forward = -slope * variance / posterior - tilt.imag
        left_variance = LEFT_STD**2 + (SPEED_ERROR * np.sum(rate)) ** 2
        return TiltEvidence(
            np.array([forward, left + tilt.real]),
            np.array([variance, left_variance]),
            complex(np.sum(weight)),
            complex(np.sum(weight * waited)),
            mean_speed,
            -slope - tilt.imag,
            posterior,
            -change,
        )


def _until_middle(values: Array) -> Array:
    """Return the values at the middle between two fixes, relative to the last fix."""
    return 0.5 * (values[1:] + values[:-1]) - values[-1]


def _since_middle(pieces: Complex) -> Complex:
    """Return the sums of the pieces from the middle of each one to the last fix."""
    return np.cumsum(pieces[::-1])[::-1] - 0.5 * pieces
