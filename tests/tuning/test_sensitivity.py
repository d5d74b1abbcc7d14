"""Ranges of parameters: closed forms, and a filter with a known result."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.tuning.bounds import Bounds, Dimension
from sigmaswarm.tuning.inflation import NOISE_SCALE, Sensitivity, sensitivities
from sigmaswarm.tuning.tune import tune
from support import make_drive

pytestmark = pytest.mark.usefixtures("undiagnosed")

POOL = ThreadPoolExecutor(1)


class Bowl:
    """cost = 1 + sum of weight * (coordinate - optimum)^2."""

    data = ()

    def __init__(self, weights, optimum, logarithmic):
        lowest, highest = (1e-4, 1e4) if logarithmic else (-4.0, 4.0)
        names = [f"p{i}" for i in range(len(weights))]
        dimensions = [Dimension(name, "", 0, lowest, highest, logarithmic=logarithmic) for name in names]
        self.space = Bounds(tuple(dimensions), "log10")
        self.weights, self.optimum = np.array(weights), np.array(optimum)

    def costs(self, points, executor):
        return 1 + (self.weights * (points - self.optimum) ** 2).sum(axis=1)

    def relative_increase(self, costs, best):
        return np.asarray(costs) / best - 1


def test_the_ranges_of_a_bowl_agree_with_its_closed_form():
    bowl = Bowl([1.0, 0.01, 0.0], [0.5, -1.0, 0.0], logarithmic=False)
    sharp, wide, free = sensitivities(bowl, bowl.optimum, 1.0, POOL)
    # weight x^2 = 0.01; linear interpolation gives slightly smaller ranges
    assert sharp.lowest == pytest.approx(0.4, abs=0.02)
    assert sharp.highest == pytest.approx(0.6, abs=0.02)
    assert wide.lowest == pytest.approx(-2.0, abs=0.1)
    assert wide.highest == pytest.approx(0.0, abs=0.1)
    assert (sharp.identified, wide.identified, free.identified) == (True, True, False)
    assert (free.lowest, free.highest) == (None, None)


def test_ranges_have_the_units_of_the_parameter():
    bowl = Bowl([0.01], [1.0], logarithmic=True)
    (found,) = sensitivities(bowl, bowl.optimum, 1.0, POOL)
    assert found.value == pytest.approx(10.0)
    assert np.log10([found.lowest, found.highest]) == pytest.approx([0.0, 2.0], abs=0.1)


def test_a_parameter_at_its_bound_can_still_be_identified():
    bowl = Bowl([1.0], [4.0], logarithmic=False)
    (found,) = sensitivities(bowl, bowl.optimum, 1.0, POOL)
    assert found.highest is None
    assert found.lowest == pytest.approx(3.9, abs=0.02)
    assert found.identified


def test_a_search_that_has_not_converged_is_reported():
    bowl = Bowl([0.1, 1.0], [2.0, 0.0], logarithmic=False)
    slope, level = sensitivities(bowl, np.zeros(2), 1.4, POOL)
    assert slope.lowest_rise == pytest.approx(1 / 1.4 - 1, abs=0.02)
    assert level.lowest_rise == 0.0


def test_the_common_scale_of_all_noises_is_varied():
    tuning = tune(make_drive(duration=30.0), particles=4, generations=2)
    assert tuning.sensitivities[-1].name == NOISE_SCALE
    flat = replace(tuning, sensitivities=(Sensitivity(NOISE_SCALE, 1.0, None, None),))
    assert any("the common scale of all noise variances" in remark for remark in flat.remarks)


def test_failures_bound_a_range():
    bowl = Bowl([0.0], [0.0], logarithmic=False)
    bowl.costs = lambda points, executor: np.where(points[:, 0] > 1.0, np.inf, 1.0)
    bowl.relative_increase = lambda costs, best: np.where(np.isfinite(costs), 0.0, np.inf)
    (found,) = sensitivities(bowl, bowl.optimum, 1.0, POOL)
    assert found.lowest is None
    assert 0.5 <= found.highest <= 1.0


def test_only_a_likelihood_determines_the_scale_of_the_noise():
    drives = [make_drive(duration=40.0, seed=s) for s in range(2)]
    scale = {}
    for objective in ("truth-rmse", "innovation-nll"):
        tuning = tune(drives, objective=objective, optimizer="de", particles=20, generations=20, seed=1)
        scale[objective] = next(s for s in tuning.sensitivities if s.name == NOISE_SCALE)
        assert tuning.to_dict()["within_1_percent_of_the_cost"].keys() >= {"alpha", "q_theta", NOISE_SCALE}
    sharp = scale["innovation-nll"]
    assert sharp.value == 1.0
    assert 0.7 < sharp.lowest < 1.0 < sharp.highest < 1.4
    blunt = scale["truth-rmse"]  # a small effect remains, since the initial covariance is not scaled
    assert (blunt.highest or 100.0) / (blunt.lowest or 0.01) > 3 * sharp.highest / sharp.lowest
