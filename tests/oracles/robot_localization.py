"""The filter of `models.robot_localization` in NumPy, one measurement at a time."""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.robot_yaml import MIN_VARIANCE
from sigmaswarm.filters.textbook.kalman import complex_step
from sigmaswarm.geodesy import wrap_angle

NAME = "robot-localization"
X, Y, VX, VY, YAW, AX, AY, VYAW = range(8)


class TextbookRobotLocalization:
    """An extended Kalman filter; ``mean`` (8,) and ``covariance`` (8, 8) are in the order of the model's states.

    ``process_noise`` refers to ``nominal_interval``, 1 s by default.
    """

    def __init__(self, parameters: FilterParameters, mean: Array, covariance: Array) -> None:
        self.parameters, self.mean, self.covariance = parameters, mean.copy(), covariance.copy()
        self._q = np.diag(parameters.process_noise) / (parameters.nominal_interval or 1.0)

    def predict(self, d: float) -> None:
        def f(state: Array) -> Array:
            return MODELS[NAME].process(state, d, np.empty(0))

        jacobian = complex_step(f, self.mean)
        self.mean = f(self.mean)
        self.mean[YAW] = wrap_angle(self.mean[YAW])
        self.covariance = jacobian @ self.covariance @ jacobian.T + d * self._q

    def correct(self, states: list[int], z: Array, variances: Array, gate: float = np.inf) -> None:
        """Update with measurements of some states, in Joseph's form; a NIS of ``gate`` or more is rejected."""
        p, r = self.covariance, np.diag(np.maximum(variances, MIN_VARIANCE))
        h = np.eye(8)[states]
        nu, s = z - self.mean[states], h @ p @ h.T + r
        nu = wrap_angle(nu) if states == [YAW] else nu
        if nu @ np.linalg.solve(s, nu) >= gate:
            return
        gain = np.linalg.solve(s, h @ p).T
        self.mean = self.mean + gain @ nu
        self.mean[YAW] = wrap_angle(self.mean[YAW])
        kept = np.eye(8) - gain @ h
        self.covariance = kept @ p @ kept.T + gain @ r @ gain.T

    def imu(self, gz: float, ax: float, ay: float | None = None) -> None:
        """Update with an IMU sample; the tuned model does not use ``ay``, but many configurations fuse it."""
        (r_gyro, r_accel, *_), (gyro_gate, accel_gate) = self.parameters.imu_noise, self.parameters.imu_gate
        self.correct([VYAW], np.array([gz]), np.array([r_gyro]), gyro_gate)
        self.correct([AX], np.array([ax]), np.array([r_accel]), accel_gate)
        if ay is not None:
            self.correct([AY], np.array([ay]), np.array([self.parameters.imu_noise[-1]]))

    def twist(self) -> None:
        """Update with a sideways velocity of 0."""
        self.correct([VY], np.zeros(1), np.array([self.parameters.lateral_noise]))

    def odometer(self, speed: float) -> None:
        """Update with the wheels' speed forward, m/s."""
        self.correct([VX], np.array([speed]), np.array([self.parameters.odometer_noise]))

    def heading(self, yaw: float, stated: float) -> None:
        """Update with a yaw, rad, and its stated variance, rad2."""
        self.correct([YAW], np.array([yaw]), np.array([stated + (self.parameters.heading_noise or 0.0)]))

    def fix(self, position: Array, stated: Array) -> None:
        """Update with a fix, (2,) m, and its stated variances, (2,) m2."""
        p = self.parameters
        variances = np.array(p.measurement_noise) + (p.accuracy_scale or 0.0) * stated
        self.correct([X, Y], position, variances, p.gate or np.inf)
