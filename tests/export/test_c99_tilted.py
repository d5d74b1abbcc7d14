"""tilted12 in C equals the run with every measurement, on hills, in gaps and with late fixes."""

import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

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
    replay,
    tuned,
    write,
)
from sigmaswarm import InputError, simulate
from sigmaswarm.drives.drive import Drive
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.simulation.gps import GPS_GRADES
from support import make_drive, quickly

OPTIONS = {
    "plain": {},
    "velocity": {"velocity_noise": 0.1},
    "lateral": {"lateral_noise": 0.05, "rear_axle": 1.2, "tire_slip": 0.004},
    "standstill": {"standstill_noise": 1e-3},
    "gate": {"gate": 2.0},
    "latency": {"latency": 0.1},
    "accuracy": {"accuracy_scale": 0.4},
    "robust": {"robust_dof": 4.0},
    "all": {"velocity_noise": 0.1, "lateral_noise": 0.05, "rear_axle": -0.7, "tire_slip": 0.01, "latency": 0.05,
            "standstill_noise": 1e-3, "accuracy_scale": 0.4, "robust_dof": 2.0},
}  # fmt: skip


def given(option: str) -> FilterParameters:
    return replace(tuned("tilted12", "ekf", 0.01, everything=False), **OPTIONS[option])


@cache
def hills() -> Drive:
    """Return a hilly drive: antenna above the IMU, velocities, accuracies, outliers, a gap, stale fixes, a stop."""
    grade = replace(GPS_GRADES["ublox-m8"], lever_arm=(0.4, -0.3, 1.2))
    drive = simulate("brake", terrain="hilly", gps=grade, jitter=1e-3, run=2)
    imu, gps, rng = drive.imu, drive.gps, np.random.default_rng(2)
    silent = (imu.time > 16.0) & (imu.time < 16.7)
    n = len(gps)
    std_x, std_y = rng.uniform(0.3, 3.0, (2, n))
    x = gps.x + 15.0 * np.isin(np.arange(n), (60, 61))
    frozen = np.isin(np.arange(n), (70, 71, 72))
    x, y = np.where(frozen, x[69], x), np.where(frozen, gps.y[69], gps.y)
    gps = replace(gps, x=x, y=y, std_x=std_x, std_y=std_y)
    return replace(
        drive, imu=imu.select(~silent), gps=gps, metadata={"gps_lever_arm_m": list(grade.lever_arm)}
    )


@needs_gcc
@pytest.mark.parametrize("option", quickly([(o,) for o in OPTIONS], lambda o: o == "all"))
def test_it_equals_the_run(tmp_path: Path, option: str):
    p = given(option)
    ours = run_filter(hills(), p, recover=False)
    theirs = replay(build(tmp_path, p, *(OPTIMIZED if option == "all" else ())), hills(), "tilted12")
    np.testing.assert_array_equal(theirs.time, ours.time)
    assert distance(theirs.mean, ours.mean) < 1e-11
    np.testing.assert_allclose(theirs.variance, np.diagonal(ours.covariance, axis1=1, axis2=2), rtol=1e-9)
    assert np.degrees(np.abs(ours.mean[:, 8:10]).max()) > 2.0  # the hills have an effect
    if option not in ("plain", "all"):
        plain = run_filter(hills(), given("plain"), recover=False)
        assert distance(plain.mean, ours.mean) > 1e-6  # the option has an effect


@needs_gcc
def test_late_fixes_are_applied_at_their_time(tmp_path: Path):
    first, *rows = replay_rows(hills(), "tilted12").splitlines()

    def known(row: str) -> tuple[float, str]:
        return float(row.split(",")[1]) + (0.31 if row.startswith("fix") else 0.0), row

    rows = [row for row in rows if not row.startswith("fix") or float(row.split(",")[1]) < 20.0]
    late = [first, *sorted(rows, key=known)]
    program = build(tmp_path, replace(given("lateral"), standstill_noise=1e-3))
    final, in_time = (
        subprocess.run([program], input="\n".join(each) + "\n", capture_output=True, text=True, check=True)
        for each in (late, [first, *rows])
    )
    last = [
        np.array([float(cell) for cell in run.stdout.splitlines()[-1].split(",")]) for run in (final, in_time)
    ]
    np.testing.assert_allclose(last[0], last[1], rtol=0, atol=1e-12)


@needs_gcc
def test_its_own_alignment_needs_three_coordinates_of_the_antenna(tmp_path: Path):
    told = replay_rows(hills(), "tilted12").splitlines()
    program = build(tmp_path, given("lateral"))

    def run(first: str) -> subprocess.CompletedProcess[str]:
        rows = "\n".join([first, *told[1:]]) + "\n"
        return subprocess.run([program], input=rows, capture_output=True, text=True, check=False)

    ends = [
        np.array(run(first).stdout.splitlines()[-1].split(","), float)
        for first in (told[0], "align,0.4,-0.3,1.2")
    ]
    np.testing.assert_allclose(ends[0][:3], ends[1][:3], atol=0.2)
    refused = run("align,0.4,-0.3")
    assert (refused.returncode, "align,forward,left,up" in refused.stderr) == (2, True)


@needs_gcc
def test_float_differs_by_centimeters(tmp_path: Path):
    p = given("all")
    off = replay(build(tmp_path, p, "-DINS_GPS_FLOAT"), hills(), "tilted12").mean
    off = off - run_filter(hills(), p, recover=False).mean
    assert 1e-9 < np.max(np.abs(off[:, :2])) < 2e-2


@pytest.mark.long
@needs_gcc
def test_the_sanitizers_find_nothing_over_a_drive(tmp_path: Path):
    p = given("all")
    sanitized = replay(build(tmp_path, p, *SANITIZERS), hills(), "tilted12")
    assert distance(sanitized.mean, run_filter(hills(), p, recover=False).mean) < 1e-11


@pytest.mark.parametrize(
    "compiler", [pytest.param("gcc", marks=needs_gcc), pytest.param("clang", marks=needs_clang)]
)
@pytest.mark.parametrize("flags", [(), ("-DINS_GPS_FLOAT", "-DINS_GPS_HISTORY=0")], ids=str)
def test_compilers_give_no_warning(tmp_path: Path, compiler: str, flags: tuple[str, ...]):
    for option in ("plain", "all"):
        write(tmp_path, given(option))
        command = [compiler, *STRICT, *flags, "-fsyntax-only", *sorted(tmp_path.glob("*.c"))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


def test_what_c_does_not_support_is_rejected_with_one_line(tmp_path: Path):
    with pytest.raises(InputError, match=r"tilted12 is not available as ukf in C; use kind ekf"):
        export_filter(replace(given("plain"), kind="ukf"), "c99", tmp_path)
    with pytest.raises(InputError, match=r"has no az, gx, gy, which tilted12 needs"):
        drive = make_drive()
        planar = replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None))
        export_filter(given("plain"), "c99", tmp_path, replay=planar)
