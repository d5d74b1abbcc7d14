"""The least-squares fit of an alignment.

    p(t) = p_i - exp(i theta_i) * integral_t^t_i  v(s) exp(i (psi(s) - psi_i)) ds
    v(s) = v_i + integral_t_i^s a_x + b (s - t_i)

Positions are complex numbers east + i north, psi is the integrated gyro, a_x the forward specific force, and b the
contribution of tilt and bias to it. The unknowns are position p_i, heading theta_i, speed v_i and b.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.gyro_bias import MAX_BIAS, TILT_CHANGE_STD, TURN_SHARE, UP, YAW_STD, GyroBiasEvidence
from sigmaswarm.drives.tables import Imu
from sigmaswarm.drives.tilt_evidence import Motion, TiltEvidence
from sigmaswarm.geodesy import wrap_angle

Complex = NDArray[np.complex128]
FixPaths = Complex
"""Path from each fix to the last one by the IMU, (3, f), in the body frame at the last fix.

Rows: per m/s of speed at the last fix (s), per m/s2 of tilt and bias (s2), and by the accelerometer (m).
"""

SLIP_STD = np.radians(1.0)  # rad, angle between course and heading at the IMU in ordinary driving
ACCELERATION_BIAS_STD = 0.5  # m/s2, prior of b (tilt and bias)
MIN_POSITION_STD = 0.05  # m per axis, smallest assumed standard deviation of fixes


@dataclass(frozen=True, eq=False)
class InitialState:
    """Initial state of a filter.

    Attributes
    ----------
    mean : ndarray, shape (5,)
        x, y (m), vx, vy (m/s), theta (rad).
    covariance : ndarray, shape (5, 5)
        Covariance of ``mean``, positive definite.
    time : float
        Time of the last fix of the alignment, s, at which filters and scores start.
    gyro : GyroBiasEvidence or None
        Evidence about the gyro's bias, for filters that estimate it; with None, they start with a bias of 0.
    tilt : TiltEvidence or None
        Evidence about roll, pitch and accelerometer biases, for filters with tilts; with None, they start level.
    """

    mean: Array
    covariance: Array
    time: float
    gyro: GyroBiasEvidence | None = None
    tilt: TiltEvidence | None = None


@dataclass(frozen=True, eq=False)
class AlignmentFit:
    """A fit to the fixes of the last few seconds; unknowns east, north, theta, v, b at ``time``.

    ``taken`` is the subtracted gyro bias, rad/s. ``yaw_bias`` and ``yaw_std``, rad/s, are the estimated bias and its
    standard deviation; ``bias_std`` is its standard deviation from the fit alone. ``turns`` is the
    change of the unknowns per rad/s of bias.
    """

    time: float
    solution: Array
    covariance: Array
    travel: float
    misfit: float
    taken: float
    yaw_bias: float
    yaw_std: float
    turns: Array
    span: float
    bias_std: float

    @property
    def heading_std(self) -> float:
        return float(np.sqrt(self.covariance[2, 2]))

    @classmethod
    def of(
        cls,
        drive: Drive,
        turned: Array,
        sped: Array,
        time: Array,
        position: Complex,
        taken: float = 0.0,
    ) -> "AlignmentFit":
        imu, end = drive.imu, time[-1]
        # the IMU's times from the first to the last fix
        inside = slice(*np.searchsorted(imu.time, [time[0]], side="right"), *np.searchsorted(imu.time, [end]))
        grid = np.concatenate([[time[0]], imu.time[inside], [end]])
        psi, gained = integral_at(imu, turned, imu.gz, grid), integral_at(imu, sped, imu.ax, grid)
        direction = np.exp(1j * (psi - psi[-1]))

        def until_end(integrand: Complex) -> Complex:
            pieces = 0.5 * (integrand[1:] + integrand[:-1]) * np.diff(grid)
            since_start = np.concatenate([[0.0], np.cumsum(pieces)])
            return since_start[-1] - np.interp(time, grid, since_start)

        integrands = direction, direction * (grid - end), direction * (gained - gained[-1])
        straight = np.array([until_end(each) for each in integrands])
        # Relative to the last fix, a bias rotates the path between two fixes by its integral from their middle time.
        since, middle = time - end, 0.5 * (time[1:] + time[:-1]) - end
        # The fixes are positions of the antenna, which rotates about the IMU with the lever arm.
        arm = np.interp(time, grid, direction) * complex(*drive.lever_arm) * np.exp(-1j * taken * since)
        way = _turned(straight, np.exp(-1j * taken * middle)) if taken else straight.copy()
        way[2] -= arm
        change = _turned(straight, -1j * middle * np.exp(-1j * taken * middle))
        change[2] -= -1j * since * arm
        coasting = float(np.trapezoid(gained - gained[-1], grid))  # m, the contribution of changes of speed
        fit = cls._solve(end, position, way, change, float(-since[0]), coasting, taken)
        # Part of a turn may look like a bias in any fit. The square of a NumPy float may be inf.
        turn = np.float64(np.ptp(psi - fit.yaw_bias * grid)) / fit.span
        std = float(np.sqrt(fit.yaw_std**2 + YAW_STD**2 + (TURN_SHARE * turn) ** 2))
        return replace(fit, yaw_std=std)

    def with_bias_variance(self, variance: float) -> "AlignmentFit":
        """Add the effect of a variance of the gyro's bias, (rad/s)^2, to the covariance of the unknowns."""
        covariance = self.covariance.copy()
        covariance[:4, :4] += variance * np.outer(self.turns, self.turns)
        return replace(self, covariance=covariance)

    @classmethod
    def _solve(
        cls,
        end: float,
        position: Complex,
        seen: FixPaths,
        change: FixPaths,
        span: float,
        coasting: float,
        taken: float,
    ) -> "AlignmentFit":
        """Solve for east, north, theta, v, b (Gauss-Newton); ``change``: derivative of the path by the gyro's bias."""
        g, t = seen[0], seen[1]
        chord = position[-1] - position[0]
        theta, v, b, p = np.angle(chord / g[0]), abs(chord) / max(abs(g[0]), 1e-9), 0.0, position[-1]
        prior = 1.0 / ACCELERATION_BIAS_STD
        jacobian, residual = np.empty((2 * len(g) + 1, 5)), np.empty(2 * len(g) + 1)
        variance, worst = 1.0, 0.0
        for _ in range(12):
            turn = np.exp(1j * theta)
            way = turn * (v * g + b * t + seen[2])
            columns = np.ones_like(g), 1j * np.ones_like(g), -1j * way, -turn * g, -turn * t
            jacobian[:-1] = np.column_stack([_real(column) for column in columns])
            misfit = position - (p - way)
            residual[:-1] = _real(misfit)
            worst = float(np.max(np.abs(misfit)))
            variance = max(float(residual[:-1] @ residual[:-1]) / (2 * len(g) - 4), MIN_POSITION_STD**2)
            jacobian[-1] = [0, 0, 0, 0, prior * np.sqrt(variance)]
            residual[-1] = -b * prior * np.sqrt(variance)
            step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
            p, theta, v, b = p + step[0] + 1j * step[1], theta + step[2], v + step[3], b + step[4]
            if np.max(np.abs(step)) < 1e-10:
                break
        covariance = np.asarray(variance * np.linalg.pinv(jacobian.T @ jacobian), np.float64)
        travel = v * span - b * span**2 / 2 + coasting  # the integral of v(s)
        forward = float(travel) if v > 0 else 0.0
        solution = np.array([p.real, p.imag, theta, v, b])
        bends = np.append(_real(-np.exp(1j * theta) * (v * change[0] + b * change[1] + change[2])), 0.0)
        more, std, turns = _one_more(jacobian, residual, bends)
        return cls(end, solution, covariance, forward, worst, taken, taken + more, std, turns[:4], span, std)

    def state(self, moved: Motion | None, *, tilts: bool = True) -> InitialState:
        """Return the start, with evidence about tilts if b was fitted; ``moved``: the IMU in the window."""
        east, north, theta, v, b = self.solution.tolist()
        c, s = np.cos(theta), np.sin(theta)
        # from (east, north, theta, v, slip angle) to (x, y, vx, vy, theta)
        motion = [0, 0, -v * s, c, 0], [0, 0, v * c, s, 0], [0, 0, 1, 0, -1]
        jacobian = np.array([[1, 0, 0, 0, 0], [0, 1, 0, 0, 0], *motion])
        inner = np.zeros((5, 5))
        inner[:4, :4] = self.covariance[:4, :4]
        inner[[0, 1], [0, 1]] += MIN_POSITION_STD**2
        inner[4, 4] = SLIP_STD**2
        covariance = jacobian @ inner @ jacobian.T
        mean = np.array([east, north, v * c, v * s, wrap_angle(theta)])
        gyro, tilt = self._gyro(moved, jacobian[:, :4] @ self.turns), None
        if moved is not None and tilts:
            posterior = float(self.covariance[4, 4])
            alone = posterior / max(
                1.0 - posterior / ACCELERATION_BIAS_STD**2, 1e-9
            )  # without the prior of b
            tilt = moved.evidence(
                v, b, alone, posterior, jacobian[:, :4] @ self.covariance[:4, 4] / posterior
            )
        return InitialState(mean, 0.5 * (covariance + covariance.T), self.time, gyro, tilt)

    def _gyro(self, moved: Motion | None, turns: Array) -> GyroBiasEvidence:
        bias, variance = np.append(np.zeros(2), self.yaw_bias), np.append(np.full(2, np.inf), self.yaw_std**2)
        if moved is not None:
            rates = (moved.leaned[-1] - moved.leaned[0]) / self.span
            bias[:UP], variance[:UP] = (rates.real, rates.imag), (TILT_CHANGE_STD / self.span) ** 2
        if abs(self.yaw_bias) > MAX_BIAS:  # the bias is unknown
            bias[UP], variance[UP] = self.taken, np.inf
        return GyroBiasEvidence(bias, variance, self.taken, turns)


def integral_at(imu: Imu, integral: Array, rate: Array, time: Array) -> Array:
    """Return the integral of a rate at some times, s, up to a fix.

    A live filter has no sample after the last fix, so the last sample before the fix is repeated.
    """
    values = np.interp(time, imu.time, integral)
    last = int(np.searchsorted(imu.time, time[-1], side="right")) - 1
    values[-1] = integral[last] + rate[last] * (time[-1] - imu.time[last])
    return values


def _turned(way: FixPaths, each: Complex) -> FixPaths:
    """Multiply the paths between successive fixes by complex factors (f - 1,)."""
    pieces = each * (way[:, :-1] - way[:, 1:])
    sums = np.cumsum(pieces[:, ::-1], axis=1)[:, ::-1]
    return np.column_stack([sums, np.zeros(3, np.complex128)])


def _real(column: Complex) -> Array:
    return np.concatenate([column.real, column.imag])


def _one_more(jacobian: Array, residual: Array, column: Array) -> tuple[float, float, Array]:
    """Add an unknown with the Jacobian ``column`` (m,) to a solved least-squares problem (m, n).

    Return the unknown's value, its standard deviation, and the change of the other unknowns per unit of it, (n,).
    """
    others = np.linalg.lstsq(jacobian, column, rcond=None)[0]
    alone = column - jacobian @ others
    size = max(float(alone @ alone), 1e-30)
    value = float(alone @ residual) / size
    left = float(residual @ residual) - size * value**2
    variance = max(left / max(len(column) - jacobian.shape[1] - 1, 1), MIN_POSITION_STD**2)
    return value, float(np.sqrt(variance / size)), np.asarray(-others, np.float64)
