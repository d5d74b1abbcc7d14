"""Fixed-lag smoothing of a live filter."""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.compiled import live
from sigmaswarm.filters.compiled.layout import N_KEPT, state_rows
from sigmaswarm.filters.compiled.memory import LiveArrays
from sigmaswarm.filters.compiled.single import single_step
from sigmaswarm.filters.compiled.smoothing import smooth_back
from sigmaswarm.filters.compiled.step_log import logged_rows

LAG_ROUNDING = 1e-6  # s, largest rounding error of a lag
N_LOGGED = live.N_ALL
"""Index of the number of logged steps; this number is stored after the state of a live filter, before the log."""
STEP_LOG = N_LOGGED + 1


class FixedLag:
    """Fixed-lag smoother of a live filter: it processes the last samples again, logs their steps, and smooths the log.

    ``lag`` is in s; ``arrays`` belong to the live filter; ``most_steps`` is the largest number of logged steps.
    """

    def __init__(self, kernel: str, lag: float, arrays: LiveArrays, *, most_steps: int) -> None:
        self._kernel, self._lag = kernel, lag
        self._state, self._width = state_rows(kernel), len(logged_rows(kernel))
        self._filter_state = np.zeros(STEP_LOG + most_steps * self._width)
        self._step = single_step(kernel, N_LOGGED)
        nothing = np.zeros((0, len(self._state)))
        self._no_starts = np.zeros(0, dtype=np.int64), nothing
        self._out = nothing
        self._replay(arrays, 0)  # compile now, so that no sample waits for the compiler
        self._back(np.zeros((0, self._width)), np.zeros(len(self._state)), np.zeros(len(self._state)))

    def smoothed(self, arrays: LiveArrays) -> tuple[float, Array]:
        """Return the time (s) and the rows (n_rows,) of the smoothed state."""
        filter_state, counts, history = arrays.filter_state, arrays.counts, arrays.history
        now, kept = float(filter_state[live.TIME]), int(counts[live.N_HISTORY])
        order = (int(counts[live.OLDEST]) + np.arange(kept)) % len(history)
        # The state before a sample is the state after the previous sample.
        moments = history[order, live.TIME]
        first = int(np.searchsorted(moments, now - self._lag + LAG_ROUNDING, side="right")) - 1
        if not kept:
            return now, filter_state[self._state]
        first = max(first, 0)
        before = history[order[first], : live.N_FILTER_STATE]
        v = self._filter_state
        v[: len(filter_state)] = filter_state  # for the settings; the next line replaces the state
        v[: live.N_FILTER_STATE] = before
        v[N_LOGGED] = 0.0
        self._replay(arrays, first)
        step_log = v[STEP_LOG : STEP_LOG + int(v[N_LOGGED]) * self._width].reshape(-1, self._width)
        return float(moments[first]), self._back(step_log, before[self._state], v[:N_KEPT][self._state])

    def _replay(self, arrays: LiveArrays, first: int) -> None:
        own = arrays._replace(filter_state=self._filter_state, step=self._step.address)
        live.replay_call()(own, first, False)

    def _back(self, step_log: Array, start: Array, behind: Array) -> Array:
        sampled = np.zeros(len(step_log), dtype=np.bool_)
        smooth_back(self._kernel, step_log, start, *self._no_starts, sampled, behind, self._out)
        return behind
