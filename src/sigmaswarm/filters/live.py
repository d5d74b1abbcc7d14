"""LiveFilter: one sample at a time, for real-time use, with the results of `run_filter` on the same data."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array
from sigmaswarm.drives.standstill import FIX_WINDOW, new_memory, new_stop
from sigmaswarm.filters.compiled import live
from sigmaswarm.filters.compiled.layout import N_KEPT
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.packing import Chunk, plausible, start_rows
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import LATERAL_INTERVAL, STANDSTILL_INTERVAL
from sigmaswarm.geodesy import wrap_angle

MOST_WAITING = 1000
"""Fixes that may wait for an IMU sample, about; more of them mean that the IMU is silent."""


@dataclass(frozen=True, eq=False)
class LiveState:
    """What the filter believes now.

    Attributes
    ----------
    time : s, of the last IMU sample
    mean : ndarray, shape (n,); heading wrapped to (-pi, pi]
    covariance : ndarray, shape (n, n)
    failed : bool: the covariance lost its definiteness, or something became NaN
    """

    time: float
    mean: Array
    covariance: Array
    failed: bool


class LiveFilter:
    """A filter that is fed one sample at a time.

    A fix waits for the IMU sample that follows it, which drives the filter to the fix's time and on. A fix that comes
    late, at most ``history`` seconds, takes the filter back to its time and forward again; so the state is the one
    that `run_filter` gives for the same data in order. Fixes of one time, as two receivers give them, are absorbed one
    after the other; one that is the same in all its numbers is the same message again, and is left out. A frozen fix is
    kept and not absorbed: see `drives.frozen`.

    That the IMU is silent can't be known before it speaks again. The state stays that of the last sample meanwhile, and
    fixes wait; the sample that ends the gap brings the filter through it (`drives.gaps`).

    One stamp alone is not believed if it lies more than 10 s ahead: such a sample is held back until a second one,
    within a second of it, says the same; then both are taken, as after a silence. Else it is dropped and counted. So
    are fixes, of which samples that have got there also say the same.

    What it keeps has a fixed size, and what happens at a sample or a fix is compiled: see `compiled.live`. The first
    filter of a process loads or compiles that; no sample waits for it.

    Parameters
    ----------
    parameters : FilterParameters
    initial : InitialState
        Where and when it starts.
    nominal_interval : float
        s between IMU samples.
    lever_arm : sequence of float
        m forward and left from the IMU to the antenna.
    history : float
        s that are kept for late fixes.
    as_recorded : bool
        Absorb frozen fixes, and cross gaps in the IMU as if they were steps like others: for diagnosis.

    Attributes
    ----------
    too_late : int
        Fixes that were left out: they came later than ``history``, or no IMU sample came for too long.
    time_jumps : int
        Samples and fixes that were dropped, stamped far ahead as no other one was.
    frozen : int
        Fixes that repeated one of a car that may have moved since, and were not absorbed.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        initial: InitialState,
        *,
        nominal_interval: float,
        lever_arm: Sequence[float] = (0.0, 0.0),
        history: float = 1.0,
        as_recorded: bool = False,
    ) -> None:
        p = parameters
        self.parameters = p
        self._n = p.n_states
        self._plausible = plausible(p)
        self._takes_velocity = p.velocity_noise is not None
        # More than the history takes: an IMU may run faster than it says.
        samples = max(1, int(np.ceil(1.25 * history / nominal_interval)))
        seen = samples + int(FIX_WINDOW / nominal_interval)  # fixes come as often as samples at most
        self._belief = _believe(p, initial, nominal_interval, lever_arm)
        self._belief[live.AS_RECORDED] = as_recorded
        counts = np.zeros(live.N_COUNTS, dtype=np.int64)
        counts[live.N_STATES] = p.n_states
        self._memory = (
            self._belief,
            counts,
            new_memory()[: 0 if p.standstill_noise is None else None],
            np.zeros((MOST_WAITING + seen, live.N_FIX)),
            np.zeros((samples, live.N_RECORD)),
        )
        live.ready()

    def predict(self, t: float, imu: Sequence[float]) -> None:
        """Take an IMU sample: ax, ay (m/s2), yaw rate (rad/s). One that is not after the last one is left out.

        One more than 10 s ahead is held back: see the class.

        Samples before the start only teach the filter what calm is, for the standstill.
        """
        ax, ay, gz = imu
        _take_sample(*self._memory, t, ax, ay, gz)

    def update(self, t: float, fix: Sequence[float], velocity: Sequence[float] | None = None) -> bool:
        """Take a fix: x, y (m), and perhaps its velocity, m/s east and north.

        Returns
        -------
        bool
            False if it was left out (it lies before the start, came too late, or was there already) or is held back.
        """
        if velocity is None or not self._takes_velocity:
            kept = _take_fix(*self._memory, t, fix[0], fix[1], 0.0, 0.0, 0.0)
        else:
            kept = _take_fix(*self._memory, t, fix[0], fix[1], velocity[0], velocity[1], 1.0)
        return kept == live.TAKEN

    @property
    def too_late(self) -> int:
        """See the class."""
        return int(self._memory[1][live.TOO_LATE])

    @property
    def time_jumps(self) -> int:
        """See the class."""
        return int(self._memory[1][live.TIME_JUMPS])

    @property
    def frozen(self) -> int:
        """See the class."""
        return int(self._memory[1][live.N_FROZEN])

    @property
    def state(self) -> LiveState:
        """What the filter believes after the last IMU sample and all fixes up to then."""
        mean, covariance = np.empty(self._n), np.empty((self._n, self._n))
        sound = _read_state(self._belief, mean, covariance) and self._plausible
        if np.pi < abs(mean[THETA]) < np.inf or mean[THETA] == -np.pi:
            mean[THETA] = wrap_angle(float(mean[THETA]))
        return LiveState(float(self._belief[live.TIME]), mean, covariance, not sound)


# Numba's types say nothing of what they call.
_take_sample: Any = live.take_sample
_take_fix: Any = live.take_fix
_read_state: Any = live.read_state


def _believe(
    p: FilterParameters, initial: InitialState, nominal_interval: float, lever_arm: Sequence[float]
) -> Array:
    """The belief at the start, and the settings behind it."""
    v = np.zeros(live.N_ALL)
    v[:N_KEPT] = start_rows([initial], [nominal_interval], Chunk((p,)))[0, :, 0]
    v[live.TIME] = v[live.START] = initial.time
    v[live.LATERAL_SLOT] = v[live.STANDSTILL_SLOT] = -1.0
    v[live.NOMINAL] = nominal_interval
    v[live.LEVER_X], v[live.LEVER_Y] = lever_arm[0], lever_arm[1]
    v[live.LATERAL_INTERVAL] = 0.0 if p.lateral_noise is None else LATERAL_INTERVAL
    v[live.STANDSTILL_INTERVAL] = 0.0 if p.standstill_noise is None else STANDSTILL_INTERVAL
    v[live.LAST_SAMPLE] = -np.inf
    v[live.STOP] = new_stop()
    return v
