"""Costs from scores: the formulas of the design, and no win for a failure."""

import math

import numpy as np
import pytest

from sigmaswarm.errors import InputError
from sigmaswarm.scoring.batch import Scores
from sigmaswarm.tuning.objectives import OBJECTIVES, objective_named


def scores(**given) -> Scores:
    """Two sets on two drives."""
    table = {
        "position_rmse": [[1.0, 3.0], [2.0, 2.5]],
        "heading_rmse": np.radians([[10.0, 20.0], [5.0, 1.0]]),
        "outage_drift": [[4.0, 8.0], [1.0, 2.0]],
        "fix_rmse": [[0.1, 0.2], [0.3, 0.4]],
        "mean_nis": [[2.0, 2.0], [2.0, 2.0]],
    }
    failed = np.array(given.pop("failed", np.zeros((2, 2), bool)))
    return Scores(**{k: np.array(v) for k, v in (table | given).items()}, failed=failed)


def test_the_three_objectives_are_there():
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


@pytest.mark.parametrize(
    ("name", "costs"),
    [
        ("truth-rmse", [2.0, 2.25]),
        # mean over drives of position + 0.1 heading in degrees + 0.1 drift
        ("truth-pose", [((1 + 1 + 0.4) + (3 + 2 + 0.8)) / 2, ((2 + 0.5 + 0.1) + (2.5 + 0.1 + 0.2)) / 2]),
        ("gps-rmse", [0.15, 0.35]),
    ],
)
def test_costs_are_the_mean_over_drives(name: str, costs: list[float]):
    np.testing.assert_allclose(objective_named(name).costs(scores()), costs, rtol=1e-12)


@pytest.mark.parametrize("name", ["truth-rmse", "truth-pose", "gps-rmse"])
def test_a_failure_on_any_drive_costs_infinity(name: str):
    costs = objective_named(name).costs(scores(failed=[[False, True], [False, False]]))
    assert math.isinf(costs[0])
    assert math.isfinite(costs[1])


def test_what_can_not_be_scored_costs_infinity():
    costs = objective_named("truth-rmse").costs(scores(position_rmse=[[np.nan, 1.0], [1.0, np.inf]]))
    assert costs.tolist() == [np.inf, np.inf]
    costs = objective_named("truth-pose").costs(scores(outage_drift=[[np.inf, 1.0], [1.0, 1.0]]))
    assert costs[0] == np.inf
    assert math.isfinite(costs[1])


def test_a_drive_without_outages_or_headings_has_no_such_term():
    none = [[np.nan, np.nan]] * 2
    costs = objective_named("truth-pose").costs(scores(outage_drift=none, heading_rmse=none))
    np.testing.assert_allclose(costs, [2.0, 2.25])


def test_only_the_paper_s_objective_warns():
    assert "copies the GPS" in OBJECTIVES["gps-rmse"].warning
    assert OBJECTIVES["truth-rmse"].warning is OBJECTIVES["truth-pose"].warning is None


def test_an_unknown_name_is_answered_with_the_known_ones():
    with pytest.raises(
        InputError, match=r"no objective is called 'rmse'; choose one of truth-rmse, truth-pose, gps"
    ):
        objective_named("rmse")
