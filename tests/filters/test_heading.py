"""The heading of two antennas in every form of the filter: textbook, compiled, smoother, live, bank, C."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exported import needs_gcc
from filter_cases import OPTIONS, equipped, parameters, straying
from oracles.smoother import smooth_textbook
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive, Gps, Imu, Truth
from sigmaswarm.drives.events import FIX, HEADING, events_of
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.errors import InputError
from sigmaswarm.exports.check import check_export
from sigmaswarm.exports.targets import export_texts, write_texts
from sigmaswarm.filters import tilted
from sigmaswarm.filters.bank.run import run_bank
from sigmaswarm.filters.compiled import live, monitor
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.run import run_filter, run_textbook
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.filters.textbook.manifold import ErrorStateKalmanFilter
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.simulation.gps import GPS_GRADES
from sigmaswarm.simulation.scenarios import simulate
from sigmaswarm.tuning.tune import tune
from support import quickly, sparse

MORE: dict[str, dict[str, Any]] = {
    "plain": {},
    "all": OPTIONS["all"],
    "weighed": {"accuracy_scale": 0.4, "robust_dof": 4.0},
    "fix-error": {"fix_error": 1.3, "fix_error_time": 2.0, "latency": 0.05},
}
CASES = [
    *(("planar5", "ukf", "all"), ("planar5", "ekf", "plain"), ("planar8", "ekf", "all")),
    *(("planar8", "ukf", "weighed"), ("planar8", "ekf", "fix-error"), ("planar8", "adaptive-ukf", "all")),
    *(("tilted12", "ekf", "all"), ("tilted12", "ekf", "fix-error"), ("tilted12", "ukf", "weighed")),
    ("tilted12", "ukf", "all"),
]


def filter_of(
    model: str = "planar8", kind: str = "ekf", option: str = "plain", noise: float | None = 1e-5, **more: Any
):
    return parameters(model, **{"kind": kind, **MORE[option], "heading_noise": noise, **more})


def with_heading(drive: Drive) -> Drive:
    """Return a drive with headings to 1 degree; four are 57 degrees off, ten are absent."""
    gps, truth, rng = drive.gps, drive.truth, np.random.default_rng(0)
    assert truth is not None
    theta = np.interp(gps.time, truth.time, np.unwrap(truth.theta)) + rng.normal(0, np.radians(1.0), len(gps))
    theta[30:34] += 1.0
    std = np.where(np.isin(np.arange(len(gps)), range(50, 60)), np.pi, np.radians(1.0))
    return replace(drive, gps=replace(gps, heading=np.angle(np.exp(1j * theta)), std_heading=std))


@cache
def driven(option: str = "plain") -> Drive:
    return with_heading(straying() if option == "weighed" else equipped())


@cache
def hilly() -> Drive:
    grade = replace(GPS_GRADES["ublox-m8"], lever_arm=(0.4, -0.3, 1.2))
    drive = simulate("brake", terrain="hilly", gps=grade, jitter=1e-3, run=2)
    return replace(with_heading(drive), metadata={"gps_lever_arm_m": list(grade.lever_arm)})


def thinned(drive: Drive, model: str, kind: str) -> Drive:
    """Return the drive with less IMU, since the textbook takes 25 sigma points of tilted12 through each step."""
    return sparse(drive, 16 if (model, kind) == ("tilted12", "ukf") else 8)


def relative(a: Any, b: Any) -> float:
    """Return the largest difference of means (headings wrapped), and of covariances relative to their maximum."""
    off = a.mean - b.mean
    off[:, THETA] = wrap_angle(off[:, THETA])
    scale = np.abs(b.covariance).max(axis=(1, 2), keepdims=True)
    return max(np.abs(off).max(), (np.abs(a.covariance - b.covariance) / scale).max())


def test_textbook_update_is_that_of_a_scalar_kalman_filter():
    drive, p = driven(), filter_of(latency=0.1)
    line, start = prepare_drive(drive).timeline(), initial_state(equipped())
    car = TextbookCar(line, p, start)
    for off in (0.01, -0.02, 0.5, -2.0):  # two are beyond the gate
        x, covariance = car.filter.mean, car.filter.covariance
        h = np.eye(8)[THETA]
        car._update_with_heading(x[THETA] + off - 0.1 * 0.3 + 4 * np.pi, 2e-4, 0.3)
        s = max(h @ covariance @ h + 1e-5 + 2e-4, off**2 / 9.0)
        gain = covariance @ h / s
        np.testing.assert_allclose(car.filter.mean, x + gain * off, rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            car.filter.covariance, covariance - s * np.outer(gain, gain), rtol=0, atol=1e-13
        )


def test_jacobian_of_the_yaw_of_an_attitude_is_its_derivative():
    state = np.zeros(12)
    state[[8, 9, 4]] = 0.2, -0.3, 3.1
    h = tilted.heading(state[4])
    jacobian = ErrorStateKalmanFilter(tilted.tilted12, h, state, np.eye(12)).sensitivity(h, state)
    for i in range(12):
        error = 1e-6 * np.eye(12)[i]
        numeric = (h(tilted.plus(state, error)) - h(tilted.plus(state, -error))) / 2e-6
        np.testing.assert_allclose(jacobian[:, i], numeric, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(CASES, lambda *case: case[2] == "all" and case[:2] != ("tilted12", "ukf")),
)
def test_compiled_filter_agrees_with_the_textbook(model: str, kind: str, option: str):
    drive = thinned(hilly() if model == "tilted12" and option == "all" else driven(option), model, kind)
    p = filter_of(model, kind, option)
    start = initial_state(replace(drive, gps=replace(drive.gps, heading=None)))
    compiled = run_filter(drive, p, initial=start, recover=False)
    textbook = run_textbook(drive, p, initial=start)
    assert compiled.failure is None and textbook.failure is None
    assert relative(compiled, textbook) < 1e-9
    without = run_filter(drive, replace(p, heading_noise=None), initial=start, recover=False)
    assert np.abs(wrap_angle(compiled.mean - without.mean)[:, THETA]).max() > 0.005


@pytest.mark.parametrize(
    ("model", "kind", "option"), quickly(CASES[::3], lambda *case: case[:2] != ("tilted12", "ukf"))
)
def test_compiled_smoother_agrees_with_the_textbook(model: str, kind: str, option: str):
    drive, p = thinned(driven(option), model, kind), filter_of(model, kind, option)
    assert relative(smooth(drive, p, recover=False), smooth_textbook(drive, p)) < 1e-7


@pytest.mark.parametrize(("model", "kind", "option"), [CASES[0], CASES[4], CASES[6]])
@pytest.mark.parametrize("late", [0.0, 0.3])
def test_live_filter_gives_the_estimates_of_a_run(model: str, kind: str, option: str, late: float):
    drive, p = driven("weighed"), filter_of(model, kind, option, velocity_noise=None)
    whole, gps, imu = run_filter(drive, p, recover=False), drive.gps, drive.imu
    lever = [*drive.lever_arm, drive.antenna_height]
    ours = LiveFilter(
        p, whole.initial, nominal_interval=drive.nominal_interval, lever_arm=lever, recover=False
    )
    events = [(t, 1, i) for i, t in enumerate(imu.time)]
    events += [(t + (late if i % 3 else 0.0), 0, i) for i, t in enumerate(gps.time)]
    for t, is_imu, i in sorted(events):
        if is_imu:
            ours.predict(t, [getattr(imu, axis)[i] for axis in MODELS[model].imu])
            continue
        heading = (gps.heading[i], gps.std_heading[i])
        if gps.std_heading[i] >= np.pi:
            heading = [None, (np.nan, 0.1), (1.0, np.inf), (1.0, np.pi)][i % 4]
        fix = gps.time[i], (gps.x[i], gps.y[i]), None, (gps.std_x[i], gps.std_y[i]), heading
        taken = ours.update(*fix)
        assert not (taken and ours.update(*fix))  # the same fix again
    np.testing.assert_allclose(wrap_angle(ours.state.mean - whole.mean[-1]), 0.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours.state.covariance, whole.covariance[-1], rtol=1e-6, atol=1e-12)


def test_the_monitor_reads_the_type_of_a_fix_where_live_filters_store_it():
    assert monitor._KIND == live.KIND


def test_lane_zero_of_a_bank_uses_headings_and_its_searches_replay_them():
    drive, p = driven(), filter_of()
    bank, plain = run_bank(drive, p, seed=1), run_bank(drive, replace(p, heading_noise=None), seed=1)
    truth = drive.truth
    assert truth is not None
    theta = np.interp(bank.time, truth.time, np.unwrap(truth.theta))
    off = [float(np.sqrt(np.mean(wrap_angle(of.mean[:, THETA] - theta) ** 2))) for of in (bank, plain)]
    assert off[0] < np.radians(1.0) and off[0] < off[1]


@pytest.mark.long
@needs_gcc
@pytest.mark.usefixtures("unoptimized")
@pytest.mark.parametrize(
    ("model", "kind", "option"),
    CASES[:8],
)
def test_c_library_gives_the_estimates_of_a_run(model: str, kind: str, option: str, tmp_path: Path):
    drive = hilly() if model == "tilted12" and option == "all" else driven(option)
    p = filter_of(model, kind, option, nominal_interval=0.01)
    write_texts(export_texts(p, "c99", replay=drive), tmp_path, "c99")
    (checked,) = check_export(tmp_path, p, [drive])
    assert checked.double.state < 1e-11
    assert checked.single is not None and checked.single.position < 2e-3


@pytest.mark.long
@needs_gcc
@pytest.mark.usefixtures("unoptimized")
def test_c_filter_bank_gives_the_estimates_of_a_bank(tmp_path: Path):
    p, drive = filter_of(nominal_interval=0.01), driven()
    write_texts(export_texts(p, "c99", lanes=3), tmp_path, "c99")
    (checked,) = check_export(tmp_path, p, [drive], lanes=3)
    assert checked.double.state < 1e-9


def test_only_present_headings_are_used():
    drive, p = driven(), filter_of()
    line = prepare_drive(drive).timeline()
    flags = events_of(line, {"heading"}).flags
    used = drive.gps.std_heading[drive.gps.time > line.start] < np.pi
    assert np.array_equal(flags[flags & FIX > 0] & HEADING > 0, used)
    absent = replace(drive, gps=replace(drive.gps, heading=None, std_heading=None))
    start = initial_state(absent)
    plain = run_filter(absent, replace(p, heading_noise=None), initial=start)
    np.testing.assert_array_equal(run_filter(absent, p, initial=start).mean, plain.mean)
    np.testing.assert_array_equal(
        run_filter(drive, replace(p, heading_noise=None), initial=start).mean, plain.mean
    )


def test_filterpy_rejects_it_with_one_line():
    with pytest.raises(InputError, match="filterpy does not support heading; tune without heading"):
        export_texts(filter_of(nominal_interval=0.01, kind="ukf"), "filterpy")


def test_tuning_searches_its_noise_and_rejects_a_drive_without_headings():
    use = ("lateral", "heading")
    options: dict[str, Any] = {"model": "planar8", "kind": "ekf", "particles": 4, "generations": 2}
    found = tune([driven()], use=use, objective="truth-pose", **options)
    assert found.parameters.heading_noise is not None
    assert baseline(driven(), found.parameters).heading_noise == pytest.approx(np.radians(0.5) ** 2)
    with pytest.raises(
        InputError, match=r"its gps.csv has no heading, which --use heading needs; omit heading"
    ):
        tune([equipped()], use=use, **options)


def standing(speed: float, seed: int) -> Drive:
    """Return a drive with 5 s of standstill, then constant speed along a curve; headings have errors of 1 degree."""
    rng, t = np.random.default_rng(seed), np.arange(6001) / 100
    v = speed * np.clip((t - 5) / 4, 0, 1)
    rate = np.where(t > 5, 0.1 * np.sin(t / 5), 0.0)
    theta = 2.0 + np.append(0.0, np.cumsum(rate[:-1])) / 100
    velocity = v * np.exp(1j * theta)
    place = np.append(0.0, np.cumsum(velocity[:-1])) / 100
    noise = rng.standard_normal((3, len(t)))
    imu = Imu(
        t, np.gradient(v, t) + 0.05 * noise[0], v * rate + 0.05 * noise[1], rate + 0.002 * noise[2] + 0.005
    )
    fix = slice(7, None, 20)
    off = rng.standard_normal((3, len(t[fix])))
    heading, std = theta[fix] + np.radians(1.0) * off[2], np.full(len(t[fix]), np.radians(1.0))
    gps = Gps(t[fix], place.real[fix] + off[0], place.imag[fix] + off[1], heading=heading, std_heading=std)
    truth = Truth(t, place.real, place.imag, velocity.real, velocity.imag, theta)
    return Drive("standing", imu, gps, truth)


@pytest.mark.parametrize("seed", range(3))
def test_a_start_at_standstill_followed_by_half_a_meter_per_second(seed: int):
    drive = standing(0.5, seed)
    p = baseline(drive, filter_of("planar8", lateral_noise=0.04, standstill_noise=0.0025, noise=1e-4))
    found = run_filter(drive, p)
    truth = drive.truth
    assert truth is not None and found.initial.time == drive.gps.time[0]
    off = wrap_angle(found.mean[:, THETA] - np.interp(found.time, truth.time, truth.theta))
    assert np.degrees(np.sqrt(np.mean(off**2))) < 1.0 and found.failure is None and not found.restarts
