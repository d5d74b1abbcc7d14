"""Unrolled loops over states compute the same as the original loops."""

import ast

import numpy as np
import pytest

from sigmaswarm.filters.compiled import lanes
from sigmaswarm.filters.compiled.layout import MEAN, P0, at
from sigmaswarm.filters.compiled.unroll import unrolled


def outer_sums(w, *, n, twice):
    total = 0.0
    for lane in range(w.shape[1]):
        for j in range(n):
            for i in range(j + 1):
                w[at(i, j), lane] += 1.0 + i + 10 * j
                if j > 2:
                    total += twice(w[at(i, j), lane])
                elif lane == 0:
                    total -= 1.0
    return total


def test_an_unrolled_function_equals_the_loop():
    for n in (2, 5):
        a, b = np.zeros((44, 3)), np.zeros((44, 3))
        straight = unrolled(outer_sums, n=n, twice=lambda v: 2 * v)
        assert straight(a) == outer_sums(b, n=n, twice=lambda v: 2 * v)
        np.testing.assert_array_equal(a, b)
        names = straight.__code__.co_varnames
        assert "lane" in names
        assert not {"i", "j", "n"} & set(names)


def squares(w, *, n):
    x, y = tuple(w[k] * w[k] for k in range(n))
    return y - x


def sum_of(w, *, n):
    return sum(w[k] for k in range(n))


def positive(w, *, n):
    return tuple(w[k] for k in range(n) if k)


def test_only_a_tuple_of_all_values_is_unrolled():
    assert unrolled(squares, n=2)([3.0, 5.0]) == 16.0
    for other in (sum_of, positive):
        with pytest.raises(TypeError, match="only tuple"):
            unrolled(other, n=2)


def test_rows_of_the_upper_triangle_are_distinct():
    n = len(MEAN)
    rows = {at(i, j) for j in range(n) for i in range(j + 1)}
    assert rows == set(range(P0, P0 + n * (n + 1) // 2))
    assert at(3, 5) == at(5, 3)


LIMIT = 7.0


def _inner(w, a):
    gain = a * LIMIT
    a = gain + 1.0
    w[0, 0] += a


def _ends_early(w, a):
    if a == 0.0:
        return
    w[0, 0] = a


def _outer(w, a, *, inner):
    LIMIT, gain, gain_1 = 2.0, 3.0, 5.0
    inner(w, a)
    inner(w, a + 1.0)
    w[0, 1] = LIMIT + gain + gain_1 + a


def test_inlining_a_kernel_keeps_the_names_of_both_separate():
    w, expected = np.zeros((1, 2)), np.zeros((1, 2))
    straight = unrolled(_outer, inner=lanes.kernel(_inner))
    assert "inner" not in straight.__code__.co_names
    straight(w, 1.0)
    _outer(expected, 1.0, inner=_inner)
    np.testing.assert_array_equal(w, expected)


def test_a_kernel_with_an_early_return_is_rejected():
    with pytest.raises(TypeError, match="nor end early"):
        unrolled(_outer, inner=lanes.kernel(_ends_early))


def test_an_error_in_the_parser_caused_by_other_threads_leads_to_a_retry(monkeypatch: pytest.MonkeyPatch):
    parse, calls = ast.parse, []

    def disturbed(*arguments):
        calls.append(arguments)
        if len(calls) < 3:
            raise SystemError("AST constructor recursion depth mismatch (before=87, after=47)")
        return parse(*arguments)

    monkeypatch.setattr(ast, "parse", disturbed)
    straight = unrolled(outer_sums, n=2, twice=lambda v: 2 * v)
    assert len(calls) == 3
    assert straight(np.zeros((44, 3))) == outer_sums(np.zeros((44, 3)), n=2, twice=lambda v: 2 * v)
