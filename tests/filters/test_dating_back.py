"""A start that is dated back: from the log before it alone, with all states of the filter."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from filter_cases import parameters
from sigmaswarm import InputError, dated_back, initial_state, run_filter, simulate, smooth
from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import start_of

EACH_MODEL = pytest.mark.parametrize(
    "model", [name for name, model in MODELS.items() if not model.measures_imu]
)
LATERAL = {"lateral_noise": 0.05, "rear_axle": 1.3, "standstill_noise": 1e-3}


@cache
def hilly() -> Drive:
    """A drive that begins at standstill."""
    return simulate("urban", terrain="hilly", gps="white-1m", duration=60.0, seed=3)


def cases(model: str) -> FilterParameters:
    interval = hilly().nominal_interval
    return replace(parameters(model, **LATERAL), measurement_noise=(1.0, 1.0), nominal_interval=interval)


@EACH_MODEL
def test_no_truth_and_nothing_after_the_start_is_used(model: str):
    drive = hilly()
    start = dated_back(drive, cases(model))
    later = drive.gps.time > start.time
    silent = replace(drive.imu, gz=np.where(drive.imu.time > start.time + 0.02, 9.0, drive.imu.gz))
    jumped = replace(drive.gps, x=drive.gps.x + 50.0 * later)
    changed = dated_back(replace(drive, imu=silent, gps=jumped, truth=None), cases(model))
    assert start.time == initial_state(drive).time == changed.time
    assert np.array_equal(start.mean, changed.mean)
    assert np.array_equal(start.covariance, changed.covariance)


@EACH_MODEL
def test_the_start_keeps_what_the_alignment_determines_and_completes_the_rest(model: str):
    drive, p = hilly(), cases(model)
    start, found = dated_back(drive, p), initial_state(drive)
    if p.n_states == 5:
        assert np.array_equal(start.mean, found.mean)
        return
    plain_mean, plain_covariance = start_of(found, p)
    kept = [0, 1, 2, 3, 4, MODELS[model].gyro_bias]
    rest = [i for i in range(p.n_states) if i not in kept]
    assert start.mean.shape == (p.n_states,)
    assert np.array_equal(start.mean[kept], plain_mean[kept])
    assert np.array_equal(start.covariance[np.ix_(kept, kept)], plain_covariance[np.ix_(kept, kept)])
    assert np.all(start.mean[rest] != plain_mean[rest])
    assert np.all(np.diag(start.covariance)[rest] < np.diag(plain_covariance)[rest])


def test_tilts_are_those_that_all_fixes_show():
    drive, p = hilly(), cases("tilted12")
    start, smoothed = dated_back(drive, p), smooth(drive, p)
    off = start.mean[8:10] - smoothed.initial.mean[8:10]
    assert np.all(np.abs(off) < np.sqrt(np.diag(start.covariance)[8:10]))
    assert np.hypot(*off) < 0.2 * np.hypot(*smoothed.initial.mean[8:10])


def test_correlated_fix_errors_keep_their_prior():
    drive, p = hilly(), replace(cases("planar8"), fix_error=1.0, fix_error_time=60.0)
    start, plain = dated_back(drive, p), start_of(initial_state(drive), p)
    assert len(start.mean) == 10
    assert np.array_equal(start.mean[8:], plain[0][8:])
    assert np.array_equal(start.covariance[8:, :2], plain[1][8:, :2])


@EACH_MODEL
def test_filters_start_from_it(model: str):
    drive, p = hilly(), cases(model)
    start = dated_back(drive, p)
    estimate = run_filter(drive, p, initial=start)
    assert estimate.initial is start
    assert estimate.failure is None
    assert np.abs(estimate.mean[0, :2] - start.mean[:2]).max() < 1.0


def test_where_the_filter_fails_the_start_is_the_alignments():
    drive = hilly()
    p = replace(cases("planar8"), process_noise=(-1.0,) * 8)
    assert np.array_equal(dated_back(drive, p).mean, initial_state(drive).mean)


def test_a_model_that_measures_the_imu_is_refused():
    with pytest.raises(InputError, match="dated_back does not support robot-localization"):
        dated_back(hilly(), parameters("robot-localization"))
