"""`tune --use fix-error`: searched parameters, the prior on the total variance of a fix, and the result."""

from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm import run_batch, tune
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.tuning.defaults import FIX_ERROR_OBJECTIVE, objective_for
from sigmaswarm.tuning.diagnostics import correlation_warnings
from sigmaswarm.tuning.receiver import prior_costs
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.space import search_space
from support import make_drive

USE = ("lateral", "standstill", "fix-error")


def test_without_truth_only_g_is_searched_and_r_keeps_a_share_of_the_receivers_variance():
    plain = search_space("planar8", "log10", kind="ekf", use=USE[:2])
    blind = search_space("planar8", "log10", kind="ekf", use=USE, fix_std=3.0)
    assert set(blind.names) - set(plain.names) == {"fix_error"}
    g, r = blind.names.index("fix_error"), blind.names.index("r_xy")
    assert (blind.lowest[g], blind.highest[g], blind.logarithmic[g]) == (1e-3, 4.0, True)
    assert blind.lowest[r] == pytest.approx(0.04 * 9.0)
    p = blind.decode(blind.low[np.newaxis])[0]
    assert (p.fix_std, p.fix_error_time, p.kernel) == (3.0, 5.0, "planar8+fix-error")
    weighs = search_space("planar8", "log10", kind="ekf", use=(*USE, "accuracy"), fix_std=3.0)
    assert weighs.lowest[weighs.names.index("accuracy_scale")] == 0.04
    assert weighs.lowest[weighs.names.index("r_xy")] == 1e-4


def test_with_truth_the_time_constant_is_searched_if_the_model_has_roll_and_pitch():
    space = search_space("tilted12", "log10", kind="ekf", use=USE, has_truth=True)
    tau = space.names.index("fix_error_time")
    assert (space.lowest[tau], space.highest[tau], space.logarithmic[tau]) == (0.5, 300.0, True)
    assert space.lowest[space.names.index("r_xy")] == 1e-5
    blind = search_space("tilted12", "log10", kind="ekf", use=USE)
    assert set(space.names) - set(blind.names) == {"fix_error_time"}
    assert blind.decode(blind.low[np.newaxis])[0].fix_error_time == 30.0
    planar = [search_space("planar8", "log10", kind="ekf", use=USE, has_truth=each) for each in (True, False)]
    assert planar[0].dimensions == planar[1].dimensions
    drive = make_drive(duration=25.0)
    assert objective_for([drive], "auto", "planar8", USE) == FIX_ERROR_OBJECTIVE
    assert objective_for([replace(drive, truth=None)], "auto", "tilted12", USE) == "innovation-t"


def test_filter_types_that_adapt_their_noise_are_rejected():
    with pytest.raises(InputError, match="fix-error can't be combined with fuzzy-ukf"):
        search_space("planar8", "log10", kind="fuzzy-ukf", use=USE)


@pytest.mark.parametrize(
    ("r", "g", "decades"), [(0.5, 0.5, 0.0), (0.04, 0.06, -1 / 0.5), (6.0, 4.0, 1 / 0.25)]
)
def test_the_prior_adds_the_white_and_the_correlated_variance(r: float, g: float, decades: float):
    q = (1e-6,) * 8
    p = FilterParameters(1.0, 0.0, 0.0, q, (4.0 * r, 4.0 * r), "planar8", kind="ekf", fix_error=g)
    std = np.full((1, 2), 2.0)
    assert prior_costs([p], std)[0, 0] == pytest.approx(0.5 * decades**2, abs=1e-12)
    white = replace(p, fix_error=None)
    assert prior_costs([white], std)[0, 0] == pytest.approx(0.5 * min(np.log10(r) / 0.5, 0.0) ** 2)


def test_correlated_innovations_are_reported_if_fix_error_would_model_them():
    p = FilterParameters(1.0, 0.0, 0.0, (1e-6,) * 8, (1.0, 1.0), "planar8", kind="ekf")
    (said,) = correlation_warnings(p, [0.9, 0.5, np.nan, 0.1])
    assert "(autocorrelation at lag 1: 0.50)" in said
    for other in (replace(p, fix_error=0.5), replace(p, kind="fuzzy-ukf")):
        assert correlation_warnings(other, [0.9]) == []
    assert correlation_warnings(p, [0.9, 0.2, 0.1]) == correlation_warnings(p, [np.nan]) == []


def wandering(seed: int):
    """Return fixes with a Gauss-Markov error of 1 m and 10 s and little white noise; the stated accuracy is 1 m."""
    drive, rng = make_drive(duration=90.0, gps_std=0.05, seed=seed), np.random.default_rng(seed)
    n = len(drive.gps)
    phi, error = np.exp(-np.diff(drive.gps.time) / 10.0), np.zeros((2, n))
    error[:, 0] = rng.normal(0.0, 1.0, 2)
    for k in range(1, n):
        error[:, k] = phi[k - 1] * error[:, k - 1] + rng.normal(0.0, np.sqrt(1 - phi[k - 1] ** 2), 2)
    gps = replace(
        drive.gps, x=drive.gps.x + error[0], y=drive.gps.y + error[1], std_x=np.ones(n), std_y=np.ones(n)
    )
    return replace(drive, gps=gps)


@pytest.mark.long
def test_without_truth_it_is_consistent_where_white_noise_is_overconfident(tmp_path):
    drive, search = wandering(3), {"model": "planar8", "kind": "ekf", "particles": 16, "generations": 15}
    blind = replace(drive, truth=None)
    white = tune([blind], use=USE[:2], **search)
    tuning = tune([blind], use=USE, out=tmp_path, **search)
    saved = Tuning.load(tmp_path).parameters
    assert saved == tuning.parameters
    assert (saved.fix_std, saved.fix_error_time) == (1.0, 5.0)
    assert saved.fix_error is not None and saved.fix_error > 0.2
    advice = f"TO DO: tune with --use {' '.join(USE[:2])} fix-error"
    assert [w.startswith(advice) for w in white.warnings].count(True) == 1
    assert not any(w.startswith(advice) for w in tuning.warnings)
    with_error, without = (
        score.mean_nees for (score,) in run_batch([drive], [saved, white.parameters]).scores
    )
    assert with_error < 4.0 < without
