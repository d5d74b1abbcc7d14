"""tilted12: rotations, Jacobians and filters, and the columns that it requires of a drive."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from exported import export_filter
from oracles.extended import covariance_error, mean_error
from sigmaswarm import InputError, LiveFilter, TuneConfig, initial_state, run_filter, run_textbook, tune
from sigmaswarm.drives.drive import Drive
from sigmaswarm.exports.names import DESCRIPTIONS
from sigmaswarm.filters import tilted
from sigmaswarm.filters.compiled.lanes import angle_of
from sigmaswarm.filters.compiled.layout import QUATERNION, R
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.models import MODELS, velocity
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import run_passes, run_steps, start_passes
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.filters.textbook.manifold import ErrorStateKalmanFilter
from stepwise import urban
from support import make_drive, quickly, sparse

Q = (1e-6, 1e-6, 1e-4, 1e-4, 1e-8, 1e-8, 1e-8, 1e-12, 1e-7, 1e-7, 1e-12, 1e-12)
ANGLES = [*tilted.ATTITUDE]
ALL = {
    "lateral_noise": 0.05,
    "rear_axle": 1.2,
    "tire_slip": 0.004,
    "standstill_noise": 1e-3,
    "velocity_noise": 0.1,
    "latency": 0.05,
}


compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="takes minutes without the compiler")


def parameters(**more) -> FilterParameters:
    return FilterParameters(0.5, 2.0, 1.0, Q, (0.5, 0.6), "tilted12", **({"kind": "ekf"} | more))


@cache
def town() -> Drive:
    """Return an urban drive with standstill, gap, lever arm, velocities and stated accuracy."""
    drive = urban()
    n = len(drive.gps)
    std = np.random.default_rng(3).uniform(0.3, 2.0, (2, n))
    x = drive.gps.x.copy()
    x[n // 2 : n // 2 + 3] += 15.0
    return replace(drive, gps=replace(drive.gps, x=x, std_x=std[0], std_y=std[1]))


def by_kind(kind: str) -> Drive:
    """Return the drive, for sigma points with less IMU: the textbook takes 25 of them through each step in Python."""
    return sparse(town(), 3 if kind == "ekf" else 16)


def some_state(seed: int = 0, tilt: float = 0.2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    state = rng.normal(0, 1, tilted.N) * [10, 10, 8, 8, 2, 0.3, 0.3, 0.01, tilt, tilt, 0.01, 0.01]
    state[2:4] += 5.0
    return state


def differences(function: Callable[[np.ndarray], np.ndarray], state: np.ndarray) -> np.ndarray:
    """Return the derivative of a function with respect to errors of each state, by central differences."""
    small = 1e-5
    columns = [
        function(tilted.plus(state, small * e)) - function(tilted.plus(state, -small * e))
        for e in np.eye(tilted.N)
    ]
    return np.array(columns).T / (2 * small)


# --- Rotations ---------------------------------------------------------------------------------------------

angle = st.floats(-3.0, 3.0)
slope = st.floats(-1.4, 1.4)


@given(st.tuples(angle, slope, angle), st.tuples(angle, angle, angle))
def test_rotations_agree_with_scipy(attitude: tuple[float, ...], vector: tuple[float, ...]):
    state = np.zeros(tilted.N)
    state[ANGLES] = attitude
    theirs = Rotation.from_euler("ZYX", attitude[::-1])
    np.testing.assert_allclose(tilted.rotation(state), theirs.as_matrix(), atol=1e-14)
    quaternion = tilted.quaternion_of(state)
    np.testing.assert_allclose(
        Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), theirs.as_matrix(), atol=1e-14
    )
    np.testing.assert_allclose(tilted.angles_of(quaternion), attitude, atol=1e-7)
    np.testing.assert_allclose(tilted.with_rotation(state, theirs.as_matrix())[ANGLES], attitude, atol=1e-7)
    turned = Rotation.from_rotvec(vector)
    np.testing.assert_allclose(tilted.turn(np.array(vector)), turned.as_matrix(), atol=1e-14)
    short = np.array(vector) * min(1.0, 3.0 / (np.linalg.norm(vector) + 1e-9))
    np.testing.assert_allclose(tilted.turn_of(tilted.turn(short)), short, atol=1e-7)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_the_kernels_angle_agrees_with_arctan2(y: float, x: float):
    if np.hypot(x, y) > 1e-200:
        off = getattr(angle_of, "py_func", angle_of)(y, x) - np.arctan2(y, x)
        assert min(abs(off), abs(abs(off) - 2 * np.pi)) < 1e-15


def test_plus_and_minus_are_inverse():
    state, error = some_state(), 0.1 * some_state(1)
    np.testing.assert_allclose(tilted.minus(tilted.plus(state, error), state), error, atol=1e-13)


def jacobian(h: Callable[[np.ndarray], np.ndarray], state: np.ndarray) -> np.ndarray:
    """Return H of the extended filter for a measurement."""
    ekf = ErrorStateKalmanFilter(tilted.tilted12, h, state, np.eye(len(state)))
    return ekf.sensitivity(h, state)


# --- Jacobians ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "h",
    [
        *(tilted.antenna((1.0, -0.5, 1.5), 0.1), tilted.rear_axle(0.3, 1.4)),
        *(tilted.wheels(1.2, 0.15), velocity),
    ],
    ids=["fix", "lateral", "odometer", "velocity"],
)
@pytest.mark.parametrize("seed", range(3))
def test_jacobians_of_measurements_agree_with_central_differences(h, seed: int):
    state = some_state(seed)
    np.testing.assert_allclose(jacobian(h, state), differences(h, state), atol=1e-8)


def test_the_lateral_jacobian_includes_the_vertical_velocity():
    # With a constant vz, H would be wrong by the tangent of the bank angle: a fifth at 11 degrees.
    state, bank = np.zeros(tilted.N), np.radians(11.0)
    state[[2, 3, 4, 8]] = 8.0 * np.cos(0.7), 8.0 * np.sin(0.7), 0.7, bank
    h = tilted.rear_axle(0.3, 1.4)
    _, left, up = tilted.rotation(state).T
    v = tilted.along_the_road(state, up)
    held, whole = np.cross(left, v), jacobian(h, state)[0, ANGLES]
    assert np.linalg.norm(held - whole) / np.linalg.norm(held) == pytest.approx(np.tan(bank), rel=1e-9)


def test_the_jacobian_of_the_process_agrees_with_central_differences():
    state, dt = some_state(tilt=0.05), 1e-3
    force = tilted.rotation(state).T @ [
        1.5,
        -0.7,
        tilted.GRAVITY,
    ]  # so that the vertical acceleration is zero
    force[:2] += state[5:7]
    imu = np.concatenate([force, [0.2, -0.1, 0.4]])
    after = tilted.tilted12(state, dt, imu)
    numeric = differences(lambda s: tilted.minus(tilted.tilted12(s, dt, imu), after), state)
    # F omits terms of second order in dt: a biased rate that rotates the force within the step.
    np.testing.assert_allclose(tilted.transition(state, dt, imu), numeric, atol=10 * dt**2)
    assert np.max(np.abs(numeric - np.eye(tilted.N))) > 9 * dt


def test_the_covariance_of_angles_follows_from_that_of_the_error():
    state, spread = some_state(), np.diag(np.linspace(1, 2, tilted.N))
    numeric = differences(lambda s: s, state)
    np.testing.assert_allclose(
        tilted.as_angles(state, spread), numeric @ spread @ numeric.T, rtol=1e-6, atol=1e-7
    )


# --- Filters -----------------------------------------------------------------------------------------------


UNSCENTED = MODELS["tilted12"].filter_types[1:]
CASES = {
    "plain": {},
    "all": ALL,
    "gate": ALL | {"gate": 6.0},
    "weighed": ALL | {"robust_dof": 4.0, "accuracy_scale": 0.4},
}


@pytest.mark.parametrize(
    ("kind", "case"),
    quickly(
        [*product(("ekf", "ukf"), CASES), *product(UNSCENTED[1:], ["gate"])],
        lambda kind, case: kind == "ekf" or (kind, case) == ("ukf", "weighed"),
    ),
)
def test_the_compiled_filter_agrees_with_the_textbook(kind: str, case: str):
    drive, p = by_kind(kind), parameters(kind=kind, forgetting=0.7, **CASES[case])
    ours, book = run_filter(drive, p, recover=False), run_textbook(drive, p)
    assert book.failure is None and ours.failure is None
    assert mean_error(ours.mean, book.mean).max() < 1e-9
    assert covariance_error(ours.covariance, book.covariance).max() < 1e-8


def test_the_unscented_filter_is_close_to_the_extended_one():
    drive = town()
    extended, unscented = (
        run_filter(drive, parameters(kind=kind, **ALL), recover=False) for kind in ("ekf", "ukf")
    )
    assert unscented.failure is None
    off = unscented.mean - extended.mean
    std = np.sqrt(np.diagonal(extended.covariance, axis1=1, axis2=2))
    assert 1e-9 < np.max(np.abs(off / std)) < 0.3


def test_the_quaternion_keeps_its_norm_over_an_hour():
    drive = town()
    drive_pass = whole_pass(drive)
    line = drive_pass.timeline
    hour = int(np.ceil(3600 / line.dt.sum()))
    chunk = KernelArray((parameters(**ALL),))
    rows = start_passes([drive_pass], chunk)[0]
    cursor = np.zeros(4)
    for _ in range(hour):
        cursor[:] = 0.0
        run_steps(drive_pass, chunk, rows, cursor, len(line.dt))
    quaternion = rows[[getattr(R, name) for name in QUATERNION]]
    assert np.max(np.abs(np.linalg.norm(quaternion, axis=0) - 1)) < 1e-12


def test_it_estimates_the_slope_and_the_gyros_biases():
    # The car drives straight up a slope of 4 deg, its left side 2 deg up, with biased gyros.
    flat = make_drive(duration=60, gps_std=0.3, seed=4)
    truth, imu = flat.truth, flat.imu
    assert truth is not None
    state = np.zeros(tilted.N)
    state[ANGLES] = np.radians([2.0, -4.0, 0.0])
    body = tilted.rotation(state)
    force = np.column_stack([imu.ax, imu.ay, np.full(len(imu), tilted.GRAVITY)])
    about_up = np.column_stack([0 * imu.gz, 0 * imu.gz, imu.gz])
    # The slope turns with the car, so that it is constant in the body frame: a spiral ramp.
    ax, ay, az = (force @ body).T
    gx, gy, gz = (about_up @ body + [0.004, -0.003, 0.002]).T
    drive = replace(flat, imu=replace(imu, ax=ax, ay=ay, az=az, gx=gx, gy=gy, gz=gz))
    estimate = run_filter(drive, parameters(lateral_noise=0.01))
    late = estimate.time > estimate.time[-1] - 20
    found = np.median(estimate.mean[late], axis=0)
    np.testing.assert_allclose(np.degrees(found[ANGLES[:2]]), [2.0, -4.0], atol=0.5)
    np.testing.assert_allclose(found[[10, 11, 7]], [0.004, -0.003, 0.002], atol=0.002)


@compiled
def test_other_filter_types_in_the_batch_change_no_bit():
    sets = [parameters(kind=kind, **ALL) for kind in ("ekf", "ukf", "ekf", "adaptive-ukf", "fuzzy-ukf")]
    drive_pass = whole_pass(town())
    together = run_passes([drive_pass], sets)
    for i, p in enumerate(sets):
        alone = run_passes([drive_pass], [p])
        assert together["NIS"][0, i] == alone["NIS"][0, 0]
        assert together["LOG_DET"][0, i] == alone["LOG_DET"][0, 0]
    assert len({*together["NIS"][0]}) == 4


@pytest.mark.long
@compiled
def test_points_far_from_the_mean_change_no_bit_of_other_filters():
    # The series are valid near the mean. A filter with a large covariance needs more terms; others are not changed.
    drive, p = sparse(town(), 16), parameters(kind="ukf", **ALL)
    far = replace(p, alpha=1.0, kappa=300.0)
    together, alone = run_passes([whole_pass(drive)], [p, far]), run_passes([whole_pass(drive)], [p])
    assert together["NIS"][0, 0] == alone["NIS"][0, 0]
    assert together["LOG_DET"][0, 0] == alone["LOG_DET"][0, 0]
    ours, book = run_filter(drive, far, recover=False), run_textbook(drive, far)
    variances = np.diagonal(ours.covariance, axis1=1, axis2=2)[:, ANGLES].sum(axis=1)
    root = np.sqrt(312.0 * variances)  # rad; the series are used up to 0.9
    assert root.max() > 1.0 > 0.8 > root.min()
    assert mean_error(ours.mean, book.mean).max() < 1e-9
    assert covariance_error(ours.covariance, book.covariance).max() < 1e-8


@pytest.mark.parametrize("turns", [0.4, 0.9, 1.3])
def test_an_error_of_more_than_half_a_turn_is_kept(turns: float):
    error = np.zeros(tilted.N)
    error[ANGLES] = 2 * np.pi * turns * np.array([0.36, 0.48, 0.8])
    state = some_state()
    short = tilted.minus(tilted.plus(state, error), state)
    np.testing.assert_allclose(tilted.nearest(short, error + 0.1), error, atol=1e-9)


@pytest.mark.parametrize(("kind", "rate"), [*product(["ekf"], [0.02, 0.3, 0.9]), ("ukf", 0.02), ("ukf", 0.9)])
def test_a_gap_may_contain_a_turn_of_any_size(kind: str, rate: float):
    """The series for the quaternion is valid for small turns only; 18 s at 0.9 rad/s in one step is no small turn."""
    drive, p = by_kind(kind), parameters(kind=kind)
    imu, gps = (
        replace(table, time=np.where(table.time > 15.0, table.time + 18.0, table.time))
        for table in (drive.imu, drive.gps)
    )
    around = np.abs(imu.time - 24.0) < 9.1
    turning = replace(imu, gz=np.where(around, rate, imu.gz)).select(imu.time < 33.2)
    silenced = replace(drive, imu=turning, gps=gps, truth=None)
    ours, book = run_filter(silenced, p, recover=False), run_textbook(silenced, p)
    assert np.diff(ours.time).max() > 17.9
    assert mean_error(ours.mean, book.mean).max() < 1e-9
    assert covariance_error(ours.covariance, book.covariance).max() < 1e-8


@pytest.mark.parametrize("kind", quickly([("ekf",), ("ukf",)], lambda kind: kind == "ekf"))
def test_the_live_filter_equals_the_run(kind: str):
    drive, p = town(), parameters(kind=kind, **ALL, gate=9.0)
    start = initial_state(drive)
    lever = [*drive.lever_arm, drive.antenna_height]
    live = LiveFilter(p, start, nominal_interval=drive.nominal_interval, lever_arm=lever)
    run, imu, gps, means = run_filter(drive, p), drive.imu, drive.gps, []
    assert gps.speed is not None and gps.course is not None
    due = 0
    for i, t in enumerate(imu.time):
        while due < len(gps) and gps.time[due] <= t:
            v = gps.speed[due] * np.array([np.cos(gps.course[due]), np.sin(gps.course[due])])
            live.update(gps.time[due], (gps.x[due], gps.y[due]), v)
            due += 1
        live.predict(t, [getattr(imu, axis)[i] for axis in tilted.AXES])
        if t > start.time:
            means.append(live.state.mean)
    np.testing.assert_allclose(np.array(means), run.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(live.state.covariance, run.covariance[-1], rtol=1e-7, atol=1e-14)


# --- Requirements ------------------------------------------------------------------------------------------


def test_an_imu_of_three_axes_is_refused():
    drive = make_drive(duration=20)
    drive = replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None))
    for call in (
        lambda: run_filter(drive, parameters()),
        lambda: run_textbook(drive, parameters()),
        lambda: tune([drive], model="tilted12", objective="innovation-nll"),
    ):
        with pytest.raises(InputError, match=r"has no az, gx, gy, which tilted12 needs; use planar8"):
            call()


def test_a_live_sample_of_three_axes_is_refused():
    live = LiveFilter(parameters(), initial_state(town()), nominal_interval=0.01)
    with pytest.raises(InputError, match="3 numbers, but tilted12 reads ax, ay, az, gx, gy, gz"):
        live.predict(100.0, (0.0, 0.0, 0.0))


def test_its_default_filter_type_is_ekf():
    assert TuneConfig(model="tilted12").kind == "ekf"
    assert TuneConfig(model="tilted12", kind="ukf").kind == "ukf"
    assert TuneConfig().kind == TuneConfig(model="planar8").kind == "ukf"


@pytest.mark.parametrize("target", [t for t in DESCRIPTIONS if t != "c99"])
def test_targets_that_do_not_support_it_raise_an_error(target: str, tmp_path):
    with pytest.raises(InputError, match=f"{target} .*tilted12.*planar8"):
        export_filter(parameters(nominal_interval=0.01), target, tmp_path / "out")


def test_the_textbooks_noise_follows_the_timeline():
    drive = town()
    drive_pass = whole_pass(drive)
    car = TextbookCar(drive_pass.timeline, parameters(), drive_pass.initial)
    before = car.filter.covariance.copy()
    car.step(0)
    grown = np.diag(car.filter.covariance - before)[8:]
    np.testing.assert_allclose(grown[2:], np.array(Q[10:]) * drive_pass.timeline.q_scale[0], rtol=1e-6)
