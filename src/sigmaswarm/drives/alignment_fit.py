"""The least-squares fit of an alignment.

    p(t) = p_n - exp(i theta_n) * integral from t to t_n of v(s) exp(i (psi(s) - psi_n)) ds
    v(s) = v_n + b (s - t_n) + integral from t_n to s of a_x

Positions are complex numbers east + i north. t_n is the time of the last fix, psi the integrated yaw rate, a_x the
forward specific force, and b a correction of this force for tilt and bias. The unknowns are position p_n, heading
theta_n and speed v_n at t_n, and b. The compiled functions have no complex numbers, since `exports.c_alignment`
translates them to C.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import cached
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gyro_bias import MAX_BIAS, TILT_CHANGE_STD, TURN_SHARE, UP, YAW_STD, GyroBiasEvidence
from sigmaswarm.drives.tables import Imu
from sigmaswarm.drives.tilt_evidence import (
    CHANGE,
    NUMBERS,
    PITCHED,
    ROLLED,
    TIME,
    TiltEvidence,
    X,
    Y,
    mean_forces,
)
from sigmaswarm.geodesy import wrap_angle

SLIP_STD = np.radians(1.0)  # rad, standard deviation of course minus heading at the IMU in ordinary driving
ACCELERATION_BIAS_STD = 0.5  # m/s2, standard deviation of the prior of b (tilt and bias)
FIX_ERROR_TIME = 60.0  # s, time constant of lasting errors of the fixes
MIN_POSITION_STD = 0.05  # m per axis, smallest assumed standard deviation of fixes
MAX_STEPS = 12  # largest number of Gauss-Newton steps
CONVERGED = 1e-10  # m, rad, m/s or m/s2; the fit ends when no unknown changes by more

BY_SPEED, BY_SLOPE, BY_GAINS, ARM, BY_BIAS, COLUMNS = range(0, 12, 2)
"""Columns of the path from each fix to the last fix.

Each quantity has two columns, forward and left in the body frame at the last fix.

The first quantities are the path per m/s of speed at the last fix (s), the path per m/s2 of b (s2), and the path due to
the measured acceleration (m). The next quantity is the position of the antenna relative to the IMU (m). The fit writes
the derivative of the path with respect to the gyro's bias (m s) to the last two columns.
"""
EAST, NORTH, YAW, SPEED, SLOPE, TRAVEL, MISFIT, YAW_BIAS, YAW_VARIANCE, RESULTS = range(10)
"""Indices of the results of a fit.

The first values are the unknowns: position (m), heading (rad) and speed (m/s) at the last fix, and b (m/s2). The others
are travel (m; 0 if backward), largest residual (m), remaining gyro bias (rad/s) and its variance.
"""
RESIDUAL = 5  # column of the residuals in the two equations of a fix, after the columns of the derivatives


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
        Time of the last fix of the alignment, s. Filters and scores start at this time.
    gyro : GyroBiasEvidence or None
        Evidence about the gyro's bias, for filters that estimate this bias. If None, the bias starts at 0.
    tilt : TiltEvidence or None
        Evidence about roll, pitch and accelerometer biases, for filters with tilts. If None, roll and pitch start at 0.
    """

    mean: Array
    covariance: Array
    time: float
    gyro: GyroBiasEvidence | None = None
    tilt: TiltEvidence | None = None


class AlignmentFit:
    """A fit to the fixes of a window.

    Attributes
    ----------
    taken : subtracted gyro bias, rad/s
    yaw_bias, yaw_std, bias_std : gyro bias about the vertical, its standard deviation, and the part of the standard
        standard deviation that is due to the residuals of the fit, rad/s
    travel, misfit : length of the path, and largest residual of a fix, m
    heading_std : standard deviation of the heading if there is no slip, rad
    span : time from the first to the last fix, s
    """

    def __init__(
        self, drive: Drive, integrals: Mapping[str, Array], time: Array, position: NDArray[np.complex128]
    ) -> None:
        """Fit to the fixes ``time`` (s) and ``position`` (m), without a gyro bias.

        ``integrals`` contains, by axis, time integrals of the IMU's measurements since the first sample.
        """
        imu, end = drive.imu, time[-1]
        inside = slice(*np.searchsorted(imu.time, [time[0]], side="right"), *np.searchsorted(imu.time, [end]))
        self._grid = grid = np.concatenate([[time[0]], imu.time[inside], [end]])
        psi, gained = (_integral_at(imu, axis, integrals, grid) for axis in ("gz", "ax"))
        direction = np.exp(1j * (psi - psi[-1]))

        def until_end(integrand: Array) -> Array:
            pieces = 0.5 * (integrand[1:] + integrand[:-1]) * np.diff(grid)
            since_start = np.concatenate([[0.0], np.cumsum(pieces)])
            return since_start[-1] - np.interp(time, grid, since_start)

        integrands = direction, direction * (grid - end), direction * (gained - gained[-1])
        # The fixes are positions of the antenna, which rotates about the IMU with the lever arm.
        arm = np.interp(time, grid, direction) * complex(*drive.lever_arm)
        columns = np.array([*(until_end(each) for each in integrands), arm, np.zeros(len(time))])
        self._path = np.ascontiguousarray(columns.T).view(np.float64)
        axes = [_integral_at(imu, axis, integrals, time) for axis in ("gz", "ax", "gx", "gy", "ay")]
        self._fixes = np.column_stack([time, position.real, position.imag, *axes])
        self._coasting = float(np.trapezoid(gained - gained[-1], grid))  # m, by changes of speed
        self._psi, self._leans = psi, imu.gx is not None and imu.gy is not None
        self.span, self.taken = float(end - time[0]), 0.0
        self._solve()

    def subtract(self, bias: float) -> None:
        """Subtract a gyro bias (rad/s) from the yaw rate, and fit again."""
        turn_path(self._fixes, len(self._fixes), self._path, bias - self.taken)
        self.taken = bias
        self._solve()

    def _solve(self) -> None:
        self._fit, self._covariance, self._turns = np.zeros(RESULTS), np.zeros((5, 5)), np.zeros(5)
        fit, fixes = self._fit, self._fixes
        fit_path(fixes, len(fixes), self._path, self._coasting, fit, self._covariance, self._turns)
        self.travel, self.misfit, more, variance = fit[TRAVEL:].tolist()
        self.yaw_bias, self.bias_std = self.taken + more, float(np.sqrt(variance))
        # Part of a turn may look like a bias in any fit. The square of np.float64 overflows without an error.
        turn = np.float64(np.ptp(self._psi - self.yaw_bias * self._grid)) / self.span
        self.yaw_std = float(np.sqrt(variance + YAW_STD**2 + (TURN_SHARE * turn) ** 2))

    @property
    def heading_std(self) -> float:
        return float(np.sqrt(self._covariance[YAW, YAW]))

    def add_bias_variance(self, variance: float) -> None:
        """Add the effect of a gyro bias variance, (rad/s)^2, to the covariance of position, heading and speed."""
        self._covariance[:SLOPE, :SLOPE] += variance * np.outer(self._turns[:SLOPE], self._turns[:SLOPE])

    def add_lasting_errors(self, variance: float) -> None:
        """Add the effect of lasting errors of the fixes with a variance, m2 per axis, to the covariance."""
        change = 2 * variance * -float(np.expm1(-self.span / FIX_ERROR_TIME))
        added = variance, variance, change / max(self.travel, 1e-9) ** 2, change / self.span**2
        self._covariance[range(SLOPE), range(SLOPE)] += added

    def state(self, *, tilts: bool = True) -> InitialState:
        """Return the initial state. With ``tilts``, include evidence about tilts if the IMU has gx and gy."""
        fixes, mean, numbers = self._fixes, np.zeros(5), np.zeros(NUMBERS)
        posterior, covariance = self._covariance[SLOPE, SLOPE], self._covariance.copy()
        turns = self._turns.copy()
        variance = convert_to_start(self._fit, mean, covariance, turns, numbers[CHANGE:])
        mean[4] = wrap_angle(mean[4])
        tilt = None
        if self._leans and tilts:
            speed, slope = self._fit[SPEED], self._fit[SLOPE]
            mean_forces(fixes, len(fixes), self.taken, speed, slope, variance, posterior, numbers)
            tilt = TiltEvidence(numbers)
        return InitialState(mean, covariance, float(fixes[-1, TIME]), self._gyro(turns), tilt)

    def _gyro(self, turns: Array) -> GyroBiasEvidence:
        bias, variance = np.append(np.zeros(2), self.yaw_bias), np.append(np.full(2, np.inf), self.yaw_std**2)
        if self._leans:
            leaned = self._fixes[:, ROLLED : PITCHED + 1]
            bias[:UP] = (leaned[-1] - leaned[0]) / self.span
            variance[:UP] = (TILT_CHANGE_STD / self.span) ** 2
        if abs(self.yaw_bias) > MAX_BIAS:  # the bias is unknown
            bias[UP], variance[UP] = self.taken, np.inf
        return GyroBiasEvidence(bias, variance, self.taken, turns)


def _integral_at(imu: Imu, axis: str, integrals: Mapping[str, Array], time: Array) -> Array:
    """Return the integral for an axis at times (s) up to a fix, or 0 if ``integrals`` does not contain the axis.

    The integral at the fix is extrapolated from the last sample before it, since a live filter has no later sample.
    """
    if axis not in integrals:
        return np.zeros(len(time))
    values = np.interp(time, imu.time, integrals[axis])
    last = int(np.searchsorted(imu.time, time[-1], side="right")) - 1
    values[-1] = integrals[axis][last] + getattr(imu, axis)[last] * (time[-1] - imu.time[last])
    return values


@cached(error_model="numpy")
def turn_path(fixes: Array, n: int, path: Array, bias: float) -> None:
    """Correct the path of n fixes for a gyro bias (rad/s).

    Each piece of the path between two fixes is rotated by the integral of the bias from the middle of the piece to the
    last fix.
    """
    end = fixes[n - 1, TIME]
    for k in range(n):
        angle = bias * (end - fixes[k, TIME])
        c, s = np.cos(angle), np.sin(angle)
        x, y = path[k, ARM], path[k, ARM + 1]
        path[k, ARM] = c * x - s * y
        path[k, ARM + 1] = s * x + c * y
        if k < n - 1:
            angle = bias * (end - 0.5 * (fixes[k, TIME] + fixes[k + 1, TIME]))
            c, s = np.cos(angle), np.sin(angle)
            for j in range(BY_SPEED, ARM, 2):
                x, y = path[k, j] - path[k + 1, j], path[k, j + 1] - path[k + 1, j + 1]
                path[k, j] = c * x - s * y
                path[k, j + 1] = s * x + c * y
    for k in range(n - 2, -1, -1):
        for j in range(ARM):
            path[k, j] += path[k + 1, j]


@cached(error_model="numpy")
def _invert(matrix: Array) -> None:
    """Invert a positive definite matrix (5, 5) by Gauss-Jordan elimination."""
    for p in range(5):
        pivot = 1.0 / matrix[p, p]
        matrix[p, p] = 1.0
        for j in range(5):
            matrix[p, j] *= pivot
        for i in range(5):
            if i != p:
                factor = matrix[i, p]
                matrix[i, p] = 0.0
                for j in range(5):
                    matrix[i, j] -= factor * matrix[p, j]


@cached(error_model="numpy")
def _multiply(matrix: Array, vector: Array, product: Array) -> None:
    """Multiply a matrix (5, 5) by a vector (5,)."""
    for i in range(5):
        product[i] = 0.0
        for j in range(5):
            product[i] += matrix[i, j] * vector[j]


@cached(error_model="numpy")
def _equations_of(fix: Array, way: Array, fit: Array, c: float, s: float, rows: Array) -> None:
    """Set rows (2, 6): the equations of a fix along a heading (forward) and perpendicular to it (left).

    ``c`` and ``s`` are cosine and sine of the heading. The columns of the position (forward, left) are not set, since
    they are those of the identity matrix.
    """
    v, slope = fit[SPEED], fit[SLOPE]
    x, y = fix[X] - fit[EAST], fix[Y] - fit[NORTH]
    forward = v * way[BY_SPEED] + slope * way[BY_SLOPE] + way[BY_GAINS] - way[ARM]
    left = v * way[BY_SPEED + 1] + slope * way[BY_SLOPE + 1] + way[BY_GAINS + 1] - way[ARM + 1]
    for i in range(2):
        rows[i, SPEED] = -way[BY_SPEED + i]
        rows[i, SLOPE] = -way[BY_SLOPE + i]
    rows[0, YAW] = left
    rows[1, YAW] = -forward
    rows[0, RESIDUAL] = c * x + s * y + forward
    rows[1, RESIDUAL] = c * y - s * x + left


@cached(error_model="numpy")
def fit_path(
    fixes: Array, n: int, path: Array, coasting: float, fit: Array, covariance: Array, turns: Array
) -> None:
    """Fit the unknowns to n fixes by the Gauss-Newton method, and then the gyro bias.

    ``coasting`` is the part of the travel that is due to changes of speed, m. The results are ``fit``, ``covariance``
    (of the unknowns) and ``turns`` (the derivatives of the unknowns with respect to the gyro bias).
    """
    east, north = fixes[n - 1, X] - fixes[0, X], fixes[n - 1, Y] - fixes[0, Y]
    forward, left = path[0, BY_SPEED], path[0, BY_SPEED + 1]
    fit[EAST], fit[NORTH] = fixes[n - 1, X], fixes[n - 1, Y]
    fit[YAW] = np.arctan2(north * forward - east * left, east * forward + north * left)
    fit[SPEED] = np.hypot(east, north) / max(np.hypot(forward, left), 1e-9)
    fit[SLOPE] = 0.0
    variance, worst, squares = 1.0, 0.0, 0.0
    prior = 1.0 / (ACCELERATION_BIAS_STD * ACCELERATION_BIAS_STD)
    rows, right, step = np.zeros((2, 6)), np.zeros(5), np.zeros(5)
    for _ in range(MAX_STEPS):
        c, s = np.cos(fit[YAW]), np.sin(fit[YAW])
        worst = 0.0
        squares = 0.0
        for i in range(5):
            right[i] = 0.0
            for j in range(5):
                covariance[i, j] = 0.0
        for k in range(n):
            _equations_of(fixes[k], path[k], fit, c, s, rows)
            x, y = rows[0, RESIDUAL], rows[1, RESIDUAL]
            right[EAST] += x
            right[NORTH] += y
            for i in range(YAW, 5):
                covariance[i, EAST] += rows[0, i]
                covariance[i, NORTH] += rows[1, i]
                right[i] += rows[0, i] * x + rows[1, i] * y
                for j in range(YAW, i + 1):
                    covariance[i, j] += rows[0, i] * rows[0, j] + rows[1, i] * rows[1, j]
            squares += x * x + y * y
            worst = max(worst, x * x + y * y)
        covariance[EAST, EAST], covariance[NORTH, NORTH] = 1.0 * n, 1.0 * n
        for i in range(5):
            for j in range(i):
                covariance[j, i] = covariance[i, j]
        variance = max(squares / (2.0 * n - 4.0), MIN_POSITION_STD * MIN_POSITION_STD)
        covariance[SLOPE, SLOPE] += prior * variance
        right[SLOPE] -= prior * variance * fit[SLOPE]
        _invert(covariance)
        _multiply(covariance, right, step)
        fit[EAST] += c * step[EAST] - s * step[NORTH]
        fit[NORTH] += s * step[EAST] + c * step[NORTH]
        largest = max(abs(step[EAST]), abs(step[NORTH]))
        for i in range(YAW, 5):
            fit[i] += step[i]
            largest = max(largest, abs(step[i]))
        if largest < CONVERGED:
            break
    v, slope, span = fit[SPEED], fit[SLOPE], fixes[n - 1, TIME] - fixes[0, TIME]
    travel = v * span - 0.5 * slope * span * span + coasting  # the integral of v(s)
    fit[TRAVEL] = travel if v > 0.0 else 0.0
    fit[MISFIT] = np.sqrt(worst)
    _fit_bias(fixes, n, path, fit, covariance, prior * variance, turns)
    for i in range(5):
        for j in range(5):
            covariance[i, j] *= variance


@cached(error_model="numpy")
def _fit_bias(
    fixes: Array, n: int, path: Array, fit: Array, inverse: Array, prior: float, turns: Array
) -> None:
    """Fit the remaining gyro bias, from the part of its effect on the path that the other unknowns do not explain.

    ``inverse`` is the inverse of the normal matrix. ``prior`` is the weight of the prior of b in the normal matrix.
    """
    c, s = np.cos(fit[YAW]), np.sin(fit[YAW])
    rows, right = np.zeros((2, 6)), np.zeros(5)
    x, y, bend_x, bend_y, before = 0.0, 0.0, 0.0, 0.0, fixes[n - 1, TIME]
    for k in range(n - 1, -1, -1):
        _equations_of(fixes[k], path[k], fit, c, s, rows)
        forward, left = path[k, ARM] - rows[1, YAW], path[k, ARM + 1] + rows[0, YAW]
        age = fixes[n - 1, TIME] - fixes[k, TIME]
        middle = 0.5 * (fixes[k, TIME] + before) - fixes[n - 1, TIME]
        before = fixes[k, TIME]
        bend_x -= middle * (left - y)
        bend_y += middle * (forward - x)
        x = forward
        y = left
        path[k, BY_BIAS] = bend_x - age * path[k, ARM + 1]
        path[k, BY_BIAS + 1] = bend_y + age * path[k, ARM]
        right[EAST] += path[k, BY_BIAS]
        right[NORTH] += path[k, BY_BIAS + 1]
        for i in range(YAW, 5):
            right[i] += rows[0, i] * path[k, BY_BIAS] + rows[1, i] * path[k, BY_BIAS + 1]
    _multiply(inverse, right, turns)
    slope = turns[SLOPE]
    size, value = prior * slope * slope, prior * slope * fit[SLOPE]
    squares = prior * fit[SLOPE] * fit[SLOPE]
    for k in range(n):
        _equations_of(fixes[k], path[k], fit, c, s, rows)
        for row in range(2):
            alone = path[k, BY_BIAS + row] - turns[row]
            for i in range(YAW, 5):
                alone -= rows[row, i] * turns[i]
            size += alone * alone
            value += alone * rows[row, RESIDUAL]
            squares += rows[row, RESIDUAL] * rows[row, RESIDUAL]
    size = max(size, 1e-30)
    fit[YAW_BIAS] = value / size
    left_over = squares - value * value / size
    fit[YAW_VARIANCE] = max(left_over / (2.0 * n - 5.0), MIN_POSITION_STD * MIN_POSITION_STD) / size
    for i in range(5):
        turns[i] = -turns[i]


@cached(error_model="numpy")
def _convert_change(c: float, s: float, v: float, e: Array) -> None:
    """Convert changes of the unknowns (5,) to changes of x, y, vx, vy and theta."""
    x, y, turn, faster = e[EAST], e[NORTH], e[YAW], e[SPEED]
    e[0], e[1] = c * x - s * y, s * x + c * y
    e[2], e[3] = c * faster - s * v * turn, s * faster + c * v * turn
    e[4] = turn


@cached(error_model="numpy")
def convert_to_start(fit: Array, mean: Array, covariance: Array, turns: Array, change: Array) -> float:
    """Convert a fit to the mean x, y, vx, vy, theta of an initial state. Return the variance of b without its prior.

    ``covariance`` and ``turns`` are converted in place. The change of the mean per m/s2 of forward force is stored in
    ``change``.
    """
    c, s, v, posterior = (np.cos(fit[YAW]), np.sin(fit[YAW]), fit[SPEED], covariance[SLOPE, SLOPE])
    mean[0], mean[1], mean[2], mean[3], mean[4] = (fit[EAST], fit[NORTH], v * c, v * s, fit[YAW])
    _convert_change(c, s, v, turns)
    for i in range(5):
        _convert_change(c, s, v, covariance[i])
    for i in range(5):
        change[i] = -covariance[SLOPE, i] / posterior
        for j in range(i):
            x, y = covariance[i, j], covariance[j, i]
            covariance[i, j], covariance[j, i] = y, x
    for i in range(5):
        _convert_change(c, s, v, covariance[i])
        for j in range(i):
            covariance[i, j] = 0.5 * (covariance[i, j] + covariance[j, i])
            covariance[j, i] = covariance[i, j]
    covariance[0, 0] += MIN_POSITION_STD * MIN_POSITION_STD
    covariance[1, 1] += MIN_POSITION_STD * MIN_POSITION_STD
    covariance[4, 4] += SLIP_STD * SLIP_STD  # the car moves along its heading, except for this slip
    return posterior / max(1.0 - posterior / (ACCELERATION_BIAS_STD * ACCELERATION_BIAS_STD), 1e-9)
