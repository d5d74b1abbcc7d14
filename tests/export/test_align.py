"""The exported C code computes the library's initial state from the drive, with a consistent covariance."""

import re
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from exported import SANITIZERS, STRICT, build, export_filter, needs_gcc, tuned
from filter_cases import equipped
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.filters.run import run_filter
from sigmaswarm.geodesy import wrap_angle
from support import DRIVES, make_drive, needs_shared, quickly

P = tuned("planar5", "ukf", 0.01, everything=False)
STARTS = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "ins_gps_align.h"

int main(void) /* Every start that a drive's rows show: time, mean, covariance. */
{
    static InsGpsAlign align;
    static char row[4096];
    double z[33] = {0.0};
    ins_gps_real mean[5], P[25];
    while (fgets(row, sizeof row, stdin)) {
        int n = 0;
        for (char *c = strchr(row, ','); c && n < 33; c = strchr(c + 1, ',')) {
            z[n++] = strtod(c + 1, NULL);
        }
        if (row[0] == 'a') {
            const ins_gps_real arm[2] = {(ins_gps_real)z[0], (ins_gps_real)z[1]};
            ins_gps_align_init(&align, arm);
        } else if (row[0] == 'i') {
            ins_gps_align_predict(&align, z[0], (ins_gps_real)z[1], (ins_gps_real)z[3]);
        } else if (ins_gps_align_fix(&align, z[0], (ins_gps_real)z[1], (ins_gps_real)z[2], mean, P)) {
            printf("%.17g", z[0]);
            for (int i = 0; i < 30; i++) {
                printf(",%.17g", (double)(i < 5 ? mean[i] : P[i - 5]));
            }
            puts("");
        }
    }
    return 0;
}
"""


@cache
def rows_of(drive: Drive) -> list[str]:
    """Return the rows of the replay without an initial state."""
    lever = drive.lever_arm.tolist()
    return [f"align,{lever[0]!r},{lever[1]!r}", *replay_rows(drive).splitlines()[1:]]


@pytest.fixture(
    scope="module",
    params=quickly([(SANITIZERS,), (("-DINS_GPS_FLOAT",),)], lambda flags: flags is SANITIZERS),
    ids=["double", "float"],
)
def program(request, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("align"), P, *request.param, main=STARTS)


@pytest.fixture(scope="module")
def clean(program: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return starts(program, rows_of(equipped()))


def starts(program: Path, rows: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (k,), means (k, 5) and covariances (k, 5, 5) of the initial states that a program prints."""
    done = subprocess.run(
        [program], input="\n".join(rows) + "\n", capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    table = np.array([[float(cell) for cell in line.split(",")] for line in done.stdout.splitlines()])
    table = table.reshape(-1, 31)
    return table[:, 0], table[:, 1:6], table[:, 6:].reshape(-1, 5, 5)


def errors(drive: Drive, time: np.ndarray, mean: np.ndarray) -> np.ndarray:
    truth = drive.truth
    assert truth is not None
    columns = truth.x, truth.y, truth.vx, truth.vy, np.unwrap(truth.theta)
    wrong = mean - np.column_stack([np.interp(time, truth.time, column) for column in columns])
    wrong[:, 4] = wrap_angle(wrong[:, 4])
    return wrong


@cache
def simulated(seed: int) -> Drive:
    return make_drive(duration=60.0, seed=seed, jitter=0.3)


@needs_gcc
@pytest.mark.parametrize("seed", quickly([(0,), (1,)], lambda seed: seed == 1))
def test_its_errors_agree_with_its_covariance(program: Path, seed: int):
    time, mean, covariance = starts(program, rows_of(simulated(seed)))
    assert len(time) > 200
    assert np.linalg.eigvalsh(covariance).min() > 0
    wrong = errors(simulated(seed), time, mean)
    nees = np.einsum("ki,kij,kj->k", wrong, np.linalg.inv(covariance), wrong)
    assert 1.0 < np.median(nees) < 9.0  # chi-square of five has 4.4; windows overlap, so the spread is wide
    assert np.degrees(np.median(np.abs(wrong[:, 4]))) < 1.5
    assert np.degrees(np.quantile(np.abs(wrong[:, 4]), 0.9)) < 4.0
    assert np.median(np.hypot(*wrong[:, :2].T)) < 1.0
    assert np.median(np.hypot(*wrong[:, 2:4].T)) < 0.5


@needs_gcc
def test_without_noise_it_is_exact(program: Path):
    drive, arm = make_drive(duration=60.0, seed=1, gps_std=0.0), np.array([2.5, -1.0])
    truth, t = drive.truth, drive.gps.time
    assert truth is not None
    theta = np.interp(t, truth.time, np.unwrap(truth.theta))
    antenna = np.exp(1j * theta) * complex(*arm)
    gps = replace(drive.gps, x=drive.gps.x + antenna.real, y=drive.gps.y + antenna.imag)
    time, mean, _ = starts(
        program, rows_of(replace(drive, gps=gps, metadata={"gps_lever_arm_m": [*arm, 0.0]}))
    )
    wrong = np.abs(errors(drive, time, mean))
    assert np.max(wrong[:, :4]) < 0.02  # m, m/s: fixes are between samples
    assert np.max(wrong[:, 4]) < np.radians(0.1)


@needs_gcc
def test_it_starts_at_the_time_of_the_library(program: Path):
    time, mean, covariance = starts(program, rows_of(equipped()))
    ours = initial_state(equipped())
    assert time[0] == ours.time
    off = mean[0] - ours.mean
    off[4] = wrap_angle(float(off[4]))
    assert np.all(np.abs(off) < 2e-3)  # m, m/s, rad: samples are summed in another order
    np.testing.assert_allclose(covariance[0], ours.covariance, rtol=2e-3, atol=1e-4)


@needs_gcc
@needs_shared
@pytest.mark.parametrize(
    ("name", "first", "last"),
    quickly(
        [("kitti-09-30-0033", 0.0, 60.0), ("colorado-1", 0.0, 120.0), ("kingston-1", 500.0, 700.0)],
        lambda name, first, last: name != "colorado-1",
    ),
)
def test_real_drives(program: Path, name: str, first: float, last: float):
    drive = clip(read_drive(DRIVES / name), first, last)
    time, mean, _ = starts(program, rows_of(drive))
    assert abs(time[0] - initial_state(drive).time) < 5.0
    assert np.degrees(np.median(np.abs(errors(drive, time, mean)[:, 4]))) < 2.0


@needs_gcc
def test_a_replay_computes_its_start(tmp_path: Path):
    drive, program = simulated(0), build(tmp_path, P)
    done = subprocess.run(
        [program], input="\n".join(rows_of(drive)) + "\n", capture_output=True, text=True, check=True
    )
    last = np.array([float(cell) for cell in done.stdout.splitlines()[-1].split(",")])
    ours = run_filter(drive, P, recover=False)
    assert last[0] == ours.time[-1]
    np.testing.assert_allclose(last[1:6], ours.mean[-1], atol=0.02)  # the start has no effect any more


@needs_gcc
def test_without_a_determined_heading_there_is_no_start(program: Path, tmp_path: Path):
    rng = np.random.default_rng(0)
    still = ["align,0,0"]
    for k in range(6000):
        if k % 20 == 0:
            east, north = rng.normal(0.0, 1.5, 2)
            still.append(f"fix,{0.01 * k},{east},{north}")
        still.append(f"imu,{0.01 * k},0.02,0,0.001")
    assert len(starts(program, still)[0]) == 0
    moving = rows_of(simulated(0))
    for broken in ("imu,nan,0,0,0", "imu,9.0,nan,0,0", "imu,1.0,0,0,0", "fix,9.5,inf,0", "fix,1.0,0,0"):
        inserted = [*moving[:1000], broken, *moving[1000:]]
        np.testing.assert_array_equal(starts(program, inserted)[1], starts(program, moving)[1])
    quiet = build(tmp_path, P)
    done = subprocess.run([quiet], input="\n".join(still) + "\n", capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "replay: no start was found\n")


@needs_gcc
def test_fixes_at_25_hz_do_not_overflow_the_buffer(program: Path):
    often = make_drive(duration=20.0, gps_rate=25.0, seed=1)
    assert 50 < len(starts(program, rows_of(often))[0]) < 200


@needs_gcc
@pytest.mark.parametrize("flags", [(), ("-DINS_GPS_FLOAT",)], ids=str)
def test_the_example_in_the_docs_compiles(tmp_path: Path, flags: tuple[str, ...]):
    page = Path(__file__).parents[2] / "docs" / "export.md"
    (example,) = re.findall(r"```c\n(.*?)```", page.read_text(), re.DOTALL)
    export_filter(P, "c99", tmp_path)
    (tmp_path / "example.c").write_text(example)
    strict = [flag for flag in STRICT if flag != "-Wconversion"]  # the example converts double to float
    command = ["gcc", *strict, *flags, "-fsyntax-only", tmp_path / "example.c"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs_gcc
@pytest.mark.parametrize("off", [1e9, 20.0, -20.0, -1e9])
@pytest.mark.parametrize("name", ["imu", "fix"])
def test_one_wrong_time_does_not_end_the_search(
    program: Path, clean: tuple[np.ndarray, ...], name: str, off: float
):
    rows = rows_of(equipped())
    k = next(i for i in range(300, len(rows)) if rows[i].startswith(name))
    _, t, *rest = rows[k].split(",")
    found = starts(program, [*rows[:k], ",".join([name, repr(float(t) + off), *rest]), *rows[k:]])
    if name == "fix":  # the fix is ignored
        np.testing.assert_array_equal(found[1], clean[1])
    else:  # the search starts again and needs 4 to 6 s
        assert clean[0][0] < found[0][0] < float(t) + 7.0
        np.testing.assert_allclose(found[1][-1], clean[1][-1], rtol=0, atol=1e-6)
