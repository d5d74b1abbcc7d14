"""Scores without truth: likelihood and predictions of fixes, compared with the textbook filter and SciPy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq, minimize_scalar
from scipy.special import exp1
from scipy.stats import multivariate_normal, multivariate_t

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.outages import balanced_windows, hidden_fixes
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.filters import constants
from sigmaswarm.filters.models import gps_position
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter, run_innovations
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.scoring.score import negative_log_t
from sigmaswarm.scoring.targets import forecast_pass
from support import make_drive, quickly, timeline_of

PLANAR5 = FilterParameters(0.5, 2.0, 1.0, (1e-4, 1e-4, 1e-3, 1e-3, 1e-5), (1.2, 0.8), latency=0.05)
PLANAR8 = FilterParameters(
    0.3,
    2.0,
    0.0,
    (1e-5,) * 2 + (1e-4,) * 2 + (1e-6,) + (1e-7,) * 2 + (1e-9,),
    (1.0, 1.0),
    "planar8",
    gate=4.0,
)
ADAPTIVE = replace(PLANAR5, kind="adaptive-ukf")
STRONG = replace(PLANAR5, kind="strong-tracking-ukf", forgetting=0.95)
ROBUST = replace(PLANAR8, gate=None, robust_dof=3.0)
SETS = {"planar5": PLANAR5, "planar8": PLANAR8, "adaptive": ADAPTIVE, "strong": STRONG, "robust": ROBUST}
DRIVE = replace(
    make_drive(duration=40.0, imu_rate=20.0, jitter=0.3, seed=2), metadata={"gps_lever_arm_m": [1.0, 0.4]}
)


def by_textbook(drive: Drive, parameters: FilterParameters, hidden: np.ndarray):
    """Return innovations nu and S at all fixes, and which of them were hidden, with the textbook filter."""
    start = initial_state(drive)
    line = timeline_of(drive, start.time).hiding(hidden)
    car = TextbookCar(line, parameters, start)
    h = gps_position(tuple(line.lever[:2]), parameters.latency)
    found, fixes = [], iter(line.fixes)
    for i in range(len(line.dt)):
        absorbed, line.updates[i] = line.updates[i], False
        fix_flag = car.flags[i]
        car.flags[i] = 0
        car.step(i)  # prediction only
        if absorbed or line.hides[i]:
            z = next(fixes)[:2]
            innovation = car.filter.measure(z, np.diag(car.noise.measurement_noise), h)
            found.append((innovation.nu, innovation.variance, bool(line.hides[i])))
            if absorbed:
                car._update_with_fix(z, np.zeros(2), float(line.end[i]))
        line.updates[i], car.flags[i] = absorbed, fix_flag
    nu, s, hides = zip(*found, strict=True)
    return np.array(nu), np.array(s), np.array(hides)


def scale_of(dof: float) -> float:
    """Return c = 2 x, where x e^x E1(x) = v / (v + 2)."""
    return 2 * brentq(lambda x: x * np.exp(x) * exp1(x) - dof / (dof + 2), 1e-3, 1e2, xtol=1e-14)


@pytest.mark.parametrize(
    ("dof", "scale", "rounded"),
    quickly(
        [
            (constants.INNOVATION_DOF, constants.INNOVATION_SCALE, 2.907),
            (constants.FORECAST_DOF, constants.FORECAST_SCALE, 6.610),
        ],
        lambda dof, scale, rounded: rounded == 6.610,
    ),
)
def test_gaussian_innovations_keep_their_nis_with_students_t(dof: float, scale: float, rounded: float):
    assert scale == pytest.approx(scale_of(dof), rel=1e-12)
    assert scale == pytest.approx(rounded, abs=5e-4)
    # also for samples: of all S = k I, the most likely one has k = 1; with c = v, it is too small
    nu = np.random.default_rng(0).standard_normal((50_000, 2))

    def best(c: float) -> float:
        return minimize_scalar(
            lambda k: negative_log_t(nu, np.tile(k * np.eye(2), (len(nu), 1, 1)), dof, c).mean(),
            bounds=(0.5, 1.5),
            method="bounded",
        ).x

    assert 2 / best(scale) == pytest.approx(2.0, abs=0.02)
    assert 2 / best(dof) == pytest.approx({4: 2.752, 8: 2.421}[int(dof)], abs=0.02)


def test_with_scale_v_it_is_the_density_of_students_t():
    nu, s = np.array([[3.0, -1.0], [0.0, 0.5]]), np.array([[[2.0, 0.3], [0.3, 1.0]]] * 2)
    ours = negative_log_t(nu, s, 5.0, 5.0)
    np.testing.assert_allclose(ours, [-multivariate_t(shape=s[0], df=5).logpdf(v) for v in nu], rtol=1e-12)


def test_distant_fixes_have_a_finite_cost():
    gps = DRIVE.gps
    place = np.arange(len(gps))
    for size, off in ((1e100, place % 30 == 29), (1e5, place > 100)):
        x = gps.x + size * off
        score = BatchScorer.prepare(
            [replace(DRIVE, gps=replace(gps, x=x))], PassOptions(forecasts=True)
        ).scores([ROBUST])
        assert not score.failed.any()
        assert np.isfinite([score.innovation_t, score.forecast_t]).all()


@pytest.mark.parametrize("kind", SETS)
def test_innovations_and_their_likelihood_agree_with_the_textbook(kind: str):
    parameters = SETS[kind]
    nu, s, _ = by_textbook(DRIVE, parameters, np.zeros(len(DRIVE.gps), bool))
    found = run_innovations(DRIVE, parameters)
    np.testing.assert_allclose(found.innovation, nu, atol=1e-7)
    np.testing.assert_allclose(found.covariance, s, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(
        found.time, DRIVE.gps.time[DRIVE.gps.time > initial_state(DRIVE).time][: len(nu)]
    )
    likelihood = [multivariate_normal(cov=c).logpdf(v) for v, c in zip(nu, s, strict=True)]
    score = BatchScorer.prepare([DRIVE]).scores([parameters])[0, 0]
    assert score.innovation_nll == pytest.approx(-np.mean(likelihood), rel=1e-6)
    nis = [v @ np.linalg.solve(c, v) for v, c in zip(nu, s, strict=True)]
    assert score.mean_nis == pytest.approx(np.mean(nis), rel=1e-6)
    assert score.innovation_t == pytest.approx(negative_log_t(nu, s, 4.0, scale_of(4)).mean(), rel=1e-6)
    np.testing.assert_allclose(found.nis, nis, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(np.square(found.normalized).sum(axis=1), nis, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize(
    "kind", quickly([(kind,) for kind in SETS], lambda kind: kind in ("planar5", "robust"))
)
def test_predictions_agree_with_a_textbook_filter_without_the_hidden_fixes(kind: str):
    parameters = SETS[kind]
    drive_pass = forecast_pass(prepare_drive(DRIVE), seed=5)
    hidden = np.isin(DRIVE.gps.time, drive_pass.timeline.end[drive_pass.timeline.hides])
    assert 20 < hidden.sum() < len(DRIVE.gps) / 2
    nu, s, hides = by_textbook(DRIVE, parameters, hidden)
    expected = math.sqrt(np.square(nu[hides]).sum(axis=1).mean())
    score = BatchScorer.prepare([DRIVE], PassOptions(forecasts=True, outage_seed=5)).scores([parameters])[
        0, 0
    ]
    assert score.forecast_rmse == pytest.approx(expected, rel=1e-6)
    by_hand = negative_log_t(nu[hides], s[hides], 8.0, scale_of(8)).mean()
    assert score.forecast_t == pytest.approx(by_hand, rel=1e-6)
    # hiding fixes does not change the scores with all fixes
    assert score.innovation_nll == BatchScorer.prepare([DRIVE]).scores([parameters])[0, 0].innovation_nll


def test_a_hidden_fix_has_no_effect_on_the_filter():
    gps = DRIVE.gps
    drive_pass = forecast_pass(prepare_drive(DRIVE), seed=1)
    hidden = np.isin(gps.time, drive_pass.timeline.end[drive_pass.timeline.hides])
    moved = replace(DRIVE, gps=replace(gps, x=gps.x + 1000.0 * hidden))
    far, near = (
        BatchScorer.prepare([d], PassOptions(forecasts=True, outage_seed=1)).scores([PLANAR5])[0, 0]
        for d in (moved, DRIVE)
    )
    assert near.forecast_rmse < 10.0
    # the error of every prediction increases by 1000 m, since the filter does not use the hidden fixes
    assert far.forecast_rmse == pytest.approx(1000.0, abs=10.0)


def test_nees_agrees_with_that_of_the_trajectory():
    estimate = run_filter(DRIVE, PLANAR5)
    x, y = (np.interp(estimate.time, DRIVE.truth.time, c) for c in (DRIVE.truth.x, DRIVE.truth.y))
    error = estimate.mean[:, :2] - np.stack([x, y], axis=1)
    p = estimate.covariance[:, :2, :2]
    nees = np.einsum("ti,tij,tj->t", error, np.linalg.inv(p), error)
    score = BatchScorer.prepare([DRIVE]).scores([PLANAR5])[0, 0]
    assert score.mean_nees == pytest.approx(nees.mean(), rel=0.01)  # includes truth at the start


@given(
    start=st.floats(-1e3, 1e6),
    duration=st.floats(0.0, 900.0),
    seed=st.integers(0, 99),
)
def test_balanced_windows_are_distributed_over_the_drive(start: float, duration: float, seed: int):
    end = start + duration
    windows = balanced_windows(start, end, np.random.default_rng(seed))
    again = balanced_windows(start, end, np.random.default_rng(seed))
    np.testing.assert_array_equal(windows, again)
    lengths = windows[:, 1] - windows[:, 0]
    assert np.all((lengths > 3 - 1e-6) & (lengths < 5 + 1e-6))
    before = np.concatenate([[start], windows[:-1, 1]]) if len(windows) else np.empty(0)
    assert np.all(windows[:, 0] - before >= 5.0 - 1e-6)
    assert np.all(windows[:, 1] <= end + 1e-6)
    assert (len(windows) >= 1) == (end - start >= 10.0)
    slot = (end - start) / max(len(windows), 1)
    assert np.all((windows[:, 0] - start) // slot == np.arange(len(windows)))


def test_a_window_hides_fixes_at_both_ends():
    assert hidden_fixes([0.0, 1.0, 2.0, 3.0], [[1.0, 2.0]]).tolist() == [False, True, True, False]
