"""Loops over states that are written out do what the loops did."""

import numpy as np

from sigmaswarm.filters.compiled.layout import MEAN, P0, at
from sigmaswarm.filters.compiled.unroll import unrolled


def outer_sums(w, *, n, twice):
    total = 0.0
    for l in range(w.shape[1]):  # noqa: E741
        for j in range(n):
            for i in range(j + 1):
                w[at(i, j), l] += 1.0 + i + 10 * j
                if j > 2:
                    total += twice(w[at(i, j), l])
                elif l == 0:
                    total -= 1.0
    return total


def test_written_out_is_the_loop():
    for n in (2, 5):
        a, b = np.zeros((44, 3)), np.zeros((44, 3))
        straight = unrolled(outer_sums, n=n, twice=lambda v: 2 * v)
        assert straight(a) == outer_sums(b, n=n, twice=lambda v: 2 * v)
        np.testing.assert_array_equal(a, b)
        names = straight.__code__.co_varnames
        assert "l" in names
        assert not {"i", "j", "n"} & set(names)


def test_rows_of_the_upper_triangle_are_told_apart():
    n = len(MEAN)
    rows = {at(i, j) for j in range(n) for i in range(j + 1)}
    assert rows == set(range(P0, P0 + n * (n + 1) // 2))
    assert at(3, 5) == at(5, 3)
