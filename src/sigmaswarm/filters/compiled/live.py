"""A live filter's memory, and what an IMU sample and a fix do to it: one call each, with nothing left to Python.

The filter is the first lane of the rows in `layout`. Each step spreads it over all lanes, which costs less than another
set of kernels would. The memory is five arrays, so that each call takes the same few arguments:

    belief  (N_ALL,) what is believed, which a late fix takes back; then settings, and what is never taken back
    counts  (N_COUNTS,) how much of the other arrays is filled, and what was left out
    memory  (N_MEMORY, 8) what tells calm, see `drives.standstill`; of no rows where nothing asks
    fixes   (f, N_FIX) by time; those of one time in the order in which they came; each with what it is
    history (h, N_RECORD) a ring: the last samples, and the belief before each of them
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math
from functools import cache, partial

import numpy as np
from numba import float64, int64, njit
from numba.core.dispatcher import Dispatcher

from sigmaswarm.drives.frozen import FROZEN, kind_of
from sigmaswarm.drives.gaps import gap_of, usual_after
from sigmaswarm.drives.standstill import FIX_WINDOW, MEANS, N_STOP, fixes_stand, is_as_it_was, is_calm
from sigmaswarm.drives.timeline import CORNERING
from sigmaswarm.filters.compiled.lanes import LANES
from sigmaswarm.filters.compiled.layout import N_KEPT, P0, R
from sigmaswarm.filters.compiled.rows import new_rows
from sigmaswarm.filters.compiled.run import cached_by_sources
from sigmaswarm.filters.compiled.step import step5, step8
from sigmaswarm.filters.schedule import FIX, LATERAL, STANDSTILL, VELOCITY

# The belief: state, constants and sums as in `layout`, then when it is, Q's scale since the last fix, and the intervals
# in which the constraints were absorbed last.
N_FILTER = N_KEPT
OK = R.OK
TIME, SINCE, LATERAL_SLOT, STANDSTILL_SLOT = range(N_FILTER, N_FILTER + 4)
STOP = slice(N_FILTER + 4, N_FILTER + 4 + N_STOP)  # what is remembered of a stop
N_BELIEF = STOP.stop
# Behind it, what no late fix takes back. An interval of 0: the filter does not take that constraint.
NOMINAL, START, LEVER_X, LEVER_Y, LATERAL_INTERVAL, STANDSTILL_INTERVAL, AS_RECORDED = range(
    N_BELIEF, N_BELIEF + 7
)
LAST_SAMPLE, LAST_AX, LAST_AY, LAST_GZ, USUAL_INTERVAL = range(N_BELIEF + 7, N_BELIEF + 12)
FIX_TIME, FIX_X, FIX_Y, FIX_U, FIX_V, HAS_VELOCITY, FIX_VAR_X, FIX_VAR_Y, KIND = range(9)
N_FIX = 9
# The last sample and fix that lay too far ahead to be taken at once.
SAMPLE_AHEAD = slice(N_BELIEF + 12, N_BELIEF + 16)
FIX_AHEAD = slice(SAMPLE_AHEAD.stop, SAMPLE_AHEAD.stop + N_FIX)
N_ALL = FIX_AHEAD.stop

N_STATES, N_FIXES, N_HISTORY, OLDEST = range(4)
HOLDS_SAMPLE, HOLDS_FIX, TOO_LATE, TIME_JUMPS, N_FROZEN = range(4, 9)
N_COUNTS = 9
NOTHING, HELD, BELIEVED = range(3)  # of a fix that lay ahead: it waits for a second one; that one came

LEAP = 10.0
"""s: a sample or fix that is stamped farther ahead of the filter is held back until a second one agrees."""
AGREES = 1.0 + 1e-6
"""s between the two; beside the second, what rounding takes off times that count from 1970."""

# What drives the filter to a sample's time, whether the last second was calm, and its means.
S_TIME, S_AX, S_AY, S_GZ, S_GAP, S_CALM = range(N_BELIEF, N_BELIEF + 6)
S_MEANS = slice(N_BELIEF + 6, N_BELIEF + 10)
N_RECORD = S_MEANS.stop

TAKEN, IGNORED, LEFT_OUT = 1, 0, -1
"""What became of a fix: taken; before the start, there already or held back; too late, or no room."""


# Bookkeeping has no lanes to vectorize, and must divide as Python does: slots of time are compared with those of a run.
_plain = partial(njit, error_model="numpy", nogil=True)
_cached_plain = partial(cached_by_sources, fastmath=False)


@cached_by_sources
def live_step(sources):
    def step(
        v, n, dt, ax, ay, gz, q_scale, gap, happens, zx, zy, zu, zv, var_x, var_y, lever_x, lever_y, since
    ):  # fmt: skip
        """One step of one filter; v (N_FILTER or more,) is its state before and after."""
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        for r in range(N_FILTER):
            for l in range(LANES):
                w[r, l] = v[r]
        if n == 5:
            step5(
                w, dt, ax, ay, gz, q_scale, gap, happens,
                zx, zy, zu, zv, var_x, var_y, lever_x, lever_y, since,
            )  # fmt: skip
        else:
            step8(
                w, dt, ax, ay, gz, q_scale, gap, happens,
                zx, zy, zu, zv, var_x, var_y, lever_x, lever_y, since,
            )  # fmt: skip
        for r in range(N_FILTER):
            v[r] = w[r, 0]

    return step


@_plain
def _step_to(v, n, to, ax, ay, gz, gap, happens, zx, zy, zu, zv, var_x, var_y):
    """From where the belief is to a moment."""
    dt = to - v[TIME]
    scale = dt / v[NOMINAL]
    v[SINCE] += scale
    live_step(
        v, n, dt, ax, ay, gz, scale, gap, happens,
        zx, zy, zu, zv, var_x, var_y, v[LEVER_X], v[LEVER_Y], v[SINCE],
    )  # fmt: skip
    v[TIME] = to


@_plain
def _slot(t, start, interval):
    """Which interval a moment lies in, as `schedule._every` says it; a constraint is absorbed once in each."""
    return math.floor((t - start) / interval + 1e-6)


@_plain
def _take(v, counts, fixes, t, ax, ay, gz, gap, calm, means):
    """Step through the fixes up to a sample's time, and absorb there what a car on its wheels can't do."""
    n, end = counts[N_STATES], _seen(counts, fixes, t)
    first = end
    while first > 0 and fixes[first - 1, FIX_TIME] > v[TIME]:
        first -= 1
    for f in range(first, end):
        z = fixes[f]
        if z[KIND] >= FROZEN:
            continue
        happens = FIX | VELOCITY if z[HAS_VELOCITY] > 0.0 else FIX
        _step_to(
            v, n, z[FIX_TIME], ax, ay, gz, gap, happens,
            z[FIX_X], z[FIX_Y], z[FIX_U], z[FIX_V], z[FIX_VAR_X], z[FIX_VAR_Y],
        )  # fmt: skip
        v[SINCE] = 0.0
    happens = 0
    if v[LATERAL_INTERVAL] > 0.0 and abs(ay) <= CORNERING:
        slot = _slot(t, v[START], v[LATERAL_INTERVAL])
        if slot != v[LATERAL_SLOT]:
            happens |= LATERAL
            v[LATERAL_SLOT] = slot
    if calm and _stands(v, fixes, end, t, means):
        slot = _slot(t, v[START], v[STANDSTILL_INTERVAL])
        if slot != v[STANDSTILL_SLOT]:
            happens |= STANDSTILL
            v[STANDSTILL_SLOT] = slot
    if t > v[TIME] or happens:
        _step_to(v, n, t, ax, ay, gz, gap, happens, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@_plain
def _seen(counts, fixes, now):
    """How many fixes there are up to a time."""
    end = counts[N_FIXES]
    while end > 0 and fixes[end - 1, FIX_TIME] > now:
        end -= 1
    return end


@_plain
def _stands(v, fixes, end, now, means):
    """After a calm second: what the fixes of the last seconds, up to row ``end``, and the stop so far say."""
    first = end
    while first > 0 and fixes[first - 1, FIX_TIME] >= now - FIX_WINDOW:
        first -= 1
    return fixes_stand(fixes[first:end], fixes[first:end, KIND], now) and is_as_it_was(v[STOP], now, means)


@_plain
def _lies_ahead(v, t):
    """Whether a time is so far ahead of the filter's that one stamp alone is not believed."""
    return t - v[TIME] > LEAP


@_plain
def _record(counts, history, k):
    """The k-th record of the history, the oldest one first."""
    return history[(counts[OLDEST] + k) % history.shape[0]]


@_plain
def _keep(v, counts, fixes, history, z):
    """Put a fix among the others, by time; where there is no room, without those that nothing needs any more."""
    if counts[N_FIXES] == fixes.shape[0]:
        oldest = _record(counts, history, 0)[TIME] if counts[N_HISTORY] > 0 else v[TIME]
        old = 0
        while old < counts[N_FIXES] and fixes[old, FIX_TIME] <= oldest - FIX_WINDOW:
            old += 1
        for f in range(old, counts[N_FIXES]):
            fixes[f - old] = fixes[f]
        counts[N_FIXES] -= old
        if old == 0:
            last = fixes[counts[N_FIXES] - 1, FIX_TIME]
            if not (_lies_ahead(v, last) and z[0] < last):
                return LEFT_OUT
            counts[N_FIXES] -= 1  # what is stamped far ahead gives way
            counts[TIME_JUMPS] += 1
    at = counts[N_FIXES]
    while at > 0 and fixes[at - 1, FIX_TIME] > z[0]:
        at -= 1
    same = at
    while same > 0 and fixes[same - 1, FIX_TIME] == z[0]:
        same -= 1
        if (fixes[same, :KIND] == z[:KIND]).all():
            return IGNORED
    for f in range(counts[N_FIXES], at, -1):
        fixes[f] = fixes[f - 1]
    fixes[at] = z
    counts[N_FIXES] += 1
    if v[AS_RECORDED] == 0.0:
        for f in range(at, counts[N_FIXES]):  # those after it may repeat it
            fixes[f, KIND] = kind_of(fixes, fixes[:, KIND], f)
        if fixes[at, KIND] >= FROZEN:
            counts[N_FROZEN] += 1
    return TAKEN


@_plain
def _go_on(v, counts, memory, fixes, history, t, ax, ay, gz):
    """Take an IMU sample whose time is believed: a gap before it is driven by the mean of the two around it."""
    gap, ax1, ay1, gz1 = 0.0, ax, ay, gz
    if v[LAST_SAMPLE] > -math.inf:
        interval = t - v[LAST_SAMPLE]
        if v[AS_RECORDED] == 0.0:
            gap = gap_of(interval, v[USUAL_INTERVAL])
        v[USUAL_INTERVAL] = usual_after(interval, v[USUAL_INTERVAL])
        if gap > 0.0:
            ax1, ay1, gz1 = 0.5 * (v[LAST_AX] + ax), 0.5 * (v[LAST_AY] + ay), 0.5 * (v[LAST_GZ] + gz)
    v[LAST_SAMPLE], v[LAST_AX], v[LAST_AY], v[LAST_GZ] = t, ax, ay, gz
    calm, means = False, np.zeros(4)
    if v[STANDSTILL_INTERVAL] > 0.0:
        calm = is_calm(memory, t, ax, ay, gz)
        means[:] = memory[MEANS, :4]
    if t <= v[START]:
        if calm:  # a stop may have begun before
            _stands(v, fixes, _seen(counts, fixes, t), t, means)
        return
    if counts[N_HISTORY] < history.shape[0]:
        counts[N_HISTORY] += 1
    else:
        counts[OLDEST] = (counts[OLDEST] + 1) % history.shape[0]
    record = _record(counts, history, counts[N_HISTORY] - 1)
    record[:N_BELIEF] = v[:N_BELIEF]
    record[S_TIME], record[S_AX], record[S_AY], record[S_GZ], record[S_GAP] = t, ax1, ay1, gz1, gap
    record[S_CALM], record[S_MEANS] = 1.0 if calm else 0.0, means
    _take(v, counts, fixes, t, ax1, ay1, gz1, gap, calm, means)


@_plain
def _place(v, counts, fixes, history, z):
    """Take a fix whose time is believed: it waits for its sample, or takes the filter back and forward again."""
    t = z[FIX_TIME]
    if t <= v[START]:  # absorbed already, but it may show a standstill
        _keep(v, counts, fixes, history, z)
        return IGNORED
    if t > v[TIME]:
        return _keep(v, counts, fixes, history, z)
    back = counts[N_HISTORY]
    while back > 0 and _record(counts, history, back - 1)[S_TIME] >= t:
        back -= 1
    if back == counts[N_HISTORY] or _record(counts, history, back)[TIME] >= t:
        return LEFT_OUT
    kept = _keep(v, counts, fixes, history, z)
    if kept == TAKEN:
        v[:N_BELIEF] = _record(counts, history, back)[:N_BELIEF]
        for k in range(back, counts[N_HISTORY]):
            record = _record(counts, history, k)
            record[:N_BELIEF] = v[:N_BELIEF]
            _take(
                v, counts, fixes, record[S_TIME], record[S_AX], record[S_AY], record[S_GZ],
                record[S_GAP], record[S_CALM] > 0.0, record[S_MEANS],
            )  # fmt: skip
    return kept


@_plain
def _place_and_count(v, counts, fixes, history, z):
    kept = _place(v, counts, fixes, history, z)
    if kept == LEFT_OUT:
        counts[TOO_LATE] += 1
    return kept


@_cached_plain
def take_sample(sources):
    def sample(v, counts, memory, fixes, history, t, ax, ay, gz):
        """An IMU sample; one that is not after the last one is left out, one far ahead waits for a second."""
        if sources == "" or not v[LAST_SAMPLE] < t < math.inf:
            return
        held = v[SAMPLE_AHEAD]
        holds = counts[HOLDS_SAMPLE] > 0
        ahead = _lies_ahead(v, t)
        agrees = ahead and holds and 0.0 < t - held[0] <= AGREES
        if ahead and not agrees:
            if not holds or t != held[0]:  # not the same again
                counts[TIME_JUMPS] += counts[HOLDS_SAMPLE]
                counts[HOLDS_SAMPLE] = 1
                held[0], held[1], held[2], held[3] = t, ax, ay, gz
            return
        counts[HOLDS_SAMPLE] = 0
        if agrees:
            _go_on(v, counts, memory, fixes, history, held[0], held[1], held[2], held[3])
        elif holds:
            counts[TIME_JUMPS] += 1
        _go_on(v, counts, memory, fixes, history, t, ax, ay, gz)
        if agrees and counts[HOLDS_FIX] == HELD and not _lies_ahead(v, v[FIX_AHEAD][FIX_TIME]):
            counts[HOLDS_FIX] = NOTHING  # the samples say the same
            _place_and_count(v, counts, fixes, history, v[FIX_AHEAD].copy())

    return sample


@_cached_plain
def take_fix(sources):
    def fix(v, counts, memory, fixes, history, t, x, y, vx, vy, has_velocity, var_x, var_y):
        """A fix: it waits for its sample, or takes the filter back; one far ahead waits for a second."""
        if sources == "" or not math.isfinite(t):
            counts[TOO_LATE] += 1
            return LEFT_OUT
        z = np.array([t, x, y, vx, vy, has_velocity, var_x, var_y, 0.0])
        ahead = v[FIX_AHEAD]
        agrees = counts[HOLDS_FIX] != NOTHING and abs(t - ahead[FIX_TIME]) <= AGREES
        if counts[HOLDS_FIX] == HELD:
            if (ahead == z).all():  # the same message again
                return IGNORED
            if agrees:
                _place_and_count(v, counts, fixes, history, ahead.copy())
            else:
                counts[TIME_JUMPS] += 1
        counts[HOLDS_FIX] = NOTHING
        if _lies_ahead(v, t):
            counts[HOLDS_FIX] = BELIEVED if agrees else HELD
            ahead[:] = z
            if not agrees:
                return IGNORED
        return _place_and_count(v, counts, fixes, history, z)

    return fix


@_cached_plain
def read_state(sources):
    def read(v, mean, covariance):
        """Write the mean (n,) and the covariance (n, n); gives whether the filter is sound. The heading is as it is."""
        sound = sources != "" and v[OK] == 1.0
        n = len(mean)
        for column in range(n):
            mean[column] = v[column]
            sound = sound and math.isfinite(mean[column])
            for row in range(column + 1):
                value = v[P0 + column * (column + 1) // 2 + row]
                covariance[row, column] = covariance[column, row] = value
                sound = sound and math.isfinite(value)
        return sound

    return read


_MEMORY = (float64[::1], int64[::1], *(float64[:, ::1],) * 3)


@cache
def ready():
    """Compile now what a live filter calls, and once: numbers of other types are converted, not compiled for again."""
    signatures = {
        take_sample: (*_MEMORY, *(float64,) * 4),
        take_fix: (*_MEMORY, *(float64,) * 8),
        read_state: (float64[::1], float64[::1], float64[:, ::1]),
    }
    for function, signature in signatures.items():
        if isinstance(function, Dispatcher):  # not with NUMBA_DISABLE_JIT
            function.compile(signature)
            function.disable_compile()
