"""The exported C filter uses evidence about the gyro's bias, from the library's start and from its own alignment."""

import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from exported import SANITIZERS, build, distance, needs_gcc, replay, tuned
from sigmaswarm.drives.alignment import Alignments
from sigmaswarm.drives.drive import Drive
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.simulation.scenarios import simulate
from support import make_drive, quickly, some

KINDS = {"planar8": "ukf", "tilted12": "ekf"}
OFF = np.radians([9.0, -6.0, 14.0])


def off(share: float) -> Drive:
    drive = make_drive(duration=30.0, seed=4)
    imu = drive.imu
    assert imu.gx is not None
    assert imu.gy is not None
    x, y, z = share * OFF
    return replace(
        drive,
        imu=replace(imu, gx=imu.gx + x, gy=imu.gy + y, gz=imu.gz + z),
        metadata={"gps_lever_arm_m": [0.8, -0.3, 1.0]},
    )


def filter_of(model: str) -> FilterParameters:
    """Return a filter for a gyro with a small bias."""
    return replace(tuned(model, KINDS[model], 0.01, everything=False), bias_std=(0.1, 3e-4))


@needs_gcc
@pytest.mark.parametrize(
    ("model", "share"), quickly(product(KINDS, (0.1, 1.0)), lambda *case: case == ("tilted12", 0.1))
)
def test_with_the_library_s_start_it_equals_the_run(tmp_path: Path, model: str, share: float):
    drive, p = off(share), filter_of(model)
    ours = run_filter(drive, p, recover=False)
    theirs = replay(build(tmp_path, p, *SANITIZERS), drive, model)
    np.testing.assert_array_equal(theirs.time, ours.time)
    assert distance(theirs.mean, ours.mean) < 1e-9
    deviation = np.sqrt(np.diagonal(ours.covariance, axis1=1, axis2=2))
    np.testing.assert_allclose(np.sqrt(theirs.variance), deviation, rtol=1e-7)


@needs_gcc
@pytest.mark.parametrize(
    ("model", "flags"),
    quickly(
        product(KINDS, (SANITIZERS, ("-DINS_GPS_FLOAT",))),
        lambda model, flags: (model == "tilted12") == (flags == SANITIZERS),
    ),
)
def test_its_own_alignment_estimates_the_bias(tmp_path: Path, model: str, flags: tuple[str, ...]):
    drive, p = off(1.0), filter_of(model)
    arm = [*drive.lever_arm.tolist(), drive.antenna_height][: 3 if model == "tilted12" else 2]
    rows = [",".join(["align", *map(repr, arm)]), *replay_rows(drive, model).splitlines()[1:]]
    done = subprocess.run(
        [build(tmp_path, p, *flags)],
        input="\n".join(rows) + "\n",
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    table = np.loadtxt(done.stdout.splitlines(), delimiter=",", skiprows=1)
    ours, truth = run_filter(drive, p), drive.truth
    assert truth is not None
    assert not ours.restarts
    soon = 100  # 1 s after the start
    theta = np.interp(table[soon, 0], truth.time, np.unwrap(truth.theta))
    assert abs(wrap_angle(float(table[soon, 5] - theta))) < np.radians(12.0)  # otherwise 25 to 30 degrees
    assert table[soon, 8] == pytest.approx(OFF[2], abs=np.radians(5.0))
    np.testing.assert_allclose(table[-1, 1:6], ours.mean[-1, :5], atol=0.3)
    assert abs(table[-1, 8] - OFF[2]) < np.radians(0.5)


@needs_gcc
def test_a_start_without_the_evidence_is_accepted(tmp_path: Path):
    drive, p = off(0.1), filter_of("planar8")
    first, *rest = replay_rows(drive, "planar8").splitlines()
    plain = ",".join(first.split(",")[:34])
    done = subprocess.run(
        [build(tmp_path, p)],
        input="\n".join([plain, *rest]) + "\n",
        capture_output=True,
        text=True,
        check=True,
    )
    last = np.array([float(cell) for cell in done.stdout.splitlines()[-1].split(",")])
    initial = replace(run_filter(drive, p, recover=False).initial, gyro=None)
    ours = run_filter(drive, p, initial=initial, recover=False)
    np.testing.assert_allclose(last[1:9], ours.mean[-1], rtol=0, atol=1e-8)


EVIDENCE = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "ins_gps_align.h"

int main(void) /* Time and evidence of every start. */
{
    static InsGpsAlign align;
    static char row[4096];
    double z[8] = {0.0};
    ins_gps_real mean[5], P[25];
    while (fgets(row, sizeof row, stdin)) {
        int n = 0;
        for (char *c = strchr(row, ','); c && n < 8; c = strchr(c + 1, ',')) {
            z[n++] = strtod(c + 1, NULL);
        }
        if (row[0] == 'i') {
            ins_gps_align_predict(&align, z[0], (ins_gps_real)z[1], (ins_gps_real)z[2], (ins_gps_real)z[5],
                                  (ins_gps_real)z[6], (ins_gps_real)z[3]);
        } else if (row[0] == 'f' && ins_gps_align_fix(&align, z[0], (ins_gps_real)z[1], (ins_gps_real)z[2], mean, P)) {
            const double *numbers = (const double *)&align.gyro;
            printf("%.17g", z[0]);
            for (unsigned i = 0; i < sizeof align.gyro / sizeof *numbers; i++) {
                printf(",%.17g", numbers[i]);
            }
            puts("");
        }
    }
    return 0;
}
"""


@needs_gcc
def test_its_alignment_has_the_same_evidence_as_the_library(tmp_path: Path):
    drive = make_drive(duration=30.0, seed=4, gps_std=0.3)
    imu, t = drive.imu, drive.imu.time
    leaning = {
        "gx": 0.05 * np.cos(1.5 * t),
        "gy": 0.03 * np.sin(t) - 0.01,
        "ay": imu.ay + 0.3 * np.sin(1.5 * t),
    }
    drive = replace(drive, imu=replace(imu, ax=imu.ax - 0.3, gz=imu.gz + 0.4, **leaning))
    rows = replay_rows(drive, "tilted12").splitlines()[1:]
    program = build(tmp_path, filter_of("tilted12"), main=EVIDENCE)
    done = subprocess.run([program], input="\n".join(rows) + "\n", capture_output=True, text=True, check=True)
    table = np.array([[float(cell) for cell in line.split(",")] for line in done.stdout.splitlines()])
    alignments, compared = Alignments(drive), 0
    for time, *numbers in table[::5].tolist():
        start = alignments.at(int(np.searchsorted(alignments.time, time)))
        if start is None or start.tilt is None or start.gyro is None or not start.gyro.taken:
            continue
        compared += 1
        gyro = [*start.gyro.bias, *start.gyro.variance, start.gyro.taken, *start.gyro.turns]
        ours = np.array([*gyro, *start.tilt.numbers])
        np.testing.assert_allclose(numbers, ours, rtol=0.02, atol=2e-3)
    assert compared > 10


@needs_gcc
@pytest.mark.parametrize("flags", some([(), ("-DINS_GPS_FLOAT",)]), ids=["double", "float"])
def test_its_own_alignment_estimates_the_tilt(tmp_path: Path, flags: tuple[str, ...]):
    drive = simulate("urban", terrain="hilly", gps="white-1m", imu="icm-20602", duration=30.0, seed=3)
    p = replace(filter_of("tilted12"), bias_std=(0.02, 1e-3))
    rows = ["align,0,0,0", *replay_rows(drive, "tilted12").splitlines()[1:]]
    done = subprocess.run(
        [build(tmp_path, p, *flags)], input="\n".join(rows) + "\n", capture_output=True, text=True, check=True
    )
    theirs = np.array([float(cell) for cell in done.stdout.splitlines()[1].split(",")])
    ours = run_filter(drive, p)
    k = int(np.searchsorted(ours.time, theirs[0]))
    assert ours.time[k] == theirs[0]
    assert k == 0
    std = np.sqrt(np.diag(ours.covariance[k]))
    assert abs(ours.mean[k, 8]) > 3.0 * std[8]  # the road is tilted
    assert np.all(np.abs(theirs[1:13] - ours.mean[k]) < 2e-3 * std)  # samples are summed in another order
    np.testing.assert_allclose(theirs[13:25], std, rtol=1e-3)
