"""Costs from scores: formulas of the objectives, and inf for a failure."""

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sigmaswarm.errors import InputError
from sigmaswarm.scoring.batch import NAMES, Scores
from sigmaswarm.tuning.config import SearchConfig
from sigmaswarm.tuning.objectives import OBJECTIVES, conditional_value_at_risk, parse_objective


def scores(**given) -> Scores:
    """Return the scores of two sets on two drives."""
    table = {
        "position_rmse": [[1.0, 3.0], [2.0, 2.5]],
        "heading_rmse": np.radians([[10.0, 20.0], [5.0, 1.0]]),
        "outage_drift": [[4.0, 8.0], [1.0, 2.0]],
        "fix_rmse": [[0.1, 0.2], [0.3, 0.4]],
        "forecast_rmse": [[5.0, 7.0], [1.0, 2.0]],
        "innovation_nll": [[3.0, 4.0], [-1.0, -2.0]],
        "innovation_t": [[2.0, 4.0], [1.0, -2.0]],
        "forecast_t": [[1.0, 2.0], [3.0, 5.0]],
        "mean_nis": [[2.0, 4.0], [1.0, 2.0]],
        "mean_nees": [[20.0, 2.0], [2.0, 2.0]],
    }
    shape = np.shape(next(iter(given.values()), np.zeros((2, 2))))
    known = {name: values for name, values in (table | given).items() if np.shape(values) == shape}
    numbers = [known.get(name, np.full(shape, name != "failed" and np.nan)) for name in NAMES]
    return Scores(np.array(numbers, dtype=float))


def test_the_three_objectives_are_defined():
    assert {"truth-rmse", "truth-pose", "gps-rmse"} <= set(OBJECTIVES)
    assert [OBJECTIVES[n].needs_truth for n in ("truth-rmse", "truth-pose", "gps-rmse")] == [
        True,
        True,
        False,
    ]
    assert [OBJECTIVES[n].needs_outages for n in ("truth-rmse", "truth-pose", "gps-rmse")] == [
        False,
        True,
        False,
    ]
    assert all(o.name == name and o.summary for name, o in OBJECTIVES.items())
    help_text = SearchConfig.model_fields["objective"].description or ""
    assert list(OBJECTIVES) == [name for name in re.split(r"[^a-z-]+", help_text) if name in OBJECTIVES]


@pytest.mark.parametrize(
    ("name", "costs"),
    [
        ("truth-rmse", [2.0, 2.25]),
        # mean over drives of position + 0.1 heading in degrees + 0.1 drift
        ("truth-pose", [((1 + 1 + 0.4) + (3 + 2 + 0.8)) / 2, ((2 + 0.5 + 0.1) + (2.5 + 0.1 + 0.2)) / 2]),
        ("gps-rmse", [0.15, 0.35]),
        ("innovation-nll", [3.5, -1.5]),
        ("innovation-t", [3.0, -0.5]),
        ("forecast-t", [1.5, 4.0]),
        ("0.5 innovation-t + 0.5 forecast-t", [2.25, 1.75]),
        ("outage-rmse", [6.0, 1.5]),
        ("nis", [math.log(2) / 2, math.log(2) / 2]),
        ("nees", [math.log(10) / 2, 0.0]),
        ("truth-rmse + 0.5 nees", [2.0 + math.log(10) / 4, 2.25]),
        ("2*truth-rmse+1e-1*outage-rmse", [4.6, 4.65]),
    ],
)
def test_costs_are_the_mean_over_drives(name: str, costs: list[float]):
    np.testing.assert_allclose(parse_objective(name).costs(scores()), costs, rtol=1e-12)


@pytest.mark.parametrize("name", ["truth-rmse", "truth-pose", "gps-rmse"])
def test_a_failure_on_any_drive_costs_infinity(name: str):
    costs = parse_objective(name).costs(scores(failed=[[False, True], [False, False]]))
    assert math.isinf(costs[0])
    assert math.isfinite(costs[1])


def test_a_score_that_is_nan_costs_infinity():
    costs = parse_objective("truth-rmse").costs(scores(position_rmse=[[np.nan, 1.0], [1.0, np.inf]]))
    assert costs.tolist() == [np.inf, np.inf]
    costs = parse_objective("truth-pose").costs(scores(outage_drift=[[np.inf, 1.0], [1.0, 1.0]]))
    assert costs[0] == np.inf
    assert math.isfinite(costs[1])


def test_terms_without_outages_or_headings_are_omitted():
    none = [[np.nan, np.nan]] * 2
    costs = parse_objective("truth-pose").costs(scores(outage_drift=none, heading_rmse=none))
    np.testing.assert_allclose(costs, [2.0, 2.25])


def test_only_the_paper_s_objective_has_a_warning():
    assert "copies the fixes" in OBJECTIVES["gps-rmse"].warning
    assert OBJECTIVES["truth-rmse"].warning is OBJECTIVES["truth-pose"].warning is None


def test_the_error_for_an_unknown_name_lists_the_known_ones():
    with pytest.raises(
        InputError, match=r"no objective is called 'rmse'; choose one of truth-rmse, truth-pose, innovation"
    ):
        parse_objective("rmse")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("truth-rmse + ", "no objective is called ''"),
        ("truth-rmse - nees", "no objective is called 'truth-rmse - nees'"),
        ("-1 nees", "no objective is called '-1 nees'"),
        ("0 nees", "the weight of nees must be positive"),
        ("1.2.3 nees", "'1.2.3' is not a weight"),
        ("1e999 nees", "must be positive"),
    ],
)
def test_a_sum_that_can_not_be_parsed_is_rejected(name: str, said: str):
    with pytest.raises(InputError, match=re.escape(said)):
        parse_objective(name)


def test_a_sum_needs_the_data_of_its_terms():
    both = parse_objective("gps-rmse + 0.25 truth-pose + outage-rmse")
    assert both.name == "gps-rmse + 0.25 truth-pose + outage-rmse"
    assert both.needs_truth
    assert both.needs_outages
    assert both.needs_forecasts
    assert "copies the fixes" in both.warning
    assert not parse_objective("innovation-nll + nis").needs_truth


@given(
    costs=arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 8)), elements=st.floats(-10, 10)),
    share=st.floats(0.01, 1.0),
)
def test_the_worst_mean_is_the_conditional_value_at_risk(costs: np.ndarray, share: float):
    # Rockafellar and Uryasev: CVaR = min over v of v + mean(max(c - v, 0)) / share; v can be one of the values
    by_definition = [min(v + np.maximum(row - v, 0).mean() / share for v in row) for row in costs]
    np.testing.assert_allclose(conditional_value_at_risk(costs, share), by_definition, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(conditional_value_at_risk(costs, 1.0), costs.mean(axis=1))


def test_with_worst_a_single_bad_drive_determines_the_cost():
    table = scores(position_rmse=[[1.0, 1.0, 7.0], [4.0, 4.0, 4.0]], failed=np.zeros((2, 3), bool))
    truth = parse_objective("truth-rmse")
    assert truth.costs(table).tolist() == [3.0, 4.0]
    assert truth.costs(table, 1 / 3).tolist() == [7.0, 4.0]


def test_an_increase_of_a_likelihood_equals_the_increase_of_errors():
    assert parse_objective("truth-rmse").relative_increase(2.2, 2.0) == pytest.approx(0.1)
    # errors larger by 10% on two axes, with S to match, cost 2 ln 1.1 nats, independent of the value of the cost
    nll = parse_objective("innovation-nll")
    assert nll.relative_increase(-3.0 + 2 * math.log(1.1), -3.0) == pytest.approx(0.1)
    assert nll.relative_increase(np.array([np.inf, 0.0]), 0.0).tolist() == [np.inf, 0.0]
    # independent of the weight and of the number of elements of a measurement
    for weight in ("0.01", "100"):
        part = parse_objective(f"{weight} innovation-nll")
        assert part.relative_increase(5.0 + 2 * float(weight) * math.log(1.1), 5.0) == pytest.approx(0.1)
    halves = parse_objective("0.5 innovation-t + 0.5 forecast-t")
    assert halves.needs_forecasts and not halves.needs_truth
    assert halves.relative_increase(-3.0 + 2 * math.log(1.1), -3.0) == pytest.approx(0.1)
    with_rmse = parse_objective("innovation-t + truth-rmse")  # all terms count as nats
    assert with_rmse.relative_increase(-3.0 + 2 * math.log(1.1), -3.0) == pytest.approx(0.1)
    assert nll.relative_increase(3 * math.log(1.1), 0.0, elements=3) == pytest.approx(0.1)
    assert parse_objective("nis + nees").relative_increase(0.001 + 4 * math.log(1.1), 0.001) == pytest.approx(
        0.1
    )
    assert parse_objective("truth-pose + 0.2 nees").relative_increase(2.2, 2.0) == pytest.approx(0.1)


@pytest.mark.parametrize("share", [0.0, -1.0, 1.5, math.nan])
def test_an_invalid_share_is_rejected(share: float):
    with pytest.raises(InputError, match="worst = "):
        conditional_value_at_risk(np.ones((1, 3)), share)


def test_failures_beyond_the_worst_share_give_no_nan():
    assert conditional_value_at_risk(np.array([[np.inf, np.inf, 1.0, 2.0]]), 0.25).tolist() == [np.inf]
