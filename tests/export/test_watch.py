"""The exported C filter detects divergence and is reset, approximately as in the library."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from exported import SANITIZERS, build, needs_gcc
from filters.test_divergence import PLANTS, SET, drive_of, rmse, stops_and_goes
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.filters.run import run_filter
from support import quickly

WATCHED = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "ins_gps_align.h"

int main(void) /* Time, x, y, whether it started anew and whether it is lost, after each sample. */
{
    static InsGps filter;
    static InsGpsWatch watch;
    static char row[4096];
    ins_gps_real numbers[33];
    double z[33], start = 0.0;
    while (fgets(row, sizeof row, stdin)) {
        int n = 0;
        for (char *c = strchr(row, ','); c && n < 33; c = strchr(c + 1, ',')) {
            z[n] = strtod(c + 1, NULL);
            numbers[n] = (ins_gps_real)z[n];
            n++;
        }
        if (row[0] == 's') {
            start = z[0];
            ins_gps_init(&filter, z[0], numbers + 3, numbers + 8, numbers + 1);
            ins_gps_watch_init(&watch, z[0], numbers + 1);
        } else if (row[0] == 'f') {
            ins_gps_update(&filter, z[0], numbers[1], numbers[2], NULL);
            ins_gps_watch_fix(&watch, z[0], numbers[1], numbers[2]);
        } else if (ins_gps_predict(&filter, z[0], numbers[1], numbers[2], numbers[3])) {
            const bool anew = ins_gps_watch_sample(&watch, &filter, z[0], numbers[1], numbers[3]);
            InsGpsState state;
            ins_gps_state(&filter, &state);
            if (z[0] > start) {
                printf("%.17g,%.17g,%.17g,%d,%d\n", state.time, (double)state.mean[0], (double)state.mean[1], anew,
                       watch.lost);
            }
        }
    }
    return 0;
}
"""


@pytest.fixture(
    scope="module",
    params=quickly([(SANITIZERS,), (("-DINS_GPS_FLOAT",),)], lambda flags: flags is not SANITIZERS),
    ids=["double", "float"],
)
def program(request, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("watch"), SET, *request.param, main=WATCHED)


def watched(program: Path, drive: Drive, start: InitialState) -> np.ndarray:
    """Return the rows that the program prints, (k, 5)."""
    first = (start.time, *drive.lever_arm, *start.mean, *start.covariance.ravel())
    rows = [",".join(["start", *(repr(float(v)) for v in first)]), *replay_rows(drive).splitlines()[1:]]
    done = subprocess.run(
        [program], input="\n".join(rows) + "\n", capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return np.loadtxt(done.stdout.splitlines(), delimiter=",")


@needs_gcc
@pytest.mark.parametrize("plant", quickly([(plant,) for plant in PLANTS], lambda plant: plant == "turned"))
def test_it_is_reset_at_the_same_times_as_the_library(program: Path, plant: str):
    drive, start = PLANTS[plant](drive_of("simulated"))
    run = run_filter(drive, SET, initial=start)
    rows = watched(program, drive, start)
    restarts = rows[rows[:, 3] == 1, 0]
    np.testing.assert_allclose(restarts, run.restarts, rtol=0, atol=1e-5)
    truth, gps = drive.truth, drive.gps
    assert truth is not None
    for restart in restarts:
        part = (rows[:, 0] >= restart) & (rows[:, 0] <= restart + 10)
        fixes = (gps.time >= restart) & (gps.time <= restart + 10)
        raw = rmse(truth, gps.time[fixes], gps.x[fixes], gps.y[fixes])
        assert rmse(truth, *rows[part, :3].T) <= raw


@pytest.mark.long
@needs_gcc
def test_while_no_alignment_is_possible_it_returns_the_last_fix(program: Path):
    drive, start = stops_and_goes()
    run = run_filter(drive, SET, initial=start)
    rows = watched(program, drive, start)
    assert run.lost is not None
    np.testing.assert_allclose(rows[rows[:, 3] == 1, 0], run.restarts, rtol=0, atol=1e-5)
    both = (rows[:, 4] == 1) & run.lost
    assert both.sum() > 0.9 * run.lost.sum()
    np.testing.assert_allclose(rows[both, 1:3], run.mean[both, :2], rtol=0, atol=1e-3)  # float


@needs_gcc
def test_a_sound_filter_is_not_reset(program: Path):
    drive = drive_of("simulated")
    run = run_filter(drive, SET)
    rows = watched(program, drive, run.initial)
    assert not rows[:, 3:].any()
    np.testing.assert_allclose(rows[:, 1:3], run.mean[:, :2], rtol=0, atol=0.1)  # float
