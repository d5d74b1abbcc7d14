"""Measure the noise of an IMU on a static log or on the standstills of a drive, or read it from a tuned filter.

`imu_noise` finds the static stretches (`static`), fits the noise model to the spectrum of each axis (`spectrum`) and
computes the Allan deviation (`allan`). `exports.imu_noise` writes the result for other packages.
"""

from sigmaswarm.noise.allan import allan_deviation
from sigmaswarm.noise.measure import filter_noise, imu_noise
from sigmaswarm.noise.records import AxisNoise, Noise
from sigmaswarm.noise.spectrum import Interval

__all__ = ["AxisNoise", "Interval", "Noise", "allan_deviation", "filter_noise", "imu_noise"]
