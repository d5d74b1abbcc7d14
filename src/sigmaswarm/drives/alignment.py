"""Where and how a filter starts: an initial state taken from the drive alone, causally, without truth.

A car's heading can't be seen at standstill, and a GPS fix has none. Once the car has driven some metres,
its course over ground shows the heading; the gyro takes out the turns and the accelerometer the speed
changes in between. `initial_state` looks back over the last seconds of fixes and fits, by least squares,

    p(t) = p_i - exp(i theta_i) * integral_t^t_i  v(s) exp(i (psi(s) - psi_i)) ds
    v(s) = v_i + integral_t_i^s a_x + b (s - t_i)

with positions as complex numbers east + i north, psi the integrated gyro, a_x the forward specific force and
b what tilt and bias add to it. The unknowns are position p_i, heading theta_i, speed v_i and b.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.frozen import frozen_fixes
from sigmaswarm.errors import AlignmentError
from sigmaswarm.geodesy import wrap_angle

Array = NDArray[np.float64]

MIN_DURATION = 4.0
"""s of forward travel behind the first usable fix."""
MAX_DURATION = 6.0
"""s: older fixes tell little about the heading now, since the gyro's bias adds up."""
MIN_TRAVEL = 20.0
"""m of forward travel behind the first usable fix."""
FEWEST_FIXES = 4
"""In that time."""
WORTH_TRAVEL = 0.5 * MIN_TRAVEL
"""m between the first and the last of them: a cheap look before the fit."""
MAX_MISFIT = 0.3
"""Share of the travel: where a fix lies farther off the fit, the fixes jumped rather than the car moved."""
MAX_HEADING_STD = np.radians(6.0)
"""rad: a worse fit is not travel but scattered fixes; the next fix is tried."""
SLIP_STD = np.radians(1.0)
"""rad: at the IMU a car's course differs from its heading by about this much in ordinary driving."""
ACCELERATION_BIAS_STD = 0.5
"""m/s2: tilt and bias of the forward accelerometer, the prior of b."""
MIN_POSITION_STD = 0.05
"""m per axis: no fit is believed to be better than this."""


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
        s: the time of the fix that was absorbed last. Filters and scores start here.
    """

    mean: Array
    covariance: Array
    time: float


def initial_state(drive: Drive, *, as_recorded: bool = False) -> InitialState:
    """The first moment at which the drive itself tells position, speed and heading.

    The start is the first fix with at least 4 s and 20 m of forward travel behind it. It is found from
    earlier samples only, so a filter on board could have started at the same moment with the same state.

    Parameters
    ----------
    drive : Drive
        Its truth, if any, is not looked at.
    as_recorded : bool
        Take frozen fixes as positions, too: see `drives.frozen`.

    Raises
    ------
    AlignmentError
        If the car never travels 20 m within 6 s.
    """
    # Later code may start a filter only where IMU samples follow.
    usable = (drive.gps.time > drive.imu.time[0]) & (drive.gps.time < drive.imu.time[-1])
    alignments = Alignments(drive, usable if as_recorded else usable & ~frozen_fixes(drive.gps))
    for k in range(len(alignments.time)):
        if found := alignments.at(k):
            return found
    raise AlignmentError(
        f"{drive.name}: never travels {MIN_TRAVEL:g} m within {MAX_DURATION:g} s, so the heading can't be found; "
        "use a longer drive, or one that gets up to speed"
    )


class Alignments:
    """The alignment that ends at each fix, by the log alone; found when it is first asked for, and kept.

    Parameters
    ----------
    drive : Drive
    usable : ndarray of bool, shape (number of fixes,), optional
        The fixes that are looked at; of them those after the first IMU sample and up to the last one. All by default.

    Attributes
    ----------
    time : ndarray, shape (m,)
        s, of those fixes.
    """

    def __init__(self, drive: Drive, usable: NDArray[np.bool_] | None = None) -> None:
        self._drive = drive
        inside = (drive.gps.time > drive.imu.time[0]) & (drive.gps.time <= drive.imu.time[-1])
        inside &= np.isfinite(drive.gps.x + drive.gps.y)
        fixes = np.flatnonzero(inside if usable is None else inside & usable)
        self.time = drive.gps.time[fixes]
        self._position = (drive.gps.x + 1j * drive.gps.y)[fixes]
        # The fixes of the last seconds before each.
        self._first = np.searchsorted(self.time, self.time - MAX_DURATION, side="left")
        count = np.arange(len(fixes)) - self._first + 1
        chord = np.abs(self._position - self._position[self._first])
        self._worth = (self.time - self.time[self._first] >= MIN_DURATION) & (count >= FEWEST_FIXES)
        self._worth &= chord >= WORTH_TRAVEL
        self._found: dict[int, InitialState | None] = {}

    def at(self, k: int) -> InitialState | None:
        """The alignment that ends at the k-th of the fixes; None where the car has not travelled enough, or they jump.

        It takes some milliseconds: ask where it matters.
        """
        if k not in self._found:
            with np.errstate(all="ignore"):  # what overflows is no alignment
                self._found[k] = self._fitted(k) if self._worth[k] else None
        return self._found[k]

    def _fitted(self, k: int) -> InitialState | None:
        window = slice(self._first[k], k + 1)
        try:
            fit = _Fit.of(self._drive, *self._integrals, self.time[window], self._position[window])
        except np.linalg.LinAlgError:  # something was not finite
            return None
        smooth = fit.misfit <= MAX_MISFIT * fit.travel
        usable = fit.travel >= MIN_TRAVEL and fit.heading_std <= MAX_HEADING_STD and smooth
        return fit.state() if usable else None

    @cached_property
    def _integrals(self) -> tuple[Array, Array]:
        return _integrated(self._drive)

    @cached_property
    def course(self) -> Array:
        """A rough heading at each fix, (m,) rad; NaN where there is no alignment. All of a drive's cost little.

        It is where the fit begins: the chord of the last seconds, with the turns in between taken out. Changes of speed
        in a turn make it wrong by some degrees.
        """
        with np.errstate(all="ignore"):
            return self._rough()

    def _rough(self) -> Array:
        imu, turned = self._drive.imu, self._integrals[0]
        direction = np.exp(1j * turned)
        direction[1:] = 0.5 * (direction[1:] + direction[:-1]) * np.diff(imu.time)
        direction[0] = 0.0
        way = np.cumsum(direction, out=direction)
        at = np.interp(self.time, imu.time, way)
        psi = np.interp(self.time, imu.time, turned)
        first, last = self._first[self._worth], np.flatnonzero(self._worth)
        course = np.full(len(self.time), np.nan)
        chord = self._position[last] - self._position[first]
        course[last] = np.angle(chord * (at[last] - at[first]).conj() * np.exp(1j * psi[last]))
        return course


def _integrated(drive: Drive) -> tuple[Array, Array]:
    """Heading change (rad) and speed change (m/s) since the first IMU sample, at the IMU's times."""
    dt = np.diff(drive.imu.time)
    turned = np.concatenate([[0.0], np.cumsum(drive.imu.gz[1:] * dt)])
    sped = np.concatenate([[0.0], np.cumsum(drive.imu.ax[1:] * dt)])
    return turned, sped


@dataclass(frozen=True, eq=False)
class _Fit:
    """A least-squares fit of the last seconds of fixes; unknowns east, north, theta, v, b at ``time``."""

    time: float
    solution: Array
    covariance: Array
    travel: float
    misfit: float

    @property
    def heading_std(self) -> float:
        return float(np.sqrt(self.covariance[2, 2]))

    @classmethod
    def of(
        cls, drive: Drive, turned: Array, sped: Array, time: Array, position: NDArray[np.complex128]
    ) -> "_Fit":
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

        def until_end(integrand: Array) -> Array:
            """The integral from each fix to the last one (trapezoids)."""
            pieces = 0.5 * (integrand[1:] + integrand[:-1]) * np.diff(grid)
            since_start = np.concatenate([[0.0], np.cumsum(pieces)])
            return since_start[-1] - np.interp(time, grid, since_start)

        g = until_end(direction)  # a metre per second for the whole way
        t = until_end(direction * (grid - end))  # per unit of b
        m = until_end(direction * (gained - gained[-1]))  # what the accelerometer saw
        # The fixes are the antenna's, which the lever arm carries around the IMU.
        m -= np.interp(time, grid, direction) * complex(*drive.lever_arm)
        coasting = float(np.trapezoid(gained - gained[-1], grid))  # m, what the speed changes alone add
        return cls._solve(end, position, g, t, m, float(end - time[0]), coasting)

    @classmethod
    def _solve(
        cls,
        end: float,
        position: NDArray[np.complex128],
        g: Array,
        t: Array,
        m: Array,
        span: float,
        coasting: float,
    ) -> "_Fit":
        """Gauss-Newton on east, north, theta, v, b."""
        chord = position[-1] - position[0]
        theta, v, b, p = np.angle(chord / g[0]), abs(chord) / max(abs(g[0]), 1e-9), 0.0, position[-1]
        prior = 1.0 / ACCELERATION_BIAS_STD
        jacobian, residual = np.empty((2 * len(g) + 1, 5)), np.empty(2 * len(g) + 1)
        variance, worst = 1.0, 0.0
        for _ in range(12):
            turn = np.exp(1j * theta)
            way = turn * (v * g + b * t + m)
            columns = [np.ones_like(g), 1j * np.ones_like(g), -1j * way, -turn * g, -turn * t]
            for k, column in enumerate(columns):
                jacobian[:-1, k] = np.concatenate([column.real, column.imag])
            misfit = position - (p - way)
            residual[:-1] = np.concatenate([misfit.real, misfit.imag])
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
        return cls(end, np.array([p.real, p.imag, theta, v, b]), covariance, forward, worst)

    def state(self) -> InitialState:
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
        return InitialState(mean, 0.5 * (covariance + covariance.T), self.time)
