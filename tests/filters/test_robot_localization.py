"""robot_localization's filter: textbook and compiled form, compared with outputs of the original code."""

import csv
import gzip
from dataclasses import replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from filter_cases import equipped
from oracles.robot_localization import NAME, TextbookRobotLocalization
from sigmaswarm import evaluate, export, tune
from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Odometer
from sigmaswarm.drives.events import FIX, HEADING, IMU, LATERAL, ODOMETER, events_of
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.compiled import run
from sigmaswarm.filters.compiled.layout import R, state_rows
from sigmaswarm.filters.compiled.robot_localization import GATE_AX, GATE_GZ, R_AY, R_VY, USES_AY, USES_VY
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.packing import pack_states, state_estimate, unpack_states
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import run_steps, start_passes
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.run import run_filter, run_textbook, whole_pass
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.filters.starts import measured_by
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.targets import tracking_pass
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.space import search_space
from support import make_drive, quickly

REFERENCE = Path(__file__).parents[3] / "shared" / "robot_localization"
ORDER = [0, 1, 6, 7, 5, 12, 13, 11]  # of its 15 states: x, y, vx, vy, yaw, ax, ay, yaw rate
NAMES = ("x", "y", "vx", "vy", "yaw", "ax", "ay", "vyaw")
YAW = 4
RUNS = [
    (drive, name)
    for drive in ("kitti-09-26-0022", "colorado-1", "kingston-1")
    for name in ("default", "tuned")
]
QUICK = quickly(
    RUNS, lambda drive, name: (drive, name) in (("colorado-1", "tuned"), ("kingston-1", "default"))
)


class Messages:
    """Messages in order with the settings of a run: this project's, or those of a reference run."""

    def __init__(self, rows: list[list[str]], values: dict[str, Array]) -> None:
        self.uses_ay, self.uses_vy = bool(values["use_ay"][0]), bool(values["use_vy"][0])
        threshold = values.get("odom0_pose_rejection_threshold")
        self.parameters = FilterParameters(
            1.0, 0.0, 0.0, tuple(values["process_noise_covariance"][ORDER]), (1e-12, 1e-12),
            model=NAME, kind="ekf", nominal_interval=1.0, accuracy_scale=1.0,
            imu_noise=(values["r_gz"][0], values["r_ax"][0]), lateral_noise=values["r_vy"][0],
            gate=None if threshold is None else threshold[0] ** 2,
        )  # fmt: skip
        self.mean = values["initial_state"][ORDER]
        self.covariance = values["initial_estimate_covariance"].reshape(15, 15)[np.ix_(ORDER, ORDER)]
        times = np.array([round(1e9 * values["t0"][0]), *(int(row[0]) for row in rows)])
        self.dt = np.diff(times) / 1e9
        self.is_imu = np.array([row[1] == "imu" for row in rows])
        self.numbers = np.array([[float(cell or 0) for cell in row[2:6]] for row in rows])

    @cached_property
    def textbook(self) -> tuple[Array, Array, dict[tuple[int, str], tuple[Array, Array]]]:
        """Means (k, 8) and covariances (k, 8, 8) after each message, and both after each correction of a message."""
        means, covariances, after = list[Array](), list[Array](), dict[tuple[int, str], tuple[Array, Array]]()

        class Noted(TextbookRobotLocalization):
            def correct(self, states: list[int], *given: Any) -> None:
                super().correct(states, *given)
                called = {7: "gyro", 5: "accel", 6: "accel", 3: "vy0", 0: "gps"}[states[0]]
                after[len(means), called] = self.mean, self.covariance

        filter = Noted(self.parameters, self.mean, self.covariance)
        for dt, is_imu, (a, b, c, d) in zip(self.dt, self.is_imu, self.numbers, strict=True):
            if dt > 0:
                filter.predict(dt)
            if is_imu:
                filter.imu(c, a, b if self.uses_ay else None)
                if self.uses_vy:
                    filter.twist()
            else:
                filter.fix(np.array([a, b]), np.array([c, d]))
            means.append(filter.mean)
            covariances.append(filter.covariance)
        return np.array(means), np.array(covariances), after

    def compiled(self, stop: int | None = None) -> tuple[Array, Array, Array]:
        """Return means and covariances after each IMU message, and the rows after the last message before ``stop``."""
        k = len(self.dt)
        array = KernelArray((self.parameters,))
        rows = np.zeros((run.N_KEPT, array.width))
        rows[[R.DET, R.TAIL, R.OK]] = 1.0
        rows[run.R.QUARTER_GAMMA : run.R.QUARTER_GAMMA + len(array.constants(1.0))] = array.constants(1.0)
        rows[[GATE_GZ, GATE_AX]] = np.inf
        rows[R_AY], rows[R_VY] = self.parameters.imu_noise[1], self.parameters.lateral_noise
        i, j = np.array([(i, j) for j in range(8) for i in range(j + 1)]).T
        rows[state_rows(NAME)] = np.concatenate([self.mean, self.covariance[i, j]])[:, np.newaxis]
        both = (USES_AY if self.uses_ay else 0) | (USES_VY if self.uses_vy else 0)
        flags = np.where(self.is_imu, IMU | both, FIX).astype(np.uint16)
        fixes = np.insert(self.numbers[~self.is_imu], [2, 2, 4, 4], [0.0, 0.0, 0.0, np.inf], axis=1)
        record = np.empty((k, 8 + 36 + 1, 1))
        steps, ends = np.column_stack([self.dt, self.dt, 0 * self.dt]), np.zeros(k, dtype=np.int32)
        imu = np.arange(k, dtype=np.int32), self.numbers[:, :3].copy(), flags
        drive = (steps, *imu, fixes, np.empty((0, 3)), np.zeros(3), run.NO_TARGETS, ends)
        stop = k if stop is None else stop
        run.run_lanes(NAME, drive, rows, run.new_cursor(), stop, record, run.NO_INNOVATIONS)
        done = record[: int(self.is_imu[:stop].sum()), :44, 0].T
        return *unpack_states(done, NAME), rows


@cache
def reference(drive: str, name: str) -> Messages:
    if not REFERENCE.is_dir():
        pytest.skip("the reference outputs of robot_localization (../shared) are not there")
    values = dict[str, Array]()
    for line in (REFERENCE / f"{drive}_ekf_{name}_parameters.txt").read_text().splitlines():
        if not line.startswith("#"):
            key, *numbers = line.split()
            values[key] = np.array(numbers, dtype=float)
    own = f"{drive}_input_ekf_{name}"
    return Messages(rows_of(own if (REFERENCE / f"{own}.csv.gz").exists() else f"{drive}_input"), values)


def rows_of(name: str) -> list[list[str]]:
    with gzip.open(REFERENCE / f"{name}.csv.gz", "rt") as file:
        return list(csv.reader(file))[1:]


def columns_of(name: str) -> Any:
    return np.genfromtxt(
        REFERENCE / f"{name}.csv.gz", delimiter=",", names=True, dtype=None, encoding="ascii"
    )


def means_of(table: Any) -> Array:
    return np.column_stack([table[name] for name in NAMES])


def covariances_of(table: Any) -> Array:
    found = np.empty((len(table), 8, 8))
    for i, a in enumerate(NAMES):
        for j, b in enumerate(NAMES):
            name = f"P_{a}_{b}" if f"P_{a}_{b}" in table.dtype.names else f"P_{b}_{a}"
            found[:, i, j] = table[name]
    return found


def difference(a: Array, b: Array) -> float:
    apart = a - b
    apart[..., YAW] = wrap_angle(apart[..., YAW])
    return float(np.abs(apart).max())


@pytest.mark.parametrize(("drive", "name"), quickly(RUNS, lambda *run: run == ("kingston-1", "default")))
def test_both_forms_agree_with_the_original_code_over_a_minute(drive: str, name: str):
    messages, table = reference(drive, name), columns_of(f"{drive}_ekf_{name}")
    means, covariances, _ = messages.textbook
    assert difference(means, means_of(table)) < 1e-9
    compiled, compiled_covariances, rows = messages.compiled()
    assert difference(compiled, means_of(table)[messages.is_imu]) < 1e-9
    assert difference(rows[:8, 0], means_of(table)[-1]) < 1e-9
    np.testing.assert_allclose(compiled_covariances, covariances[messages.is_imu], rtol=0, atol=1e-9)
    stated = columns_of(f"{drive}_ekf_{name}_covariance")
    for moment, wanted in zip(stated["t_ns"], covariances_of(stated), strict=True):
        k = int(np.flatnonzero(table["t_ns"] == moment)[-1])
        np.testing.assert_allclose(covariances[k], wanted, rtol=0, atol=1e-9)
        *_, rows = messages.compiled(k + 1)
        _, found = unpack_states(rows[state_rows(NAME)], NAME)
        np.testing.assert_allclose(found[0], wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("drive", "name"), QUICK)
def test_the_first_steps_agree_with_the_original_code(drive: str, name: str):
    moments, (*_, after) = columns_of(f"{drive}_ekf_{name}")["t_ns"], reference(drive, name).textbook
    table = columns_of(f"{drive}_ekf_{name}_first_steps")
    assert {"gyro", "accel", "gps"} <= set(table["after"])
    for row, mean, covariance in zip(table, means_of(table), covariances_of(table), strict=True):
        found = after[int(np.searchsorted(moments, row["t_ns"])), row["after"]]
        assert difference(found[0], mean) < 1e-12
        np.testing.assert_allclose(found[1], covariance, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("uses_ay", quickly([(False,), (True,)], bool))
def test_compiled_agrees_with_the_textbook(uses_ay: bool):
    rng = np.random.default_rng(1)
    rows = list[list[str]]()
    for k in range(600):
        t = 10_000_000 * (k + 1)
        rows.append([f"{t}", "imu", *(f"{value}" for value in rng.normal(size=3)), ""])
        if k % 20 == 19:  # some are beyond the threshold
            x, y = rng.normal(scale=(30.0 if k % 100 == 99 else 2.0), size=2)
            rows.append([f"{t + 3_000_000}", "gps", f"{x}", f"{y}", "1.5", "2.5"])
    root = rng.normal(size=(15, 15))
    values: dict[str, Any] = {
        "use_ay": [uses_ay], "use_vy": [not uses_ay], "r_gz": [1e-3], "r_ax": [0.05], "r_vy": [0.2],
        "odom0_pose_rejection_threshold": [3.0], "t0": [0.0], "process_noise_covariance": rng.uniform(0.01, 1, 15),
        "initial_state": rng.normal(size=15), "initial_estimate_covariance": root @ root.T,
    }  # fmt: skip
    messages = Messages(rows, values)
    means, covariances, _ = messages.textbook
    compiled, compiled_covariances, _ = messages.compiled()
    assert difference(compiled, means[messages.is_imu]) < 1e-9
    np.testing.assert_allclose(compiled_covariances, covariances[messages.is_imu], rtol=0, atol=1e-9)
    free = Messages(rows, values)
    free.parameters = replace(free.parameters, gate=None)
    assert difference(free.textbook[0], means) > 0.1  # the threshold has rejected some


@pytest.mark.parametrize(
    ("imu_noise", "changes"),
    quickly(
        [
            ((1e-3, 0.5), {}),
            ((1e-3, 0.5, 0.3), {"odometer_noise": 0.04, "imu_gate": (1e-5, 1e-4), "heading_noise": 1e-4}),
        ],
        lambda _, changes: bool(changes),
    ),
    ids=["ax", "all with ay"],
)
def test_a_run_over_a_drive_agrees_with_the_textbook(imu_noise: tuple[float, ...], changes: dict[str, Any]):
    drive, rng = equipped(), np.random.default_rng(4)
    assert drive.truth is not None
    time = np.arange(0.003, 20.0, 0.02)
    speed = np.interp(time, drive.truth.time, np.hypot(drive.truth.vx, drive.truth.vy))
    drive = replace(drive, odometer=Odometer(time, speed + rng.normal(scale=0.2, size=len(time))))
    start = initial_state(drive)
    yaw, n = np.interp(drive.gps.time, drive.truth.time, np.unwrap(drive.truth.theta)), len(drive.gps)
    yaw, std = yaw + rng.normal(scale=0.05, size=n) + 2 * np.pi * rng.integers(-2, 3, n), np.full(n, 0.03)
    drive = replace(drive, gps=replace(drive.gps, heading=yaw, std_heading=std))
    p = replace(P, imu_noise=imu_noise, gate=1.0, **changes)
    found = run_filter(drive, p, initial=start, recover=False)
    drive_pass = whole_pass(drive, start)
    line, array = drive_pass.timeline, KernelArray((p,))
    mean, covariance = unpack_states(
        array.start([drive_pass.initial], [line.nominal_interval])[0][state_rows(NAME)], NAME
    )
    filter = TextbookRobotLocalization(p, mean[0], covariance[0])
    flags, rows = events_of(line, measured_by(p))
    fixes, wheels, means, used = iter(line.fixes), iter(rows), list[Array](), 0
    for k, (dt, happens) in enumerate(zip(line.dt, flags, strict=True)):
        ax, ay, gz = line.imu(("ax", "ay", "gz"))[k]
        if dt > 0:
            filter.predict(dt)
        if happens & IMU:
            filter.imu(gz, ax, ay if len(imu_noise) > 2 else None)
            if happens & LATERAL:
                filter.twist()
        if happens & ODOMETER:
            filter.odometer(next(wheels)[0])
        if happens & FIX:
            before, fix, turn = filter.mean, next(fixes), np.exp(1j * filter.mean[YAW])
            arm = turn * complex(*line.lever[:2])
            filter.fix(fix[:2] - [arm.real, arm.imag], fix[4:6])
            used += before is not filter.mean
            if happens & HEADING:
                filter.heading(fix[6], fix[7])
        if happens & IMU:
            moves = (filter.mean[2] + 1j * filter.mean[3]) * np.exp(1j * filter.mean[YAW])
            means.append(np.array([*filter.mean[:2], moves.real, moves.imag, filter.mean[YAW]]))
    assert difference(np.array(means), found.mean) < 1e-9
    assert 0 < used < len(line.fixes)  # the thresholds have rejected some
    assert ("odometer_noise" in changes) == bool((flags & ODOMETER).any()) == bool((flags & HEADING).any())
    free = run_filter(drive, replace(p, imu_gate=(np.inf, np.inf)), initial=start, recover=False)
    assert (difference(free.mean, found.mean.copy()) > 1e-3) == ("imu_gate" in changes)


def test_an_estimate_has_the_velocity_in_the_map_frame():
    rng = np.random.default_rng(2)
    mean, root = rng.normal(size=(3, 8)), rng.normal(size=(3, 8, 8))
    covariance = root @ root.swapaxes(1, 2)
    rows = pack_states(mean, covariance, NAME)[state_rows(NAME)]
    found, found_covariance = state_estimate(rows, NAME)
    np.testing.assert_allclose(found, mean[:, :5], atol=1e-14)
    np.testing.assert_allclose(found_covariance, covariance[:, :5, :5], atol=1e-12)
    body, _ = unpack_states(rows, NAME)
    speed = np.hypot(mean[:, 2], mean[:, 3])
    course = np.arctan2(mean[:, 3], mean[:, 2]) - mean[:, 4]
    np.testing.assert_allclose(
        body[:, 2:4], np.column_stack([speed * np.cos(course), speed * np.sin(course)])
    )


P = FilterParameters(
    1.0, 0.0, 0.0, (1e-4, 2e-4, 3e-4, 4e-4, 5e-6, 6e-3, 7e-3, 8e-4), (1.5, 2.5), model=NAME, kind="ekf",
    nominal_interval=0.01, imu_noise=(1e-3, 0.5), lateral_noise=0.2, gate=9.0,
)  # fmt: skip


def test_constants_and_start_are_in_their_rows():
    start = replace(initial_state(equipped()), gyro=None)
    rows = KernelArray((P,)).start([start], [0.02])[0]
    assert rows[R.Q_X : R.Q_X + 8, 0].tolist() == [2 * q for q in P.process_noise]
    wanted = {"RX": 1.5, "RY": 2.5, "R_RATE": 1e-3, "R_VELOCITY": 0.5, "R_LATERAL": 0.2, "GATE": 9.0}
    assert {row: rows[getattr(R, row), 0] for row in wanted} == wanted
    mean, covariance = unpack_states(rows[state_rows(NAME)], NAME)
    assert mean[0, 2:4] == pytest.approx([np.hypot(*start.mean[2:4]), 0.0], abs=0.5)  # the car drives forward
    assert mean[0, 5:].tolist() == [0.0, 0.0, 0.0]
    assert np.diag(covariance[0])[5:] == pytest.approx([1.0, 1.0, 0.1], rel=1e-2)
    found, found_covariance = state_estimate(rows[state_rows(NAME)], NAME)
    np.testing.assert_allclose(found[0], start.mean, atol=1e-13)
    np.testing.assert_allclose(found_covariance[0], start.covariance, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"velocity_noise": 0.1},
            "robot-localization does not have the option velocity_noise; omit this option",
        ),
        (
            {"robust_dof": 4.0, "gate": None},
            "robot-localization does not have the option robust_dof; omit this option",
        ),
        ({"latency": 0.1}, "if fixes are late, set smooth_lagged_data in ekf.yaml"),
    ],
)
def test_options_that_it_does_not_have_are_rejected(change: dict[str, Any], said: str):
    with pytest.raises(ValueError, match=said):
        replace(P, **change)
    with pytest.raises(
        InputError,
        match="robot-localization can't use 'velocity'; choose from lateral, odometer, heading, gate",
    ):
        search_space(NAME, "log10", kind="ekf", use=("velocity",))


def test_uses_that_it_does_not_support_are_rejected():
    drive = equipped()
    ready = initial_state(drive)
    for use in (
        lambda: smooth(drive, P),
        lambda: LiveFilter(P, ready, nominal_interval=0.01),
        lambda: LiveFilterBank(P, ready, nominal_interval=0.01),
        lambda: run_textbook(drive, P),
    ):
        with pytest.raises(InputError, match="does not support robot-localization; use planar8 or tilted12"):
            use()


def test_the_bounds_contain_the_stated_variances_and_the_baseline_uses_its_defaults():
    space = search_space(NAME, "log10", 0.01, kind="ekf", use=("lateral", "gate"))
    names = ["q_xy", "q_vx", "q_vy", "q_theta", "q_ax", "q_ay", "q_yaw_rate", "r_xy", "r_gyro", "r_accel"]
    assert list(space.names) == [*names, "lateral_noise", "gate"]
    more = search_space(NAME, "log10", 0.01, kind="ekf", use=("lateral", "odometer", "imu-gate"))
    assert list(more.names) == [*names, "lateral_noise", "odometer_noise", "gate_gyro", "gate_accel"]
    assert search_space(NAME, "log10", kind="ekf").decode(more.low[np.newaxis, :10])[0].imu_gate == (
        np.inf,
        np.inf,
    )
    found = more.decode((more.low + more.high)[np.newaxis] / 2)[0]
    assert found.imu_gate == pytest.approx((20.0, 20.0)) and found.odometer_noise is not None
    drive = equipped()
    usual = baseline(drive, like=P)
    per_second = np.array(usual.process_noise) / drive.nominal_interval
    assert per_second == pytest.approx([0.05, 0.05, 0.025, 0.025, 0.06, 0.01, 0.01, 0.02])
    assert (usual.imu_noise, usual.gate, usual.lateral_noise) == ((1e-4, 1e-2), None, pytest.approx(0.01))


def test_a_tuning_of_it_is_better_than_its_defaults_and_is_exported(tmp_path: Path):
    drive = make_drive(duration=40.0)
    tuning = tune([drive], model=NAME, particles=8, generations=4, out=tmp_path)
    assert tuning.config.use == ("lateral", "gate")
    assert Tuning.load(tmp_path).parameters == tuning.parameters
    scores = evaluate([drive], tuning)
    tuned, usual = (scores.mean(method, "position_rmse_m") for method in ("tuned", "baseline"))
    assert tuned is not None and usual is not None and tuned < usual
    assert "robot_localization with its default process noise" in str(scores.view.explanations())
    assert "ekf.yaml" in export(tuning, "robot_localization")


def test_an_estimate_has_no_subnormal_numbers() -> None:
    """Subnormal numbers take a hundred cycles each; without fixes, vy and ay decay to 5e-324 in a minute."""
    noise = (1e-8, 1e-8, 4e-7, 5e-7, 4e-7, 2e-5, 1.3, 0.5)
    parameters = replace(P, process_noise=noise, imu_noise=(6e-3, 2.0), lateral_noise=0.07, gate=1e-9)
    drive_pass, array = tracking_pass(prepare_drive(make_drive(duration=90))), KernelArray((parameters,))
    rows = start_passes([drive_pass], array)[0]
    rows[R.B] = 1.0
    run_steps(drive_pass, array, rows, run.new_cursor(), len(drive_pass.timeline.dt))
    numbers = np.abs(rows[[*state_rows(NAME)], 0])
    assert not np.any((numbers > 0) & (numbers < np.finfo(float).tiny))
    assert abs(rows[R.B, 0]) < 1e-300
    assert np.float64(5e-324) * np.float64(1.0) > 0, "the caller's arithmetic has changed"
