"""Compiled run of up to `most_lanes` filters over one timeline, with scores."""

import hashlib
import math
import re
from functools import cache, partial
from pathlib import Path
from types import FunctionType

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.compilation import FunctionRecipe, cached, call_once
from sigmaswarm.drives import alignment, gaps, odometer, stale_fixes, standstill, timeline
from sigmaswarm.drives import events as drive_events
from sigmaswarm.drives.events import FIX, HIDDEN, IMU, ODOMETER
from sigmaswarm.drives.timeline import Q_SCALE
from sigmaswarm.filters import constants, kernels, models, tilted
from sigmaswarm.filters.compiled.lanes import OPTIONS, exchange_control, kernel
from sigmaswarm.filters.compiled.layout import LANES, N_KEPT, N_ROWS, R, state_rows
from sigmaswarm.filters.compiled.memory import new_rows
from sigmaswarm.filters.compiled.step import step_of
from sigmaswarm.filters.compiled.transition import logged_rows
from sigmaswarm.filters.compiled.unroll import unrolled
from sigmaswarm.filters.kernels import FILTERS

# Cursor of a run in pieces: the next step, fix and target, nominal steps since the last fix, the next wheel speed.
NEXT_STEP, NEXT_FIX, NEXT_TARGET, SINCE, NEXT_SPEED = range(5)
BRANCH, RETURN = 512, 1024
"""Bits of a step's flags, in addition to those of `drives.events`: see `passes.FilterPass`.

Before a step with the bit BRANCH, the filters are copied. Before a step with the bit RETURN, the copies replace them,
except for the sums of branches. A step may have both bits; then the filters first return.
"""
NO_RECORD, NO_INNOVATIONS = np.empty((0, 0, 0)), np.empty((0, 5))


def readonly(column: Array) -> Array:
    """Return a contiguous read-only array; kernels are compiled for this type."""
    view = np.ascontiguousarray(column).view()
    view.flags.writeable = False
    return view


TargetColumns = tuple[Array, Array, Array, Array, NDArray[np.bool_], Array]  # see `passes.Targets.columns`
_NOTHING, NO_DEVIATIONS = readonly(np.empty(0)), readonly(np.empty((0, 4)))
NO_TARGETS: TargetColumns = _NOTHING, _NOTHING, _NOTHING, _NOTHING, np.empty(0, dtype=np.bool_), NO_DEVIATIONS
DriveArrays = tuple[
    *tuple[Array, NDArray[np.int32], Array, NDArray[np.uint16]],
    *tuple[Array, Array, Array, TargetColumns, NDArray[np.int32]],
]
"""k steps of a drive, its fixes and its targets (times at which errors are scored), in the arrays that a kernel reads:

- steps (k, 3) as `Timeline.steps`
- sample (k,), the row of ``driving`` of each step
- driving (n, 3 or 6) as `Timeline.driving`, with all axes that the model reads
- flags (k,), bits of each step: see `drives.events`
- fixes (f, 8) as `Timeline.fixes`, in the order of their updates
- wheels (o, 3) as `drives.events.Events.wheels`
- lever (3,), m forward, left and up from the IMU to the antenna
- targets, columns (m,) as `Targets.columns`
- target_end (k,), number of targets before the end of each step; it increases only at steps with the flag IMU
"""


def new_cursor() -> Array:
    return np.zeros(5)


_TWO_PI = 2 * math.pi
_DETERMINANTS_PER_LOG = 8  # determinants per logarithm; a double can contain their product


@njit(**OPTIONS)
def _keep_copy(w, kept):
    """Copy the filters ``w`` to ``kept``, (N_KEPT, columns), and begin the sum of a branch's position errors."""
    _store(w, kept)
    for first in range(0, w.shape[1], LANES):
        for lane in range(LANES):
            w[first // LANES * N_ROWS + R.SQ_POSITION, lane] = 0.0


@njit(**OPTIONS)
def _return(w, kept):
    """Replace the filters ``w`` at the end of a branch by their copies, and keep the sums of the branch."""
    for first in range(0, kept.shape[1], LANES):
        below = first // LANES * N_ROWS
        for lane in range(first, min(first + LANES, kept.shape[1])):
            l = lane - first
            kept[R.SQ_BRANCH, lane] += w[below + R.SQ_POSITION, l]
            kept[R.SQ_FORECAST, lane] = w[below + R.SQ_FORECAST, l]
            kept[R.FORECAST_T, lane] = w[below + R.FORECAST_T, l]
            kept[R.OK, lane] = min(kept[R.OK, lane], w[below + R.OK, l])
            w[below + R.SIN_COS_VALID_ALL, l] = 0.0
        for r in range(N_KEPT):
            for lane in range(first, min(first + LANES, kept.shape[1])):
                w[below + r, lane - first] = kept[r, lane]


@kernel
def _take_logarithm(w):
    """Add the logarithms of the products DET and TAIL over the last fixes to the sums, and reset the products."""
    for l in range(LANES):
        w.LOG_DET += math.log(w.DET)
        w.LOG_TAIL += math.log(w.TAIL)
        w.DET, w.TAIL = 1.0, 1.0


def _wrapped(angle):
    return angle - _TWO_PI * np.floor(angle / _TWO_PI + 0.5)


@kernel
def _off_between(w, l, weight, true_x, true_y, true_theta, heading):
    """Interpolate the estimate linearly between two IMU samples. Return its errors in x, y and heading."""
    x = w.BEFORE_X + weight * (w.X - w.BEFORE_X) - true_x
    y = w.BEFORE_Y + weight * (w.Y - w.BEFORE_Y) - true_y
    turn = _wrapped(w[heading] - w.BEFORE_T)
    return x, y, _wrapped(w.BEFORE_T + weight * turn - true_theta)


@kernel
def _add(w, l, x, y, wrong, scores_heading):
    w.SQ_POSITION += x * x + y * y
    w.SQ_HEADING += scores_heading * wrong * wrong
    xx, xy, yy = w.XX, w.XY, w.YY
    w.NEES += (x * (yy * x - xy * y) + y * (xx * y - xy * x)) / (xx * yy - xy * xy)


def _score(w, weight, true_x, true_y, true_theta, scores_heading, *, heading):
    """Add the squared errors at a time of truth to the sums, and the position's NEES with P at the later IMU sample."""
    for l in range(LANES):
        x, y, wrong = _off_between(w, l, weight, true_x, true_y, true_theta, heading)
        _add(w, l, x, y, wrong, scores_heading)


def _score_there(w, true_x, true_y, true_theta, scores_heading, *, heading):
    for l in range(LANES):
        x, y, wrong = w.X - true_x, w.Y - true_y, _wrapped(w[heading] - true_theta)
        _add(w, l, x, y, wrong, scores_heading)


def _score_by_deviation(
    w, weight, true_x, true_y, true_theta, scores_heading, counts, heading_counts, var_x, var_y, *, heading
):
    """Like `_score`, for truth with a variance: weight the squared errors, and add the variance to P in the NEES.

    This is a separate function, since `_score` would round differently with weights of 1.
    """
    for l in range(LANES):
        x, y, wrong = _off_between(w, l, weight, true_x, true_y, true_theta, heading)
        w.SQ_POSITION += counts * (x * x + y * y)
        w.SQ_HEADING += scores_heading * heading_counts * wrong * wrong
        xx, xy, yy = w.XX + var_x, w.XY, w.YY + var_y
        w.NEES += (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)


def _run(
    w,
    drive,
    cursor,
    stop,
    record,
    innovations,
    *,
    step,
    state,
    n_axes,
    heading,
    score,
    score_there,
    score_by_deviation,
):
    """Run the filters ``w`` from step ``cursor[NEXT_STEP]`` up to ``stop``, and update ``w`` and ``cursor``.

    ``state`` contains the recorded rows, and ``heading`` is the row of the scored heading. The numbers of a step and of
    a fix are passed to the kernel ``step`` as tuples, since Numba would count references for array slices at each step.
    """
    steps, sample, driving, flags, fixes, speeds, lever, targets, target_end = drive
    z, arm = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), tuple(lever[k] for k in range(3))
    wheels = (0.0, 0.0, 0.0)
    n_speeds = int(cursor[NEXT_SPEED])
    n_fixes = int(cursor[NEXT_FIX])
    n_targets = int(cursor[NEXT_TARGET])
    n_recorded = 0
    n_products = n_fixes  # number of factors of DET and TAIL, also those before the last logarithm
    since = cursor[SINCE]
    kept, kept_since, kept_products = np.empty((N_KEPT, w.shape[1])), since, n_products
    interval_starts = True
    weight, true_x, true_y, true_theta, scores_heading, deviations = targets
    for s in range(int(cursor[NEXT_STEP]), stop):
        events = int(flags[s])
        if events & RETURN:
            _return(w, kept)
            since, n_products, interval_starts = kept_since, kept_products, True
        if events & BRANCH:
            _keep_copy(w, kept)
            kept_since, kept_products = since, n_products
        if (
            interval_starts
            and n_targets < len(weight)
            and (weight[n_targets] != 1.0 or deviations.shape[0] > 0)
        ):
            for l in range(LANES):
                w.BEFORE_X = w.X
                w.BEFORE_Y = w.Y
                w.BEFORE_T = w[heading]
        m = sample[s]
        u = tuple(steps[s, k] for k in range(3)) + tuple(driving[m, k] for k in range(n_axes))
        since += u[Q_SCALE]
        if events & (FIX | HIDDEN):
            z = tuple(fixes[n_fixes, k] for k in range(8))
        if events & ODOMETER:
            wheels = tuple(speeds[n_speeds, k] for k in range(3))
            n_speeds += 1
        step(w, u, events, z, wheels, arm, since)
        if events & FIX:
            since = 0.0
        if events & (FIX | HIDDEN):
            if innovations.shape[0] > 0:
                for r in range(5):
                    innovations[n_fixes, r] = w[(R.NU1, R.NU2, R.V11, R.V12, R.V22)[r], 0]
            n_fixes += 1
            n_products += 1
            if n_products % _DETERMINANTS_PER_LOG == 0:
                _take_logarithm(w)
        interval_starts = (events & IMU) != 0
        while n_targets < target_end[s]:
            t = n_targets
            if deviations.shape[0] == 0:
                counts = 1.0 if scores_heading[t] else 0.0
                if weight[t] == 1.0:
                    score_there(w, true_x[t], true_y[t], true_theta[t], counts)
                else:
                    score(w, weight[t], true_x[t], true_y[t], true_theta[t], counts)
            else:
                score_by_deviation(
                    w, weight[t], true_x[t], true_y[t], true_theta[t], 1.0 if scores_heading[t] else 0.0,
                    deviations[t, 0], deviations[t, 1], deviations[t, 2], deviations[t, 3],
                )  # fmt: skip
            n_targets += 1
        if interval_starts and record.shape[0] > 0:
            for l in range(record.shape[2]):
                for r in range(len(state)):
                    record[n_recorded, r, l] = w[state[r]]
                record[n_recorded, len(state), l] = w.OK
            n_recorded += 1
    if stop == steps.shape[0]:
        _take_logarithm(w)
    cursor[NEXT_STEP], cursor[NEXT_FIX], cursor[NEXT_TARGET], cursor[SINCE] = stop, n_fixes, n_targets, since
    cursor[NEXT_SPEED] = n_speeds


@njit(**OPTIONS)
def _load(w, rows):
    for first in range(0, w.shape[1], LANES):
        below = first // LANES * N_ROWS
        for r in range(N_KEPT):
            for lane in range(first, min(first + LANES, w.shape[1])):
                w[below + r, lane - first] = rows[r, lane % rows.shape[1]]  # uncompiled, w has more lanes
        for r in range(N_KEPT, N_ROWS):
            for lane in range(first, min(first + LANES, w.shape[1])):
                w[below + r, lane - first] = 0.0


@njit(**OPTIONS)
def _store(w, rows):
    for first in range(0, rows.shape[1], LANES):
        below = first // LANES * N_ROWS
        for r in range(N_KEPT):
            for lane in range(first, min(first + LANES, rows.shape[1])):
                rows[r, lane] = w[below + r, lane - first]


_ELSEWHERE = (
    alignment,
    constants,
    drive_events,
    stale_fixes,
    gaps,
    odometer,
    standstill,
    timeline,
    models,
    kernels,
    tilted,
)


@cache
def _digest():
    files = [
        *sorted(Path(__file__).parent.glob("*.py")),
        *(Path(str(module.__file__)) for module in _ELSEWHERE),
    ]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


def named_by_sources(function, name, known=None):
    """Return the `FunctionRecipe` of a function; its key in Numba's cache contains a hash of all kernels' sources.

    Numba's own key does not depend on the called functions, which are in other files or bound by `unrolled`. ``known``
    returns the values of the keyword-only parameters, which are needed only for compilation.
    """

    def named(function):
        function.__qualname__ += "_" + re.sub(r"\W+", "_", name)  # see `unroll._hash_of`
        return function

    like = named(FunctionType(function.__code__.replace(co_kwonlyargcount=0), function.__globals__))
    make = (lambda: named(unrolled(function, **known()))) if known else lambda: like
    return FunctionRecipe(like, f"{name} {_digest()}", make)


def cached_by_sources(function, name, known=None):
    return cached(named_by_sources(function, name, known), **OPTIONS)


def _run_model(drive, rows, cursor, stop, record, innovations, *, steps_to):
    control = exchange_control(-1)
    w = new_rows(rows.shape[1])
    _load(w, rows)
    steps_to(w, drive, cursor, stop, record, innovations)
    _store(w, rows)
    exchange_control(control)


def _kernel_of(model, step, rows, name):
    described = FILTERS[model]
    heading = R.HEADING if described.tilts else R.T

    def known():
        steps_to = kernel(
            _run, step=step(), state=rows, n_axes=len(described.imu), heading=heading,
            score=kernel(_score, heading=heading), score_there=kernel(_score_there, heading=heading),
            score_by_deviation=kernel(_score_by_deviation, heading=heading),
        )  # fmt: skip
        return {"steps_to": steps_to}

    return cached_by_sources(_run_model, name, known)


@call_once
def run_kernel(model):
    return _kernel_of(model, partial(step_of, model), state_rows(model), model)


@call_once
def logging_kernel(model):
    """Return a kernel that records `transition.logged_rows` after each step with the flag IMU."""
    return _kernel_of(model, partial(step_of, model, noted=True), logged_rows(model), f"{model}, logged")


def run_lanes(
    model: str, drive: DriveArrays, rows: Array, cursor: Array, stop: int, record: Array, innovations: Array
) -> None:
    """Run up to `most_lanes` filters over steps of one timeline, from the step at which the last call stopped.

    A run in pieces has the same results as one call if each piece, except the last, ends after a step with the flag
    IMU.

    Parameters
    ----------
    model : name of the model
    drive : DriveArrays
    rows : (N_KEPT, a multiple of WIDEST), changed: state, constants and sums of each lane
    cursor : (5,), changed: see NEXT_STEP ... NEXT_SPEED
    stop : the step before which the run stops; the sums are complete if ``stop`` is k, the number of steps
    record : (r, s + 1, m), written from index 0 on: at each IMU sample of these steps, the model's s `state_rows` and
        the OK flag of the first m lanes, at most LANES; r = 0: none
    innovations : (f, 5), written: nu (m) and S (m2; xx, xy, yy) of the first lane at each fix of these steps, before
        the update; f = 0: none
    """
    run_kernel(model)(drive, rows, cursor, stop, record, innovations)
