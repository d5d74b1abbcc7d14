"""Series that arrive in pieces are thinned like whole series; close-ups have gaps where a track is outside."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.scoring.tracks import CloseUp, ThinnedSeries


def rows_of_whole(matters: np.ndarray, most: int) -> np.ndarray:
    """Return the rows by their definition, which needs the whole series."""
    n = len(matters)
    if n <= most:
        return np.arange(n)
    parts = np.array_split(np.arange(1, n - 1), most // 2 - 1)
    ends = [[part[matters[part].argmin()], part[matters[part].argmax()]] for part in parts]
    return np.unique([0, n - 1, *np.concatenate(ends)])


@given(
    n=st.integers(1, 400),
    most=st.sampled_from([4, 10, 11, 60]),
    cuts=st.lists(st.integers(0, 400), max_size=6),
    seed=st.integers(0, 5),
    column=st.sampled_from(["position_error", "nis", None]),
)
def test_the_rows_do_not_depend_on_the_pieces(
    n: int, most: int, cuts: list[int], seed: int, column: str | None
):
    rng = np.random.default_rng(seed)
    columns = {"time": np.arange(n, dtype=float), "x": rng.normal(size=n)}
    matters = np.arange(n, dtype=float)
    if column:
        columns[column] = matters = np.round(rng.normal(size=n), 1)  # with ties
        columns[column][rng.random(n) < 0.1] = np.nan
        matters = np.nan_to_num(matters, nan=0.0)
    kept = ThinnedSeries(n, most)
    edges = sorted({0, n, *(c for c in cuts if c < n)})
    for first, last in pairwise(edges):
        kept.add({name: values[first:last] for name, values in columns.items()})
    rows = rows_of_whole(matters, most)
    for name, values in columns.items():
        np.testing.assert_array_equal(kept.columns[name], values[rows], err_msg=name)


@pytest.mark.parametrize("size", [1, 2, 3, 100])
def test_a_close_up_keeps_every_near_point_and_one_gap_for_each_exit(size: int):
    x = np.array([0.0, 5, 50, 60, 5, 6, 70, 80, 90, 7])
    close = CloseUp(np.zeros(2), 10.0)
    for first in range(0, len(x), size):
        part = x[first : first + size]
        close.add({"x": part, "y": np.zeros(len(part))})
    nan = np.nan
    np.testing.assert_array_equal(close.columns["x"], [0, 5, nan, 5, 6, nan, 7])
    np.testing.assert_array_equal(np.isnan(close.columns["y"]), np.isnan(close.columns["x"]))
