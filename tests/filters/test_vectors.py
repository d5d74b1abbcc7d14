"""Loops over lanes in LLVM compute the same as in Python; unsupported code is rejected."""

# ruff: noqa: E741 (a lane is l in kernels)

import math
from functools import cache

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.filters.compiled import lanes
from sigmaswarm.filters.compiled.layout import LANES, N_ROWS, WIDEST
from sigmaswarm.filters.compiled.memory import new_rows
from sigmaswarm.filters.compiled.unroll import unrolled

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
THREE = 3.0


def _halved(w, l, by, *, row):
    """A function that is inlined into a loop."""
    half = w[row, l] / (by + 1.0)
    w[row + 1, l] += half
    return half, -half


def _everything(w, shift, *, n, halved):
    large, small = 1, 0
    for l in range(LANES):
        a, b = w[0, l] - shift, THREE * abs(w[1, l])
        both = (a > b) & (b >= 0.75) | (a != a)
        c = math.sqrt(b) if not both else np.floor(a)
        w[2, l], w[3, l] = c, w[2, l] - math.log(b + 1.0)
        for i in range(n):
            w[4 + i, l] -= i * c / (1.0 + b)
        first, second = halved(w, l, b)
        w[8, l] = first - 0.25 * second
        large += both
        small += b < 1.0
        small += b <= 0.75
    for l in range(LANES):
        shift = w[8, l] * 2.0  # a local name
        w[9, l] = shift
    w[10, 0] = large + 100.0 * small


def _run(rows, shift, *, kernel, n_lanes):
    w = new_rows(n_lanes)
    for r in range(12):
        for lane in range(n_lanes):
            w[lane // LANES * N_ROWS + r, lane % LANES] = rows[r, lane]
    kernel(w, shift)
    for r in range(12):
        for lane in range(n_lanes):
            rows[r, lane] = w[lane // LANES * N_ROWS + r, lane % LANES]


KNOWN = {"n": 2, "halved": unrolled(_halved, row=6)}


@cache
def compiled_for(n_lanes):
    run = unrolled(_run, kernel=lanes.kernel(_everything, **KNOWN), n_lanes=n_lanes)
    return numba.njit(run, error_model="numpy")


@compiled
@given(st.integers(0, 2**32 - 1))
def test_a_loop_over_lanes_equals_the_loop_in_python(seed):
    rows = np.round(np.random.default_rng(seed).normal(0.0, 2.0, (12, LANES)) * 4.0) / 4.0  # some are equal
    rows[0, 3] = np.nan
    straight, many, few = np.zeros((N_ROWS, LANES)), rows.copy(), rows.copy()
    straight[:12] = rows
    with np.errstate(all="ignore"):
        unrolled(_everything, **KNOWN)(straight, 0.5)
    compiled_for(LANES)(many, 0.5)
    np.testing.assert_allclose(many, straight[:12], rtol=1e-14, atol=1e-14)
    compiled_for(WIDEST)(few, 0.5)
    assert many[:10, :WIDEST].tobytes() == few[:10, :WIDEST].tobytes(), "a lane's bits depend on the others"
    n_lanes = LANES + WIDEST
    most = np.hstack([rows, rows[:, ::-1]])[:, :n_lanes].copy()
    compiled_for(n_lanes)(most, 0.5)
    assert most[:10].tobytes() == np.hstack([many, many[:, ::-1]])[:10, :n_lanes].tobytes()


def _with_a_branch(w, shift):
    for l in range(LANES):
        if w[0, l] > 0.0:
            w[0, l] = 1.0


def _of_an_unknown_row(w, row):
    for l in range(LANES):
        w[row, l] = 1.0


def _handed_on(w, shift):
    for l in range(LANES):
        w[0, l] = shift
        shift = w[1, l]


def _counted_down(w, n):
    for l in range(LANES):
        n -= w[0, l] > 0.0


def _of_a_row_before_the_first(w, shift):
    for l in range(LANES):
        w[-1, l] = shift


def _to_a_power(w, shift):
    for l in range(LANES):
        w[0, l] = w[1, l] ** shift


@compiled
@pytest.mark.parametrize(
    "function",
    [_with_a_branch, _of_an_unknown_row, _handed_on, _counted_down, _of_a_row_before_the_first, _to_a_power],
)
def test_unsupported_code_in_a_loop_over_lanes_is_rejected(function):
    with pytest.raises(TypeError, match=r"loop over lanes|row of a lane must be"):
        numba.njit(unrolled(_run, kernel=lanes.kernel(function), n_lanes=LANES))(np.zeros((12, LANES)), 1.0)


def _picked(w, *, rows):
    for l in range(LANES):
        w[0, l] = w[rows[0], l]


@compiled
def test_loops_that_differ_in_their_rows_have_different_names():
    names = [
        {n for n in lanes.kernel(_picked, rows=rows).written.names if n.startswith("_picked_")}
        for rows in ((1,), (2,))
    ]
    assert names[0] != names[1]
