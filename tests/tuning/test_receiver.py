"""A tuned R compared with the accuracy of the fixes: a filter that copies the fixes causes a warning."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sigmaswarm import evaluate, split_time
from sigmaswarm.doctor import evidence
from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import true_std
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, baseline
from sigmaswarm.simulation.scenarios import simulate
from sigmaswarm.tuning.receiver import FixNoise, accuracy_warnings, fix_noise, noise_warnings
from sigmaswarm.tuning.tune import tune


@cache
def town() -> Drive:
    return simulate("urban", duration=60.0, gps="white-1m", imu_rate=50.0)


@cache
def unstated() -> Drive:
    """Return a drive without truth and without the receiver's stated accuracy."""
    return replace(town(), truth=None, metadata={}, gps=replace(town().gps, std_x=None, std_y=None))


NONE = float("nan")


def stating(drive: Drive, std: float) -> Drive:
    column = np.full(len(drive.gps), std)
    return replace(drive, gps=replace(drive.gps, std_x=column, std_y=column))


def with_r(std: float):
    return replace(DEFAULTS, measurement_noise=(std**2, std**2))


@pytest.mark.parametrize(
    ("std", "noise", "said"),
    [
        (
            0.05,
            FixNoise(1.8, 0.1),
            "of 0.05 m per axis, but the receiver states a standard deviation of 1.8 m",
        ),
        (0.05, FixNoise(NONE, 1.0), "scatter by 1 m about a path that is consistent with the IMU"),
        (
            0.9,
            FixNoise(1.8, 0.1),
            "of 1.8 m per axis, but its fixes scatter by only 0.1 m, so their errors are correlated",
        ),
        (0.1, FixNoise(NONE, 0.1), "does not state the accuracy of its fixes. Their small scatter of 0.1 m"),
        (0.9, FixNoise(1.0, 1.0), ""),
        (0.9, FixNoise(NONE, 1.0), ""),
        (0.9, FixNoise(NONE, NONE), ""),
    ],
)
def test_r_is_compared_with_the_stated_accuracy_and_the_scatter(std: float, noise: FixNoise, said: str):
    found = noise_warnings(with_r(std), [noise])
    assert len(found) == bool(said)
    assert all(said in one and "A log without truth does not show" in one for one in found)
    scaled = replace(with_r(std), accuracy_scale=1.0)
    assert noise_warnings(scaled, [noise]) == []


@pytest.mark.parametrize(("scale", "said"), [(None, False), (0.004, True), (0.1, False), (1.0, False)])
def test_an_accuracy_without_effect_is_reported(scale: float | None, said: bool):
    filters = replace(with_r(1.0), accuracy_scale=scale)
    found = accuracy_warnings(filters, [1.0])
    assert ["`accuracy` has hardly any effect" in one for one in found] == [True] * said
    assert accuracy_warnings(filters, [NONE]) == []


def test_the_stated_accuracy_and_the_scatter_of_a_drive():
    found = fix_noise(stating(unstated(), 3.0))
    assert found.stated == 3.0
    assert found.scatter == pytest.approx(1.0, rel=0.2)  # the white noise is 1 m
    assert np.isnan(fix_noise(unstated()).stated)
    assert fix_noise(replace(unstated(), metadata={"gps_std_m": 2.0})).stated == 2.0


def test_errors_that_are_only_assumed_to_be_correlated_are_reported():
    """If the receiver states no accuracy, the log does not show whether its fixes are smooth or accurate."""
    p = FilterParameters(1.0, 2.0, 0.0, (1e-3,) * 5, (1.0, 1.0), kind="ekf", fix_error=0.5)
    (said,) = noise_warnings(p, [FixNoise(np.nan, 0.1)])
    assert "correlated errors with a standard deviation of 2.1 m per axis" in said
    assert said.endswith("write it as gps_std_m at the top of drive.toml; then tune again with a new folder")
    for noise in (FixNoise(2.0, 0.1), FixNoise(np.nan, 1.0)):
        assert noise_warnings(p, [noise]) == []


def test_only_a_tuning_without_truth_warns_about_the_stated_accuracy():
    blind = tune(stating(unstated(), 30.0), model="planar5", particles=2, generations=1)
    assert any("the receiver states a standard deviation of 30 m" in remark for remark in blind.remarks)
    assert blind.to_dict()["result"]["warnings"] == list(blind.warnings)
    seen = tune(stating(town(), 30.0), particles=2, generations=1)
    assert not [doubt for doubt in seen.warnings if "the receiver states" in doubt]


def test_the_doctor_keeps_the_stated_accuracy_of_a_smooth_receiver():
    """Correlated errors do not scatter, so a stated 3 m must not be replaced with 0.05 m."""
    time = town().gps.time
    truth = town().truth
    assert truth is not None
    x, y = (np.interp(time, truth.time, column) + 2.0 for column in (truth.x, truth.y))
    smooth = stating(replace(unstated(), gps=replace(unstated().gps, x=x, y=y)), 3.0)
    assert "gps-noise" not in diagnose(smooth).codes
    assert "gps-correlated" in diagnose(smooth).codes
    assert "gps-noise" in diagnose(stating(unstated(), 30.0)).codes  # white noise is scatter


@pytest.mark.long
def test_only_the_middle_of_a_long_drive_is_used(monkeypatch: pytest.MonkeyPatch):
    """Fixes of the first and last minute have large errors; the scatter is that of the minutes between."""
    monkeypatch.setattr("sigmaswarm.tuning.receiver.SPAN", 90.0)
    drive = simulate("urban", seed=4, duration=220.0, gps="f9p-rtk")
    early_late = (drive.gps.time < 60) | (drive.gps.time > 160)
    wild = np.where(early_late, np.random.default_rng(0).normal(0, 3, len(drive.gps)), 0.0)
    rough = replace(drive, gps=replace(drive.gps, x=drive.gps.x + wild))
    assert fix_noise(rough).scatter == pytest.approx(fix_noise(drive).scatter)


def test_the_scatter_of_a_drive_is_computed_once(monkeypatch: pytest.MonkeyPatch):
    drive = replace(unstated(), gps=replace(unstated().gps, x=unstated().gps.x + 1.0))
    diagnose(drive)
    with monkeypatch.context() as patch:
        patch.setattr(evidence, "_gather", lambda _: pytest.fail("computed again"))
        kept = fix_noise(replace(drive, name="the same")).scatter
    monkeypatch.setattr(evidence, "_scatters", {})
    assert kept == fix_noise(drive).scatter
    assert kept != fix_noise(replace(drive, gps=replace(drive.gps, y=1.5 * drive.gps.y))).scatter


def test_the_baseline_uses_the_accuracy_that_truth_shows_on_the_training_drives():
    rng, plain = np.random.default_rng(5), simulate("urban", duration=100.0, gps="white-1m", imu_rate=50.0)
    time, truth = plain.gps.time, plain.truth
    assert truth is not None
    x, y = (
        np.interp(time, truth.time, v) + 0.02 * rng.standard_normal(len(time)) for v in (truth.x, truth.y)
    )
    train, test = split_time(replace(plain, gps=type(plain.gps)(time, x, y), metadata={}), 0.6)
    quick = {"model": "planar8", "particles": 2, "generations": 1}
    seen = tune(train, **quick)
    assert seen.record.shown_std == pytest.approx(0.02, rel=0.2)
    blind = tune(replace(train, truth=None), **quick).record
    assert blind.shown_std == pytest.approx(0.02, rel=0.5)  # the scatter, with which the baseline drifts less
    assert [drive.receiver_std_m for drive in blind.data] == [2.1]
    shown, assumed = (evaluate(test, given) for given in (seen, seen.parameters))
    rmse = [one.value(test.name, "untuned", "position_rmse_m") for one in (shown, assumed)]
    assert rmse[0] < 0.7 * rmse[1], rmse
    stated = replace(test, metadata={"gps_std_m": 3.0})
    assert baseline(stated, seen.parameters, 0.02).measurement_noise == (9.0, 9.0)
    blind = replace(test, truth=None)  # the truth of the tested drive has no effect
    assert baseline(blind, seen.parameters, 0.02) == baseline(test, seen.parameters, 0.02)


def test_a_lever_arm_is_not_counted_as_an_error_of_the_fixes():
    rng, plain = np.random.default_rng(5), simulate("urban", duration=40.0, imu_rate=50.0)
    time, truth = plain.gps.time, plain.truth
    assert truth is not None
    arm = complex(1.5, 0.3) * np.exp(1j * truth.theta)
    x, y = (
        np.interp(time, truth.time, v) + 0.02 * rng.standard_normal(len(time))
        for v in (truth.x + arm.real, truth.y + arm.imag)
    )
    drive = replace(plain, gps=type(plain.gps)(time, x, y), metadata={"gps_lever_arm_m": (1.5, 0.3)})
    assert true_std(drive) == pytest.approx(0.02, rel=0.3)
    unknown = replace(truth, theta=np.full_like(truth.theta, np.nan))
    assert np.isnan(true_std(replace(drive, truth=unknown)))
    assert true_std(replace(plain, truth=unknown)) == true_std(plain)
