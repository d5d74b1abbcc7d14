"""The extended Kalman filter of ROS's robot_localization in ``two_d_mode``: its eight states that matter.

State: x, y (m), vx, vy (m/s, body), yaw (rad), ax, ay (m/s2, body), yaw rate (rad/s). Over d seconds, all from the old
state, with A = vx d + ax d^2 / 2 and B = vy d + ay d^2 / 2:

    x += cos(yaw) A - sin(yaw) B        y += sin(yaw) A + cos(yaw) B        yaw += d yaw rate
    vx += d ax                          vy += d ay                          P = J P J' + d Q

The velocity does not turn with the body, so an ay that is fused becomes sideways speed in a turn. Measurements are
states: gz, ax, ay of the IMU, vy = 0 of a twist, x and y of a fix. A fix with nu' S^-1 nu >= threshold^2 is left out.
z, roll, pitch and their rates stay at 0 in ``two_d_mode`` and decouple. Read from
https://github.com/cra-ros-pkg/robot_localization, branch rolling-devel.
"""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.compiled.layout import N_KEPT, N_STATE, Q0, R, lanes_for, most_lanes, state_rows
from sigmaswarm.filters.compiled.robot_localization import R_AX, R_AY, R_GZ, R_VY, robot_kernel
from sigmaswarm.geodesy import wrap_angle

STATES = ("x", "y", "vx", "vy", "yaw", "ax", "ay", "vyaw")
X, Y, VX, VY, YAW, AX, AY, VYAW = range(8)
SMALLEST = 1e-9
"""The filter raises variances of measurements to this."""


@dataclass(frozen=True)
class RobotLocalization:
    """Settings of the filter.

    Attributes
    ----------
    process_noise : tuple of float
        Variances per second, in the order of `STATES`.
    gz, ax, ay, vy : float or None
        Stated variances, (rad/s)2, (m/s2)2, (m/s2)2, (m/s)2; None for ay and vy: not fused.
    accuracy : float
        Factor on the variances that the fixes state.
    fix : float
        m2, variance of a fix on each axis, added to that.
    threshold : float or None
        ``pose_rejection_threshold``, a Mahalanobis distance.
    """

    process_noise: tuple[float, ...] = (0.05, 0.05, 0.025, 0.025, 0.06, 0.01, 0.01, 0.02)
    gz: float = 1e-4
    ax: float = 1e-2
    ay: float | None = None
    vy: float | None = None
    accuracy: float = 1.0
    fix: float = 0.0
    threshold: float | None = None


class TextbookRobotLocalization:
    """The filter in NumPy, one measurement at a time.

    Parameters
    ----------
    settings : RobotLocalization
    mean, covariance : ndarray, shapes (8,), (8, 8)
    """

    def __init__(self, settings: RobotLocalization, mean: Array, covariance: Array) -> None:
        self.settings, self.mean, self.covariance = settings, mean.copy(), covariance.copy()

    def predict(self, d: float) -> None:
        """Predict over ``d`` s."""
        x = self.mean
        c, s = np.cos(x[YAW]), np.sin(x[YAW])
        a, b = x[VX] * d + x[AX] * d**2 / 2, x[VY] * d + x[AY] * d**2 / 2
        jacobian = np.eye(8)
        along = [YAW, VX, VY, AX, AY]
        jacobian[X, along] = -s * a - c * b, c * d, -s * d, c * d**2 / 2, -s * d**2 / 2
        jacobian[Y, along] = c * a - s * b, s * d, c * d, s * d**2 / 2, c * d**2 / 2
        jacobian[[YAW, VX, VY], [VYAW, AX, AY]] = d
        moved = [c * a - s * b, s * a + c * b, d * x[AX], d * x[AY], d * x[VYAW], 0.0, 0.0, 0.0]
        self.mean = x + moved
        self.mean[YAW] = wrap_angle(self.mean[YAW])
        self.covariance = jacobian @ self.covariance @ jacobian.T + d * np.diag(self.settings.process_noise)

    def correct(self, states: list[int], z: list[float], variances: list[float], threshold: float = np.inf) -> None:
        """Update with measurements of some states, in Joseph's form; beyond the threshold not at all."""
        p, r = self.covariance, np.diag(np.maximum(variances, SMALLEST))
        h = np.eye(8)[states]
        nu, s = np.array(z) - self.mean[states], h @ p @ h.T + r
        if nu @ np.linalg.solve(s, nu) >= threshold**2:
            return
        gain = np.linalg.solve(s, h @ p).T
        self.mean = self.mean + gain @ nu
        self.mean[YAW] = wrap_angle(self.mean[YAW])
        kept = np.eye(8) - gain @ h
        self.covariance = kept @ p @ kept.T + gain @ r @ gain.T

    def imu(self, gz: float, ax: float, ay: float) -> None:
        """Update with an IMU sample, and with vy = 0 where that is fused."""
        p = self.settings
        self.correct([VYAW], [gz], [p.gz])
        if p.ay is None:
            self.correct([AX], [ax], [p.ax])
        else:
            self.correct([AX, AY], [ax, ay], [p.ax, p.ay])
        if p.vy is not None:
            self.correct([VY], [0.0], [p.vy])

    def gps(self, x: float, y: float, variance_x: float, variance_y: float) -> None:
        """Update with a fix and the variances that it states."""
        p = self.settings
        variances = [p.fix + p.accuracy * variance_x, p.fix + p.accuracy * variance_y]
        self.correct([X, Y], [x, y], variances, np.inf if p.threshold is None else p.threshold)


def kernel_rows(sets: list[RobotLocalization], mean: Array, covariance: Array) -> Array:
    """Columns of the compiled filter at its start, shape (blocks, N_KEPT, width)."""
    width = min(lanes_for(len(sets)), most_lanes("planar8"))
    blocks = -(-len(sets) // width)
    rows = np.zeros((N_KEPT, blocks * width))
    i, j = np.triu_indices(8)
    order = np.lexsort((i, j))
    state = [*mean, *covariance[i[order], j[order]]]
    rows[state_rows("planar8")] = np.array(state)[:, np.newaxis]
    rows[[R.DET, R.TAIL, R.OK]] = 1.0
    for k in range(blocks * width):
        p = sets[min(k, len(sets) - 1)]
        rows[Q0 : Q0 + 8, k] = p.process_noise
        noises = (p.gz, p.ax, p.ay or 1.0, p.vy or 1.0)
        rows[[R_GZ, R_AX, R_AY, R_VY], k] = np.maximum(noises, SMALLEST)
        rows[[R.RX, R.RY], k], rows[R.ACCURACY, k] = max(p.fix, SMALLEST if not p.accuracy else 0.0), p.accuracy
        rows[R.GATE, k] = np.inf if p.threshold is None else p.threshold**2
    return rows.reshape(N_KEPT, blocks, width).swapaxes(0, 1).copy()
