"""A live filter's memory, and what an IMU sample and a fix do to it: one call each, with nothing left to Python.

The filter is the first lane of the rows in `layout`. Each step spreads it over all lanes, which costs less than another
set of kernels would. The memory is six arrays, so that each call takes the same few arguments:

    belief  (N_ALL,) what is believed, which a late fix takes back; then settings, and what is never taken back
    counts  (N_COUNTS,) how much of the other arrays is filled, and what was left out
    memory  (N_MEMORY, 8) what tells calm, see `drives.standstill`; of no rows where nothing asks
    fixes   (f, N_FIX) by time; those of one time in the order in which they came; each with what it is
    speeds  (r, 2) readings of the odometer by time, s and m/s; of no rows where the filter takes none
    history (h, N_RECORD) a ring: the last samples, and the belief before each of them

A sample is its time and the IMU's axes in the order of `timeline.AXES`, 0 where the model does not read one. What takes
the filter through steps is compiled for each model: see `live_calls`.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numba import float64, int64, njit
from numba.core.dispatcher import Dispatcher

from sigmaswarm.drives.frozen import FROZEN, kind_of
from sigmaswarm.drives.gaps import gap_of, usual_after
from sigmaswarm.drives.odometer import INTERVAL, SLOW, STALE
from sigmaswarm.drives.standstill import FIX_WINDOW, MEANS, N_STOP, fixes_stand, is_as_it_was, is_calm
from sigmaswarm.drives.timeline import AX, AXES, AY, CORNERING, DT, GAP, N_STEP, Q_SCALE
from sigmaswarm.filters.compiled.lanes import LANES
from sigmaswarm.filters.compiled.layout import CONSTANT_ROWS, N_KEPT, R, state_rows
from sigmaswarm.filters.compiled.rows import new_rows
from sigmaswarm.filters.compiled.run import cached_by_sources
from sigmaswarm.filters.compiled.step import STEPS
from sigmaswarm.filters.compiled.unroll import unrolled
from sigmaswarm.filters.schedule import FIX, LATERAL, ODOMETER, STANDSTILL, VELOCITY

# The belief: state, constants and sums as in `layout`, then when it is, Q's scale since the last fix, the intervals
# in which the constraints and the odometer were absorbed last, and when the latter was.
N_FILTER = N_KEPT
OK = R.OK
TIME, SINCE, LATERAL_SLOT, STANDSTILL_SLOT, ODOMETER_SLOT, ODOMETER_TIME = range(N_FILTER, N_FILTER + 6)
STOP = slice(N_FILTER + 6, N_FILTER + 6 + N_STOP)  # what is remembered of a stop
N_BELIEF = STOP.stop
# Behind it, what no late fix takes back. An interval of 0: the filter does not take that constraint.
N_SAMPLE = 1 + len(AXES)
NOMINAL, START, LATERAL_INTERVAL, STANDSTILL_INTERVAL, AS_RECORDED, USUAL_INTERVAL = range(
    N_BELIEF, N_BELIEF + 6
)
LEVER = slice(N_BELIEF + 6, N_BELIEF + 9)
SAMPLE = slice(LEVER.stop, LEVER.stop + N_SAMPLE)  # the last one
LAST_SAMPLE = SAMPLE.start  # its time
FIX_TIME, FIX_X, FIX_Y, FIX_U, FIX_V, FIX_VAR_X, FIX_VAR_Y, HAS_VELOCITY, KIND = range(9)
FIX_ROW = slice(FIX_X, HAS_VELOCITY)  # a row of `Timeline.fixes`
N_FIX = 9
# The last sample and fix that lay too far ahead to be taken at once; and the one that has just come.
SAMPLE_AHEAD = slice(SAMPLE.stop, SAMPLE.stop + N_SAMPLE)
FIX_AHEAD = slice(SAMPLE_AHEAD.stop, SAMPLE_AHEAD.stop + N_FIX)
NEW_SAMPLE = slice(FIX_AHEAD.stop, FIX_AHEAD.stop + N_SAMPLE)
N_ALL = NEW_SAMPLE.stop

N_FIXES, N_HISTORY, OLDEST, HOLDS_SAMPLE, HOLDS_FIX, TOO_LATE, TIME_JUMPS, N_FROZEN, N_SPEEDS = range(9)
N_COUNTS = 9
NOTHING, HELD, BELIEVED = range(3)  # of a fix that lay ahead: it waits for a second one; that one came

LEAP = 10.0
"""s: a sample or fix that is stamped farther ahead of the filter is held back until a second one agrees."""
AGREES = 1.0 + 1e-6
"""s between the two; beside the second, what rounding takes off times that count from 1970."""

# The step, a row of `Timeline.steps`, that ends at a sample's time; whether the last second was calm, and its means.
S_TIME = N_BELIEF
S_STEP = slice(N_BELIEF + 1, N_BELIEF + 1 + N_STEP)
S_AXES = slice(S_STEP.start + AX, S_STEP.stop)
S_CALM = S_STEP.stop
S_MEANS = slice(S_CALM + 1, S_CALM + 5)
N_RECORD = S_MEANS.stop
_NO_FIX = np.zeros(FIX_ROW.stop - FIX_ROW.start)
_NO_SPEED = np.zeros(3)

TAKEN, IGNORED, LEFT_OUT = 1, 0, -1
"""What became of a fix: taken; before the start, there already or held back; too late, or no room."""


# Bookkeeping has no lanes to vectorize, and must divide as Python does: slots of time are compared with those of a run.
_plain = partial(njit, error_model="numpy", nogil=True)


def _one_step(sources, *, step, kept):
    def live_step(v, u, happens, z, wheels, lever, since):
        """One step of one filter, as in `step`; v (N_FILTER or more,) is its state before and after."""
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        for r in kept:
            for l in range(LANES):
                w[r, l] = v[r]
        step(
            w, (u[0], u[1], u[2], u[3], u[4], u[5], u[6], u[7], u[8]), happens,
            (z[0], z[1], z[2], z[3], z[4], z[5]), (wheels[0], wheels[1], wheels[2]),
            (lever[0], lever[1], lever[2]), since,
        )  # fmt: skip
        for r in kept:
            v[r] = w[r, 0]

    return live_step


def _step_to(v, to, u, happens, z, wheels, *, live_step):
    """From where the belief is to a moment; u (N_STEP,) with the axes and the gap, its length is put in."""
    dt = to - v[TIME]
    scale = dt / v[NOMINAL]
    v[SINCE] += scale
    u[DT], u[Q_SCALE] = dt, scale
    live_step(v, u, happens, z, wheels, v[LEVER], v[SINCE])
    v[TIME] = to


@_plain
def _slot(t, start, interval):
    """Which interval a moment lies in, as `schedule._every` says it; a constraint is absorbed once in each."""
    return math.floor((t - start) / interval + 1e-6)


def _take(v, counts, fixes, speeds, t, u, calm, means, *, step_to):
    """Step through the fixes up to a sample's time, and absorb there what the wheels say and what a car can't do."""
    before = v[TIME]
    end = _seen(counts, fixes, t)
    first = end
    while first > 0 and fixes[first - 1, FIX_TIME] > v[TIME]:
        first -= 1
    for f in range(first, end):
        z = fixes[f]
        if z[KIND] >= FROZEN:
            continue
        happens = FIX | VELOCITY if z[HAS_VELOCITY] > 0.0 else FIX
        step_to(v, z[FIX_TIME], u, happens, z[FIX_ROW], _NO_SPEED)
        v[SINCE] = 0.0
    happens = 0
    if v[LATERAL_INTERVAL] > 0.0 and abs(u[AY]) <= CORNERING:
        slot = _slot(t, v[START], v[LATERAL_INTERVAL])
        if slot != v[LATERAL_SLOT]:
            happens |= LATERAL
            v[LATERAL_SLOT] = slot
    wheels = np.zeros(3)
    if speeds.shape[0] > 0:
        slot = _slot(t, v[START], INTERVAL)
        if slot != v[ODOMETER_SLOT] and _gather(v, counts, speeds, before, t, wheels):
            happens |= ODOMETER
            v[ODOMETER_SLOT], v[ODOMETER_TIME] = slot, t
    if calm and _stands(v, fixes, end, t, means) and not _turn(counts, speeds, t):
        slot = _slot(t, v[START], v[STANDSTILL_INTERVAL])
        if slot != v[STANDSTILL_SLOT]:
            happens |= STANDSTILL
            v[STANDSTILL_SLOT] = slot
    if t > v[TIME] or happens:
        step_to(v, t, u, happens, _NO_FIX, wheels)


@_plain
def _gather(v, counts, speeds, before, t, wheels):
    """Put the readings since the last look together, as `drives.odometer`; False if none came since ``before``."""
    end = counts[N_SPEEDS]
    while end > 0 and speeds[end - 1, 0] > t:
        end -= 1
    oldest = t - INTERVAL
    if end == 0 or speeds[end - 1, 0] <= max(before, oldest):
        return False
    first = end
    while first > 0 and speeds[first - 1, 0] > max(v[ODOMETER_TIME], oldest):
        first -= 1
    total, age, n = 0.0, 0.0, end - first
    for r in range(first, end):
        total += speeds[r, 1]
        age += t - speeds[r, 0]
    wheels[0], wheels[1] = total / n, age / n
    wheels[2] = SLOW * SLOW if abs(wheels[0]) < SLOW else 0.0
    return True


@_plain
def _turn(counts, speeds, t):
    """Whether the wheels turn: the car does not stand then, however calm it is."""
    end = counts[N_SPEEDS] if speeds.shape[0] > 0 else 0
    while end > 0 and speeds[end - 1, 0] > t:
        end -= 1
    return end > 0 and speeds[end - 1, 0] > t - STALE and abs(speeds[end - 1, 1]) >= SLOW


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
def _keep_speed(v, counts, speeds, history, t, speed):
    """Put a reading among the others, by time; where there is no room, without those that nothing needs any more."""
    if counts[N_SPEEDS] == speeds.shape[0]:
        oldest = _record(counts, history, 0)[TIME] if counts[N_HISTORY] > 0 else v[TIME]
        old = 0
        while old < counts[N_SPEEDS] and speeds[old, 0] <= oldest - STALE:
            old += 1
        for r in range(old, counts[N_SPEEDS]):
            speeds[r - old] = speeds[r]
        counts[N_SPEEDS] -= old
        if old == 0:
            return LEFT_OUT
    at = counts[N_SPEEDS]
    while at > 0 and speeds[at - 1, 0] > t:
        at -= 1
    if at > 0 and speeds[at - 1, 0] == t:
        return IGNORED
    for r in range(counts[N_SPEEDS], at, -1):
        speeds[r] = speeds[r - 1]
    speeds[at, 0], speeds[at, 1] = t, speed
    counts[N_SPEEDS] += 1
    return TAKEN


def _go_on(v, counts, memory, fixes, speeds, history, sample, *, take):
    """Take an IMU sample whose time is believed: a gap before it is driven by the mean of the two around it."""
    t, last, gap = sample[0], v[SAMPLE], 0.0
    if last[0] > -math.inf:
        interval = t - last[0]
        if v[AS_RECORDED] == 0.0:
            gap = gap_of(interval, v[USUAL_INTERVAL])
        v[USUAL_INTERVAL] = usual_after(interval, v[USUAL_INTERVAL])
    calm, means = False, np.zeros(4)
    if v[STANDSTILL_INTERVAL] > 0.0:
        calm = is_calm(memory, t, sample[1], sample[2], sample[3])
        means[:] = memory[MEANS, :4]
    if t <= v[START]:
        last[:] = sample
        if calm:  # a stop may have begun before
            _stands(v, fixes, _seen(counts, fixes, t), t, means)
        return
    if counts[N_HISTORY] < history.shape[0]:
        counts[N_HISTORY] += 1
    else:
        counts[OLDEST] = (counts[OLDEST] + 1) % history.shape[0]
    record = _record(counts, history, counts[N_HISTORY] - 1)
    record[:N_BELIEF] = v[:N_BELIEF]
    record[S_TIME], record[S_STEP][GAP] = t, gap
    record[S_AXES] = sample[1:]
    if gap > 0.0:
        for axis in range(len(AXES)):
            record[S_AXES][axis] = 0.5 * (last[1 + axis] + sample[1 + axis])
    record[S_CALM], record[S_MEANS] = 1.0 if calm else 0.0, means
    last[:] = sample
    take(v, counts, fixes, speeds, t, record[S_STEP], calm, means)


@_plain
def _first_after(counts, history, t):
    """The first of the kept samples that is not before a time, or -1 if the filter can't go back to before it."""
    back = counts[N_HISTORY]
    while back > 0 and _record(counts, history, back - 1)[S_TIME] >= t:
        back -= 1
    if back == counts[N_HISTORY] or _record(counts, history, back)[TIME] >= t:
        return -1
    return back


def _again_from(v, counts, fixes, speeds, history, back, *, take):
    """Back to before a kept sample, and forward again."""
    v[:N_BELIEF] = _record(counts, history, back)[:N_BELIEF]
    for again in range(back, counts[N_HISTORY]):
        record = _record(counts, history, again)
        record[:N_BELIEF] = v[:N_BELIEF]
        take(v, counts, fixes, speeds, record[S_TIME], record[S_STEP], record[S_CALM] > 0.0, record[S_MEANS])


def _place(v, counts, fixes, speeds, history, z, *, again_from):
    """Take a fix whose time is believed: it waits for its sample, or takes the filter back and forward again."""
    t = z[FIX_TIME]
    if t <= v[START]:  # absorbed already, but it may show a standstill
        _keep(v, counts, fixes, history, z)
        return IGNORED
    if t > v[TIME]:
        return _keep(v, counts, fixes, history, z)
    back = _first_after(counts, history, t)
    if back < 0:
        return LEFT_OUT
    kept = _keep(v, counts, fixes, history, z)
    if kept == TAKEN:
        again_from(v, counts, fixes, speeds, history, back)
    return kept


def _place_and_count(v, counts, fixes, speeds, history, z, *, place):
    kept = place(v, counts, fixes, speeds, history, z)
    if kept == LEFT_OUT:
        counts[TOO_LATE] += 1
    return kept


def _take_sample(sources, *, go_on, place_and_count):
    def sample(v, counts, memory, fixes, speeds, history, t, ax, ay, gz, az, gx, gy):
        """An IMU sample; one that is not after the last one is left out, one far ahead waits for a second."""
        if sources == "" or not v[LAST_SAMPLE] < t < math.inf:
            return
        new, held = v[NEW_SAMPLE], v[SAMPLE_AHEAD]
        new[0], new[1], new[2], new[3], new[4], new[5], new[6] = t, ax, ay, gz, az, gx, gy
        holds = counts[HOLDS_SAMPLE] > 0
        ahead = _lies_ahead(v, t)
        agrees = ahead and holds and 0.0 < t - held[0] <= AGREES
        if ahead and not agrees:
            if not holds or t != held[0]:  # not the same again
                counts[TIME_JUMPS] += counts[HOLDS_SAMPLE]
                counts[HOLDS_SAMPLE] = 1
                held[:] = new
            return
        counts[HOLDS_SAMPLE] = 0
        if agrees:
            go_on(v, counts, memory, fixes, speeds, history, held)
        elif holds:
            counts[TIME_JUMPS] += 1
        go_on(v, counts, memory, fixes, speeds, history, new)
        if agrees and counts[HOLDS_FIX] == HELD and not _lies_ahead(v, v[FIX_AHEAD][FIX_TIME]):
            counts[HOLDS_FIX] = NOTHING  # the samples say the same
            place_and_count(v, counts, fixes, speeds, history, v[FIX_AHEAD].copy())

    return sample


def _take_fix(sources, *, place_and_count):
    def fix(v, counts, memory, fixes, speeds, history, t, x, y, vx, vy, has_velocity, var_x, var_y):
        """A fix: it waits for its sample, or takes the filter back; one far ahead waits for a second."""
        if sources == "" or not math.isfinite(t):
            counts[TOO_LATE] += 1
            return LEFT_OUT
        z = np.array([t, x, y, vx, vy, var_x, var_y, has_velocity, 0.0])
        ahead = v[FIX_AHEAD]
        agrees = counts[HOLDS_FIX] != NOTHING and abs(t - ahead[FIX_TIME]) <= AGREES
        if counts[HOLDS_FIX] == HELD:
            if (ahead == z).all():  # the same message again
                return IGNORED
            if agrees:
                place_and_count(v, counts, fixes, speeds, history, ahead.copy())
            else:
                counts[TIME_JUMPS] += 1
        counts[HOLDS_FIX] = NOTHING
        if _lies_ahead(v, t):
            counts[HOLDS_FIX] = BELIEVED if agrees else HELD
            ahead[:] = z
            if not agrees:
                return IGNORED
        return place_and_count(v, counts, fixes, speeds, history, z)

    return fix


def _take_speed(sources, *, again_from):
    def speed(v, counts, memory, fixes, speeds, history, t, value):
        """A reading of the odometer: it waits for its sample, or takes the filter back; none is held back."""
        if sources == "" or speeds.shape[0] == 0:
            return IGNORED
        if not (math.isfinite(t) and math.isfinite(value)):
            counts[TOO_LATE] += 1
            return LEFT_OUT
        if _lies_ahead(v, t):
            counts[TIME_JUMPS] += 1
            return LEFT_OUT
        begun = t > v[START]
        back = _first_after(counts, history, t) if begun and t <= v[TIME] else 0
        kept = LEFT_OUT if back < 0 else _keep_speed(v, counts, speeds, history, t, value)
        if kept == LEFT_OUT:
            counts[TOO_LATE] += 1
        elif kept == TAKEN and begun and t <= v[TIME]:
            again_from(v, counts, fixes, speeds, history, back)
        return kept

    return speed


_MEMORY = (float64[::1], int64[::1], *(float64[:, ::1],) * 4)


@dataclass(frozen=True)
class LiveCalls:
    """What is done with the memory of a live filter of one model.

    Attributes
    ----------
    step : ``(v, u, happens, z, wheels, lever, since)``, one step as in `step`; v (N_FILTER or more,) is the filter
    sample : ``(*memory, t, ax, ay, gz, az, gx, gy)``, an IMU sample
    fix : ``(*memory, t, x, y, vx, vy, has_velocity, var_x, var_y)``, a fix; what became of it
    speed : ``(*memory, t, speed)``, a reading of the odometer; what became of it
    """

    step: Any
    sample: Any
    fix: Any
    speed: Any


@cache
def live_calls(model):
    """Compiled now, and once: numbers of other types are converted, not compiled for again."""
    kept = np.array([*state_rows(model), *range(CONSTANT_ROWS.start, N_KEPT)])
    plain = partial(cached_by_sources, model=model, fastmath=False)
    live_step = cached_by_sources(unrolled(_one_step, step=STEPS[model], kept=kept), model)
    take = _bound(_take, step_to=_bound(_step_to, live_step=live_step))
    again_from = _bound(_again_from, take=take)
    place_and_count = _bound(_place_and_count, place=_bound(_place, again_from=again_from))
    go_on = _bound(_go_on, take=take)
    sample = plain(unrolled(_take_sample, go_on=go_on, place_and_count=place_and_count))
    fix = plain(unrolled(_take_fix, place_and_count=place_and_count))
    speed = plain(unrolled(_take_speed, again_from=again_from))
    for function, numbers in ((sample, 7), (fix, 8), (speed, 2)):
        signature = (*_MEMORY, *(float64,) * numbers)
        if isinstance(function, Dispatcher):  # not with NUMBA_DISABLE_JIT
            function.compile(signature)
            function.disable_compile()
    return LiveCalls(live_step, sample, fix, speed)


def _bound(function, **known):
    return _plain(unrolled(function, **known))
