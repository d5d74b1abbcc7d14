"""Measure the noise of an IMU on a static log or on the standstills of a drive, or read it from a tuned filter."""

from sigmaswarm.noise.measure import filter_noise, imu_noise
from sigmaswarm.noise.records import AxisNoise, Noise
from sigmaswarm.noise.spectrum import Interval, allan_deviation

__all__ = ["AxisNoise", "Interval", "Noise", "allan_deviation", "filter_noise", "imu_noise"]
