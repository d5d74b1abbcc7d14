"""Filter banks in C equal a `LiveFilterBank` without searches."""

import ctypes
import importlib.util
import math
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from exported import (
    OPTIMIZED,
    SANITIZERS,
    STRICT,
    build,
    distance,
    export_filter,
    needs_clang,
    needs_gcc,
    write,
)
from exported import replay as replay_c
from filter_cases import OPTIONS, WEIGHED, equipped, parameters, rough, straying
from microcontroller import M4F, build_for, needs_arm, replay_on
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.exports.check import check_export
from sigmaswarm.exports.lanes import Lanes
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.bank.offsets import FIXED_OFFSETS
from sigmaswarm.filters.compiled.layout import LANES
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from support import DRIVES, make_drive, needs_shared, quickly

CASES = [
    ("planar8", "ukf", "all", 16),
    ("planar8", "ukf", "both", 5),
    ("tilted12", "ekf", "all", 3),
    ("planar5", "ekf", "plain", 2),
    ("planar5", "strong-tracking-ukf", "accuracy", 8),
    ("planar8", "adaptive-ukf", "all", 4),
    ("planar8", "fuzzy-ukf", "accuracy", 8),
    ("planar8", "ukf", "plain", 16),
]


def given(model: str, kind: str, option: str) -> FilterParameters:
    return parameters(model, kind=kind, nominal_interval=0.01, **(OPTIONS | WEIGHED)[option])


def start_of(drive: Drive) -> InitialState:
    """Return the initial state without evidence about the gyro's bias, which other tests check."""
    return replace(initial_state(drive), gyro=None)


def c_filter(folder: Path, p: FilterParameters, drive: Drive, lanes: int, seed: int = 0) -> Any:
    """Return the exported filter bank, called from Python, at the start of the drive."""
    write(folder, p, lanes=lanes, seed=seed)
    sources = [folder / "ins_gps.c", folder / "ins_gps_shared.c"]
    library = folder / "libins_gps.so"
    command = ["gcc", *STRICT[:-2], "-shared", "-fPIC", *sources, "-lm", "-o", library]
    subprocess.run(command, check=True)
    spec = importlib.util.spec_from_file_location("ins_gps", folder / "ins_gps.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    start = start_of(drive)
    return module.Filter(start.time, start.mean, start.covariance.ravel(), [1.0, 0.5, 1.2], library)


def python_lanes(
    p: FilterParameters, drive: Drive, lanes: int, seed: int = 0, start: InitialState | None = None
) -> LiveFilterBank:
    swarm = LiveFilterBank(
        p, start or start_of(drive), nominal_interval=drive.nominal_interval, lever_arm=[1.0, 0.5, 1.2],
        seed=seed, searches=False, recover=False,
    )  # fmt: skip
    swarm.count_only(lanes)
    return swarm


def both(drive: Drive, c: Any, swarm: LiveFilter, late: float) -> Iterator[float]:
    """Feed C and Python with the same data, where some fixes arrive ``late`` s late; yield the time of each sample."""
    p, gps, imu = swarm.parameters, drive.gps, drive.imu
    axes = ("ax", "ay", "az", "gx", "gy", "gz") if MODELS[p.model].tilts else ("ax", "ay", "gz")
    samples = [(t, True, i) for i, t in enumerate(imu.time)]
    for t, is_imu, i in sorted(
        samples + [(t + (late if i % 3 else 0.0), False, i) for i, t in enumerate(gps.time)]
    ):
        if is_imu:
            swarm.predict(t, [getattr(imu, axis)[i] for axis in MODELS[p.model].imu])
            c.predict(t, [getattr(imu, axis)[i] for axis in axes])
            yield t
            continue
        velocity, std = None, (0.5, 0.6)
        if p.velocity_noise is not None and gps.speed is not None and gps.course is not None:
            velocity = (gps.speed[i] * math.cos(gps.course[i]), gps.speed[i] * math.sin(gps.course[i]))
        swarm.update(gps.time[i], (gps.x[i], gps.y[i]), velocity, std)
        stated = {} if p.accuracy_scale is None else {"std": std}
        c.update(gps.time[i], (gps.x[i], gps.y[i]), velocity=velocity, **stated)


@needs_gcc
@pytest.mark.parametrize(
    ("model", "kind", "option", "lanes", "late"),
    quickly(
        [(*case, late) for case in CASES for late in (0.0, 0.3)],
        lambda *case: case[:4] in CASES[:2] and (case[-1] > 0.0) == (case[:4] == CASES[1]),
    ),
)
def test_it_equals_the_filter_bank_without_searches(
    tmp_path: Path, model: str, kind: str, option: str, lanes: int, late: float
):
    p, drive = given(model, kind, option), straying() if option in WEIGHED else rough()
    c, swarm = c_filter(tmp_path, p, drive, lanes), python_lanes(p, drive, lanes)
    seen, largest, start = 0, [], initial_state(drive).time
    for t in both(drive, c, swarm, late):
        if t <= start or round(100 * t) % 23:
            continue
        seen += 1
        ours = swarm.state
        largest.append(max(c.weights))
        assert distance(np.array([c.mean]), ours.mean[np.newaxis]) < 1e-9
        scale = np.sqrt(np.outer(np.diag(ours.covariance), np.diag(ours.covariance)))
        assert np.max(np.abs(np.array(c.covariance) - ours.covariance) / scale) < 1e-9
        np.testing.assert_allclose(c.weights, swarm.weights[:lanes], rtol=0, atol=1e-9)
    assert seen > 50
    assert min(largest) < 0.99  # several lanes have a weight
    assert not c.failed


@needs_gcc
def test_the_seed_determines_the_lanes_after_the_fixed_ones(tmp_path: Path):
    p = given("planar8", "ukf", "plain")
    one, other = Lanes(16, seed=1).filters(p), Lanes(16, seed=2).filters(p)
    assert one[: len(FIXED_OFFSETS)] == other[: len(FIXED_OFFSETS)]
    assert one[0] == p
    assert all(a != b for a, b in zip(one[len(FIXED_OFFSETS) :], other[len(FIXED_OFFSETS) :], strict=True))
    drive = equipped()
    c, swarm = c_filter(tmp_path, p, drive, 16, seed=1), python_lanes(p, drive, 16, seed=1)
    for _ in both(drive, c, swarm, 0.0):
        pass
    np.testing.assert_allclose(c.weights, swarm.weights, rtol=0, atol=1e-9)
    unlike = python_lanes(p, drive, 16)
    for _ in both(drive, c, unlike, 0.0):  # C ignores old data
        pass
    assert np.max(np.abs(unlike.weights - swarm.weights)) > 1e-3


@needs_gcc
def test_the_mean_heading_of_a_mixture_is_a_circular_mean(tmp_path: Path):
    drive = make_drive(duration=40.0, seed=2, gps_std=1.0)
    drive = turned_west(drive)
    p = given("planar8", "ukf", "plain")
    c, swarm = c_filter(tmp_path, p, drive, 16), python_lanes(p, drive, 16)
    crossed, start = 0, initial_state(drive).time
    for t in both(drive, c, swarm, 0.0):
        if t > start and round(100 * t) % 5 == 0:
            ours = swarm.state.mean
            assert distance(np.array([c.mean]), ours[np.newaxis]) < 1e-9
            headings = swarm._rows_of(swarm._numbers)[4]
            crossed += bool(np.abs(ours[4]) > 3.0 and np.ptp(np.sign(np.sin(headings))) == 2)
    assert crossed > 10, "the lanes' headings were never on both sides of west"


def turned_west(drive: Drive) -> Drive:
    """Return the drive rotated so that it goes west after half of its duration."""
    gps, start = drive.gps, initial_state(drive)
    half = drive.gps.time > drive.imu.time[0] + 0.5 * drive.duration
    middle = np.flatnonzero(half)[0]
    way = complex(gps.x[middle + 2] - gps.x[middle - 2], gps.y[middle + 2] - gps.y[middle - 2])
    turn = -np.conj(way) / abs(way)
    z = (gps.x + 1j * gps.y) * turn
    assert start.time < gps.time[middle]
    return replace(
        drive, gps=replace(gps, x=z.real.copy(), y=z.imag.copy(), speed=None, course=None), truth=None
    )


@needs_gcc
def test_the_failure_of_all_lanes_is_reported_and_weights_are_zero(tmp_path: Path):
    p, drive = given("planar8", "ukf", "plain"), equipped()
    c = c_filter(tmp_path, p, drive, 4)
    t = initial_state(drive).time + 0.01
    assert c.predict(t, (0.0, 0.0, 0.0))
    assert not c.failed and sum(c.weights) == pytest.approx(1.0)
    c.predict(t + 0.01, (1e200, 0.0, 0.0))
    assert c.failed
    assert c.weights == [0.0] * 4


@needs_gcc
def test_a_failed_lane_has_no_weight(tmp_path: Path):
    """The heading of a lane is set to NaN in the memory of C and of Python."""
    p, drive = given("planar8", "ukf", "plain"), equipped()
    c, swarm = c_filter(tmp_path, p, drive, 3), python_lanes(p, drive, 3)
    for k, _ in enumerate(both(drive, c, swarm, 0.0)):
        if k == 1500:
            swarm._rows_of(swarm._numbers)[4, 1] = np.nan
            plant(c, lane=1)
    assert c.weights[1] == 0.0 == swarm.weights[1]
    np.testing.assert_allclose(c.weights, swarm.weights[:3], rtol=0, atol=1e-9)
    assert distance(np.array([c.mean]), swarm.state.mean[np.newaxis]) < 1e-9


def plant(c: Any, lane: int) -> None:
    """Set a lane's heading to NaN; its address is found by its value, which is unique in the memory."""
    state = type(c._state)()
    c._c.ins_gps_lane(c._memory, lane, ctypes.byref(state))
    assert -math.pi < state.mean[4] <= math.pi
    memory = np.frombuffer(c._memory, dtype=np.float64)
    (place,) = np.flatnonzero(
        np.abs(np.mod(memory - state.mean[4] + math.pi, 2 * math.pi) - math.pi) < 1e-13
    )[:1]
    memory[place] = np.nan


@needs_gcc
@pytest.mark.parametrize(
    "flags",
    quickly(
        [(("-DINS_GPS_FLOAT", "-DINS_GPS_HISTORY=0", *OPTIMIZED),), (SANITIZERS,)],
        lambda flags: flags is not SANITIZERS,
    ),
)
@pytest.mark.parametrize(
    "case", quickly([(0,), (2,)], lambda case: case == 0), ids=lambda case: CASES[case][0]
)
def test_the_replay_builds_without_warnings(tmp_path: Path, case: int, flags: tuple[str, ...]):
    model, kind, option, lanes = CASES[case]
    p, drive = given(model, kind, option), equipped()
    theirs = replay_c(build(tmp_path, p, *flags, lanes=lanes), drive, p.model)
    assert np.isfinite(theirs.mean).all()


@needs_gcc
@pytest.mark.parametrize(
    "case", quickly([(0,), (2,)], lambda case: case == 0), ids=lambda case: CASES[case][0]
)
@pytest.mark.usefixtures("unoptimized")
def test_a_check_compares_with_the_filter_bank(tmp_path: Path, case: int):
    model, kind, option, lanes = CASES[case]
    p = given(model, kind, option)
    write(tmp_path, p, lanes=lanes)
    (checked,) = check_export(tmp_path, p, [equipped()], lanes=lanes)
    assert checked.double.state < 1e-9
    assert checked.single is not None and 0.0 < checked.single.position < 1e-3


@needs_clang
def test_clang_gives_no_warning(tmp_path: Path):
    build(tmp_path, given("planar8", "ukf", "all"), compiler="clang", lanes=16)


@needs_gcc
@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_cpp_compiles_the_header(tmp_path: Path):
    write(tmp_path, given("planar8", "ukf", "all"), lanes=16)
    (tmp_path / "main.cpp").write_text(
        '#include "ins_gps.h"\nstatic InsGps f;\nint main() { return f.now.lane[0].failed; }\n'
    )
    subprocess.run(["g++", "-Wall", "-Wextra", "-Werror", "-c", "main.cpp"], cwd=tmp_path, check=True)


@pytest.mark.long
@needs_arm
def test_an_emulated_board_computes_the_mixture(tmp_path: Path):
    p, drive = given("planar8", "ukf", "all"), equipped()
    flags = ("-DINS_GPS_FLOAT", "-DINS_GPS_HISTORY=0")
    program = build_for(M4F, tmp_path, p, *flags, optimize="-O1", lanes=4)
    board = replay_on(M4F, program, drive, p.model)
    start = initial_state(drive)
    swarm = python_lanes(p, drive, 4, start=start)
    times = (t for t in both(drive, Mock(), swarm, 0.0) if t > start.time)
    off = board.mean[::10] - np.array([swarm.state.mean for k, _ in enumerate(times) if k % 10 == 0])
    assert 0.0 < np.max(np.hypot(off[:, 0], off[:, 1])) < 0.01


@pytest.mark.long
@needs_gcc
@needs_shared
@pytest.mark.usefixtures("unoptimized")
@pytest.mark.parametrize(
    "name", quickly([("kitti-09-30-0033",), ("colorado-1",)], lambda name: name == "colorado-1")
)
def test_it_equals_the_filter_bank_on_real_drives(tmp_path: Path, name: str):
    p, drive = given("planar8", "ukf", "lateral"), read_drive(DRIVES / name)
    drive = clip(drive, 0.0, initial_state(drive).time - drive.imu.time[0] + 45.0)
    write(tmp_path, p, lanes=16)
    (checked,) = check_export(tmp_path, p, [drive], lanes=16)
    assert checked.double.state < 1e-9


@pytest.mark.parametrize("lanes", [-1, 0, LANES + 1])
def test_an_invalid_number_of_lanes_is_rejected(tmp_path: Path, lanes: int):
    with pytest.raises(InputError, match=f"lanes = {lanes}"):
        export_filter(given("planar8", "ukf", "all"), "c99", tmp_path, lanes=lanes)


def test_other_targets_support_one_filter_only(tmp_path: Path):
    with pytest.raises(InputError, match="--lanes needs --to c99"):
        export_filter(given("planar8", "ukf", "all"), "filterpy", tmp_path, lanes=4)


def test_one_lane_is_a_filter_without_a_bank(tmp_path: Path):
    p = given("planar8", "ukf", "all")
    texts = [
        {path.name: path.read_text() for path in export_filter(p, "c99", tmp_path / name, lanes=1, seed=seed)}
        for name, seed in (("alone", 0), ("one", 5))
    ]
    assert texts[0] == texts[1]
    assert "#define INS_GPS_LANES 1 " in texts[0]["ins_gps.h"]
    assert not any(
        word in "".join(texts[0].values()) for word in ("b->evidence", "penalty", "ins_gps_weights")
    )
