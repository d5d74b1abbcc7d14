"""Every filter, compiled and in textbook form, on the same drives; and relations between filters."""

import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter as FilterPyEkf

from filter_cases import KINDS, OPTIONS, equipped, parameters, stands_for_all, two_receivers
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.filters.models import gps_position, planar5, planar8
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_filter, run_textbook
from sigmaswarm.filters.textbook import ExtendedKalmanFilter
from sigmaswarm.filters.textbook.adaptive import FuzzyNoise
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.filters.textbook.kalman import complex_step
from sigmaswarm.tuning.batch import run_batch
from support import DRIVES, make_drive, needs_shared, quickly, sparse, timeline_of


def difference(a: Estimate, b: Estimate) -> float:
    """Return the largest difference of means and relative difference of covariances."""
    std = np.sqrt(np.diagonal(b.covariance, axis1=1, axis2=2))
    covariance = np.abs(a.covariance - b.covariance) / (std[:, :, None] * std[:, None, :])
    return max(float(np.max(np.abs(a.mean - b.mean))), float(np.max(covariance)))


@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(product(("planar5", "planar8"), KINDS, OPTIONS), stands_for_all),
)
def test_the_compiled_filter_agrees_with_the_textbook(model: str, kind: str, option: str):
    p, drive = parameters(model, kind=kind, **OPTIONS[option]), sparse(equipped(), 8)
    assert difference(run_filter(drive, p), run_textbook(drive, p)) < 1e-9


@pytest.mark.parametrize(
    ("model", "kind"),
    quickly(
        product(("planar5", "planar8"), KINDS),
        lambda *case: case in (("planar8", "ekf"), ("planar8", "adaptive-ukf"), ("planar5", "ukf")),
    ),
)
def test_the_compiled_filter_agrees_with_the_textbook_for_two_receivers(model: str, kind: str):
    p, initial = parameters(model, kind=kind, **OPTIONS["all"]), initial_state(equipped())
    drive = sparse(two_receivers(), 8)
    compiled, textbook = (run(drive, p, initial=initial) for run in (run_filter, run_textbook))
    assert difference(compiled, textbook) < 1e-9


def test_each_option_changes_the_estimate():
    plain = run_filter(equipped(), parameters("planar8"))
    for name, option in OPTIONS.items():
        if name != "plain":
            assert difference(run_filter(equipped(), parameters("planar8", **option)), plain) > 1e-3, name
    for kind in KINDS[1:]:
        assert difference(run_filter(equipped(), parameters("planar8", kind=kind)), plain) > 1e-6, kind


@pytest.mark.long
@needs_shared
@pytest.mark.parametrize("kind", quickly([(kind,) for kind in KINDS], lambda kind: kind == "ukf"))
def test_the_compiled_filter_agrees_with_the_textbook_on_a_real_drive(kind: str):
    drive = clip(read_drive(DRIVES / "colorado-1"), 0.0, 75.0)  # with the standstill before departure
    p = parameters("planar8", kind=kind, lateral_noise=0.05, rear_axle=1.2, standstill_noise=1e-3, gate=12.0)
    assert difference(run_filter(drive, p), run_textbook(drive, p)) < 1e-9


def test_the_extended_filter_agrees_with_filterpy():
    drive, p = make_drive(duration=20, seed=2), parameters("planar5", kind="ekf")
    initial = initial_state(drive)
    line = timeline_of(drive, initial.time)
    theirs = FilterPyEkf(dim_x=5, dim_z=2)
    theirs.x, theirs.P, theirs.R = (
        initial.mean.copy(),
        initial.covariance.copy(),
        np.diag(p.measurement_noise),
    )
    means, fixes = [], iter(line.fixes)
    h = np.eye(2, 5)
    for i, dt in enumerate(line.dt):
        theta, ax, ay = theirs.x[4], line.ax[i], line.ay[i]
        turned = np.array([-np.sin(theta) * ax - np.cos(theta) * ay, np.cos(theta) * ax - np.sin(theta) * ay])
        f = np.eye(5)
        f[0, 2] = f[1, 3] = dt
        f[:2, 4], f[2:4, 4] = turned * dt**2 / 2, turned * dt
        theirs.F, theirs.Q = f, np.diag(p.process_noise) * line.q_scale[i]
        theirs.x = planar5(theirs.x, dt, np.array([ax, ay, line.gz[i]]))
        theirs.P = f @ theirs.P @ f.T + theirs.Q
        if line.updates[i]:
            theirs.update(next(fixes)[:2], lambda x: h, lambda x: h @ x)
        if line.sampled[i]:
            means.append(theirs.x.copy())
    wrapped = np.array(means)
    wrapped[:, 4] = np.pi - np.mod(np.pi - wrapped[:, 4], 2 * np.pi)
    assert np.max(np.abs(run_filter(drive, p).mean - wrapped)) < 1e-10


def test_planar8_with_known_biases_equals_planar5():
    drive = make_drive(duration=20, seed=4)
    five = FilterParameters(0.5, 2.0, 3.0, (1e-4,) * 5, (1.0, 1.0))
    eight = FilterParameters(
        0.5, 2.0, 0.0, (1e-4,) * 5 + (0.0,) * 3, (1.0, 1.0), "planar8", bias_std=(1e-10, 1e-10)
    )
    start = replace(initial_state(drive), gyro=None)  # otherwise, the bias has an uncertainty
    a, b = run_filter(drive, five, initial=start), run_filter(drive, eight, initial=start)
    assert np.max(np.abs(a.mean - b.mean[:, :5])) < 1e-9
    assert np.max(np.abs(b.mean[:, 5:])) < 1e-9


def test_planar8_estimates_the_biases():
    drive = make_drive(duration=120, gps_std=0.3, seed=6)
    biases = np.array([0.2, -0.1, 0.01])
    imu = replace(drive.imu, ax=drive.imu.ax + 0.2, ay=drive.imu.ay - 0.1, gz=drive.imu.gz + 0.01)
    p = FilterParameters(
        0.5, 2.0, 0.0, (1e-8, 1e-8, 1e-7, 1e-7, 1e-9, 1e-10, 1e-10, 1e-13), (0.09, 0.09), "planar8",
        bias_std=(0.3, 0.02),
    )  # fmt: skip
    estimate = run_filter(replace(drive, imu=imu), p)
    std = np.sqrt(np.diagonal(estimate.covariance[-1]))[5:]
    assert np.all(np.abs(estimate.mean[-1, 5:] - biases) < 4 * std)
    assert np.all(std < [0.05, 0.05, 0.002])


def test_strong_tracking_corrects_for_a_bias_that_q_does_not_model():
    drive = make_drive(duration=60, gps_std=0.5, seed=1)
    stiff = FilterParameters(0.5, 2.0, 1.0, (1e-9,) * 5, (0.25, 0.25))
    biased = replace(drive, imu=replace(drive.imu, ax=drive.imu.ax + 1.0))
    errors = {}
    for kind in ("ukf", "adaptive-ukf", "strong-tracking-ukf"):
        mean = run_filter(biased, replace(stiff, kind=kind, forgetting=0.9), recover=False).mean
        truth = biased.truth
        assert truth is not None
        errors[kind] = np.hypot(mean[-1, 0] - truth.x[-1], mean[-1, 1] - truth.y[-1])
    assert errors["ukf"] > 20
    assert errors["strong-tracking-ukf"] < 3
    assert errors["adaptive-ukf"] < errors["ukf"] * 0.7


FUZZY = FilterParameters(
    0.5, 2.0, 1.0, (1e-5, 1e-5, 1e-5, 1e-5, 1e-8), (0.25, 0.25), kind="fuzzy-ukf", forgetting=0.8
)


def test_a_fuzzy_filter_without_gains_equals_the_unscented_filter():
    drive, silent = make_drive(duration=30, gps_std=2.0, seed=1), replace(FUZZY, fuzzy_gains=(1.0, 1.0))
    plain, fuzzy = run_filter(drive, replace(silent, kind="ukf")), run_filter(drive, silent)
    assert fuzzy.mean.tobytes() == plain.mean.tobytes()
    assert fuzzy.covariance.tobytes() == plain.covariance.tobytes()


@pytest.mark.parametrize(
    ("ratio", "trend", "times_r", "times_q"),
    [
        (1.0, 1.0, 1.0, 1.0),  # as expected
        (1e-9, 1.0, 1 / 4, 1 / 9),  # small
        (9.0, 9.0, 4.0, 9.0),  # large and lasting
        (9.0, 1.0, 4.0, 1.0),  # large and rising
        (9.0, 1e9, 4.0, 9.0),  # large and falling
        (1.5, 1.5, 1 + 3 * 0.4, 1 + 8 * 0.4),  # 0.2 / 0.5 of the way to large
        (9.0, 6.0, 4.0, 9 - 8 * 0.4),  # 0.2 / 0.5 of the way to rising
    ],
)
def test_fuzzy_rules_agree_with_their_table(ratio: float, trend: float, times_r: float, times_q: float):
    noise = FuzzyNoise(np.ones(5), np.ones(2), 0.9, (0.5, 0.5), (4.0, 9.0), quick=ratio, slow=trend)
    assert noise.factors() == pytest.approx((times_r, times_q), rel=1e-6)


def factors(drive: Drive, p: FilterParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return the factors of R and Q of a fuzzy filter after each step."""
    car = TextbookCar(timeline_of(drive, initial_state(drive).time), p, initial_state(drive))
    assert car.fuzzy is not None
    found = []
    for i in range(len(car.timeline.dt)):
        car.step(i)
        found.append((car.fuzzy.times_r, car.fuzzy.times_q))
    r, q = np.array(found).T
    return r, q


@pytest.mark.long
def test_fuzzy_rules_increase_r_for_an_outlier_and_q_for_lasting_errors():
    drive = make_drive(duration=40, gps_std=0.5, seed=3)
    x, after = drive.gps.x.copy(), drive.gps.time[100]
    x[100] += 6.0
    p = replace(FUZZY, forgetting=0.9, fuzzy_widths=(0.3, 0.15), fuzzy_gains=(10.0, 10.0))
    r, q = factors(replace(drive, gps=replace(drive.gps, x=x)), p)
    at = np.searchsorted(timeline_of(drive, initial_state(drive).time).end, after)
    assert r[at] > 1.5 * r[at - 1]
    assert q[at] < 1.5  # a rising error indicates a wrong fix
    biased = replace(drive, imu=replace(drive.imu, ax=drive.imu.ax + 1.0))
    r, q = factors(biased, p)
    assert np.mean(q[at:]) > 2


def test_a_fuzzy_filter_corrects_for_a_bias_that_q_does_not_model():
    drive = make_drive(duration=60, gps_std=0.5, seed=1)
    biased = replace(drive, imu=replace(drive.imu, ax=drive.imu.ax + 0.5))
    truth, errors = biased.truth, {}
    assert truth is not None
    for kind in ("ukf", "fuzzy-ukf"):
        p = replace(FUZZY, kind=kind, fuzzy_gains=(1.0, 100.0))
        mean = run_filter(biased, p, recover=False).mean
        errors[kind] = np.hypot(mean[-1, 0] - truth.x[-1], mean[-1, 1] - truth.y[-1])
    assert errors["fuzzy-ukf"] < 0.5 * errors["ukf"]


def test_strong_tracking_stays_stable_on_a_drive_without_faults():
    drive = make_drive(duration=60, seed=2)
    p = FilterParameters(
        0.5, 2.0, 1.0, (1e-4, 1e-4, 1e-3, 1e-3, 1e-5), (1.0, 1.0), kind="strong-tracking-ukf"
    )
    for forgetting in (0.9, 0.98):
        estimate = run_filter(drive, replace(p, forgetting=forgetting))
        assert estimate.failure is None
        assert np.sqrt(estimate.covariance[:, 4, 4].max()) < 1.0
    rng = np.random.default_rng(0)
    sets = [
        replace(
            p,
            process_noise=tuple(10 ** rng.uniform(-5, 1, 5)),
            measurement_noise=tuple(10 ** rng.uniform(-5, 1, 2)),
        )
        for _ in range(100)
    ]
    assert not run_batch([drive], sets).failed.any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_gate_rejects_an_outlier_and_lets_a_diverged_filter_recover(kind: str):
    drive = make_drive(duration=40, gps_std=0.5, seed=3)
    x = drive.gps.x.copy()
    x[100] += 60.0
    p = parameters("planar5", gate=20.0, kind=kind, forgetting=0.95)
    outlier = replace(drive, gps=replace(drive.gps, x=x))
    clean, gated = run_filter(drive, p), run_filter(outlier, p)
    missed = replace(drive, gps=drive.gps.select(np.arange(len(drive.gps)) != 100))
    assert np.max(np.abs(gated.mean - clean.mean)) < 1.0
    # except for the step that the fix splits in two, and the time since the last fix
    assert difference(gated, run_filter(missed, p)) < (0.1 if kind == "adaptive-ukf" else 1e-3)
    lost = x.copy()
    lost[100:] += 500.0  # all later fixes
    back = run_filter(replace(drive, gps=replace(drive.gps, x=lost)), p)
    assert np.max(np.abs(back.mean[-200:, 0] - clean.mean[-200:, 0] - 500)) < 20


def test_jacobians_are_exact():
    state, imu = np.array([1.0, 2.0, 3.0, 4.0, 0.5, 0.1, -0.2, 0.01]), np.array([0.3, -0.4, 0.1])
    jacobian = complex_step(lambda s: planar8(s, 0.1, imu), state)
    numeric = np.array(
        [(planar8(state + d, 0.1, imu) - planar8(state - d, 0.1, imu)) / 2e-6 for d in 1e-6 * np.eye(8)]
    ).T
    assert np.max(np.abs(jacobian - numeric)) < 1e-8
    ekf = ExtendedKalmanFilter(lambda s, dt, u: 0.9 * s, gps_position(), np.ones(5), np.eye(5))
    ekf.predict(1.0, imu, 0.1 * np.eye(5))
    np.testing.assert_allclose(ekf.covariance, 0.91 * np.eye(5), rtol=1e-15)


@needs_shared
@pytest.mark.parametrize(
    "name", ["colorado-1", "kingston-1", "kitti-09-30-0033", "kitti-09-26-0101", "comma2k19"]
)
def test_standstill_is_detected(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        drive = read_drive(DRIVES / name)
    stands = timeline_of(drive, drive.imu.time[0]).stands
    truth = drive.truth
    assert truth is not None
    line = timeline_of(drive, drive.imu.time[0])
    speed = np.interp(line.end, truth.time, np.hypot(truth.vx, truth.vy))
    assert np.all(speed[stands] < 0.3)
    if name in ("colorado-1", "kingston-1"):
        assert np.mean(stands[speed < 0.02]) > 0.3
