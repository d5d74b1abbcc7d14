"""What road and engine shake a sensor by, beyond what its data sheet says.

The levels are white-noise densities seen on two public recordings of real cars, from the differences of
neighboring samples at 5-16 m/s: rtklibexplorer's GNSS_IMU (Colorado, consumer MEMS) and comma2k19 (a phone's
chip). They are 3 to 8 times what the former shows at standstill, and about 20 times an MPU-6050's data sheet:
noise from the data sheet is too small in a car. Only such a level is modelled: no bumps, and no spectrum but for
this: the springs bring a body that rolls or pitches back, so what shakes it about these axes has no part that is
slower than they are. (White noise would turn it by degrees in a minute, which gravity would show as acceleration.)
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from sigmaswarm.simulation.motion import Motion

Array = NDArray[np.float64]

FORCE_DENSITY = (0.06, 0.025, 0.04)
"""m/s2/sqrt(Hz) forward, left, up, at `FULL_SPEED` and above."""
RATE_DENSITY = (0.002, 0.003, 0.0005)
"""rad/s/sqrt(Hz) about the same axes. About the second one, the one recording that has it shows 0.010."""
FULL_SPEED = 5.0
"""m/s; below it the shaking grows with speed from nothing."""
SPRINGS = 1.0
"""Hz; about where a car's body moves on its springs: a choice."""


def vibrate(motion: Motion, rate: float, strength: float, rng: np.random.Generator) -> Motion:
    """Return the motion with a shaken specific force and angular rate; place and velocity stay as they are.

    Parameters
    ----------
    motion : Motion
        At the samples' times.
    rate : float
        Hz, of the samples.
    strength : float
        1 is the level of those recordings.
    rng : numpy.random.Generator
        Source of the shaking.
    """
    speed = np.linalg.norm(motion.velocity, axis=1, keepdims=True)
    level = strength * np.sqrt(rate) * np.minimum(speed / FULL_SPEED, 1.0)
    shaken = rng.standard_normal((2, *motion.specific_force.shape)) * level
    kept = math.exp(-2 * math.pi * SPRINGS / rate)
    shaken[1, :, :2] = lfilter(
        [kept, -kept], [1.0, -kept], shaken[1, :, :2], axis=0
    )  # a first-order high pass
    return replace(
        motion,
        specific_force=motion.specific_force + shaken[0] * FORCE_DENSITY,
        angular_rate=motion.angular_rate + shaken[1] * RATE_DENSITY,
    )
