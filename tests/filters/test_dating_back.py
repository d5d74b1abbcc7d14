"""A start that is dated back: from the log before it alone, with all states of the model."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from filter_cases import parameters
from sigmaswarm import InputError, dated_back, initial_state, run_filter, simulate
from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.geodesy import wrap_angle

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
def test_all_states_are_estimated_within_their_deviations(model: str):
    drive, p = hilly(), cases(model)
    start, found, truth = dated_back(drive, p), initial_state(drive), drive.truth
    assert start.mean.shape == (p.n_states,)
    assert not np.array_equal(start.mean[:5], found.mean)
    columns = truth.x, truth.y, truth.vx, truth.vy, np.unwrap(truth.theta)
    error = start.mean[:5] - [np.interp(start.time, truth.time, column) for column in columns]
    error[4] = wrap_angle(error[4])
    assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(start.covariance)[:5]))
    if MODELS[model].tilts:  # what an alignment does not see
        assert np.all(np.diag(start.covariance)[8:10] < np.radians(3.0) ** 2)
        assert abs(start.mean[9]) > 0.0


@EACH_MODEL
def test_filters_start_from_it(model: str):
    drive, p = hilly(), cases(model)
    start = dated_back(drive, p)
    estimate = run_filter(drive, p, initial=start)
    assert estimate.initial is start
    assert estimate.failure is None
    assert np.abs(estimate.mean[0, :2] - start.mean[:2]).max() < 1.0
    assert not np.array_equal(estimate.mean, run_filter(drive, p).mean)


def test_where_the_filter_fails_the_start_is_the_alignments():
    drive = hilly()
    p = replace(cases("planar8"), process_noise=(-1.0,) * 8)
    assert np.array_equal(dated_back(drive, p).mean, initial_state(drive).mean)


def test_a_model_that_measures_the_imu_is_refused():
    with pytest.raises(InputError, match="dated_back does not support robot-localization"):
        dated_back(hilly(), parameters("robot-localization"))
