"""NIS, its interval, and whiteness, for innovations with a known distribution."""

import numpy as np
import pytest
from scipy.stats import chi2

from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Innovations
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.scoring.consistency import GATE_95, Consistency, consistency, consistency_of, verdicts
from sigmaswarm.scoring.evaluation import evaluate
from support import make_drive


def innovations(n: int, seed: int, *, scale: float = 1.0, memory: float = 0.0) -> Innovations:
    """Draw innovations whose covariance changes at each fix; ``memory`` correlates consecutive ones."""
    rng = np.random.default_rng(seed)
    root = np.array([[1.0, 0.0], [0.6, 0.5]]) * rng.uniform(0.5, 2.0, (n, 1, 1))
    white = rng.standard_normal((n, 2))
    for i in range(1, n):
        white[i] = memory * white[i - 1] + np.sqrt(1 - memory**2) * white[i]
    nu = np.einsum("fij,fj->fi", root, scale * white)
    return Innovations(np.arange(n, dtype=float), nu, root @ root.transpose(0, 2, 1))


def test_a_consistent_filter_is_inside_its_intervals_with_the_stated_probability():
    found = [consistency_of(innovations(200, seed)) for seed in range(300)]
    inside = np.mean([c.nis_band[0] < c.mean_nis < c.nis_band[1] for c in found])
    white = np.mean([c.white_p > 0.05 for c in found])
    assert 0.91 < inside < 0.99
    assert 0.91 < white < 0.99
    assert np.mean([c.inside_gate for c in found]) == pytest.approx(0.95, abs=0.005)
    correlations = np.concatenate([c.autocorrelation for c in found])
    assert np.mean(np.abs(correlations) < found[0].white_band) == pytest.approx(0.95, abs=0.02)


def test_overconfident_and_correlated_innovations_are_detected():
    sure = consistency_of(innovations(1000, 1, scale=1.2))
    assert sure.mean_nis > sure.nis_band[1]
    assert sure.inside_gate < 0.93
    assert sure.white_p > 0.01  # the size is wrong, but the innovations are white
    slow = consistency_of(innovations(1000, 2, memory=0.4))
    assert slow.white_p < 1e-6
    assert slow.autocorrelation[0] == pytest.approx(0.4, abs=0.06)


def test_a_constant_innovation_is_not_white():
    few = innovations(100, 3)
    biased = Innovations(few.time, np.full((100, 2), 1.0), np.tile(np.eye(2), (100, 1, 1)))
    assert consistency_of(biased).autocorrelation[0] == pytest.approx(0.99)


def test_the_gate_is_a_quantile_of_chi_square():
    assert chi2.cdf(GATE_95, 2) == pytest.approx(0.95)


def test_too_few_fixes_or_a_failed_filter_give_no_result():
    assert consistency_of(innovations(20, 0)) is None
    drive = make_drive(duration=30.0)
    failing = FilterParameters(0.5, 2.0, 1.0, (-1.0, 1.0, 1.0, 1.0, 1.0), (1.0, 1.0))
    assert consistency(drive, failing) is None
    evaluation = evaluate(drive, failing)
    assert evaluation.consistency[drive.name] is None
    assert evaluation.to_dict()["consistency"] == {drive.name: None}


def test_an_evaluation_contains_the_consistency():
    drive = make_drive(duration=60.0, seed=1)
    parameters = FilterParameters(0.5, 2.0, 1.0, (1e-6, 1e-6, 1e-6, 1e-6, 1e-9), (1.0, 1.0))
    told = evaluate(drive, parameters).to_dict()["consistency"][drive.name]
    found = consistency(drive, parameters)
    assert told["mean_nis"] == found.mean_nis
    assert 1.5 < found.mean_nis < 2.5  # 1 m of white noise, as assumed by R
    assert told["mean_nees"] == BatchScorer.prepare([drive]).scores([parameters])[0, 0].mean_nees


def judged(found: list[tuple[float, tuple[float, float], float | None, float] | None]) -> dict[str, str]:
    """Return verdicts for tuples of mean NIS, its interval, mean NEES, and correlation of consecutive innovations."""
    return verdicts(
        [
            one
            and Consistency(
                n_fixes=100,
                mean_nis=one[0],
                nis_band=one[1],
                inside_gate=0.9,
                autocorrelation=[one[3]],
                white_p=0.5,
                mean_nees=one[2],
            )
            for one in found
        ]
    )


def test_the_verdicts_count_the_drives_of_each_class():
    band = (1.8, 2.2)
    optimistic, pessimistic = (2.3, band, 2.5, 0.0), (1.0, band, 1.1, 0.9)
    right = (2.0, band, 2.0, 0.0)
    said = judged([optimistic, pessimistic, pessimistic, right, None])
    assert {kind: line.split(":")[0] for kind, line in said.items()} == {
        "optimistic": "on 1 of 5 drives the filter is overconfident",
        "pessimistic": "on 2 of 5 drives the filter is underconfident",
        "consistent": "on 1 of 5 drives the filter is consistent",
        "unknown": "on 1 of 5 drives the filter had too few fixes to determine its consistency, which needs more than "
        "20",
    }
    alone = judged([pessimistic])["pessimistic"]
    assert alone.endswith("are 41% too large (mean NIS 1, should be 2)")
    assert "without truth" not in alone  # truth exists
    blind = judged([(1.0, band, None, 0.4)])["pessimistic"]
    assert blind.endswith("predictions of the fixes; without truth, position errors can't be checked")
    assert judged([]) == {}
    alike = judged([(1.0, band, None, 0.6), (1.0, band, None, 0.4), (2.0, band, None, 0.6)])
    assert list(alike) == ["pessimistic", "alike", "correlated"]
    assert "can't be estimated without truth" in alike["alike"]


def test_a_nees_that_contradicts_the_nis_is_reported():
    """NIS does not show errors that consecutive fixes have in common."""
    said = judged([(0.43, (1.8, 2.2), 15.4, 0.9)])
    assert list(said) == ["pessimistic", "optimistic_position"]
    assert "too large by a factor of 2.2" in said["pessimistic"]
    assert "too small by a factor of 2.8" in said["optimistic_position"]
    assert list(judged([(3.0, (1.8, 2.2), 15.4, 0.9)])) == ["optimistic"]


def test_correlated_innovations_with_a_correct_nis_are_reported():
    """Correlated errors average out less than the filter assumes, even if NIS is correct."""
    band = (1.8, 2.2)
    said = judged([(2.0, band, None, 0.3), (2.0, band, None, 0.1)])
    assert list(said) == ["correlated", "consistent"]
    assert "on 1 of 2 drives" in said["correlated"]
    assert "of the correct size, but they are correlated" in said["correlated"]
    assert list(judged([(2.0, band, 2.1, 0.3)])) == ["consistent"]  # NEES confirms the filter


def test_correlated_errors_of_the_fixes_are_reported():
    """Consecutive fixes agree, so NIS is low although NEES is correct."""
    band = (1.8, 2.2)
    said = judged([(0.2, band, 2.1, 0.9)])
    assert list(said) == ["lasting"]
    assert "low NIS but a correct NEES, since the errors of consecutive fixes are" in said["lasting"]
    for nis, nees in (
        (0.2, 0.3),
        (0.9, 1.6),
        (0.2, None),
    ):  # both are too low, or there is no NEES
        assert list(judged([(nis, band, nees, 0.1)])) == ["pessimistic"]
    assert list(judged([(0.2, band, 2.1, 0.0), (2.0, band, 2.0, 0.0), (1.0, band, 1.1, 0.0)])) == [
        "pessimistic", "lasting", "consistent",
    ]  # fmt: skip
