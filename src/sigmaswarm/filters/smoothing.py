"""What is known of a drive in hindsight: the smoother of Rauch, Tung and Striebel behind any compiled filter.

It runs the filter forward, and back again over what the forward pass leaves on tape: see `compiled.smoothing`. It knows
nothing of measurements; what the filter absorbed, weighed or turned away, it takes as the filter decided it.

What it holds does not grow with the drive. The forward pass keeps a mark every so many samples, from which it can go
on; the backward pass runs the filter again from mark to mark, the last one first, and keeps what is known in hindsight
at the marks alone. A third pass, forward from mark to mark, hands the estimates out in the order of time.
"""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import SigmaswarmError
from sigmaswarm.filters.compiled.run import NEXT_STEP, NO_INNOVATIONS, taped_kernel
from sigmaswarm.filters.compiled.smoothing import smooth_back
from sigmaswarm.filters.compiled.tape import taped_rows
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.packing import believed
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recording import SAMPLES, Piece, Recording, failure_at, joined
from sigmaswarm.filters.recovery import Recovery
from sigmaswarm.filters.replay import Replay, require_readable
from sigmaswarm.filters.run import Estimate, replay_of
from sigmaswarm.filters.schedule import IMU, switches
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.filters.textbook.smoothing import smooth_steps
from sigmaswarm.geodesy import wrap_angle


def smooth(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    recover: bool = True,
    as_recorded: bool = False,
) -> Estimate:
    """Run the compiled filter over a drive, and smooth what it believed: each estimate knows all fixes, later ones too.

    H. E. Rauch, F. Tung and C. T. Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA Journal 3(8),
    1965; of an unscented filter S. Sarkka, Unscented Rauch-Tung-Striebel smoother, IEEE TAC 53(3), 2008.

    Parameters
    ----------
    drive, parameters, initial, recover, as_recorded
        As in `run_filter`.

    Returns
    -------
    Estimate
        At the same times. ``initial`` is smoothed, too. Where the filter started anew smoothing ends and begins again:
        what lies before such a moment does not know what comes after it. From a failure on it is NaN.

    Raises
    ------
    AlignmentError
        If ``initial`` is not given and the drive never moves far enough.
    """
    smoothing = Smoothing(replay_of(drive, initial, as_recorded=as_recorded), parameters, recover=recover)
    whole = joined(smoothing)
    return Estimate(
        whole.time,
        whole.mean,
        whole.covariance,
        smoothing.initial,
        smoothing.failure,
        tuple(smoothing.restarts),
        whole.lost if recover else None,
    )


def smoothed_estimates(replay: Replay, parameters: FilterParameters) -> Iterator[Estimate]:
    """What `smooth` gives, piece by piece: what it takes to hold does not grow with the drive.

    Raises
    ------
    SigmaswarmError
        Where the filter fails.
    """
    smoothing = Smoothing(replay, parameters, recover=True)
    restarts = np.array(smoothing.restarts)
    before = replay.initial.time
    for piece in smoothing:
        if smoothing.failure:
            raise SigmaswarmError(smoothing.failure)
        here = restarts[(restarts > before) & (restarts <= piece.time[-1])]
        before = piece.time[-1]
        yield Estimate(
            piece.time,
            piece.mean,
            piece.covariance,
            smoothing.initial,
            restarts=tuple(here.tolist()),
            lost=piece.lost,
        )


@dataclass(frozen=True, eq=False)
class _Mark:
    """All from which a run goes on."""

    rows: Array
    place: Array
    recovery: Recovery


@dataclass(frozen=True, eq=False)
class _Tape:
    """Some steps of a run, as `smooth_back` wants them, and whether the filter is lost at their samples."""

    steps: Array
    start: Array
    ends: NDArray[np.int64]
    started: Array
    sampled: NDArray[np.bool_]
    lost: NDArray[np.bool_]


class _Forward(Recording):
    """A recording with every step on tape, which keeps a mark before each of its pieces, and can run one again.

    All of it goes through one kernel: another one rounds otherwise, and the estimates would depend on the marks.
    """

    def __init__(self, replay: Replay, parameters: FilterParameters, *, samples: int, recover: bool) -> None:
        super().__init__(replay, parameters, samples=samples, recover=recover)
        require_readable(replay, self._array)
        self.marks: list[_Mark] = []
        self._switches = switches(parameters)
        self._kernel: Any = taped_kernel(parameters.model)
        self._width = len(taped_rows(parameters.model)) + 1  # and whether it is sound
        self._first, self._taped = 0, np.empty((0, self._width, 1))
        self._anew: list[tuple[int, Array]] = []

    def _run_to(self, stops: NDArray[np.intp], record: Array) -> NDArray[np.bool_]:
        self.marks.append(_Mark(self._rows[0, :, 0].copy(), self._place.copy(), deepcopy(self._recovery)))
        return self._tape_to(stops, record)

    def _tape_to(self, stops: NDArray[np.intp], record: Array) -> NDArray[np.bool_]:
        self._first, self._anew = int(self._place[NEXT_STEP]), []
        self._taped = np.empty((int(stops[-1]) - self._first, self._width, 1))
        return super()._run_to(stops, record)

    def again(self, number: int, samples: int) -> _Tape:
        """A piece once more, its first ``samples``."""
        mark, sampled = self.marks[number], self._replay.timeline.sampled
        self._rows[0] = mark.rows[:, np.newaxis]  # all lanes are the same filter
        self._place[:] = mark.place
        self._recovery = deepcopy(mark.recovery)
        start = self._rows[0, self._state, 0]
        first = int(mark.place[NEXT_STEP])
        stops = np.flatnonzero(sampled[first:])[:samples] + 1 + first
        lost = self._tape_to(stops, np.empty((samples, len(self._state) + 1, 1)))
        ends = np.array([step for step, _ in self._anew], dtype=np.int64)
        started = np.array([state for _, state in self._anew]).reshape(-1, len(self._state))
        return _Tape(self._taped[:, :, 0], start, ends, started, sampled[first : stops[-1]], lost)

    def _steps_to(self, stop: int, record: Array) -> None:
        first = int(self._place[NEXT_STEP])
        taped = self._taped[first - self._first : stop - self._first]
        steps, sample, driving, flags, *rest = self._replay.arrays(*self._switches)
        # With IMU in all flags it records all steps.
        self._kernel(
            *(steps, sample, driving, flags | IMU, *rest),
            *(self._rows[0], self._place, stop, taped, NO_INNOVATIONS),
        )
        at, n = np.flatnonzero(self._replay.timeline.sampled[first:stop]), len(self._state)
        record[:, :n], record[:, n] = taped[at, :n], taped[at, -1]

    def _start_anew(self, start: InitialState) -> None:
        super()._start_anew(start)
        behind = int(self._place[NEXT_STEP]) - 1 - self._first
        self._anew.append((behind, self._rows[0, self._state, 0]))


class Smoothing:
    """A smoother over a replay, as an iterator of pieces; the forward and the backward pass are made at once.

    The pieces, joined, have the same bits whatever the length of a piece.

    Parameters
    ----------
    replay : Replay
    parameters : FilterParameters
    samples : int
        IMU samples in a piece, and between two marks of the forward pass.
    recover : bool
        See `Recording`.

    Attributes
    ----------
    restarts : list of float
        s: when the filter started anew.
    failure : str or None
        What went wrong, and when.
    initial : InitialState
        The start, smoothed: all states of the model.
    """

    def __init__(
        self,
        replay: Replay,
        parameters: FilterParameters,
        *,
        samples: int = SAMPLES,
        recover: bool = False,
    ) -> None:
        self._line = replay.timeline
        self._model: ModelName = parameters.model
        self._forward = forward = _Forward(replay, parameters, samples=samples, recover=recover)
        self._sizes: list[tuple[int, int]] = []  # samples of each piece, and how many of them are sound
        for piece in forward:
            self._sizes.append((len(piece.time), int(piece.sound.sum())))
        self.restarts = list(forward.restarts)
        self.failure = forward.failure
        self._behind: list[Array] = []  # what is known in hindsight behind each piece
        self._kept: tuple[int, Array, NDArray[np.bool_]] | None = None
        self._n = parameters.n_states
        self.initial = replay.initial
        if self._sizes[0][1]:
            mean, covariance = self._believed(self._back()[np.newaxis])
            self.initial = InitialState(mean[0], covariance[0], replay.initial.time)

    def __iter__(self) -> Iterator[Piece]:
        first = 0
        for number, (size, sound) in enumerate(self._sizes):
            yield self._piece(number, first, size, sound)
            first += size

    def _back(self) -> Array:
        """The backward pass: what is known in hindsight at the start, (s,)."""
        behind = None
        self._behind = [np.empty(0)] * len(self._sizes)
        for number in reversed(range(len(self._sizes))):
            sound = self._sizes[number][1]
            if not sound:
                continue
            tape = self._forward.again(number, sound)
            if behind is None:
                behind = self._last(tape)
            self._behind[number] = behind
            out, behind = self._smoothed(tape, behind, sound)
            self._kept = number, out, tape.lost  # the first piece is asked for next
        assert behind is not None
        return behind

    def _last(self, tape: _Tape) -> Array:
        """The filter's state behind the last step: nobody knows more."""
        if len(tape.ends) and tape.ends[-1] == len(tape.steps) - 1:
            return tape.started[-1]
        return tape.steps[-1, : tape.start.shape[0]]

    def _smoothed(self, tape: _Tape, behind: Array, samples: int) -> tuple[Array, Array]:
        """States at the samples, (samples, s), and before the first step, (s,)."""
        out, before = np.empty((samples, len(behind))), behind.copy()
        smooth_back(self._model, tape.steps, tape.start, tape.ends, tape.started, tape.sampled, before, out)
        return out, before

    def _piece(self, number: int, first: int, size: int, sound: int) -> Piece:
        time, n = self._line.imu_time[first : first + size], self._n
        mean, covariance = np.full((size, n), np.nan), np.full((size, n, n), np.nan)
        lost = np.zeros(size, dtype=np.bool_)
        if sound:
            if self._kept is None or self._kept[0] != number:
                tape = self._forward.again(number, sound)
                self._kept = number, self._smoothed(tape, self._behind[number], sound)[0], tape.lost
            _, states, lost[:sound] = self._kept
            mean[:sound], covariance[:sound] = self._believed(states)
        return Piece(time, mean, covariance, np.arange(size) < sound, lost)

    def _believed(self, states: Array) -> tuple[Array, Array]:
        """Means (r, n), the heading wrapped, and covariances (r, n, n) of states (r, s)."""
        mean, covariance = believed(states.T, self._model)
        mean[:, THETA] = wrap_angle(mean[:, THETA])
        return mean, covariance


def smooth_textbook(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    heading_first: bool = True,
) -> Estimate:
    """Smooth the textbook filter; parameters as in `run_textbook`. Of a filter that failed it has what lies before."""
    replay = replay_of(drive, initial)
    line = replay.timeline
    car = TextbookCar(line, parameters, replay.initial, heading_first=heading_first)
    tilts = car.model.tilts
    retraction = {"plus": tilts.plus, "minus": tilts.minus} if tilts else {}
    found = smooth_steps(car, len(line.dt), **retraction)
    sampled = np.flatnonzero(line.sampled[: len(found.mean) - 1]) + 1
    mean, covariance = found.mean[sampled], found.covariance[sampled]
    mean[:, THETA] = wrap_angle(mean[:, THETA])
    failure = failure_at(line, line.end[found.failed]) if found.failed >= 0 else None
    covariance = tilts.as_angles(mean, covariance) if tilts else covariance
    start = InitialState(found.mean[0], found.covariance[0], replay.initial.time)
    return Estimate(line.imu_time[: len(sampled)], mean, covariance, start, failure)
