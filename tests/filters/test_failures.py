"""A filter that fails is marked, has the cost inf, reports the time, and does not affect other filters."""

from dataclasses import replace
from functools import cache

import numba
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from oracles.box import box_table
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters import packing
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets, run_passes
from sigmaswarm.filters.run import run_filter, run_textbook
from sigmaswarm.tuning.batch import run_batch
from support import make_drive, timeline_of

pytestmark = pytest.mark.skipif(
    numba.config.DISABLE_JIT, reason="whole drives take minutes without the compiler"
)

SOUND = FilterParameters(0.1, 2.0, 0.0, (1e-2,) * 5, (1.0, 1.0))
VARIANCES = [("process_noise", i) for i in range(5)] + [("measurement_noise", i) for i in range(2)]
EACH_VARIANCE = pytest.mark.parametrize(("field", "i"), VARIANCES)


@cache
def drive() -> Drive:
    return make_drive(duration=30, seed=2)


def planted(field: str, i: int, value: float) -> FilterParameters:
    """Return sound parameters with one changed variance."""
    variances = list(getattr(SOUND, field))
    variances[i] = value
    return replace(SOUND, **{field: tuple(variances)})


def with_nan(sensor: str, column: str, after: float) -> tuple[Drive, float]:
    """Return the drive with one value of a sensor replaced by NaN, and its time."""
    table = getattr(drive(), sensor)
    row = int(np.searchsorted(table.time, after))
    values = getattr(table, column).copy()
    values[row] = np.nan
    return replace(drive(), **{sensor: replace(table, **{column: values})}), float(table.time[row])


# --- One lane ----------------------------------------------------------------------------------------------


# A variance of -1 soon leads to NaN; -0.01 leaves finite numbers.
@pytest.mark.parametrize("value", [-1.0, -0.01])
@EACH_VARIANCE
def test_a_negative_variance_costs_inf_and_changes_no_bit_of_other_sets(field: str, i: int, value: float):
    table = box_table(32 + 20, seed=4)[32:]
    company = [FilterParameters(*map(float, row[:3]), tuple(row[3:8]), tuple(row[8:])) for row in table]
    alone = run_batch(drive(), company)
    assert not alone.failed.any()
    mixed = list(company)
    mixed[3] = mixed[17] = planted(field, i, value)  # one in each block of lanes
    result = run_batch(drive(), mixed)
    others = np.setdiff1d(np.arange(20), [3, 17])
    assert result.failed[[3, 17]].all()
    assert np.isinf(result.costs[[3, 17]]).all()
    assert result.scores[3][0].failed
    assert np.isnan(result.scores[3][0].position_rmse)
    assert not result.failed[others].any()
    assert result.costs[others].tobytes() == alone.costs[others].tobytes()
    # repr, since an outage drift that is not computed is NaN
    assert [repr(result.scores[j]) for j in others] == [repr(alone.scores[j]) for j in others]


@EACH_VARIANCE
def test_textbook_filter_fails_too(field: str, i: int):
    short = make_drive(duration=12, seed=2)
    estimate = run_textbook(short, planted(field, i, -1.0))
    assert "the filter failed at t = " in str(estimate.failure)
    failed = np.isnan(estimate.mean).all(axis=1)
    assert failed.any()
    assert not np.any(failed[:-1] & ~failed[1:])  # after a failure, all rows are NaN
    assert np.isnan(estimate.covariance[failed]).all()
    assert np.isfinite(estimate.covariance[~failed]).all()


def test_a_covariance_that_is_indefinite_for_most_of_the_drive_is_a_failure():
    # Each fix leaves a negative variance of the position negative, but so small that S stays positive.
    initial = initial_state(drive())
    timeline = timeline_of(drive(), initial.time)
    sets = [replace(SOUND, process_noise=(*q, 1e-5, 1e-5, 1e-5), measurement_noise=(10.0, 10.0))
            for q in ((-1e-3, 1e-5), (1e-5, -1e-3))]  # fmt: skip
    for parameters in sets:
        assert run_textbook(drive(), parameters).failure is not None
    assert run_passes([FilterPass(timeline, initial, Targets.none(timeline))], sets).failed.all()


def test_an_indefinite_initial_covariance_is_a_failure_without_any_nan():
    initial = initial_state(drive())
    timeline = timeline_of(drive(), initial.time)
    quiet = replace(SOUND, process_noise=(1e-9,) * 5, measurement_noise=(10.0, 10.0))
    for i, j in ((0, 1), (0, 2), (1, 3)):
        covariance = initial.covariance.copy()
        covariance[i, j] = covariance[j, i] = 1.1 * np.sqrt(covariance[i, i] * covariance[j, j])
        start = replace(initial, covariance=covariance)
        assert run_passes([FilterPass(timeline, start, Targets.none(timeline))], [quiet]).failed.all(), (i, j)


# --- Whole drives ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sensor", "column"), [("imu", "ax"), ("imu", "ay"), ("imu", "gz"), ("gps", "x"), ("gps", "y")]
)
def test_nan_in_the_data_is_a_failure_with_its_time(sensor: str, column: str):
    spoiled, when = with_nan(sensor, column, after=20.0)
    result = run_batch(spoiled, [SOUND, SOUND])
    assert result.failed.all()
    assert np.isinf(result.costs).all()

    estimate = run_filter(spoiled, SOUND)
    assert estimate.failure is not None
    first = estimate.time[np.searchsorted(estimate.time, when)]  # the first sample after the NaN
    assert f"t = {first:.3f} s" in estimate.failure
    assert spoiled.name in estimate.failure
    failed = estimate.time >= first
    assert np.isnan(estimate.mean[failed]).all()
    assert np.isnan(estimate.covariance[failed]).all()
    sound = run_filter(drive(), SOUND)
    assert estimate.mean[~failed].tobytes() == sound.mean[~failed].tobytes()


def test_nan_on_one_drive_fails_the_set_but_not_its_other_scores():
    spoiled, _ = with_nan("imu", "gz", after=20.0)
    both, good = run_batch([drive(), spoiled], [SOUND]), run_batch(drive(), [SOUND])
    assert np.isinf(both.costs[0])
    assert both.scores[0][1].failed
    assert repr(both.scores[0][0]) == repr(good.scores[0][0])


def test_nan_in_the_last_sample_is_a_failure():
    # No later fix reads the state, nothing is compared with truth, and the covariance is independent of the yaw rate.
    spoiled, _ = with_nan("imu", "gz", after=float(drive().imu.time[-1]))
    initial = initial_state(spoiled)
    timeline = timeline_of(spoiled, initial.time)
    assert run_filter(spoiled, SOUND).failure is not None
    assert run_passes([FilterPass(timeline, initial, Targets.none(timeline))], [SOUND]).failed.all()


def test_the_failure_of_a_negative_variance_names_variances():
    estimate = run_filter(drive(), planted("measurement_noise", 0, -1.0))
    assert estimate.failure is not None
    first = estimate.time[np.flatnonzero(np.isnan(estimate.mean[:, 0]))[0]]
    assert f"t = {first:.3f} s" in estimate.failure
    assert "variances are positive" in estimate.failure


def test_a_sound_filter_reports_no_failure():
    estimate = run_filter(drive(), SOUND)
    assert estimate.failure is None
    assert np.isfinite(estimate.mean).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from([-1e-3, -1e-8, 1e-8, 1e-3]))
def test_definite_agrees_with_the_eigenvalues_of_the_correlation(seed, smallest):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    p = (turn * np.array([smallest, *rng.uniform(0.5, 2.0, 4)])) @ turn.T
    p = (p + p.T) / 2
    some = np.array([p, np.eye(5), np.diag([1.0, 1.0, 1.0, 1.0, np.nan]), -np.eye(5)])
    least = -1.0
    if np.all(np.diag(p) > 0):
        scale = np.sqrt(np.diag(p))
        least = np.linalg.eigvalsh(p / np.outer(scale, scale))[0] + 1e-9
    assume(abs(least) > 1e-12)
    many = packing.definite(np.array([some, some[::-1]]))
    assert many.tolist() == [[least > 0, True, False, False], [False, False, True, least > 0]]
