"""A bank of sixteen filters with the interface of a `LiveFilter`.

A search starts from a stored state of the bank that late fixes can no longer change. Its result is used `SEARCH_DELAY`
later: the result replaces filters in a newer stored state of this kind, and the bank processes the later samples again.
Therefore, estimates do not depend on the computing time of the search.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.gyro_bias import UP
from sigmaswarm.errors import InputError, warn_deprecated
from sigmaswarm.filters.bank.mixture import Mixture, is_definite
from sigmaswarm.filters.bank.offsets import FIXED_OFFSETS, START, OffsetPrior
from sigmaswarm.filters.bank.search import (
    FUZZY_FACTORS,
    FilterEvidence,
    LoggedSteps,
    PendingSearch,
    SearchResult,
)
from sigmaswarm.filters.compiled import live, swarm
from sigmaswarm.filters.compiled.layout import CONSTANT_ROWS, LANES, N_KEPT, R, at, state_rows
from sigmaswarm.filters.compiled.memory import Memory
from sigmaswarm.filters.compiled.swarm import N_LOG_ROW, STEP_LOG, swarm_step
from sigmaswarm.filters.divergence import DivergenceMonitor
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.live import LiveFilter, LiveState, live_state
from sigmaswarm.filters.models import GYRO_BIAS
from sigmaswarm.filters.parameters import FilterParameters

SEARCH_INTERVAL = 10.0  # s between the starts of two searches
SEARCH_DELAY = 1.0  # s of samples from a search's start to the use of its result; a search takes about 15 ms
REPLAY_SPAN = 60.0  # s of samples that a search replays
MIN_SPEED = 2.0  # m/s; at lower speeds no search starts, since fixes hardly determine headings and biases
N_REPLACED = 7  # filters replaced per search: one by its result, the others by changed copies of good filters
COPY_STD = 0.6  # standard deviation of a copy's random changes, in standard deviations of the prior


@dataclass(frozen=True, eq=False)
class _Snapshot:
    logged: int  # number of logged steps
    time: float
    fixed_at: float  # time of the last fix before the snapshot, s
    lanes: Array  # (N_KEPT, LANES)
    evidence: Array


class LiveFilterBank(LiveFilter):
    """Sixteen filters with different parameters for one stream of samples; the estimate is their mixture.

    The weight of a filter depends on the prior of its offsets and on its evidence: the log-likelihood of the fixes, in
    which older fixes count less. Filter 0 has the tuned parameters and equals a `LiveFilter`. Filters 1 to 7 have fixed
    offsets, for larger biases and for other receivers. Every 10 s of driving, the filters with the lowest weights among
    filters 8 to 15 are replaced: one by the result of a search over the last minute, and each of the others by a
    randomly changed copy of a good filter. Thus the bank adapts to other sensors or to better or worse GPS reception.
    With the sensors of the training drives, the bank is not more accurate than a single filter. If the mixture
    diverges, filters 1 to 15 are reset; most of them keep the biases of the mixture.

    The interface is that of a `LiveFilter`, without the smoothed state. A copy by `pickle` continues with identical
    results. After a reset, all filters ignore fixes from before the reset.

    Parameters
    ----------
    parameters, initial, nominal_interval, lever_arm, history, recover, as_recorded
        See `LiveFilter`.
    seed : int
        Seed of the initial offsets and of the searches.
    searches : bool
        Search for better filters during the drive. If False, no filter is replaced.
    trust_times : bool
        Accept time stamps that are far ahead of the last sample without confirmation, for a recording that is sorted by
        time.

    Attributes
    ----------
    prior : OffsetPrior
        Prior distribution and names of the offsets from the tuned parameters.
    offsets : ndarray, shape (16, d)
        Offsets of the filters from the tuned parameters, in decades of variance; for the rear axle in m.
    n_searches : int
        Number of searches whose results were used.
    restarts : list of float
        Times of the resets of filter 0, s; ``bank_restarts`` contains the times for the other filters.
    """

    def __init__(
        self,
        parameters: FilterParameters,
        initial: InitialState,
        *,
        nominal_interval: float,
        lever_arm: Sequence[float] = (0.0, 0.0),
        history: float = 1.0,
        recover: bool = True,
        as_recorded: bool = False,
        seed: int = 0,
        searches: bool = True,
        trust_times: bool = False,
    ) -> None:
        super().__init__(
            parameters,
            initial,
            nominal_interval=nominal_interval,
            lever_arm=lever_arm,
            history=history,
            recover=recover,
            as_recorded=as_recorded,
        )
        self._seed, self._searches, self.n_searches = seed, searches, 0
        self._counted = LANES
        self.prior = OffsetPrior(parameters)
        self.offsets = self.prior.first(np.random.default_rng([seed, 0]))
        self._population = self.offsets * self.prior.lasting
        self._kernel = parameters.kernel
        self._settled = len(self._memory.arrays.history)  # late fixes change at most this many samples
        self._memory = self._with_lanes(nominal_interval)
        self._filter_state[live.TRUSTS_TIMES] = trust_times
        self._start_lanes(initial, slice(None))
        self._together = DivergenceMonitor() if recover else None
        self._last_sound = self._mixed()
        self._snapshots = [self._snapshot(self._numbers, initial.time)]
        self._pending: PendingSearch | None = None
        self._due = initial.time + SEARCH_INTERVAL
        self._n_begun = 0
        nothing = LoggedSteps(self._kernel, np.empty((0, N_LOG_ROW)), np.zeros(3))
        nothing.run(self._rows_of(self._numbers)[:, :8].copy())
        live.replay_call()

    def _with_lanes(self, nominal_interval: float) -> Memory:
        arrays = self._memory.arrays
        longest = SEARCH_INTERVAL + SEARCH_DELAY + REPLAY_SPAN
        step_log = int(2.5 * longest / nominal_interval) + self._settled  # at most as many fixes as samples
        wider = np.zeros(live.BEHIND + STEP_LOG + step_log * N_LOG_ROW)
        wider[: live.N_ALL] = arrays.filter_state
        wider[live.BEHIND + swarm.LOG_LENGTH] = step_log
        arrays.counts[live.SPARE] = live.CHECKPOINT_EVERY
        longer = np.zeros((self._settled + live.CHECKPOINT_EVERY, live.N_RECORD))
        checkpoints = np.zeros((len(longer) // live.CHECKPOINT_EVERY + 2, swarm.N_CHECKPOINT))
        arrays = arrays._replace(filter_state=wider, history=longer, checkpoints=checkpoints)
        return Memory(swarm_step(self._kernel), arrays)

    @property
    def _numbers(self) -> Array:
        return self._filter_state[live.BEHIND :]

    def _start_lanes(self, start: InitialState, lanes: slice) -> None:
        """Start the filters ``lanes``. The evidence of failed filters becomes -inf, and that of all others 0."""
        rows = self._rows_of(self._numbers)
        rows[:, lanes] = self._started(start)[:, lanes]
        rows[CONSTANT_ROWS, lanes] = self.prior.constants(self._own_constants, self.offsets[lanes])
        sound = np.isfinite(rows[state_rows(self._kernel)]).all(axis=0) & (rows[R.OK] == 1.0)
        self._numbers[swarm.EVIDENCE] = np.where(sound, 0.0, -np.inf)
        self._numbers[swarm.PENALTY] = self.prior.penalty(self.offsets)
        self._numbers[swarm.PENALTY][self._counted :] = np.inf
        self._numbers[swarm.FIXED_AT] = start.time
        swarm.weigh(self._filter_state)

    def _started(self, start: InitialState) -> Array:
        """Return the kernel rows (N_KEPT, LANES) of all filters at a start (see `compiled.layout`)."""
        sets = tuple(self.prior.parameters(self.offsets[lane]) for lane in range(LANES))
        return KernelArray(sets).start([start], [self._interval])[0]

    def count_only(self, lanes: int) -> None:
        """Give weights only to the first ``lanes`` filters, as in an export of these filters; searches must be off."""
        self._counted = lanes
        self._numbers[swarm.PENALTY][lanes:] = np.inf
        swarm.weigh(self._filter_state)

    @property
    def _own_constants(self) -> Array:
        return KernelArray((self.parameters,)).constants(self._interval)[:, :1]

    @staticmethod
    def _rows_of(numbers: Array) -> Array:
        """Return a view, (N_KEPT, LANES), of the filters in `_numbers` or in a checkpoint."""
        return numbers[swarm.ROWS].reshape(N_KEPT, LANES)

    def predict(self, t: float, imu: Sequence[float]) -> None:
        """Process an IMU sample as `LiveFilter.predict` does."""
        super().predict(t, imu)
        if t >= self._due and self._filter_state[live.TIME] >= self._due:
            self._move()

    def _move(self) -> None:
        now = float(self._filter_state[live.TIME])
        pending, self._pending = self._pending, None
        if pending is not None:
            result = pending.result()
            if result is not None:
                self._replace(result, pending.logged, pending.leader)
        elif self._searches:
            self._pending = self._begin()
        self._due = now + (SEARCH_DELAY if self._pending else SEARCH_INTERVAL - SEARCH_DELAY)

    def _settled_checkpoint(self) -> tuple[int, Array, Array] | None:
        """Return the last checkpoint that no late fix can change (history index, record, numbers), or None."""
        arrays = self._memory.arrays
        counts, history, checkpoints = arrays.counts, arrays.history, arrays.checkpoints
        n, kept = int(counts[live.N_SAMPLES]), int(counts[live.N_HISTORY])
        number = max(0, n - self._settled) // live.CHECKPOINT_EVERY * live.CHECKPOINT_EVERY
        index = number - (n - kept)
        if index < 0:  # the checkpoint was before the last reset
            return None
        record = history[(int(counts[live.OLDEST]) + index) % len(history)]
        return index, record, checkpoints[number // live.CHECKPOINT_EVERY % len(checkpoints)]

    def _snapshot(self, numbers: Array, time: float) -> _Snapshot:
        rows, evidence = self._rows_of(numbers).copy(), numbers[swarm.EVIDENCE].copy()
        return _Snapshot(int(numbers[swarm.LOGGED]), time, float(numbers[swarm.FIXED_AT]), rows, evidence)

    def _begin(self) -> PendingSearch | None:
        checkpoint = self._settled_checkpoint()
        if checkpoint is None:
            return None
        _, record, numbers = checkpoint
        settled = self._snapshot(numbers, float(record[live.TIME]))
        earliest = settled.time - REPLAY_SPAN - 1e-6
        self._snapshots = [s for s in (*self._snapshots, settled) if s.time >= earliest]
        if not numbers[swarm.WEIGHT].any():  # all filters have failed
            return None
        leads = int(np.argmax(numbers[swarm.WEIGHT]))
        if np.hypot(*settled.lanes[[R.U, R.V], leads]) <= MIN_SPEED:
            return None
        begins = next(s for s in self._snapshots if self._is_logged(s.logged))
        self._n_begun += 1
        lever = self._filter_state[live.LEVER].copy()
        steps = LoggedSteps(self._kernel, self._logged_steps(begins.logged, settled.logged), lever)
        evidence = FilterEvidence(float(begins.evidence[leads]), begins.fixed_at)
        leader = steps, begins.lanes[:, leads].copy(), evidence, self.offsets[leads].copy()
        others = self._population, self._interval, (self._seed, self._n_begun)
        return PendingSearch.begun(settled.logged, leads, self.prior, *leader, *others)

    def _is_logged(self, first: int) -> bool:
        return first >= int(self._numbers[swarm.LOGGED]) - int(self._numbers[swarm.LOG_LENGTH])

    def _logged_steps(self, first: int, last: int) -> Array:
        """Return the logged steps ``first`` to ``last`` - 1, (k, N_LOG_ROW)."""
        length = int(self._numbers[swarm.LOG_LENGTH])
        step_log = self._numbers[STEP_LOG:].reshape(length, N_LOG_ROW)
        return step_log[np.arange(first, last) % length]

    def _replace(self, result: SearchResult, replayed: int, leader: int) -> None:
        """Replace the worst filters, then process the samples after the checkpoint again.

        One filter is replaced by the result of a search, the others by changed copies of filters drawn by weight.

        ``replayed`` and ``leader`` are the fields ``logged`` and ``leader`` of the `PendingSearch`.
        """
        checkpoint = self._settled_checkpoint()
        if checkpoint is None:
            return
        index, record, numbers = checkpoint
        if not (numbers[swarm.WEIGHT].any() and self._is_logged(replayed)):
            return
        since = self._logged_steps(replayed, int(numbers[swarm.LOGGED]))
        rng = np.random.default_rng([self._seed, self._n_begun, 1])
        rows, weight = self._rows_of(numbers), numbers[swarm.WEIGHT].copy()
        evidence = numbers[swarm.EVIDENCE]
        leads = int(np.argmax(weight))
        by_weight = np.argsort(weight, kind="stable").tolist()
        worst = [lane for lane in by_weight if lane >= len(FIXED_OFFSETS)][:N_REPLACED]
        parents = rng.choice(LANES, size=len(worst) - 1, p=weight / weight.sum())
        steps = LoggedSteps(self._kernel, since, self._filter_state[live.LEVER].copy())
        state, followed = steps.followed(result.lane, result.known)
        offsets, states, known = [result.offsets], [state], [followed.evidence]
        for parent in parents:
            jitter = COPY_STD * self.prior.std * rng.standard_normal(len(self.prior.names))
            offsets.append((self.offsets[parent] + jitter) * self.prior.lasting)
            states.append(rows[:, parent].copy())
            known.append(float(evidence[parent]))
        lost = ~np.isfinite(evidence) | (rows[R.OK] != 1.0)
        failed = [lane for lane in range(1, LANES) if lost[lane] and lane not in worst]
        for lane in failed:  # they keep their offsets, and continue from the state of the best filter
            rows[:, lane], evidence[lane] = rows[:, leads], evidence[leads]
        for lane, *replacement in zip(worst, offsets, states, known, strict=True):
            self.offsets[lane], rows[:, lane], evidence[lane] = replacement
        originals = np.arange(LANES)
        originals[worst], originals[failed] = [leader, *parents], leads
        for snapshot in self._snapshots:  # a copy has the past of its original
            snapshot.lanes[:] = snapshot.lanes[:, originals]
            snapshot.evidence[:] = snapshot.evidence[originals]
        new = [*worst, *failed]  # the other filters may have adapted their constants
        rows[CONSTANT_ROWS, new] = self.prior.constants(self._own_constants, self.offsets[new])
        rows[np.ix_(np.array(FUZZY_FACTORS), np.array(new))] = 1.0
        numbers[swarm.PENALTY] = self.prior.penalty(self.offsets)
        self._population = result.population
        self.n_searches += 1
        filter_state = self._filter_state
        filter_state[live.BEHIND : live.BEHIND + swarm.N_CHECKPOINT] = numbers
        swarm.weigh(filter_state)
        numbers[swarm.WEIGHT] = self._numbers[swarm.WEIGHT]
        filter_state[: live.N_FILTER_STATE] = record[: live.N_FILTER_STATE]
        live.replay_call()(self._memory.arrays, index, True)

    def _check_divergence(self, now: float, *, due: bool) -> None:
        super()._check_divergence(now, due=due)
        fix, together = self._last_fix(now), self._together
        if fix is None or together is None or not (due or together.lost):
            return
        estimate = self._with_sound_biases(together.lost, *self._mixed())
        mean = estimate[0]
        # Without the known gyro bias (rad/s), an alignment has a wrong heading.
        known = len(mean) > GYRO_BIAS and np.isfinite(mean[GYRO_BIAS])
        gyro_bias = float(mean[GYRO_BIAS]) if known else 0.0
        start = self._reset_state(together, now, fix, lambda: estimate, due=due, gyro_bias=gyro_bias)
        if start is None and due and not self.weights.any():  # all filters have failed
            with np.errstate(all="ignore"):  # non-finite values give no start
                start = self._check(now, fix, *estimate).start
        if start is not None:
            self._start_lanes(start, slice(1, None))
            self._keep_biases(start, gyro_bias, *estimate)
            self._begin_history()
        self._holds = self._holds or together.lost

    @property
    def _biases(self) -> list[int]:
        return [i for i, state in enumerate(FILTERS[self._kernel].states) if state.bias_of]

    def _with_sound_biases(self, lost: bool, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """Return the mean (n,) and the covariance (n, n). If ``lost``, the biases are those before the divergence."""
        if not lost:
            self._last_sound = mean, covariance
            return mean, covariance
        biases = self._biases
        sound_mean, sound_covariance = self._last_sound
        mean[biases], covariance[biases], covariance[:, biases] = sound_mean[biases], 0.0, 0.0
        covariance[np.ix_(biases, biases)] = sound_covariance[np.ix_(biases, biases)]
        return mean, covariance

    def _keep_biases(self, start: InitialState, gyro_bias: float, mean: Array, covariance: Array) -> None:
        """Set the biases of reset filters to those of the mixture.

        Filters with offsets for larger initial biases do not change. No filter changes if the alignment estimated the
        gyro bias more precisely than the mixture did, or if it used a gyro bias other than ``gyro_bias`` (rad/s).
        """
        gyro = start.gyro
        if gyro is not None:
            precise = len(mean) > GYRO_BIAS and gyro.variance[UP] < covariance[GYRO_BIAS, GYRO_BIAS]
            if precise or gyro.taken != gyro_bias:
                return
        if not np.isfinite(mean.sum() + covariance.sum()):
            return
        others = range(len(FIXED_OFFSETS), LANES)
        lanes = [*(k for k, fixed in enumerate(FIXED_OFFSETS) if k and START not in fixed), *others]
        biases = self._biases
        rows, state = self._rows_of(self._numbers), state_rows(self._kernel)
        of_state = state[:, np.newaxis], np.array(lanes)
        rows[of_state] = self._started(replace(start, gyro=None, tilt=None))[of_state]
        for i in biases:
            rows[i, lanes] = mean[i]
            for j in biases[: biases.index(i) + 1]:
                rows[at(i, j), lanes] = covariance[i, j]

    def _reset(self, start: InitialState) -> None:
        super()._reset(start)
        self._rows_of(self._numbers)[:, 0] = self._filter_state[:N_KEPT]
        evidence = self._numbers[swarm.EVIDENCE]
        if not np.isfinite(evidence[0]):  # failed before: use the least evidence of all filters
            evidence[0] = evidence[np.isfinite(evidence)].min(initial=0.0)
        self._begin_history()

    def _begin_history(self) -> None:
        counts = self._memory.arrays.counts
        counts[live.N_HISTORY] = counts[live.OLDEST] = 0
        counts[live.N_SAMPLES] += -int(counts[live.N_SAMPLES]) % live.CHECKPOINT_EVERY
        self._snapshots = [self._snapshot(self._numbers, float(self._filter_state[live.TIME]))]
        self._pending = None

    @property
    def bank_restarts(self) -> list[float]:
        """Times of the resets of filters 1 to 15 after a divergence of the mixture, s."""
        return [] if self._together is None else self._together.restarts

    @property
    def swarm_restarts(self) -> list[float]:
        """Deprecated name of ``bank_restarts``."""
        warn_deprecated("LiveFilterBank.swarm_restarts", "LiveFilterBank.bank_restarts")
        return self.bank_restarts

    @property
    def spread(self) -> OffsetPrior:
        """Deprecated name of ``prior``."""
        warn_deprecated("LiveFilterBank.spread", "LiveFilterBank.prior")
        return self.prior

    @property
    def weights(self) -> Array:
        """Weights of the filters, (16,); their sum is 1, or 0 if all filters have failed."""
        return self._numbers[swarm.WEIGHT].copy()

    @property
    def effective(self) -> float:
        """Effective number of filters: 1 / sum of squared weights; 0 if all filters have failed."""
        squares = float(np.square(self.weights).sum())
        return 1.0 / squares if squares > 0.0 else 0.0

    @property
    def leader(self) -> FilterParameters:
        """Parameters of the filter with the largest weight."""
        return self.prior.parameters(self.offsets[int(np.argmax(self.weights))])

    @property
    def moved(self) -> Array:
        """Weighted mean of the ``offsets`` from the tuned parameters, (d,), in the same units."""
        return self.weights @ self.offsets * self.prior.lasting

    @property
    def settled(self) -> FilterParameters:
        """Tuned parameters, changed by the mean offsets `moved`, to be saved as the filter of this car."""
        return self.prior.parameters(self.moved)

    @property
    def n_fixes(self) -> int:
        """Number of processed fixes."""
        return int(self._numbers[swarm.N_FIXED])

    @property
    def innovation(self) -> tuple[Array, Array]:
        """Innovation nu of the mixture at the last fix, (2,) in m, and its covariance S, (2, 2) in m2."""
        n = self._numbers
        xy = n[swarm.S_XY]
        return n[[swarm.NU_X, swarm.NU_Y]], np.array([[n[swarm.S_XX], xy], [xy, n[swarm.S_YY]]])

    @property
    def state(self) -> LiveState:
        """State estimate of the mixture after the last IMU sample and all earlier fixes."""
        mean, covariance = self._mixed()
        sound = self._plausible and is_definite(covariance)
        return live_state(float(self._filter_state[live.TIME]), mean, covariance, self.lost, sound)

    @property
    def lost(self) -> bool:
        """True while the mixture has diverged and no reset is possible; the position is the last fix."""
        return self._together is not None and self._together.lost

    def lanes(self) -> tuple[Array, Array]:
        """Return the current state rows (s, 16) (see `compiled.layout`) and the weights (16,) of the filters."""
        return self._rows_of(self._numbers)[state_rows(self._kernel)], self.weights

    def _mixed(self) -> tuple[Array, Array]:
        states, weights = self.lanes()
        mixed = Mixture.of(states[np.newaxis], weights[np.newaxis], self._kernel)
        return mixed.mean[0], mixed.covariance[0]

    @property
    def smoothed(self) -> LiveState:
        """Not available for a filter bank; raises `InputError`."""
        raise InputError(
            "a filter bank has no smoothed state; use a LiveFilter with a lag, for example lag=2.0"
        )
