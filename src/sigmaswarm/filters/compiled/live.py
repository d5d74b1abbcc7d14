"""The memory of a live filter, and compiled functions that process an IMU sample, a fix or an odometer reading.

The filter is the first lane of the rows in `layout`. In functions, ``m`` is the memory (`LiveArrays`), and ``v`` its
first array. The memory consists of the address of the step (see `single`), and eight arrays:

    filter_state (N_ALL or more,) the state, which a late fix resets to an earlier state; then settings and scratch
    counts  (N_COUNTS,) numbers of used rows of the other arrays, flags, and counts of ignored data
    calm    (N_MEMORY, 8) memory of the standstill detection, see `drives.standstill`; no rows if unused
    fixes   (f, N_FIX) the fixes and their kinds, sorted by time, then by arrival
    speeds  (r, 2) odometer readings, sorted by time: time (s) and speed (m/s); no rows if unused
    history (h, N_RECORD) ring buffer: the last samples, and the state before each sample
    checkpoints (m, k) ring buffer: the k numbers of a filter bank that a step changes, from index BEHIND of
            filter_state on, stored before every CHECKPOINT_EVERY-th sample; no rows if k is 0
    lately  (l, N_SAMPLE) ring buffer: the last samples, for the divergence monitor (see `monitor`); no rows if unused

A sample consists of its time and the IMU's axes in the order of `timeline.AXES`; an unused axis is 0.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import float64, int64, njit
from numba.core.dispatcher import Dispatcher

from sigmaswarm.compilation import call_once
from sigmaswarm.drives.events import FIX, HEADING, STANDSTILL, VELOCITY, sample_events, slot_of
from sigmaswarm.drives.gaps import gap_of, usual_after
from sigmaswarm.drives.odometer import INTERVAL, LARGEST_AGE
from sigmaswarm.drives.stale_fixes import STALE, kind_of
from sigmaswarm.drives.standstill import FIX_WINDOW, MEANS, fixes_are_still, is_calm, matches_stop
from sigmaswarm.drives.timeline import AX, AXES, AY, DT, GAP, N_STEP, Q_SCALE
from sigmaswarm.filters.compiled.lanes import OPTIONS
from sigmaswarm.filters.compiled.layout import COVARIANCE, N_KEPT, P0, R
from sigmaswarm.filters.compiled.memory import memory_at
from sigmaswarm.filters.compiled.monitor import (
    CHECK_INTERVAL,
    LATEST_CHECK,
    MONITOR_SPAN,
    last_fix,
    rough_heading,
)
from sigmaswarm.filters.compiled.run import cached_by_sources
from sigmaswarm.filters.compiled.single import take_step

# The state: rows as in `layout`; its time; nominal steps since the last fix; time slots of the last events.
N_FILTER = N_KEPT
OK = R.OK
TIME, SINCE = range(N_FILTER, N_FILTER + 2)
DONE = slice(N_FILTER + 2, N_FILTER + 6)  # see `drives.events`
# Last time at which IMU and fixes showed a stop; then the stop, see `standstill.matches_stop`.
STOP_TIME = DONE.stop
STOP = slice(STOP_TIME + 1, STOP_TIME + 4)
N_FILTER_STATE = STOP.stop
# Settings. USED: bits of the constraints and the odometer, if the filter uses them.
N_SAMPLE = 1 + len(AXES)
NOMINAL, START, USED, AS_RECORDED, USUAL_INTERVAL, TRUSTS_TIMES = range(N_FILTER_STATE, N_FILTER_STATE + 6)
# Divergence monitor: largest delay of fixes, s; the time of the last fix seen; the time slot of the last check.
LATE_BY, SEEN_FIX, LAST_CHECK = range(N_FILTER_STATE + 6, N_FILTER_STATE + 9)
LEVER = slice(N_FILTER_STATE + 9, N_FILTER_STATE + 12)
SAMPLE = slice(LEVER.stop, LEVER.stop + N_SAMPLE)  # the last sample
LAST_SAMPLE = SAMPLE.start  # time of the last sample
(
    FIX_TIME, FIX_X, FIX_Y, FIX_VX, FIX_VY, FIX_VAR_X, FIX_VAR_Y, FIX_THETA, FIX_VAR_THETA, HAS_VELOCITY, KIND,
) = range(11)  # fmt: skip
FIX_ROW = slice(FIX_X, HAS_VELOCITY)  # a row of `Timeline.fixes`
N_FIX = 11
# The last sample and the last fix whose time stamps are far ahead of the filter; the new sample.
SAMPLE_AHEAD = slice(SAMPLE.stop, SAMPLE.stop + N_SAMPLE)
FIX_AHEAD = slice(SAMPLE_AHEAD.stop, SAMPLE_AHEAD.stop + N_FIX)
NEW_SAMPLE = slice(FIX_AHEAD.stop, FIX_AHEAD.stop + N_SAMPLE)
ORDER = slice(NEW_SAMPLE.stop, NEW_SAMPLE.stop + len(AXES))  # index of each of AXES in the input
DIMENSION = ORDER.stop  # number of states
FACTOR = slice(DIMENSION + 1, DIMENSION + 1 + len(COVARIANCE))  # scratch for the Cholesky factor
N_ALL = FACTOR.stop

(
    N_FIXES, N_HISTORY, OLDEST, HOLDS_SAMPLE, HOLDS_FIX, TOO_LATE, TIME_JUMPS, N_STALE, N_SPEEDS,
    N_SAMPLES,  # number of samples ever added to the history
    SPARE,  # number of records that are stored only to continue from a checkpoint
    N_LATELY, NEWEST,  # number of samples in ``lately``, and the row of the last one
    CAME_LATE,  # 1 if the last accepted fix was late
) = range(14)  # fmt: skip
N_COUNTS = 14
NOTHING, HELD, CONFIRMED = range(3)  # state of FIX_AHEAD: empty, waiting for a second fix, confirmed

BEHIND = 8 * math.ceil(N_ALL / 8)  # index of the additional numbers of a filter bank; a multiple of WIDEST
CHECKPOINT_EVERY = 16  # samples between two checkpoints, which are large and rarely needed

CHECK_EVERY = CHECKPOINT_EVERY  # samples between two checks of P, which is also checked after each fix
ROUNDING = 1e-8  # a negative eigenvalue of the correlation matrix up to this size is a rounding error

LEAP = 10.0  # s; a sample or fix further ahead of the filter waits for a second one that confirms its time
AGREES = 1.0 + 1e-6  # s, largest difference of time stamps that confirm each other; 1e-6 allows for rounding

# A record: the state; the sample's time; the step (DT ... GY) to this time; 1 if the last second was calm; the means of
# that second.
S_TIME = N_FILTER_STATE
S_STEP = slice(N_FILTER_STATE + 1, N_FILTER_STATE + 1 + N_STEP)
S_AXES = slice(S_STEP.start + AX, S_STEP.stop)
S_CALM = S_STEP.stop
S_MEANS = slice(S_CALM + 1, S_CALM + 5)
N_RECORD = S_MEANS.stop

TAKEN, IGNORED, LEFT_OUT = 1, 0, -1
"""Results for a fix or an odometer reading.

IGNORED: repeated data; a fix at or before the start of the filter; a fix whose time must be confirmed by a second fix;
an odometer reading, if the filter does not use an odometer. LEFT_OUT: a measurement that is too late, that finds its
buffer full, or whose time or speed is not finite; an odometer reading whose time is far ahead.
"""
DUE = 2  # result of a sample: used, and the divergence monitor is due


_plain = njit(**OPTIONS)  # operations are not reordered: time slots must equal those of `drives.events`


@_plain
def _step_to(m, to, u, events, z, wheels):
    """Compute the step to a time. ``u`` (N_STEP,) contains axes and gap; this function sets its DT and Q_SCALE."""
    v = m.filter_state
    dt = to - v[TIME]
    scale = dt / v[NOMINAL]
    v[SINCE] += scale
    u[DT], u[Q_SCALE] = dt, scale
    take_step(m.step, v, u, events, z, wheels, v[LEVER], v[SINCE])
    v[TIME] = to


@_plain
def _copy(of, to, n):
    """Copy the first n numbers. Numba takes long to compile copies of whole arrays."""
    for i in range(n):
        to[i] = of[i]


@_plain
def _same(a, b, n):
    for i in range(n):  # noqa: SIM110 (Numba)
        if a[i] != b[i]:
            return False
    return True


@_plain
def is_definite(p, n, factor, first):
    """Return True if the Cholesky factor shows that P of n states is positive semidefinite, up to rounding.

    ``p`` is the upper triangle of P, column by column. The factor is written to ``factor``, from index ``first`` on.
    """
    for j in range(n):
        begin = j * (j + 1) // 2
        column = first + begin
        pivot = p[begin + j] * (1.0 + ROUNDING)
        for i in range(j):
            other = first + i * (i + 1) // 2
            left = p[begin + i]
            for k in range(i):
                left -= factor[other + k] * factor[column + k]
            if factor[other + i] > 0.0:
                left /= factor[other + i]
            elif left != 0.0:
                return False
            factor[column + i] = left
            pivot -= left * left
        if not pivot >= 0.0:
            return False
        factor[column + j] = math.sqrt(pivot)
    return True


@_plain
def _process_sample(m, k):
    """Process the fixes up to the k-th stored sample, then this sample, the odometer and the constraints of a car."""
    v, fixes, record = m.filter_state, m.fixes, _record(m, k)
    t, u = record[S_TIME], record[S_STEP]
    before, nothing = v[TIME], np.zeros(11)
    no_fix, wheels = nothing[:8], nothing[8:]
    end, came = _until(fixes, m.counts[N_FIXES], t), _until(m.speeds, m.counts[N_SPEEDS], t)
    first = end
    while first > 0 and fixes[first - 1, FIX_TIME] > v[TIME]:
        first -= 1
    for f in range(first, end):
        z = fixes[f]
        if z[KIND] >= STALE:
            continue
        events = FIX | VELOCITY if z[HAS_VELOCITY] > 0.0 else FIX
        if z[FIX_VAR_THETA] < math.inf:
            events |= HEADING
        _step_to(m, z[FIX_TIME], u, events, z[FIX_ROW], wheels)
        v[SINCE] = 0.0
    slot = slot_of(t, v[START], INTERVAL)
    stands = record[S_CALM] > 0.0 and _is_standstill(v, fixes, end, t, record[S_MEANS])
    events = sample_events(int(v[USED]), slot, t, before, u[AY], stands, m.speeds, came, v[DONE], wheels)
    if t > v[TIME] or events:
        _step_to(m, t, u, events, no_fix, wheels)
    checks = first < end or _number(m, k) % CHECK_EVERY == 0
    if checks and v[OK] == 1.0 and not is_definite(v[P0:], int(v[DIMENSION]), v, FACTOR.start):
        v[OK] = 0.0


@_plain
def _until(rows: np.ndarray, n: int, now: float) -> int:
    """Return how many of the first n rows, which are sorted by time (column 0), are not later than ``now``."""
    while n > 0 and rows[n - 1, 0] > now:
        n -= 1
    return n


@_plain
def _is_standstill(v, fixes, end, now, means):
    """Return True if, after a calm second, the acceleration and the fixes before row ``end`` show a standstill."""
    if not fixes_are_still(fixes, fixes[:, KIND], end, now, np.empty(1)):
        return False
    passed, v[STOP_TIME] = now - v[STOP_TIME], now
    return matches_stop(v[STOP], passed, means)


@_plain
def _is_far_ahead(v, t):
    """Return True if a time is so far ahead of the filter that a second time stamp must confirm it."""
    return t - v[TIME] > LEAP and v[TRUSTS_TIMES] == 0.0


@_plain
def _record(m, k):
    return m.history[(m.counts[OLDEST] + k) % m.history.shape[0]]


@_plain
def _number(m, k):
    """Return the number of the k-th stored sample, counted from the first sample ever stored."""
    return m.counts[N_SAMPLES] - m.counts[N_HISTORY] + k


@_plain
def _drop_old(m, rows, count, age):
    """Remove the rows that are more than ``age`` s older than the history. Return False if there are none."""
    counts = m.counts
    oldest = _record(m, 0)[TIME] if counts[N_HISTORY] > 0 else m.filter_state[TIME]
    old = _until(rows, counts[count], oldest - age)
    for r in range(old, counts[count]):
        _copy(rows[r], rows[r - old], rows.shape[1])
    counts[count] -= old
    return old > 0


@_plain
def _insert(counts, rows, count, at, row):
    for r in range(counts[count], at, -1):
        _copy(rows[r - 1], rows[r], rows.shape[1])
    _copy(row, rows[at], rows.shape[1])
    counts[count] += 1


@_plain
def _store_fix(m, z):
    """Insert a fix in order of time; if no row is free, first remove fixes that are no longer needed."""
    v, counts, fixes = m.filter_state, m.counts, m.fixes
    is_full = counts[N_FIXES] == fixes.shape[0]  # the monitor works without some old fixes
    if is_full and not (
        _drop_old(m, fixes, N_FIXES, MONITOR_SPAN) or _drop_old(m, fixes, N_FIXES, FIX_WINDOW)
    ):
        last = fixes[counts[N_FIXES] - 1, FIX_TIME]
        if not (_is_far_ahead(v, last) and z[0] < last):
            return LEFT_OUT
        counts[N_FIXES] -= 1  # remove the fix that is stamped furthest ahead
        counts[TIME_JUMPS] += 1
    same = at = _until(fixes, counts[N_FIXES], z[0])
    while same > 0 and fixes[same - 1, FIX_TIME] == z[0]:
        same -= 1
        if _same(fixes[same], z, KIND):
            return IGNORED
    _insert(counts, fixes, N_FIXES, at, z)
    if v[AS_RECORDED] == 0.0:
        for f in range(at, counts[N_FIXES]):  # later fixes may repeat the new one
            fixes[f, KIND] = kind_of(fixes, fixes[:, KIND], f)
        if fixes[at, KIND] >= STALE:
            counts[N_STALE] += 1
    return TAKEN


@_plain
def _store_reading(m, z):
    counts, speeds = m.counts, m.speeds
    if counts[N_SPEEDS] == speeds.shape[0] and not _drop_old(m, speeds, N_SPEEDS, LARGEST_AGE):
        return LEFT_OUT
    at = _until(speeds, counts[N_SPEEDS], z[0])
    if at > 0 and speeds[at - 1, 0] == z[0]:
        return IGNORED
    _insert(counts, speeds, N_SPEEDS, at, z)
    return TAKEN


@_plain
def _process_in_order(m, sample):
    """Process an IMU sample whose time was accepted.

    If a gap precedes the sample, predict across the gap with the mean of the samples before and after it.
    """
    v, counts = m.filter_state, m.counts
    t, last, gap = sample[0], v[SAMPLE], 0.0
    if last[0] > -math.inf:
        interval = t - last[0]
        if v[AS_RECORDED] == 0.0:
            gap = gap_of(interval, v[USUAL_INTERVAL])
        v[USUAL_INTERVAL] = usual_after(interval, v[USUAL_INTERVAL])
    calm, means = False, np.zeros(4)
    if int(v[USED]) & STANDSTILL:
        calm = is_calm(m.calm, t, sample[1], sample[2], sample[3])
        _copy(m.calm[MEANS], means, 4)
    if t <= v[START]:
        _copy(sample, last, N_SAMPLE)
        if calm:  # a stop may have begun before the start
            _is_standstill(v, m.fixes, _until(m.fixes, counts[N_FIXES], t), t, means)
        return
    if counts[N_HISTORY] < m.history.shape[0]:
        counts[N_HISTORY] += 1
    else:
        counts[OLDEST] = (counts[OLDEST] + 1) % m.history.shape[0]
    counts[N_SAMPLES] += 1
    newest = counts[N_HISTORY] - 1
    _store_state(m, newest)
    record = _record(m, newest)
    record[S_TIME], record[S_STEP][GAP] = t, gap
    _copy(sample[1:], record[S_AXES], len(AXES))
    if gap > 0.0:
        for axis in range(len(AXES)):
            record[S_AXES][axis] = 0.5 * (last[1 + axis] + sample[1 + axis])
    record[S_CALM] = 1.0 if calm else 0.0
    _copy(means, record[S_MEANS], len(means))
    _copy(sample, last, N_SAMPLE)
    _process_sample(m, newest)


@_plain
def _checkpoint(m, number):
    return m.checkpoints[number // CHECKPOINT_EVERY % m.checkpoints.shape[0]]


@_plain
def _store_state(m, k):
    """Store the state before the k-th stored sample, and a checkpoint if one is due."""
    _copy(m.filter_state, _record(m, k), N_FILTER_STATE)
    number = _number(m, k)
    if m.checkpoints.shape[0] > 0 and number % CHECKPOINT_EVERY == 0:
        _copy(m.filter_state[BEHIND:], _checkpoint(m, number), m.checkpoints.shape[1])


@_plain
def _first_after(m, t):
    """Return the index of the first stored sample at or after a time, from which to process the samples again.

    The result is -1 if there is no such sample, or if the history does not reach back to the time.
    """
    kept = m.counts[N_HISTORY]
    back = kept
    while back > 0 and _record(m, back - 1)[S_TIME] >= t:
        back -= 1
    if back == kept or _record(m, back)[TIME] >= t:
        return -1
    return back if kept - back <= m.history.shape[0] - m.counts[SPARE] else -1


@_plain
def replay(m, first, corrects):
    """Process the stored samples again from index ``first`` on; the filter is in the state before this sample.

    If ``corrects`` is True, also replace the stored states and checkpoints.
    """
    for k in range(first, m.counts[N_HISTORY]):
        if corrects:
            _store_state(m, k)
        _process_sample(m, k)


@_plain
def _replay_from(m, back):
    """Return to the state before the stored sample ``back``, or to an earlier checkpoint; process the samples again."""
    if m.checkpoints.shape[0] > 0:
        number = _number(m, back)
        back -= number % CHECKPOINT_EVERY
        _copy(_checkpoint(m, number), m.filter_state[BEHIND:], m.checkpoints.shape[1])
    _copy(_record(m, back), m.filter_state, N_FILTER_STATE)
    replay(m, back, True)


@_plain
def _accept(m, z, is_fix):
    """Store a fix or a reading with an accepted time; if it is late, process the later samples again."""
    t, v = z[0], m.filter_state
    late = v[START] < t <= v[TIME]
    back, kept = _first_after(m, t) if late else 0, LEFT_OUT
    if back >= 0:
        kept = _store_fix(m, z) if is_fix else _store_reading(m, z)
    if kept == LEFT_OUT:
        m.counts[TOO_LATE] += 1
    elif kept == TAKEN and late:
        _replay_from(m, back)
    return kept


@_plain
def _accept_fix(m, z):
    v, is_number = m.filter_state, math.isfinite(z[FIX_X]) and math.isfinite(z[FIX_Y])
    if z[FIX_TIME] <= v[START]:  # the initial state includes this fix, but the fix may show a stop
        _store_fix(m, z)
        if is_number:
            m.counts[CAME_LATE] = 0
        return IGNORED
    kept = _accept(m, z, True)
    if kept == TAKEN and is_number:
        m.counts[CAME_LATE] = 1 if z[FIX_TIME] <= v[TIME] else 0
    return kept


@_plain
def _store_for_monitor(m, sample):
    counts, lately = m.counts, m.lately
    if lately.shape[0] > 0:
        row = counts[NEWEST] = (counts[NEWEST] + 1) % lately.shape[0]
        counts[N_LATELY] = min(counts[N_LATELY] + 1, lately.shape[0])
        _copy(sample, lately[row], N_SAMPLE)


@_plain
def _has_new_fixes(m, t):
    v = m.filter_state
    f = last_fix(m.fixes, m.counts[N_FIXES], t, max(v[SEEN_FIX], v[START]))
    if f >= 0:
        v[SEEN_FIX] = m.fixes[f, FIX_TIME]
    return f >= 0


@_plain
def _is_due(m, t):
    """Return True if the monitor must check after a sample: soon after a new fix, at most once per CHECK_INTERVAL."""
    if not _has_new_fixes(m, t):
        return False
    v = m.filter_state
    slot = slot_of(t, v[START], CHECK_INTERVAL)
    soon = t - v[SEEN_FIX] <= LATEST_CHECK + v[LATE_BY] * m.counts[CAME_LATE]
    if not soon or slot == v[LAST_CHECK]:
        return False
    v[LAST_CHECK] = slot
    return True


def _sample(handle, t, a, b, c, d, e, f):
    """Process an IMU sample. A sample whose time is far ahead waits for a second sample."""
    m = memory_at(handle)
    v, counts = m.filter_state, m.counts
    if not v[LAST_SAMPLE] < t < math.inf:
        return NOTHING
    new, held, axes = v[NEW_SAMPLE], v[SAMPLE_AHEAD], (a, b, c, d, e, f)
    new[0] = t
    for axis in range(len(AXES)):
        new[1 + axis] = axes[int(v[ORDER][axis])]
    holds = counts[HOLDS_SAMPLE] > 0
    ahead = _is_far_ahead(v, t)
    agrees = ahead and holds and 0.0 < t - held[0] <= AGREES
    if ahead and not agrees:
        if not holds or t != held[0]:  # not a repeat
            counts[TIME_JUMPS] += counts[HOLDS_SAMPLE]
            counts[HOLDS_SAMPLE] = 1
            _copy(new, held, N_SAMPLE)
        return NOTHING
    counts[HOLDS_SAMPLE] = 0
    if agrees:
        _process_in_order(m, held)
        _store_for_monitor(m, held)
    elif holds:
        counts[TIME_JUMPS] += 1
    _process_in_order(m, new)
    if agrees and counts[HOLDS_FIX] == HELD and not _is_far_ahead(v, v[FIX_AHEAD][FIX_TIME]):
        counts[HOLDS_FIX] = NOTHING  # the samples confirm the fix
        _accept_fix(m, v[FIX_AHEAD].copy())
    _store_for_monitor(m, new)
    if m.lately.shape[0] == 0 or t <= v[START]:
        return TAKEN
    if agrees:
        _has_new_fixes(m, held[0])  # no check at the sample that ends a gap
    return DUE if _is_due(m, t) else TAKEN


def _fix(handle, t, x, y, vx, vy, has_velocity, var_x, var_y, theta, var_theta):
    """Process a fix. A fix whose time is far ahead waits for a second fix."""
    m = memory_at(handle)
    v, counts = m.filter_state, m.counts
    if not math.isfinite(t):
        counts[TOO_LATE] += 1
        return LEFT_OUT
    z = np.array([t, x, y, vx, vy, var_x, var_y, theta, var_theta, has_velocity, 0.0])
    ahead = v[FIX_AHEAD]
    agrees = counts[HOLDS_FIX] != NOTHING and abs(t - ahead[FIX_TIME]) <= AGREES
    if counts[HOLDS_FIX] == HELD:
        if _same(ahead, z, N_FIX):  # a repeat
            return IGNORED
        if agrees:
            _accept_fix(m, ahead.copy())
        else:
            counts[TIME_JUMPS] += 1
    counts[HOLDS_FIX] = NOTHING
    if _is_far_ahead(v, t):
        counts[HOLDS_FIX] = CONFIRMED if agrees else HELD
        _copy(z, ahead, N_FIX)
        if not agrees:
            return IGNORED
    return _accept_fix(m, z)


def _speed(handle, t, value):
    m = memory_at(handle)
    if m.speeds.shape[0] == 0:
        return IGNORED
    if not (math.isfinite(t) and math.isfinite(value)):
        m.counts[TOO_LATE] += 1
        return LEFT_OUT
    if _is_far_ahead(m.filter_state, t):
        m.counts[TIME_JUMPS] += 1
        return LEFT_OUT
    return _accept(m, np.array([t, value]), False)


def _heading(handle, gyro_bias):
    m = memory_at(handle)
    return rough_heading(
        m.lately, m.counts[NEWEST], m.counts[N_LATELY], m.fixes, m.counts[N_FIXES], gyro_bias
    )


def _definite(handle):
    v = memory_at(handle).filter_state
    return is_definite(v[P0:], int(v[DIMENSION]), v, FACTOR.start)


@call_once
def replay_call():
    """Return `replay`, compiled and cached. The step of a smoother is a `single_step` that logs its steps."""
    return cached_by_sources(getattr(replay, "py_func", replay), "live again")


@dataclass(frozen=True)
class LiveCalls:
    """Compiled functions that change or read the memory of a live filter; their first argument is `Memory.handle`.

    - ``sample(handle, t, a, b, c, d, e, f)``: process an IMU sample; ``a`` to ``f``: axes in the filter's order
    - ``fix(handle, t, x, y, vx, vy, has_velocity, var_x, var_y, theta, var_theta)``: process a fix
    - ``speed(handle, t, speed)``: process an odometer reading
    - ``heading(handle, gyro_bias)``: heading (rad) from samples and fixes, see `rough_heading`; NaN if unknown
    - ``definite(handle)``: True if the covariance is positive semidefinite
    """

    sample: Any
    fix: Any
    speed: Any
    heading: Any
    definite: Any

    def __reduce__(self):
        return live_calls, ()


@call_once
def live_calls():
    """Compile the functions once, for one signature; numbers of other types are converted."""
    calls = [cached_by_sources(each, "live") for each in (_sample, _fix, _speed, _heading, _definite)]
    for function, numbers in zip(calls, (7, 10, 2, 1, 0), strict=True):
        signature = (int64, *(float64,) * numbers)
        if isinstance(function, Dispatcher):  # not with NUMBA_DISABLE_JIT
            function.compile(signature)
            function.disable_compile()
    return LiveCalls(*calls)
