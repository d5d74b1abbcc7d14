"""A step of a filter bank: LANES filters of one model at once, and the evidence of each filter.

This step replaces the `single_step` of a live filter. The live filter is the first lane of the bank. All lanes are
stored after the state of the live filter (`live.BEHIND`), so that they also return to an earlier state for a late fix:

    NUMBERS   numbers of the bank; evidence of all lanes, then log-prior penalties, then weights
    ROWS      (N_KEPT, LANES) the lanes, as in `layout`; the checkpoints of a live filter end here
    SCRATCH   (N_ROWS - N_KEPT, LANES)
    STEP_LOG  ring buffer of the last steps, N_LOG_ROW numbers each, for `bank.search`

The evidence of a lane is the Gaussian log-likelihood of the fixes, with limited NIS; old fixes lose weight with time.
The weight of a lane is exp(EVIDENCE_COUNTS evidence - penalty), normalized.
"""

import math

from llvmlite import ir
from numba import float64, njit, types
from numba.core import cgutils, config
from numba.extending import intrinsic

from sigmaswarm.compilation import address_of, call_once
from sigmaswarm.drives.events import FIX
from sigmaswarm.drives.timeline import DT
from sigmaswarm.filters.compiled.lanes import OPTIONS, exchange_control
from sigmaswarm.filters.compiled.layout import CONSTANT_ROWS, LANES, N_KEPT, N_ROWS, P0, R, state_rows
from sigmaswarm.filters.compiled.live import BEHIND, DIMENSION, FACTOR, TIME, is_definite
from sigmaswarm.filters.compiled.memory import array_at
from sigmaswarm.filters.compiled.run import named_by_sources
from sigmaswarm.filters.compiled.single import SIGNATURE, SingleStep
from sigmaswarm.filters.compiled.step import step_of

EVIDENCE_LASTS = 60.0  # s, time constant of the decay of evidence
LARGEST_NIS = 200.0
"""Upper limit of a fix's NIS in the evidence, so that no single fix dominates the weights.

Student's t would give too much weight to a lane with a small R, since fixes between tall buildings seem accurate until
they jump.
"""
EVIDENCE_COUNTS = 0.1  # weight of the evidence: errors of fixes are correlated, so ten fixes count as one

# Indices from BEHIND on: number of logged steps, and capacity of the log; time of the last fix, and number of fixes; nu
# and S of the mixture at the last fix.
LOGGED, LOG_LENGTH, FIXED_AT, N_FIXED, NU_X, NU_Y, S_XX, S_XY, S_YY = range(9)
EVIDENCE = slice(16, 16 + LANES)
PENALTY = slice(EVIDENCE.stop, EVIDENCE.stop + LANES)
WEIGHT = slice(PENALTY.stop, PENALTY.stop + LANES)
NUMBERS = WEIGHT.stop
ROWS = slice(NUMBERS, NUMBERS + N_KEPT * LANES)
N_CHECKPOINT = ROWS.stop  # number of values in a checkpoint
STEP_LOG = NUMBERS + N_ROWS * LANES

# A logged step: DT ... GY, flags, rows of `Timeline.fixes` and `Events.wheels`, the time since the last fix in nominal
# steps, and the end time of the step, s.
T_STEP, T_FLAGS, T_FIX, T_WHEELS, T_SINCE, T_TIME = slice(0, 9), 9, slice(10, 18), slice(18, 21), 21, 22
N_LOG_ROW = 23

_AT_EVIDENCE, _AT_PENALTY, _AT_WEIGHT = (BEHIND + part.start for part in (EVIDENCE, PENALTY, WEIGHT))


@intrinsic
def _rows_behind(typing_context, v):
    kind = types.Array(float64, 2, "A")

    def generate(context, builder, signature, arguments):
        size = ir.IntType(64)
        data = cgutils.gep_inbounds(builder, arguments[0], size(BEHIND + NUMBERS))
        return array_at(context, builder, kind, data, [size(N_ROWS), size(LANES)], [size(8 * LANES), size(8)])

    return kind(v), generate


_rows_of = (
    (lambda v: v[BEHIND + NUMBERS :][: N_ROWS * LANES].reshape(N_ROWS, LANES))
    if config.DISABLE_JIT
    else _rows_behind
)


@njit(**OPTIONS)
def weigh(v):
    """Compute the weights of the lanes from their evidence; all weights are 0 if no lane has finite evidence."""
    best = -math.inf
    for lane in range(LANES):
        for_it = EVIDENCE_COUNTS * v[_AT_EVIDENCE + lane] - v[_AT_PENALTY + lane]
        v[_AT_WEIGHT + lane] = for_it
        if for_it > best:  # false for NaN
            best = for_it
    total = 0.0
    for lane in range(LANES):
        for_it = v[_AT_WEIGHT + lane]
        v[_AT_WEIGHT + lane] = math.exp(for_it - best) if math.isfinite(for_it) else 0.0
        total += v[_AT_WEIGHT + lane]
    if total > 0.0:
        for lane in range(LANES):
            v[_AT_WEIGHT + lane] /= total


@njit(**OPTIONS)
def _is_predicted(w, lane):
    return math.isfinite(w[R.NU1, lane] + w[R.NU2, lane] + w[R.V11, lane] + w[R.V12, lane] + w[R.V22, lane])


@njit(**OPTIONS)
def _note_fix(v, w, now):
    """Store the innovation of the mixture at a fix, and update the evidence of each lane."""
    x, y, total = 0.0, 0.0, 0.0
    for lane in range(LANES):
        share = v[_AT_WEIGHT + lane]
        if share > 0.0 and _is_predicted(w, lane):
            x += share * w[R.NU1, lane]
            y += share * w[R.NU2, lane]
            total += share
    xx, xy, yy = 0.0, 0.0, 0.0
    x, y = (x / total, y / total) if total > 0.0 else (math.nan, math.nan)
    for lane in range(LANES):
        share = v[_AT_WEIGHT + lane]
        if share > 0.0 and _is_predicted(w, lane):
            share /= total
            dx, dy = w[R.NU1, lane] - x, w[R.NU2, lane] - y
            xx += share * (w[R.V11, lane] + dx * dx)
            xy += share * (w[R.V12, lane] + dx * dy)
            yy += share * (w[R.V22, lane] + dy * dy)
    v[BEHIND + NU_X], v[BEHIND + NU_Y] = x, y
    v[BEHIND + S_XX], v[BEHIND + S_XY], v[BEHIND + S_YY] = xx, xy, yy
    fades = math.exp((v[BEHIND + FIXED_AT] - now) / EVIDENCE_LASTS)
    v[BEHIND + FIXED_AT] = now
    v[BEHIND + N_FIXED] += 1.0
    for lane in range(LANES):
        n1, n2 = w[R.NU1, lane], w[R.NU2, lane]
        s11, s12, s22 = w[R.V11, lane], w[R.V12, lane], w[R.V22, lane]
        det = s11 * s22 - s12 * s12
        nis = (s22 * n1 * n1 - 2.0 * s12 * n1 * n2 + s11 * n2 * n2) / det
        loss = math.inf
        if w[R.OK, lane] == 1.0 and 0.0 < det < math.inf and nis >= 0.0:
            loss = 0.5 * math.log(det) + 0.5 * min(nis, LARGEST_NIS)
        v[_AT_EVIDENCE + lane] = fades * v[_AT_EVIDENCE + lane] - loss


@njit(**OPTIONS)
def _check_lanes(v, w):
    """Mark lanes with an indefinite covariance as failed. The live filter checks the first lane."""
    for lane in range(1, LANES):
        if w[R.OK, lane] == 1.0 and not is_definite(w[P0:, lane], int(v[DIMENSION]), v, FACTOR.start):
            w[R.OK, lane] = 0.0


def _swarm_step(v, u, events, z, wheels, lever, since, *, step, kept):
    control = exchange_control(-1)
    w = _rows_of(v)
    for lane in range(LANES):
        w[R.SIN_COS_VALID_ALL, lane] = 0.0  # some lanes may have been replaced
    if v[R.OK] == 0.0:  # set by the live filter's check
        w[R.OK, 0] = 0.0
    step(
        w, tuple(u[k] for k in range(9)), events, tuple(z[k] for k in range(8)),
        tuple(wheels[k] for k in range(3)), tuple(lever[k] for k in range(3)), since,
    )  # fmt: skip
    exchange_control(control)
    now = v[TIME] + u[DT]
    if events & FIX:
        _check_lanes(v, w)
        _note_fix(v, w, now)
        weigh(v)
    for r in kept:
        v[r] = w[r, 0]
    row = BEHIND + STEP_LOG + N_LOG_ROW * (int(v[BEHIND + LOGGED]) % int(v[BEHIND + LOG_LENGTH]))
    v[BEHIND + LOGGED] += 1.0
    for c in range(9):
        v[row + c] = u[c]
    v[row + 9] = events
    for c in range(8):
        v[row + 10 + c] = z[c]
    for c in range(3):
        v[row + 18 + c] = wheels[c]
    v[row + 21] = since
    v[row + 22] = now


@call_once
def swarm_step(model):
    kept = (*(int(r) for r in state_rows(model)), *range(CONSTANT_ROWS.start, N_KEPT))
    function = named_by_sources(_swarm_step, f"swarm {model}", lambda: {"step": step_of(model), "kept": kept})
    return SingleStep(address_of(function, SIGNATURE, error_model="numpy"), (swarm_step, model))
