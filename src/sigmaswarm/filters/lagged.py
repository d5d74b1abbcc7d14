"""Fixed-lag smoothing of a live filter."""

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.compiled import live
from sigmaswarm.filters.compiled.lagged import N_TAPED, TAPE, again_call
from sigmaswarm.filters.compiled.layout import N_KEPT, state_rows
from sigmaswarm.filters.compiled.memory import LiveArrays
from sigmaswarm.filters.compiled.single import single_step
from sigmaswarm.filters.compiled.smoothing import smooth_back
from sigmaswarm.filters.compiled.tape import taped_rows

NEARLY = 1e-6  # s, largest rounding error of a lag


class FixedLag:
    """Fixed-lag smoother for a live filter: it processes the last samples again, logs the steps, and smooths.

    ``lag`` is in s; ``most_steps`` is the largest number of steps in the memory.
    """

    def __init__(self, kernel: str, lag: float, *, most_steps: int) -> None:
        self._kernel, self._lag = kernel, lag
        self._state, self._width = state_rows(kernel), len(taped_rows(kernel))
        self._belief = np.zeros(TAPE + most_steps * self._width)
        self._step = single_step(kernel, N_TAPED)
        nothing = np.zeros((0, len(self._state)))
        self._no_starts = np.zeros(0, dtype=np.int64), nothing
        self._out = nothing
        # Compiled now, so that no sample waits for the compiler.
        nobody = np.zeros((0, live.N_FIX)), np.zeros((0, 2)), np.zeros((1, live.N_RECORD)), np.zeros((0, 0))
        again_call()(
            self._step.address, self._belief, np.zeros(live.N_COUNTS, dtype=np.int64), *nobody, 0, False
        )
        self._back(np.zeros((0, self._width)), np.zeros(len(self._state)), np.zeros(len(self._state)))

    def smoothed(self, memory: LiveArrays) -> tuple[float, Array]:
        """Return the time of the smoothed state, s, and its state rows, (s,)."""
        belief, counts, _, fixes, speeds, history, marks, _ = memory
        now, kept = float(belief[live.TIME]), int(counts[live.N_HISTORY])
        order = (int(counts[live.OLDEST]) + np.arange(kept)) % len(history)
        # The state before a sample is the one after the sample before it.
        moments = history[order, live.TIME]
        first = int(np.searchsorted(moments, now - self._lag + NEARLY, side="right")) - 1
        if not kept:
            return now, belief[self._state]
        first = max(first, 0)
        before = history[order[first], : live.N_BELIEF]
        v = self._belief
        v[: len(belief)] = belief  # the settings
        v[: live.N_BELIEF] = before
        v[N_TAPED] = 0.0
        again_call()(self._step.address, v, counts, fixes, speeds, history, marks, first, False)
        tape = v[TAPE : TAPE + int(v[N_TAPED]) * self._width].reshape(-1, self._width)
        return float(moments[first]), self._back(tape, before[self._state], v[:N_KEPT][self._state])

    def _back(self, tape: Array, start: Array, behind: Array) -> Array:
        sampled = np.zeros(len(tape), dtype=np.bool_)
        smooth_back(self._kernel, tape, start, *self._no_starts, sampled, behind, self._out)
        return behind
