"""Each recommended remedy improves the value in its reason, and names no option that was not given."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from doctor.test_clock_search import robot
from sigmaswarm import Drive, Tuning, clip, diagnose, evaluate, simulate, split_time, tune
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD
from sigmaswarm.tuning.receiver import FixNoise, accuracy_warnings, fix_noise, noise_warnings
from sigmaswarm.wording import TO_DO
from support import quickly


@cache
def town() -> Drive:
    return simulate("urban", run=2, duration=90.0, imu_rate=50.0, gps="white-1m")


FEW = {"trials": 1, "particles": 12, "generations": 10}


def smooth(std: float | None = None) -> Drive:
    """Return fixes without truth whose errors of 0.3 m last 10 s (time constant); drive.toml states ``std``."""
    time, rng = town().gps.time, np.random.default_rng(3)
    stay = np.exp(-np.median(np.diff(time)) / 10.0)
    pushes = 0.3 * np.sqrt(1 - stay**2) * rng.standard_normal((2, len(time)))
    error = lfilter([1.0], [1.0, -stay], pushes)
    x, y = np.array([np.interp(time, town().truth.time, v) for v in (town().truth.x, town().truth.y)]) + error
    gps = type(town().gps)(town().gps.time, x, y)
    return replace(town(), truth=None, gps=gps, metadata={} if std is None else {"gps_std_m": std})


def to_dos(tuning: Tuning[Any], about: str) -> list[str]:
    return [r for r in tuning.remarks if r.startswith(TO_DO) and about in r]


def drift_of(drive: Drive, tuning: Tuning[Any]) -> float:
    return evaluate(drive, tuning.parameters).scores[drive.name]["tuned"].outage_drift


def with_errors(white: float, slow: float) -> Drive:
    """Return fixes at 1 Hz with white and Gauss-Markov (60 s) errors, m per axis, and without stated accuracy."""
    drive, rng = (
        simulate("urban", run=4, duration=150.0, imu_rate=50.0, gps="white-1m"),
        np.random.default_rng(7),
    )
    time, stay = drive.gps.time[::5], np.exp(-1 / 60)
    pushes = slow * np.sqrt(1 - stay**2) * rng.standard_normal((2, len(time)))
    error = lfilter([1.0], [1.0, -stay], pushes) + white * rng.standard_normal((2, len(time)))
    true = np.array([np.interp(time, drive.truth.time, v) for v in (drive.truth.x, drive.truth.y)])
    return replace(drive, truth=None, gps=type(drive.gps)(time, *(true + error)), metadata={})


def with_assumed_std(drive: Drive) -> Drive:
    return replace(drive, metadata={"gps_std_m": UNSTATED_GPS_STD})


def test_using_the_scatter_of_accurate_fixes_reduces_the_drift_on_another_part():
    train, test = split_time(with_errors(0.1, 0.0), 0.6)
    options = {"model": "planar8", "use": ["lateral", "robust"], **FEW}
    shown, assumed = (tune(drive, **options) for drive in (train, with_assumed_std(train)))
    assert shown.record.shown_std == pytest.approx(0.1, rel=0.2)
    (said,) = [remark for remark in shown.remarks if "`tune` used the scatter" in remark]
    assert "m per axis: with this value the baseline drifts" in said and not said.startswith(TO_DO)
    assert drift_of(test, shown) < 0.8 * drift_of(test, assumed)
    radius = [evaluate(test, t).record.radius[test.name]["tracking"].radius_95_m for t in (shown, assumed)]
    assert radius[0] > 0.8 * radius[1]  # slowly varying errors of the fixes can still be as large as assumed


def test_a_scatter_that_does_not_reduce_the_baseline_s_drift_is_not_used():
    tuning = tune(with_errors(0.3, 2.0), model="planar8", use=["lateral", "robust"], **FEW)
    assert tuning.record.shown_std is None
    (said,) = [remark for remark in tuning.remarks if "gps_std_m" in remark]
    assert "The fixes do not show their accuracy either" in said


def test_fix_error_keeps_the_assumed_standard_deviation():
    """The option models slowly varying errors of the assumed size, which the scatter does not show."""
    tuning = tune(with_errors(0.1, 0.0), model="planar8", kind="ekf", use=["lateral", "fix-error"], **FEW)
    assert tuning.record.shown_std is None
    assert tuning.parameters.fix_std == UNSTATED_GPS_STD


@pytest.mark.long
def test_using_the_scatter_increases_the_nis_of_a_smooth_receiver():
    options = {"model": "planar8", "use": ["lateral"], **FEW}
    shown, assumed = (tune(drive, **options) for drive in (smooth(), with_assumed_std(smooth())))
    nis = [evaluate(smooth(), t.parameters).consistency[town().name].mean_nis for t in (assumed, shown)]
    r = [np.sqrt(np.mean(t.parameters.measurement_noise)) for t in (assumed, shown)]
    assert r[0] > 1.0 and r[1] < 2 * shown.record.shown_std, r
    assert nis[1] > 2 * nis[0], nis


def test_an_r_that_copies_the_fixes_leads_to_advice_on_gps_std_m_or_the_accuracy():
    copying = replace(tune(smooth(0.05), model="planar8", use=["lateral"], **FEW).parameters)
    copying = replace(copying, measurement_noise=(0.01**2, 0.01**2))
    (said,) = noise_warnings(copying, [FixNoise(float("nan"), 0.1)], use=["lateral"])
    assert "write it as gps_std_m at the top of drive.toml" in said and "--use" not in said
    assert fix_noise(smooth(1.5)).stated == 1.5
    (said,) = noise_warnings(copying, [FixNoise(1.5, 0.1)], use=["lateral"])
    assert "tune with --use lateral accuracy" in said


def test_following_the_advice_on_the_accuracy_removes_the_advice():
    drive = replace(town(), truth=None)
    std = np.random.default_rng(1).uniform(1.0, 3.0, len(drive.gps))
    drive = replace(drive, gps=replace(drive.gps, std_x=std, std_y=std))
    options = {"model": "planar8", **FEW}
    with_it = tune(drive, use=["lateral", "accuracy"], **options)
    scaled = replace(with_it.parameters, accuracy_scale=1e-3, measurement_noise=(1.0, 1.0))
    (said,) = accuracy_warnings(scaled, [2.0], ["lateral", "accuracy"])
    use = re.findall(r"tune with --use (.*?)\.", said)[0].split()
    without = tune(drive, use=use, **options)
    assert without.parameters.accuracy_scale is None and not to_dos(
        without, "`accuracy` has hardly any effect"
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("objective", "better"),
    quickly([("truth-rmse", "truth-rmse + 0.2 nees"), ("truth-pose", "truth-pose + 0.2 nees")],
            lambda objective, better: objective == "truth-rmse"),
)  # fmt: skip
def test_nees_in_the_objective_determines_the_scale_of_the_covariances(objective: str, better: str):
    options = {"model": "planar8", "use": ["lateral"], **FEW}
    free = tune(town(), objective=objective, **options)
    assert f"tune with '{better}'" in to_dos(free, "scale of the covariances")[0]
    bound = tune(town(), objective=better, **options)
    assert not to_dos(bound, "scale of the covariances")
    off = [
        abs(np.log(evaluate(town(), t.parameters).consistency[town().name].mean_nees / 2))
        for t in (free, bound)
    ]
    assert off[1] < off[0]


@pytest.mark.long
def test_the_lateral_constraint_determines_the_heading():
    options = {"model": "planar8", "objective": "innovation-t", **FEW}
    without = tune(town(), use=[], **options)
    assert "--use lateral" in to_dos(without, "heading")[0]
    with_it = tune(town(), use=["lateral"], **options)
    assert not to_dos(with_it, "heading")
    off = [evaluate(town(), t.parameters).mean("tuned", "heading_rmse_deg") for t in (without, with_it)]
    assert off[1] < off[0]


@pytest.mark.long
def test_states_for_correlated_errors_whiten_the_innovations():
    options: dict[str, Any] = {"model": "planar8", "kind": "ekf", **FEW}
    plain = tune(smooth(0.3), use=["lateral"], **options)
    use = re.findall(r"tune with --use (.*?):", to_dos(plain, "correlated")[0])[0].split()
    assert use == ["lateral", "fix-error"]
    mended = tune(smooth(0.3), use=use, **options)
    assert not to_dos(mended, "correlated")
    lag = [
        evaluate(smooth(), t.parameters).consistency[town().name].autocorrelation[0] for t in (plain, mended)
    ]
    assert abs(lag[1]) < lag[0]


def test_few_fixes_lead_to_no_advice_on_fix_error():
    """With 142 fixes, these states doubled the drift."""
    few = clip(smooth(0.3), 0.0, 45.0)
    assert not to_dos(tune(few, model="planar8", kind="ekf", use=["lateral"], **FEW), "correlated")


@pytest.mark.long
def test_splitting_a_log_that_starts_in_reverse_as_the_doctor_recommends_prevents_divergence():
    whole = robot(True, 0)
    (found,) = [f for f in diagnose(whole).findings if f.code == "reverse-start"]
    at = float(re.findall(r"--at (\d+)", found.remedy)[0])
    part = split_time(whole, at=at)[1]
    assert "reverse-start" not in diagnose(part).codes
    assert to_dos(tune(whole), "diverged")
    assert not to_dos(tune(part), "DO NOT USE THIS FILTER")


@pytest.mark.parametrize(
    ("log",),
    quickly(
        [(smooth,), (partial(robot, True, 0),), (partial(with_errors, 0.3, 2.0),)], lambda log: log is smooth
    ),
)
def test_without_given_options_no_advice_recommends_leaving_one_out(log: Callable[[], Drive]):
    found = tune(log(), trials=1, particles=4, generations=2)
    assert not [r for r in found.remarks if "omit " in r]
