"""Filters without tuning: the published figures, and the computation from data sheets."""

from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline, preset
from sigmaswarm.simulation import ImuGrade, Triad, simulate
from support import make_drive

DRIVE = make_drive(duration=12.0)


def test_defaults_are_usual_initial_values():
    assert preset("defaults", DRIVE) == FilterParameters(0.1, 2.0, 0.0, [1.0] * 5, [1.0] * 2)


def test_paper_is_the_published_optimum():
    assert preset("paper", DRIVE) == FilterParameters(0.03, 2.5, 0.48, [2.0] * 5, [0.1] * 2)


def test_datasheet_of_an_unknown_sensor():
    p = preset("datasheet", DRIVE)
    assert p == baseline(DRIVE)
    assert (p.alpha, p.beta, p.kappa) == (0.1, 2.0, 0.0)
    assert p.measurement_noise == pytest.approx((2.1**2, 2.1**2))
    # MPU-6050: 0.24 m/s per root hour, 0.3 deg per root hour; an hour has 3600 s
    velocity, heading = 0.24**2 / 3600 * 0.01, np.radians(0.3) ** 2 / 3600 * 0.01
    assert p.process_noise[2:] == pytest.approx((velocity, velocity, heading), rel=1e-9)
    assert p.process_noise[:2] == pytest.approx((velocity * 0.01**2 / 3,) * 2, rel=1e-9)
    assert p.nominal_interval == pytest.approx(0.01)


def test_datasheet_uses_the_values_that_the_drive_states():
    stated = {"gps_std_m": 0.7, "accel_noise_density": 0.02, "gyro_noise_density": 0.001}
    p = baseline(replace(DRIVE, metadata=stated))
    assert p.measurement_noise == pytest.approx((0.49, 0.49))
    assert p.process_noise[2] == pytest.approx(0.02**2 * 0.01)
    assert p.process_noise[4] == pytest.approx(0.001**2 * 0.01)


def test_the_data_sheet_s_filter_of_the_same_model_and_parts():
    """The baseline of a tuning: no value is tuned, and it has the model and options of the tuned filter."""
    dt, sheet = DRIVE.nominal_interval, baseline(DRIVE)
    plain = baseline(DRIVE, like=FilterParameters(0.5, 1.0, 1.0, [1.0] * 5, [3.0] * 2))
    assert (plain.model, plain.kind, plain.alpha) == ("planar5", "ukf", sheet.alpha)
    accel, gyro = 0.24**2 / 3600 + 0.3**2, np.radians(0.3) ** 2 / 3600 + 1e-3**2
    assert np.array(plain.process_noise[2:]) / dt == pytest.approx([accel, accel, gyro], rel=1e-9)
    assert plain.process_noise[:2] == pytest.approx((accel * dt**3 / 3,) * 2, rel=1e-9)
    q = [1e-3] * 12
    tuned = FilterParameters(
        1.0, 0.0, 0.0, q, [3.0] * 2, "tilted12", kind="ekf", lateral_noise=7.0, rear_axle=3.0, robust_dof=20.0
    )
    p = baseline(DRIVE, like=tuned)
    assert (p.model, p.kind, p.nominal_interval) == ("tilted12", "ekf", dt)
    assert p.process_noise[:5] == plain.process_noise and p.measurement_noise == plain.measurement_noise
    white = gyro
    accel, gyro = 2 * 0.01**2 / 3600, 2 * np.radians(200 / 3600) ** 2 / 3600
    assert np.array(p.process_noise[5:]) / dt == pytest.approx(
        [accel, accel, gyro, white, white, gyro, gyro], rel=1e-9
    )
    assert (p.lateral_noise, p.rear_axle, p.robust_dof) == (pytest.approx(0.04), 1.3, 4.0)
    assert p.standstill_noise is p.odometer_noise is p.gate is p.accuracy_scale is None
    stated = baseline(DRIVE, like=replace(tuned, accuracy_scale=5.0, lateral_noise=None))
    assert (stated.accuracy_scale, stated.rear_axle) == (1.0, 0.0)
    assert stated.measurement_noise == pytest.approx((0.01, 0.01))


def test_the_accuracy_is_estimated_from_the_fixes():
    """Fixes of a receiver that states no accuracy and does not smooth show their white noise."""
    drive = simulate("urban", duration=60, gps="white-1m")
    unstated = replace(drive, gps=replace(drive.gps, std_x=None, std_y=None), metadata={})
    like = FilterParameters(0.5, 1.0, 1.0, [1.0] * 5, [3.0] * 2)
    assert np.sqrt(baseline(unstated, like=like).measurement_noise) == pytest.approx(1.0, rel=0.2)
    assert baseline(unstated).measurement_noise == pytest.approx((2.1**2, 2.1**2))


def test_the_receiver_s_standard_deviation_has_priority_over_the_file_s():
    n = len(DRIVE.gps)
    std = np.where(np.arange(n) < n // 2 - 1, 50.0, 1.5)  # the median ignores the start
    drive = replace(
        DRIVE, gps=replace(DRIVE.gps, std_x=std, std_y=np.full(n, 2.5)), metadata={"gps_std_m": 9.0}
    )
    assert baseline(drive).measurement_noise == pytest.approx((1.5**2, 2.5**2))


def test_the_velocity_error_agrees_with_the_noise_density():
    """White noise of density s per root Hz, integrated over one second, gives a velocity error of deviation s."""
    grade = ImuGrade("white", accel=Triad(noise_density=0.03))
    drive, exact = (simulate("brake", imu=imu) for imu in (grade, "ideal"))
    per_second = baseline(drive).process_noise[2] / drive.nominal_interval
    std = np.std(np.stack([getattr(drive.imu, a) - getattr(exact.imu, a) for a in ("ax", "ay")]))
    noise = np.random.default_rng(0).normal(0, std, (4000, 100))  # 100 Hz, one second
    assert np.sqrt(per_second) == pytest.approx(np.std(noise.sum(axis=1) * 0.01), rel=0.05)


def test_an_unknown_preset_is_refused():
    with pytest.raises(ValueError, match="default"):
        preset("default", DRIVE)
