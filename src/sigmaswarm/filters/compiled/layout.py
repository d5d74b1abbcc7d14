"""Layout of the array of a run, (row, lane): a lane is one filter, a row is one number of each filter.

Kernels contain ``w.XX``, ``P[i, j]`` and ``C1[i]``, which denote elements of lane ``l``. Before Numba compiles a
kernel, `unroll` replaces these expressions by ``w[R.XX, l]``, ``w[at(i, j), l]`` and ``w[C1 + i, l]``.
"""

from collections import namedtuple
from functools import cache
from typing import Any

import numpy as np
from numba import config
from numpy.typing import NDArray

from sigmaswarm.filters.kernels import FILTERS

LANES = 16  # lanes per block, a compile-time constant: two AVX-512 or four AVX2 vectors

WIDEST = 8  # lanes in the widest vector; the number of lanes of a run is a multiple of WIDEST

BLOCKS = 2  # largest number of blocks of LANES lanes in a run; the second block is in additional rows


def most_lanes(kernel: str) -> int:
    """Return the largest number of lanes of a run: more lanes hide latencies, but must fit in the L1 cache."""
    uncompiled = config.DISABLE_JIT  # pyright: ignore[reportAttributeAccessIssue]
    return LANES if FILTERS[kernel].tilts or uncompiled else BLOCKS * LANES


def lanes_for(n_sets: int) -> int:
    return -(-n_sets // WIDEST) * WIDEST


LETTERS = {
    "x": "X", "y": "Y", "vx": "U", "vy": "V", "theta": "T",
    "accel_bias_x": "A", "accel_bias_y": "B", "gyro_bias_z": "W",
    "roll": "I", "pitch": "J", "gyro_bias_x": "K", "gyro_bias_y": "L",
    "fix_error_x": "M", "fix_error_y": "N",
}  # fmt: skip
"""One letter for each state of any model. Two letters denote an element of the covariance."""

_LARGEST = max(FILTERS.values(), key=lambda model: len(model.states))
_STATES = [LETTERS[name] for name in _LARGEST.names]

MEAN = tuple(_STATES)
QUATERNION = ("ATT_W", "ATT_X", "ATT_Y", "ATT_Z")  # of models with roll and pitch: see `tilted12`
COVARIANCE = tuple(a + b for j, b in enumerate(_STATES) for a in _STATES[: j + 1])
"""Upper triangle of P, column by column. The rows of a smaller model are therefore the first of these rows."""
CONSTANTS = (
    # Of sigma points, in this order: gamma / 4, -8 / gamma^2, alpha^2 (n + kappa - 1) + beta, and 1. In an extended
    # filter, QUARTER_GAMMA, SHORTENS and SECOND are 0.
    "QUARTER_GAMMA", "SHORTENS", "SPREAD", "SECOND",
    *(f"Q_{a}" for a in _STATES), "RX", "RY",  # adaptive and fuzzy filters write these rows
    "R_VELOCITY", "R_LATERAL", "R_STANDSTILL", "R_RATE",
    "REAR_AXLE", "TIRE_SLIP", "LATENCY", "GATE", "FORGETTING", "FADING",
    "FUZZY", "WIDTH_RATIO", "WIDTH_TREND", "GAIN_R", "GAIN_Q",  # FUZZY < 0: no fuzzy filter
    "ACCURACY",  # factor of a fix's stated variance in R, 0: not used; a fuzzy filter also writes this row
    "R_HEADING", "R_ODOMETER", "ODOMETER_SCALE", "ODOMETER_LATENCY",  # ODOMETER_SCALE: reciprocal of odometer_scale
    "DOF", "PATIENCE",  # DOF of Student's t, 0: Gaussian; PATIENCE: `constants.OUTLIERS_SPAN` in nominal steps
    "FIX_ERROR", "FIX_ERROR_RATE", "FIX_VAR",  # g, nominal interval / tau, s^2 if a fix states none: `kernels`
)  # fmt: skip
SUMS = (
    "SQ_POSITION", "SQ_HEADING",  # squared errors at the targets, weighted if truth has a variance; m2, rad2
    "NEES",  # e^T P^-1 e of the position at the targets; P includes the variance of truth, if any
    "SQ_FIX", "SQ_FORECAST",  # m2, squared residuals of fixes after their update; squared innovations of hidden fixes
    "NIS", "LOG_TAIL",  # nu^T S^-1 nu; ln(1 + NIS / c), with c of `innovation-t`; over all fixes, including hidden ones
    "FORECAST_T",  # ln det S / 2 + (v + 2) / 2 ln(1 + NIS / c) over the hidden fixes, with v and c of `forecast-t`
    "SQ_BRANCH",  # the sum SQ_POSITION of branches, m2: see `passes.FilterPass`
    "LOG_DET",  # ln det S over all fixes
    "DET", "TAIL", "OK", "REJECTED", "RECENT",
    "OUTLIERS", "SPAN",  # number of consecutive outliers, and the nominal steps from the first to the last
    "QUICK", "SLOW", "TIMES_R", "TIMES_Q",  # a fuzzy filter's averages, and its current factors
    "HEADING",  # of models with roll and pitch, whose mean has no row for the heading
    # COS and SIN of planar5's heading are valid if SIN_COS_VALID is 1. Updates set both flags, SIN_COS_VALID and
    # SIN_COS_VALID_ALL, to 0.
    "SIN_COS_VALID", "COS", "SIN",
)  # fmt: skip
"""Sums and other numbers that are kept between steps. `kernel_array.KernelSums` contains the sums up to LOG_DET."""
SCRATCH = (
    "SIN_COS_VALID_ALL",  # equal in all lanes; 1: SIN_COS_VALID is 1 in all lanes; 0: unknown
    "BEFORE_X", "BEFORE_Y", "BEFORE_T",  # estimate at the previous IMU sample
    *(f"C1_{a}" for a in _STATES), *(f"C2_{a}" for a in _STATES),  # Cov(state, z) for the two components of z
    "S11", "S12", "S22",  # H P H^T of a fix; for a scalar measurement, S11 is S
    "R1", "R2",  # the diagonal of R of a fix; R1: variance of a velocity
    "V11", "V12", "V22",  # S = H P H^T + R of a fix
    "N1", "N2",  # nu
    "G11", "G12", "G22", "USE",  # G = S^-1, or 0 if the fix is rejected (USE = 0)
    "FACTOR",  # inflation factor of P
    "PHI", "GAINED_X", "GAINED_Y",  # of the correlated fix error
    "ARM",  # of the lateral constraint: see `models.lateral_arm`
    # Of a prediction: acceleration times dt, its covariance with the state, and its own covariance. Of a fix: the same
    # for the rotated lever arm.
    "EAST", "NORTH", "JEAST", "JNORTH", "E", "ALONG", "MU_EAST", "MU_NORTH", "GEE", "GEN", "GNN",
    "NU1", "NU2",  # nu of the last fix
    *(f"D{i}{j}" for i in "123" for j in "123"), "LEVER_UP", *(f"FP{k}" for k in range(7 * 7)),  # of tilted12
    "TURN_W", "TURN_X", "TURN_Y", "TURN_Z", "HALF_X", "HALF_Y", "HALF_Z",
    # Of the unscented filter: square root of P, moments of the images, the center's vertical acceleration, and
    # the quaternion of a point. See `tilted12_unscented`.
    *(f"ROOT{k}" for k in range(48)), *(f"PIVOT{k}" for k in range(6)), *(f"SLOPE{k}" for k in range(30)),
    *(f"BEND{k}" for k in range(30)), *(f"SHIFT{k}" for k in range(5)), *(f"EXTRA{k}" for k in range(25)),
    "UPWARD", "POINT_FAR", "POINT_W", "POINT_X", "POINT_Y", "POINT_Z",
    # Inputs of a smoother: the prediction, and the process's coefficients. See `transition`.
    *(f"PRIOR_{name}" for name in (*MEAN, *QUATERNION, *COVARIANCE)), *(f"MOVE{k}" for k in range(26)),
)  # fmt: skip

_BLOCKS = {
    "STATE": (*MEAN, *QUATERNION, *COVARIANCE),
    "CONSTANTS": CONSTANTS,
    "SUMS": SUMS,
    "SCRATCH": SCRATCH,
}
NAMES = tuple(name for block in _BLOCKS.values() for name in block)
N_ROWS = len(NAMES)

R: Any = namedtuple("R", NAMES)(*range(N_ROWS))  # pyright: ignore[reportUntypedNamedTuple]
P0, Q0, C1, C2, FP, PRIOR, MOVE = R.XX, R.Q_X, R.C1_X, R.C2_X, R.FP0, R.PRIOR_X, R.MOVE0
ROOT, SLOPE, BEND, SHIFT, EXTRA, PIVOT = R.ROOT0, R.SLOPE0, R.BEND0, R.SHIFT0, R.EXTRA0, R.PIVOT0
"""First rows: P[i, j] with i <= j is in row P0 + j (j + 1) / 2 + i, Q[i, i] in row Q0 + i, and so on."""
P, Q = P0, Q0
COLUMNS = {"ROOT": 6, "SLOPE": 5, "BEND": 5, "EXTRA": 5}
"""Numbers of columns of matrices. The columns of SLOPE, BEND and EXTRA are vx, vy, and the rotation about east, north
and up."""


def _rows(block: str) -> slice:
    first = NAMES.index(_BLOCKS[block][0])
    return slice(first, first + len(_BLOCKS[block]))


STATE_ROWS, CONSTANT_ROWS, SUM_ROWS = _rows("STATE"), _rows("CONSTANTS"), _rows("SUMS")
N_STATE: int = STATE_ROWS.stop


@cache
def state_rows(kernel: str) -> NDArray[np.intp]:
    """Return the rows of a model's state: mean (n,), quaternion (4,) if any, upper triangle of P."""
    n = len(FILTERS[kernel].states)
    quaternion = range(R.ATT_W, R.ATT_W + len(QUATERNION)) if FILTERS[kernel].tilts else ()
    return np.array([*range(n), *quaternion, *range(P0, P0 + n * (n + 1) // 2)], dtype=np.intp)


def at(i: int, j: int) -> int:
    """Return the row of the state array that contains P[i, j]."""
    low, high = min(i, j), max(i, j)
    return P0 + high * (high + 1) // 2 + low


N_KEPT: int = SUM_ROWS.stop  # number of rows that are kept between steps; the other rows are scratch
