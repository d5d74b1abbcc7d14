"""A live filter's memory, and what an IMU sample and a fix do to it: one call each, with nothing left to Python.

The filter is the first lane of the rows in `layout`. Each step spreads it over all lanes, which costs less than another
set of kernels would. The memory is five arrays, so that each call takes the same few arguments:

    belief  (N_ALL,) what is believed, which a late fix takes back; then settings, and what is never taken back
    counts  (N_COUNTS,) how much of the other arrays is filled, and what was left out
    window  (2 w, 4) the last IMU samples, to tell calm: t, ax, ay, gz; at least the last w
    fixes   (f, 8) by time; those of one time in the order in which they came
    history (h, N_BELIEF + 5) a ring: the last samples, and the belief before each of them
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math
from functools import cache, partial

import numpy as np
from numba import float64, int64, njit
from numba.core.dispatcher import Dispatcher

from sigmaswarm.drives.standstill import FIX_WINDOW, WINDOW, fixes_stand, is_calm
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
N_BELIEF = N_FILTER + 4
# Behind it, what no late fix takes back. An interval of 0: the filter does not take that constraint.
NOMINAL, START, LEVER_X, LEVER_Y, LATERAL_INTERVAL, STANDSTILL_INTERVAL, LAST_SAMPLE = range(
    N_BELIEF, N_BELIEF + 7
)
FLOOR = slice(N_BELIEF + 7, N_BELIEF + 10)  # how restless the car is when it is calm
FIX_TIME, FIX_X, FIX_Y, FIX_U, FIX_V, HAS_VELOCITY, FIX_VAR_X, FIX_VAR_Y = range(8)
N_FIX = 8
# The last sample and fix that lay too far ahead to be taken at once.
SAMPLE_AHEAD = slice(FLOOR.stop, FLOOR.stop + 4)
FIX_AHEAD = slice(SAMPLE_AHEAD.stop, SAMPLE_AHEAD.stop + N_FIX)
N_ALL = FIX_AHEAD.stop

N_STATES, N_WINDOW, N_FIXES, N_HISTORY, OLDEST = range(5)
HOLDS_SAMPLE, HOLDS_FIX, TOO_LATE, TIME_JUMPS, TOO_FAST = range(5, 10)
N_COUNTS = 10
NOTHING, HELD, BELIEVED = range(3)  # of a fix that lay ahead: it waits for a second one; that one came

LEAP = 10.0
"""s: a sample or fix that is stamped farther ahead of the filter is held back until a second one agrees."""
AGREES = 1.0 + 1e-6
"""s between the two; beside the second, what rounding takes off times that count from 1970."""

S_TIME, S_AX, S_AY, S_GZ, S_CALM = range(N_BELIEF, N_BELIEF + 5)
N_RECORD = N_BELIEF + 5

TAKEN, IGNORED, LEFT_OUT = 1, 0, -1
"""What became of a fix: taken; before the start, there already or held back; too late, or no room."""


def fastest_rate(interval: float) -> int:
    """Hz: the IMU rate up to which standstills are told, of a filter for samples every ``interval`` s."""
    return max(1000, math.ceil(1.5 / interval))


def samples_in_window(rate: int) -> int:
    """How many samples of the last second are kept, with room for jitter."""
    return math.ceil(WINDOW * rate * 9 / 8) + 2


# Bookkeeping has no lanes to vectorize, and must divide as Python does: slots of time are compared with those of a run.
_plain = partial(njit, error_model="numpy", nogil=True)
_cached_plain = partial(cached_by_sources, fastmath=False)


@cached_by_sources
def live_step(sources):
    def step(
        v, n, dt, ax, ay, gz, q_scale, happens, zx, zy, zu, zv, var_x, var_y, lever_x, lever_y, since
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
                w, dt, ax, ay, gz, q_scale, happens, zx, zy, zu, zv, var_x, var_y, lever_x, lever_y, since
            )  # fmt: skip
        else:
            step8(
                w, dt, ax, ay, gz, q_scale, happens, zx, zy, zu, zv, var_x, var_y, lever_x, lever_y, since
            )  # fmt: skip
        for r in range(N_FILTER):
            v[r] = w[r, 0]

    return step


@_plain
def _step_to(v, n, to, ax, ay, gz, happens, zx, zy, zu, zv, var_x, var_y):
    """From where the belief is to a moment."""
    dt = to - v[TIME]
    scale = dt / v[NOMINAL]
    v[SINCE] += scale
    live_step(
        v, n, dt, ax, ay, gz, scale, happens, zx, zy, zu, zv, var_x, var_y, v[LEVER_X], v[LEVER_Y], v[SINCE]
    )  # fmt: skip
    v[TIME] = to


@_plain
def _slot(t, start, interval):
    """Which interval a moment lies in, as `schedule._every` says it; a constraint is absorbed once in each."""
    return math.floor((t - start) / interval + 1e-6)


@_plain
def _take(v, counts, fixes, t, ax, ay, gz, calm):
    """Step through the fixes up to a sample's time, and absorb there what a car on its wheels can't do."""
    n, end = counts[N_STATES], counts[N_FIXES]
    while end > 0 and fixes[end - 1, FIX_TIME] > t:
        end -= 1
    first = end
    while first > 0 and fixes[first - 1, FIX_TIME] > v[TIME]:
        first -= 1
    for f in range(first, end):
        z = fixes[f]
        happens = FIX | VELOCITY if z[HAS_VELOCITY] > 0.0 else FIX
        _step_to(
            v, n, z[FIX_TIME], ax, ay, gz, happens,
            z[FIX_X], z[FIX_Y], z[FIX_U], z[FIX_V], z[FIX_VAR_X], z[FIX_VAR_Y],
        )  # fmt: skip
        v[SINCE] = 0.0
    happens = 0
    if v[LATERAL_INTERVAL] > 0.0 and abs(ay) <= CORNERING:
        slot = _slot(t, v[START], v[LATERAL_INTERVAL])
        if slot != v[LATERAL_SLOT]:
            happens |= LATERAL
            v[LATERAL_SLOT] = slot
    if calm and _stands(fixes, end, t):
        slot = _slot(t, v[START], v[STANDSTILL_INTERVAL])
        if slot != v[STANDSTILL_SLOT]:
            happens |= STANDSTILL
            v[STANDSTILL_SLOT] = slot
    if t > v[TIME] or happens:
        _step_to(v, n, t, ax, ay, gz, happens, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@_plain
def _stands(fixes, end, now):
    """What the fixes of the last seconds, up to row ``end``, say."""
    first = end
    while first > 0 and fixes[first - 1, FIX_TIME] >= now - FIX_WINDOW:
        first -= 1
    return fixes_stand(fixes[first:end], now)


@_plain
def _is_calm(v, counts, window, t, ax, ay, gz):
    most = window.shape[0] // 2
    if counts[N_WINDOW] == 2 * most:  # keep the newer half
        window[:most] = window[most:]
        counts[N_WINDOW] = most
    row = window[counts[N_WINDOW]]
    row[0], row[1], row[2], row[3] = t, ax, ay, gz
    counts[N_WINDOW] += 1
    end = counts[N_WINDOW]
    first = max(0, end - most)
    if first > 0 and window[first - 1, 0] >= t - WINDOW:
        counts[TOO_FAST] += 1
    return is_calm(window[first:end], end - first - 1, v[FLOOR])


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
        if (fixes[same] == z).all():
            return IGNORED
    for f in range(counts[N_FIXES], at, -1):
        fixes[f] = fixes[f - 1]
    fixes[at] = z
    counts[N_FIXES] += 1
    return TAKEN


@_plain
def _go_on(v, counts, window, fixes, history, t, ax, ay, gz):
    """Take an IMU sample whose time is believed."""
    v[LAST_SAMPLE] = t
    calm = v[STANDSTILL_INTERVAL] > 0.0 and _is_calm(v, counts, window, t, ax, ay, gz)
    if t <= v[START]:
        return
    if counts[N_HISTORY] < history.shape[0]:
        counts[N_HISTORY] += 1
    else:
        counts[OLDEST] = (counts[OLDEST] + 1) % history.shape[0]
    record = _record(counts, history, counts[N_HISTORY] - 1)
    record[:N_BELIEF] = v[:N_BELIEF]
    record[S_TIME], record[S_AX], record[S_AY], record[S_GZ] = t, ax, ay, gz
    record[S_CALM] = 1.0 if calm else 0.0
    _take(v, counts, fixes, t, ax, ay, gz, calm)


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
                record[S_CALM] > 0.0,
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
    def sample(v, counts, window, fixes, history, t, ax, ay, gz):
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
            _go_on(v, counts, window, fixes, history, held[0], held[1], held[2], held[3])
        elif holds:
            counts[TIME_JUMPS] += 1
        _go_on(v, counts, window, fixes, history, t, ax, ay, gz)
        if agrees and counts[HOLDS_FIX] == HELD and not _lies_ahead(v, v[FIX_AHEAD][FIX_TIME]):
            counts[HOLDS_FIX] = NOTHING  # the samples say the same
            _place_and_count(v, counts, fixes, history, v[FIX_AHEAD].copy())

    return sample


@_cached_plain
def take_fix(sources):
    def fix(v, counts, window, fixes, history, t, x, y, vx, vy, has_velocity, var_x, var_y):
        """A fix: it waits for its sample, or takes the filter back; one far ahead waits for a second."""
        if sources == "" or not math.isfinite(t):
            counts[TOO_LATE] += 1
            return LEFT_OUT
        z = np.array([t, x, y, vx, vy, has_velocity, var_x, var_y])
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
