"""The fit behind an alignment.

By least squares,

    p(t) = p_i - exp(i theta_i) * integral_t^t_i  v(s) exp(i (psi(s) - psi_i)) ds
    v(s) = v_i + integral_t_i^s a_x + b (s - t_i)

with positions as complex numbers east + i north, psi the integrated gyro, a_x the forward specific force and
b what tilt and bias add to it. The unknowns are position p_i, heading theta_i, speed v_i and b. What the gyro's own
bias would change is kept beside them.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.gyro_seen import LEAN_STD, MOST_BIAS, TURN_SHARE, UP, YAW_STD, GyroSeen
from sigmaswarm.geodesy import wrap_angle

Complex = NDArray[np.complex128]

SLIP_STD = np.radians(1.0)
"""rad: at the IMU a car's course differs from its heading by about this much in ordinary driving."""
ACCELERATION_BIAS_STD = 0.5
"""m/s2: tilt and bias of the forward accelerometer, the prior of b."""
MIN_POSITION_STD = 0.05
"""m per axis: lowest deviation of a fit."""


@dataclass(frozen=True, eq=False)
class InitialState:
    """Where a filter starts.

    Attributes
    ----------
    mean : ndarray, shape (5,)
        x, y (m), vx, vy (m/s), theta (rad).
    covariance : ndarray, shape (5, 5)
        Positive definite, of ``mean``.
    time : float
        s: time of the last fix used. Filters and scores start here.
    gyro : GyroSeen or None
        Evidence on the gyro's bias, for filters that estimate it. None: they start with 0.
    """

    mean: Array
    covariance: Array
    time: float
    gyro: GyroSeen | None = None


@dataclass(frozen=True, eq=False)
class Way:
    """Motion from each fix to the last one by the IMU, (f,) each, in the body's frame at the last one.

    Attributes
    ----------
    per_speed : s, of a car that drives 1 m/s now
    per_bias : s2, of 1 m/s2 that tilt and bias add
    seen : m, by the accelerometer
    """

    per_speed: Complex
    per_bias: Complex
    seen: Complex

    def at(self, v: float, b: float) -> Complex:
        """m, at a speed now and what is added to the accelerometer."""
        return v * self.per_speed + b * self.per_bias + self.seen

    def turned(self, each: Complex) -> "Way":
        """With the piece between two fixes turned, and stretched, by each of (f - 1,)."""

        def anew(whole: Complex) -> Complex:
            pieces = each * (whole[:-1] - whole[1:])
            return np.asarray(np.append(np.cumsum(pieces[::-1])[::-1], 0.0), np.complex128)

        return Way(anew(self.per_speed), anew(self.per_bias), anew(self.seen))

    def carrying(self, arm: Complex) -> "Way":
        """Offset of the antenna from the IMU, m at each fix."""
        return Way(self.per_speed, self.per_bias, self.seen - arm)


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit of the last seconds of fixes; unknowns east, north, theta, v, b at ``time``.

    ``taken`` is what was taken off the gyro (rad/s), ``yaw_bias`` what should have been, as unsure as ``yaw_std``;
    ``turns`` is what that changes in the unknowns, per rad/s. ``bias_std`` is that of the fit alone, rad/s.
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
    ) -> "Fit":
        imu, end = drive.imu, time[-1]
        # The IMU's grid between the first and the last fix, both included.
        inside = slice(*np.searchsorted(imu.time, [time[0]], side="right"), *np.searchsorted(imu.time, [end]))
        grid = np.concatenate([[time[0]], imu.time[inside], [end]])
        psi, gained = np.interp(grid, imu.time, turned), np.interp(grid, imu.time, sped)
        # The last fix comes after the last sample that a filter on board would have: hold that one.
        last = int(np.searchsorted(imu.time, end, side="right")) - 1
        psi[-1] = turned[last] + imu.gz[last] * (end - imu.time[last])
        gained[-1] = sped[last] + imu.ax[last] * (end - imu.time[last])
        direction = np.exp(1j * (psi - psi[-1]))

        def until_end(integrand: Complex) -> Complex:
            """The integral from each fix to the last one (trapezoids)."""
            pieces = 0.5 * (integrand[1:] + integrand[:-1]) * np.diff(grid)
            since_start = np.concatenate([[0.0], np.cumsum(pieces)])
            return since_start[-1] - np.interp(time, grid, since_start)

        straight = Way(
            until_end(direction),
            until_end(direction * (grid - end)),
            until_end(direction * (gained - gained[-1])),
        )
        # A bias turns the piece between two fixes, as seen from the last one, by what adds up from its middle on.
        since, middle = time - end, 0.5 * (time[1:] + time[:-1]) - end
        # The fixes are the antenna's, which the lever arm carries around the IMU.
        arm = np.interp(time, grid, direction) * complex(*drive.lever_arm) * np.exp(-1j * taken * since)
        way = (straight.turned(np.exp(-1j * taken * middle)) if taken else straight).carrying(arm)
        change = straight.turned(-1j * middle * np.exp(-1j * taken * middle)).carrying(-1j * since * arm)
        coasting = float(np.trapezoid(gained - gained[-1], grid))  # m, the contribution of changes of speed
        fit = cls._solve(end, position, way, change, float(-since[0]), coasting, taken)
        return replace(fit, yaw_std=fit._doubted(psi, grid))

    def with_bias_variance(self, variance: float) -> "Fit":
        """With what a variance of the gyro's bias, (rad/s)^2, adds to the unknowns' covariance."""
        covariance = self.covariance.copy()
        covariance[:4, :4] += variance * np.outer(self.turns, self.turns)
        return replace(self, covariance=covariance)

    def _doubted(self, psi: Array, grid: Array) -> float:
        """``yaw_std`` with what no fit sees: a turn may be taken for bias in part."""
        turn = (
            np.float64(np.ptp(psi - self.yaw_bias * grid)) / self.span
        )  # squares to inf where float would raise
        return float(np.sqrt(self.yaw_std**2 + YAW_STD**2 + (TURN_SHARE * turn) ** 2))

    @classmethod
    def _solve(
        cls,
        end: float,
        position: Complex,
        seen: Way,
        change: Way,
        span: float,
        coasting: float,
        taken: float,
    ) -> "Fit":
        """Gauss-Newton on east, north, theta, v, b; ``change`` is that of the way with the gyro's bias."""
        g, t = seen.per_speed, seen.per_bias
        chord = position[-1] - position[0]
        theta, v, b, p = np.angle(chord / g[0]), abs(chord) / max(abs(g[0]), 1e-9), 0.0, position[-1]
        prior = 1.0 / ACCELERATION_BIAS_STD
        jacobian, residual = np.empty((2 * len(g) + 1, 5)), np.empty(2 * len(g) + 1)
        variance, worst = 1.0, 0.0
        for _ in range(12):
            turn = np.exp(1j * theta)
            way = turn * seen.at(v, b)
            columns = [np.ones_like(g), 1j * np.ones_like(g), -1j * way, -turn * g, -turn * t]
            for k, column in enumerate(columns):
                jacobian[:-1, k] = _real(column)
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
        bends = np.append(_real(-np.exp(1j * theta) * change.at(v, b)), 0.0)
        more, std, turns = _one_more(jacobian, residual, bends)
        return cls(end, solution, covariance, forward, worst, taken, taken + more, std, turns[:4], span, std)

    def state(self, leaning: Array) -> InitialState:
        """The start; ``leaning`` (2,) is what the gyro shows about forward and left, rad/s."""
        east, north, theta, v, _ = self.solution
        c, s = np.cos(theta), np.sin(theta)
        # (east, north, theta, v) and a slip angle of its own -> (x, y, vx, vy, theta)
        jacobian = np.array(
            [
                [1, 0, 0, 0, 0],
                [0, 1, 0, 0, 0],
                [0, 0, -v * s, c, 0],
                [0, 0, v * c, s, 0],
                [0, 0, 1, 0, -1],
            ]
        )
        inner = np.zeros((5, 5))
        inner[:4, :4] = self.covariance[:4, :4]
        inner[[0, 1], [0, 1]] += MIN_POSITION_STD**2
        inner[4, 4] = SLIP_STD**2
        covariance = jacobian @ inner @ jacobian.T
        mean = np.array([east, north, v * c, v * s, wrap_angle(float(theta))])
        gyro = self._gyro(leaning, jacobian[:, :4] @ self.turns)
        return InitialState(mean, 0.5 * (covariance + covariance.T), self.time, gyro)

    def _gyro(self, leaning: Array, turns: Array) -> GyroSeen | None:
        bias = np.nan_to_num(np.append(leaning, self.yaw_bias))
        variance = np.append(
            np.where(np.isfinite(leaning), (LEAN_STD / self.span) ** 2, np.inf), self.yaw_std**2
        )
        if abs(self.yaw_bias) > MOST_BIAS:  # then nothing is known of it
            bias[UP], variance[UP] = self.taken, np.inf
        return GyroSeen(bias, variance, self.taken, turns)


def _real(column: Complex) -> Array:
    return np.concatenate([column.real, column.imag])


def _one_more(jacobian: Array, residual: Array, column: Array) -> tuple[float, float, Array]:
    """Of a solved problem (m, n): the value of one more unknown, its standard deviation, and how the others follow it.

    What of its ``column`` (m,) the others can't do tells it.
    """
    others = np.linalg.lstsq(jacobian, column, rcond=None)[0]
    alone = column - jacobian @ others
    size = max(float(alone @ alone), 1e-30)
    value = float(alone @ residual) / size
    left = float(residual @ residual) - size * value**2
    variance = max(left / max(len(column) - jacobian.shape[1] - 1, 1), MIN_POSITION_STD**2)
    return value, float(np.sqrt(variance / size)), np.asarray(-others, np.float64)
