"""Statistics compared with manual calculations on a fixed table of scores, with scipy, and with simulations."""

import itertools
import math
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from sigmaswarm.experiments import statistics as s
from sigmaswarm.experiments.study import results

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from study_coverage import coverage

PAIR = dict.fromkeys(("protocol", "measure", "method", "against"), "any")
compare_paired = partial(results.compare_paired, **PAIR)
VARIANT = dict.fromkeys(("protocol", "method", "measure", "maneuver", "environment"), "any")
summarize = partial(results.summarize, **VARIANT)
NAN = math.nan
# Three trials and five drives; each trial held out two drives.
FROZEN = np.array(
    [
        [1.0, 3.0, NAN, NAN, NAN],
        [NAN, 5.0, 2.0, NAN, NAN],
        [3.0, NAN, NAN, 6.0, NAN],
    ]
)
STRATA = ["a", "a", "b", "b", "b"]


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def draws() -> s.Draws:
    return s.Draws(0)


def test_means_agree_with_manual_calculations():
    np.testing.assert_array_equal(s.trial_means(FROZEN), [2.0, 3.5, 4.5])
    np.testing.assert_array_equal(s.drive_means(FROZEN), [2.0, 4.0, 2.0, 6.0, NAN])


def test_the_summary_agrees_with_manual_calculations():
    found = summarize(FROZEN, STRATA, 2 / 3, draws())
    mean, sd = 10 / 3, math.sqrt(((2 - 10 / 3) ** 2 + (3.5 - 10 / 3) ** 2 + (4.5 - 10 / 3) ** 2) / 2)
    assert found.mean == pytest.approx(mean)
    assert found.sd == pytest.approx(sd)
    assert found.trial_interval == pytest.approx(
        (mean - 1.96 * sd / math.sqrt(3), mean + 1.96 * sd / math.sqrt(3))
    )
    half = 4.302652729911275 * sd  # t(0.975, 2), and 1/3 + 2/3 = 1
    assert found.corrected_t_interval == pytest.approx((mean - half, mean + half))
    assert (found.n_trials, found.n_drives) == (3, 4)


def test_without_correction_it_is_the_t_interval():
    values = np.array([1.0, 2.5, 3.0, 7.0])
    wanted = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert s.corrected_interval(values, 0.0) == pytest.approx(wanted)


def test_the_paper_s_intervals_are_over_trials():
    # Table II: manual UKF 2.80, SD 0.41, n = 20, [2.62, 2.98].
    values = np.array([-1.0, 1.0] * 10)
    values = 2.80 + 0.41 * values / np.std(values, ddof=1)
    assert s.trial_interval(values) == pytest.approx((2.62, 2.98), abs=0.005)


def test_the_bootstrap_agrees_with_scipy_for_one_stratum():
    values = np.random.default_rng(3).gamma(2.0, 1.0, 60)
    found = s.bootstrap(np.asarray, [values], ["all"] * 60, draws())
    theirs = stats.bootstrap((values,), np.mean, method="percentile", rng=rng()).confidence_interval
    assert found == pytest.approx(tuple(theirs), abs=0.03)


def test_resampling_stays_within_strata():
    values = np.array([1.0, 1.0, 1.0, 9.0, 9.0, 9.0])
    assert s.bootstrap(np.asarray, [values], list("aaabbb"), draws()) == (5.0, 5.0)
    low, high = s.bootstrap(np.asarray, [values], ["all"] * 6, draws())
    assert low < 4 < 6 < high


def test_trials_are_resampled_too():
    """If all drives are equal, the interval shows the differences between trials."""
    each = np.array([1.0, 2.0, 3.0, 4.0])
    low, high = s.crossed_bootstrap(np.repeat(each[:, np.newaxis], 5, axis=1), ["all"] * 5, draws())
    assert 0.99 < low < 1.7
    assert 3.3 < high < 4.01
    assert s.crossed_bootstrap(np.full((3, 5), 2.0), ["all"] * 5, draws()) == (2.0, 2.0)


def test_levels_agree_with_a_least_squares_fit():
    """The fit has a column for each drive and each trial."""
    chance = np.random.default_rng(4)
    values = chance.normal(size=(6, 9)) + np.arange(9) + 3.0 * np.arange(6)[:, np.newaxis]
    values[chance.random((6, 9)) < 0.5] = NAN
    assert not np.isnan(values).all(axis=0).any()
    trial, drive = np.nonzero(~np.isnan(values))
    design = np.hstack([np.eye(9)[drive], np.eye(6)[trial]])
    fitted = design @ np.linalg.lstsq(design, values[trial, drive], rcond=None)[0]
    drives, trials = s.levels(values)
    np.testing.assert_allclose(drives[drive] + trials[trial], fitted, atol=1e-12)
    assert abs(trials.sum()) < 1e-12


@pytest.mark.parametrize("n", [2, 3, 10])
def test_the_variance_of_a_mean_agrees_with_theory(n: int):
    """Drawing n of n would give a variance that is too small by (n - 1) / n, which is half for two drives."""
    values = np.random.default_rng(n).normal(size=3 * n)
    strata = np.repeat(np.arange(3), n)
    found = s._drive_weights([str(k) for k in strata], rng()) @ values / len(values)
    theory = sum(np.var(values[strata == k], ddof=1) * n for k in range(3)) / (3 * n) ** 2
    assert np.var(found) == pytest.approx(theory, rel=0.15)


def test_strata_of_one_drive_are_merged():
    values = np.array([1.0, 5.0, 9.0])
    assert s.bootstrap(np.asarray, [values], list("abc"), draws()) == s.bootstrap(
        np.asarray, [values], list("aaa"), draws()
    )


def test_few_trials_give_an_interval_as_wide_as_student_s_t():
    """If all drives are equal, the interval is approximately the t interval of the means of trials."""
    each = np.array([1.0, 2.0, 4.0, 3.0, 2.5])
    found = s.crossed_bootstrap(np.repeat(each[:, np.newaxis], 4, axis=1), ["all"] * 4, draws())
    wanted = stats.t.interval(0.95, 4, each.mean(), stats.sem(each))
    assert found[1] - found[0] == pytest.approx(wanted[1] - wanted[0], rel=0.15)


@pytest.mark.parametrize("seed", range(5))
def test_in_a_small_study_the_interval_contains_the_mean(seed: int):
    """Each of three trials holds out one of four drives, some drives repeatedly; conditions differ much."""
    chance = np.random.default_rng(seed)
    strata = np.repeat(np.arange(25), 4)
    level = 10.0 ** chance.uniform(-1, 3, 25)
    values = np.full((3, 100), NAN)
    for trial in range(3):
        held_out = 4 * np.arange(25) + chance.integers(0, 4, 25)
        values[trial, held_out] = (level * chance.uniform(0.9, 1.1, 25))[strata[held_out]]
    found = summarize(values, [str(k) for k in strata], 1 / 3, draws())
    low, high = found.bootstrap_interval
    assert low < found.mean < high
    assert high - low < 0.2 * found.mean  # drives of a condition differ less than conditions


def test_a_failed_filter_has_no_intervals():
    failed = np.where(FROZEN == 6.0, np.inf, FROZEN)
    found = summarize(failed, STRATA, 2 / 3, draws())
    assert found.mean is found.sd is None
    assert found.corrected_t_interval == found.bootstrap_interval == (None, None)


def test_the_comparison_agrees_with_manual_calculations():
    tuned = np.array([[1.0, 2.0, 3.0, 4.0]])
    manual = np.array([[2.0, 5.0, 2.5, 8.0]])
    found = compare_paired(tuned, manual, ["all"] * 4, draws())
    assert found.mean_difference == pytest.approx((-1 - 3 + 0.5 - 4) / 4)
    assert found.improvement == pytest.approx(100 * (4.375 - 2.5) / 4.375)  # eq. 5
    # ranks of |difference|: 0.5 is 1 (worse), 1 is 2, 3 is 3, 4 is 4 (better): (9 - 1) / 10
    assert found.rank_biserial == pytest.approx(0.8)
    assert found.p == pytest.approx(0.25)  # exact: 2 x P(W <= 1) = 2 x 2/16
    low, high = found.improvement_interval
    assert low < found.improvement < high
    assert found.n_drives == 4


def test_the_paper_s_improvement():
    assert s.improvement(np.array([0.5]), np.array([2.8])) == pytest.approx(82.14, abs=0.005)
    assert np.isnan(s.improvement(np.array([0.5]), np.array([0.0])))


def test_only_drives_with_results_of_both_methods_are_compared():
    other = np.where(np.isnan(FROZEN), NAN, FROZEN + 1)
    other[:, 3] = NAN
    assert compare_paired(FROZEN, other, STRATA, draws()).n_drives == 3
    assert compare_paired(FROZEN, FROZEN, STRATA, draws()).p == 1.0


@pytest.mark.parametrize("n", [1, 3, 5, 6, 10, 20, 37])
def test_the_interval_covers_the_median_and_a_narrower_one_does_not(n: int):
    low, high = s.median_interval(np.random.default_rng(n).permutation(n).astype(float))
    cut = int(low)
    assert high == n - 1 - cut
    samples = np.random.default_rng(n).normal(size=(4000, n))
    samples.sort(axis=1)
    covered = np.mean((samples[:, cut] < 0) & (samples[:, n - 1 - cut] > 0))
    assert covered > 0.94 or cut == 0
    assert np.mean((samples[:, cut + 1] < 0) & (samples[:, n - 2 - cut] > 0)) < 0.955 if n > 2 else True


@given(st.lists(st.integers(-50, 50), min_size=2, max_size=9, unique_by=abs).filter(lambda v: 0 not in v))
def test_the_paired_test_agrees_with_an_enumeration_of_signs(differences: list[int]):
    ranks = np.argsort(np.argsort(np.abs(differences))) + 1
    total = sum(r for r, d in zip(ranks, differences, strict=True) if d > 0)
    sums = [sum(r for r, up in zip(ranks, signs, strict=True) if up) for signs in
            itertools.product((0, 1), repeat=len(ranks))]  # fmt: skip
    extreme = min(np.mean(np.array(sums) <= total), np.mean(np.array(sums) >= total))
    ours = np.array(differences, float)
    assert s.signed_rank(ours, np.zeros(len(ours))) == pytest.approx(min(1.0, 2 * extreme))


def test_the_paired_test_with_ties_and_failures():
    assert s.signed_rank(np.ones(5), np.ones(5)) == 1.0
    failing = np.array([np.inf] * 10)
    assert s.signed_rank(failing, np.arange(10.0)) < 0.01
    assert s.signed_rank(failing, failing) == 1.0


def test_holm_agrees_with_manual_calculations():
    # Sorted 0.01, 0.02, 0.03, 0.04 times 4, 3, 2, 1 gives 0.04, 0.06, 0.06, 0.04; each is at least the previous one.
    assert s.holm([0.03, 0.01, 0.04, 0.02]) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert s.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert s.holm([0.9, 0.8]) == [1.0, 1.0]
    assert s.holm([]) == []


@pytest.mark.long
def test_intervals_for_new_drives_have_the_stated_coverage_and_the_naive_one_does_not():
    naive, corrected, resampled = coverage(150, luck=0.01, conditions=8, runs=10, trials=10)
    assert naive < 0.8
    assert corrected > 0.91  # for 150 studies: 0.95 less 2.2 standard errors
    assert 0.90 < resampled < 0.99


def test_resampled_weights_are_reused_for_the_same_drives(monkeypatch: pytest.MonkeyPatch):
    """They are reused for other scores and other statistics, and each statistic equals that of a separate draw."""
    other = np.where(np.isnan(FROZEN), np.nan, FROZEN**2)

    def figures(common: s.Draws | None) -> list[object]:
        pairs = [compare_paired(FROZEN, other, STRATA, common or draws())]
        return [*pairs, *(summarize(values, STRATA, 2 / 3, common or draws()) for values in (FROZEN, other))]

    alone, common = figures(None), draws()
    assert figures(common) == alone
    monkeypatch.setattr(s, "_weights", lambda *_: pytest.fail("drawn again"))
    assert figures(common) == alone
    with pytest.raises(pytest.fail.Exception):
        summarize(FROZEN, STRATA, 2 / 3, s.Draws(1))
