"""The stated radius of the position: its definition, and its coverage on simulated receivers."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import f

from sigmaswarm import run_filter, simulate
from sigmaswarm.filters.presets import baseline
from sigmaswarm.scoring.consistency import (
    DOF,
    LEVELS,
    TRACKING,
    factor_of,
    lasting_variance,
    radius_record,
)
from sigmaswarm.scoring.evaluation import evaluate


def m8(**options):
    return simulate("urban", seed=3, duration=90.0, imu="icm-20602", gps="ublox-m8", **options)


@pytest.mark.parametrize("level", [0.5, *LEVELS])
def test_the_factor_is_a_quantile_of_the_f_distribution(level):
    assert math.isclose(factor_of(level), math.sqrt(2 * f.ppf(level, 2, DOF)), rel_tol=1e-12)


def test_a_t_distributed_error_is_inside_with_the_stated_probability():
    rng = np.random.default_rng(0)
    variance, lasting = rng.uniform(0.1, 4.0, (2, 200_000))
    t = rng.normal(size=(2, 200_000)) / np.sqrt(rng.chisquare(DOF, 200_000) / DOF)
    found = radius_record(variance, lasting, np.hypot(*t) * np.sqrt(variance + lasting))
    assert abs(found.inside_95 - 0.95) < 0.002
    assert abs(found.inside_999 - 0.999) < 0.0005


def test_correlated_variance_by_receiver_and_filter():
    drive, white = m8(), simulate("urban", seed=3, duration=90.0, imu="icm-20602", gps="white-1m")
    plain = baseline(drive)

    def added(one, parameters, variance=100.0):
        return float(lasting_variance(one, parameters, np.array([30.0]), np.array([variance]))[0])

    of = [added(one, plain) for one in (drive, white)]
    assert abs(of[0] - (2.1**2 - 0.5**2)) < 0.15
    assert of[1] < 0.15
    modeled = dataclasses.replace(plain, kind="ekf", fix_error=0.5)
    assert abs(added(drive, modeled) - (of[0] - 0.5 * 2.1**2)) < 1e-9
    assert abs(added(drive, modeled, 0.7) - (of[0] - 0.7)) < 1e-9, (
        "at most the variance of the filter is subtracted"
    )
    assert added(drive, dataclasses.replace(modeled, fix_error=2.0)) == 0.0


def test_correlated_variance_is_that_of_the_last_fix():
    drive = m8()
    std = np.full(len(drive.gps), 2.0)
    std[100:] = 4.0
    gps = dataclasses.replace(drive.gps, std_x=std, std_y=std)
    stated = dataclasses.replace(drive, gps=gps)
    switch = float(gps.time[100])
    before, after = lasting_variance(stated, baseline(stated), np.array([switch - 1e-6, switch]), np.ones(2))
    assert math.isclose(after / before, 4.0, rel_tol=1e-12)


def test_an_evaluation_contains_the_radius_by_its_definition():
    drive = m8()
    parameters = baseline(drive)
    found = evaluate(drive, parameters)
    record = found.record.radius[drive.name]
    assert list(record) == [TRACKING, "short_outage_drift_m", "outage_drift_m", "long_outage_drift_m"]
    estimate, truth = run_filter(drive, parameters), drive.truth
    at = (truth.time >= estimate.initial.time) & (truth.time <= estimate.time[-1])
    x, y = (np.interp(truth.time[at], estimate.time, estimate.mean[:, i]) for i in (0, 1))
    off = np.hypot(x - truth.x[at], y - truth.y[at])
    variance = (estimate.covariance[:, 0, 0] + estimate.covariance[:, 1, 1]) / 2
    variance = np.interp(truth.time[at], estimate.time, variance)
    lasting = lasting_variance(drive, parameters, truth.time[at], variance)
    tracking = record[TRACKING]
    assert tracking.n == at.sum()
    assert math.isclose(
        tracking.inside_95, np.mean(off <= factor_of(0.95) * np.sqrt(variance + lasting)), abs_tol=1e-3
    )
    assert math.isclose(tracking.sigma_ratio, math.sqrt(2 * variance.mean() / np.mean(off**2)), rel_tol=1e-3)
    drift = found.record.drifts[drive.name]["outage_drift_m"]
    assert record["outage_drift_m"].n == drift.outages
    assert record["outage_drift_m"].radius_95_m > tracking.radius_95_m
    table = found.view.radius_table()
    assert [row[:2] for row in table.rows] == [
        (drive.name, "all fixes"),
        (drive.name, "1 s outage"),
        (drive.name, "5 s outage"),
        (drive.name, "30 s outage"),
    ]


def test_without_truth_the_radius_has_no_coverage():
    drive = dataclasses.replace(m8(), truth=None)
    found = evaluate(drive, baseline(drive))
    record = found.record.radius[drive.name][TRACKING]
    assert record.radius_95_m > 0 and record.inside_95 is None and record.sigma_ratio is None
    assert len(found.view.radius_table().columns) == 5
