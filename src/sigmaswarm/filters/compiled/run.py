"""The compiled run: LANES filters over one time line, with scores along the way."""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import hashlib
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.compilation import cached
from sigmaswarm.drives import standstill, timeline
from sigmaswarm.filters.compiled.lanes import *
from sigmaswarm.filters.compiled.measurements import absorbers
from sigmaswarm.filters.compiled.planar5 import predict_planar5
from sigmaswarm.filters.compiled.planar8 import predict_planar8
from sigmaswarm.filters.compiled.rows import new_rows
from sigmaswarm.filters.compiled.unroll import unrolled

Array = NDArray[np.float64]

# Columns of a step, and its flags: what happens at its end.
DT, AX, AY, GZ, Q_SCALE = range(5)
FIX = 1  # a fix is absorbed
IMU = 2  # it is an IMU sample's time: estimates are recorded and scored
VELOCITY = 4  # the fix has a velocity
LATERAL = 8  # the car's lateral velocity is constrained
STANDSTILL = 16  # the car stands
HIDDEN = 32  # a fix is there, but not for the filter: its forecast is scored

# Columns of a target: a moment of truth inside an IMU interval.
WEIGHT, TRUE_X, TRUE_Y, TRUE_THETA, SCORES_HEADING = range(5)

# Where a run goes on that is made in pieces: the next step, fix and target, and Q's scale since the last fix.
NEXT_STEP, NEXT_FIX, NEXT_TARGET, SINCE = range(4)

_TWO_PI = 2 * math.pi
_DETERMINANTS_PER_LOG = 8  # their product stays far inside the range of a double


@kernel
def _take_logarithm(w):
    """Move the product of the last det S into the sum of their logarithms (a slow call: once in a while)."""
    for l in range(LANES):
        w[LOG_DET, l] += math.log(w[DET, l])
        w[DET, l] = 1.0


@kernel
def _score(w, weight, true_x, true_y, true_theta, scores_heading):
    """Add the squared errors at a moment of truth, and the position's NEES.

    The estimate is linear between two IMU samples; the covariance is that at the later one.
    """
    for l in range(LANES):
        x = w[BEFORE_X, l] + weight * (w[X, l] - w[BEFORE_X, l]) - true_x
        y = w[BEFORE_Y, l] + weight * (w[Y, l] - w[BEFORE_Y, l]) - true_y
        turn = w[T, l] - w[BEFORE_T, l]
        turn -= _TWO_PI * np.floor(turn / _TWO_PI + 0.5)
        wrong = w[BEFORE_T, l] + weight * turn - true_theta
        wrong -= _TWO_PI * np.floor(wrong / _TWO_PI + 0.5)
        w[SQ_POSITION, l] += x * x + y * y
        w[SQ_HEADING, l] += scores_heading * wrong * wrong
        xx, xy, yy = w[XX, l], w[XY, l], w[YY, l]
        w[NEES, l] += (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)


def _run(
    w, steps, flags, fixes, lever, targets, target_end, place, stop, record, innovations,
    *, predict, absorb_fix, forecast_fix, absorb_velocity, absorb_lateral, absorb_standstill,
):  # fmt: skip
    """The steps from a place to a stop; w holds what the filters are and remember, before and after."""
    n_fixes = int(place[NEXT_FIX])
    n_targets = int(place[NEXT_TARGET])
    n_recorded = 0
    since = place[SINCE]
    interval_starts = True
    for step in range(int(place[NEXT_STEP]), stop):
        if interval_starts:
            for l in range(LANES):
                w[BEFORE_X, l] = w[X, l]
                w[BEFORE_Y, l] = w[Y, l]
                w[BEFORE_T, l] = w[T, l]
        u = steps[step]
        predict(w, u[DT], u[AX], u[AY], u[GZ], u[Q_SCALE])
        since += u[Q_SCALE]
        happens = flags[step]
        if happens & FIX:
            z = fixes[n_fixes]
            absorb_fix(w, z[0], z[1], lever[0], lever[1], since)
            since = 0.0
        if happens & HIDDEN:
            z = fixes[n_fixes]
            forecast_fix(w, z[0], z[1], lever[0], lever[1])
        if happens & (FIX | HIDDEN):
            if innovations.shape[0] > 0:
                for r in range(5):
                    innovations[n_fixes, r] = w[(N1, N2, V11, V12, V22)[r], 0]
            if happens & VELOCITY:
                absorb_velocity(w, z[2], z[3])
            n_fixes += 1
            if n_fixes % _DETERMINANTS_PER_LOG == 0:
                _take_logarithm(w)
        if happens & LATERAL:
            absorb_lateral(w, u[GZ])
        if happens & STANDSTILL:
            absorb_standstill(w, u[GZ])
        interval_starts = (happens & IMU) != 0
        while n_targets < target_end[step]:
            t = targets[n_targets]
            _score(w, t[WEIGHT], t[TRUE_X], t[TRUE_Y], t[TRUE_THETA], t[SCORES_HEADING])
            n_targets += 1
        if interval_starts and record.shape[0] > 0:
            for l in range(record.shape[2]):
                for r in range(N_STATE):
                    record[n_recorded, r, l] = w[r, l]
                record[n_recorded, N_STATE, l] = w[OK, l]
            n_recorded += 1
    if stop == steps.shape[0]:
        _take_logarithm(w)
    place[NEXT_STEP], place[NEXT_FIX], place[NEXT_TARGET], place[SINCE] = stop, n_fixes, n_targets, since


_run5 = kernel(unrolled(_run, predict=predict_planar5, **absorbers(5)))
_run8 = kernel(unrolled(_run, predict=predict_planar8, **absorbers(8)))


@kernel
def _load(w, rows):
    for l in range(LANES):
        for r in range(N_ROWS):
            w[r, l] = 0.0
        for r in range(N_KEPT):
            w[r, l] = rows[r, l]


@kernel
def _store(w, rows):
    for l in range(LANES):
        for r in range(N_KEPT):
            rows[r, l] = w[r, l]


def cached_by_sources(make, **options):
    """Compile the kernel that ``make(sources)`` gives, cached under a key that holds a hash of all kernels' sources.

    Numba keeps machine code in a cache, and would not notice that a function in another file has changed; but what a
    function closes over is part of its key.
    """
    frozen = standstill, timeline  # what kernels take from elsewhere
    files = [*sorted(Path(__file__).parent.glob("*.py")), *(Path(str(module.__file__)) for module in frozen)]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    return kernel(make(digest), cached, **({"forceinline": False} | options))


@cached_by_sources
def _run_planar5(sources):
    def run_planar5(steps, flags, fixes, lever, targets, target_end, rows, place, stop, record, innovations):
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        _load(w, rows)
        _run5(w, steps, flags, fixes, lever, targets, target_end, place, stop, record, innovations)
        _store(w, rows)

    return run_planar5


@cached_by_sources
def _run_planar8(sources):
    def run_planar8(steps, flags, fixes, lever, targets, target_end, rows, place, stop, record, innovations):
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        _load(w, rows)
        _run8(w, steps, flags, fixes, lever, targets, target_end, place, stop, record, innovations)
        _store(w, rows)

    return run_planar8


KERNELS = {5: _run_planar5, 8: _run_planar8}
"""By number of states."""


def run_lanes(
    n: int,
    steps: Array,
    flags: NDArray[np.int64],
    fixes: Array,
    lever: Array,
    targets: Array,
    target_end: NDArray[np.int64],
    rows: Array,
    place: Array,
    stop: int,
    record: Array,
    innovations: Array,
) -> None:
    """Run LANES filters over some steps of one time line, from where the last call has left them.

    Runs in pieces give the bits of the whole run, if each piece but the last stops after a step that has IMU.

    Parameters
    ----------
    n : 5 or 8, states of the model
    steps : (k, 5) dt (s), ax, ay (m/s2), gz (rad/s), and the scale of Q, of each step
    flags : (k,) bits of each step, FIX ... STANDSTILL
    fixes : (f, 4) m east, north, m/s east, north, in the order in which steps absorb them
    lever : (2,) m forward and left from the IMU to the antenna
    targets : (m, 5) see WEIGHT ... SCORES_HEADING
    target_end : (k,) how many targets lie before the end of each step (constant where flags lack IMU)
    rows : (N_KEPT, LANES), changed: state, constants and sums of each lane, and what it remembers
    place : (4,), changed: see NEXT_STEP ... SINCE; zeros at the start
    stop : the step before which to stop; at k, sums are complete
    record : (r, N_STATE + 1, m), written from its start: state and OK flag of the first m lanes at each IMU sample of
        these steps; r = 0: none
    innovations : (f, 5), written: nu (m) and S (m2; xx, xy, yy) of the first lane at each fix of these steps, before it
        is absorbed; of no rows: none
    """
    arrays = steps, flags, fixes, lever, targets, target_end, rows, place, stop
    KERNELS[n](*arrays, record, innovations)
