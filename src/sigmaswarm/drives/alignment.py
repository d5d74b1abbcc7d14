"""Where and how a filter starts: an initial state taken from the drive alone, causally, without truth.

A car's heading can't be seen at standstill, and a GPS fix has none. Once the car has driven some metres,
its course over ground shows the heading; the gyro takes out the turns and the accelerometer the speed
changes in between. `initial_state` looks back over the last seconds of fixes and fits all of it: `alignment_fit`.

The effect of the gyro's bias is stored separately: see `gyro_seen`. The bias is subtracted, and the fit repeated, only
where the fixes contradict a gyro without bias.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment_fit import Fit, InitialState
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.frozen import frozen_fixes
from sigmaswarm.drives.gyro_seen import CONTRADICTS, MOST_BIAS
from sigmaswarm.errors import AlignmentError

MIN_DURATION = 4.0
"""s, at least, between the first and the last fix of an alignment."""
MAX_DURATION = 6.0
"""s, at most: older fixes say little about the heading, since the gyro's bias adds up."""
MIN_TRAVEL = 20.0
"""m of forward travel in that time, for an accurate heading; it needs 12 km/h."""
FEWEST_FIXES = 4
"""In that time; one fix every 3 s is not enough."""
WORTH_TRAVEL = 0.5 * MIN_TRAVEL
"""m between the first and the last of them: a cheap test before the fit."""
MAX_MISFIT = 0.3
"""Largest residual as a share of the travel; larger ones are jumps of the fixes."""
MAX_HEADING_STD = np.radians(6.0)
"""rad: a worse fit is one of scattered fixes; the next fix is tried."""
REFITS = 3
"""Fits with a new gyro bias, after which it has converged."""


@dataclass(frozen=True)
class NoStart:
    """The reason why no filter can start on a drive, and the remedy."""

    what: str
    remedy: str


def initial_state(drive: Drive, *, as_recorded: bool = False) -> InitialState:
    """Find the first moment at which position, speed and heading are known from the drive.

    The start is the first fix with 20 m of forward travel in the 4 to 6 s before it (12 km/h or faster), with
    four fixes or more. It uses earlier samples only, so a live filter starts at the same moment with the same state.

    Parameters
    ----------
    drive : Drive
        Its truth is not used.
    as_recorded : bool
        Also use stale fixes as positions: see `drives.frozen`.

    Raises
    ------
    AlignmentError
        If there is none; the message gives the reason.
    """
    found = find_start(drive, as_recorded=as_recorded)
    if isinstance(found, NoStart):
        raise AlignmentError(f"{drive.name}: {found.what}; {found.remedy}")
    return found


def find_start(drive: Drive, *, as_recorded: bool = False) -> InitialState | NoStart:
    """Find the start as `initial_state` does, or the reason for none."""
    # Later code may start a filter only where IMU samples follow.
    usable = (drive.gps.time > drive.imu.time[0]) & (drive.gps.time < drive.imu.time[-1])
    alignments = Alignments(drive, usable if as_recorded else usable & ~frozen_fixes(drive.gps))
    for k in range(len(alignments.time)):
        if found := alignments.at(k):
            return found
    return alignments.why_none()


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
        self._chord = np.abs(self._position - self._position[self._first])
        self._many = (self.time - self.time[self._first] >= MIN_DURATION) & (count >= FEWEST_FIXES)
        self._worth = self._many & (self._chord >= WORTH_TRAVEL)
        self._found: dict[int, InitialState | None] = {}

    def at(self, k: int) -> InitialState | None:
        """The alignment that ends at the k-th of the fixes; None where the car has not travelled enough, or they jump.

        It takes some milliseconds: ask where it matters.
        """
        if k not in self._found:
            with np.errstate(all="ignore"):  # what overflows is no alignment
                self._found[k] = self._fitted(k) if self._worth[k] else None
        return self._found[k]

    def why_none(self) -> NoStart:
        """Return the reason why a drive has no alignment."""
        time, travel = f"{MAX_DURATION:g} s", f"{MIN_TRAVEL:g} m"
        if not self._many.any():
            return self._too_few()
        if not np.any(self._chord[self._many] >= MIN_TRAVEL):
            slowest = f"{3.6 * MIN_TRAVEL / MAX_DURATION:.0f} km/h for {time}"
            return NoStart(
                f"never travels {travel} within {time}, so the heading can't be found",
                f"use a longer drive, or one that gets up to speed ({slowest})",
            )
        return NoStart(
            f"its fixes move {travel} within {time}, but nowhere the way that the IMU felt, so the heading can't be "
            "found: they scatter or jump, or an axis, a unit or the clock of the IMU is wrong",
            "mend what `sigmaswarm doctor` finds",
        )

    def _too_few(self) -> NoStart:
        """Return the reason why no fix has enough others in the seconds before it."""
        time = f"{MAX_DURATION:g} s"
        every = float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0
        if every > MAX_DURATION / (FEWEST_FIXES - 1):
            told = f"its fixes come every {every:.3g} s, and the heading takes {FEWEST_FIXES} of them within {time}"
            return NoStart(f"no filter can start: {told}", "log the receiver at 1 Hz or faster")
        span = float(self.time[-1] - self.time[0]) if len(self.time) else 0.0
        usable = f"{len(self.time)} of {len(self._drive.gps.time)} fixes can be used, {span:.3g} s"
        told = f"the heading takes {FEWEST_FIXES} within {time}, {MIN_DURATION:g} s or more"
        return NoStart(
            f"no filter can start: only {usable} from first to last, and {told} from first to last",
            "use a longer drive, whose fixes come at 1 Hz or faster, without gaps, and don't repeat each other",
        )

    def _fitted(self, k: int) -> InitialState | None:
        window = slice(self._first[k], k + 1)
        seen = self._drive, *self._integrals, self.time[window], self._position[window]
        try:
            fit = Fit.of(*seen)
            if CONTRADICTS * fit.yaw_std < abs(fit.yaw_bias) < MOST_BIAS:
                for _ in range(REFITS):
                    fit = Fit.of(*seen, fit.yaw_bias)
        except np.linalg.LinAlgError:  # something was not finite
            return None
        smooth = fit.misfit <= MAX_MISFIT * fit.travel
        usable = fit.travel >= MIN_TRAVEL and fit.heading_std <= MAX_HEADING_STD and smooth
        return fit.state(self._leaning(float(self.time[self._first[k]]), fit.time)) if usable else None

    def _leaning(self, first: float, last: float) -> Array:
        """The mean rates about forward and left (rad/s) between two moments, (2,); NaN where the IMU has none."""
        imu = self._drive.imu
        if imu.gx is None or imu.gy is None:
            return np.full(2, np.nan)
        inside = slice(*np.searchsorted(imu.time, [first, last], side="right"))
        return np.array([imu.gx[inside].mean(), imu.gy[inside].mean()], np.float64)

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
