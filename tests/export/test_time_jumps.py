"""After a time stamp far in the future, the exported C filter and the live filter continue by the same rule."""

import math
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exported import build, needs_gcc
from filter_cases import equipped, parameters
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.split import clip
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.run import run_filter

P = parameters("planar8", nominal_interval=0.01, standstill_noise=1e-3, lateral_noise=0.05, gate=6.0)
COUNTING = r"""
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "ins_gps.h"

int main(void) /* What became of each row, and where the filter is: counters, time, mean. */
{
    static InsGps f;
    static char row[4096];
    while (fgets(row, sizeof row, stdin)) {
        double z[33] = {0.0};
        int n = 0;
        for (char *c = strchr(row, ','); c && n < 33; c = strchr(c + 1, ',')) {
            z[n++] = strtod(c + 1, NULL);
        }
        bool taken = true;
        if (row[0] == 's') {
            ins_gps_init(&f, z[0], z + 3, z + 8, z + 1);
        } else if (row[0] == 'i') {
            taken = ins_gps_predict(&f, z[0], z[1], z[2], z[3]);
        } else {
            taken = ins_gps_update(&f, z[0], z[1], z[2], 0);
        }
        InsGpsState state;
        ins_gps_state(&f, &state);
        printf("%d,%lu,%d,%.17g", row[0] == 'f' && taken, f.time_jumps, state.failed, state.time);
        for (int i = 0; i < INS_GPS_STATES; i++) {
            printf(",%.17g", state.mean[i]);
        }
        puts("");
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("c"), P, main=COUNTING)


@cache
def rows() -> list[str]:
    """Return the drive's rows after its start, without the receiver's velocities: the start, samples, fixes."""
    drive = clip(equipped(), 0.0, 16.0)
    start, *others = replay_rows(drive).splitlines()
    begins = initial_state(drive).time
    after = [row for row in others if float(row.split(",")[1]) > begins]
    return [start, *(",".join(row.split(",")[:4]) if row.startswith("fix") else row for row in after)]


def in_c(program: Path, fed: list[str]) -> np.ndarray:
    done = subprocess.run([program], input="\n".join(fed) + "\n", capture_output=True, text=True, check=True)
    return np.array([[float(cell) for cell in line.split(",")] for line in done.stdout.splitlines()])


def in_python(fed: list[str]) -> np.ndarray:
    drive = equipped()
    live = LiveFilter(
        P,
        replace(initial_state(drive), gyro=None),
        nominal_interval=0.01,
        lever_arm=drive.lever_arm,
        recover=False,
    )
    said: list[list[float]] = []
    for row in fed:
        name, *cells = row.split(",")
        t, *z = (float(cell) for cell in cells)
        taken = False
        if name == "imu":
            live.predict(t, z)
        elif name == "fix":
            taken = live.update(t, z)
        state = live.state
        said.append([taken, live.time_jumps, state.failed, state.time, *state.mean])
    return np.array(said)


def same_in_both(program: Path, fed: list[str]) -> np.ndarray:
    """Feed both with the same rows, and check that their outputs agree after each row; return the outputs."""
    ours, theirs = in_python(fed), in_c(program, fed)
    np.testing.assert_array_equal(theirs[:, :4], ours[:, :4])
    # In a minute without fixes, rounding errors of the heading grow to 1e-9 of the distance, which is kilometers.
    away = np.maximum(1.0, np.abs(ours[:, 4:]).max(axis=1, keepdims=True))
    np.testing.assert_allclose((theirs[:, 4:] - ours[:, 4:]) / away, 0.0, atol=1e-9)
    return ours


TAKEN, JUMPS, TIME, X = 0, 1, 3, 4


def at(seconds: float) -> int:
    """Return the index of the first sample's row at least this long after the start."""
    begins = float(rows()[0].split(",")[1])
    return next(
        k
        for k, row in enumerate(rows())
        if row.startswith("imu") and float(row.split(",")[1]) > begins + seconds
    )


def moved(row: str, seconds: float) -> str:
    name, t, *rest = row.split(",")
    return ",".join([name, repr(float(t) + seconds), *rest])


@needs_gcc
@pytest.mark.parametrize("ahead", [10.5, 1e300])
def test_one_sample_far_ahead_is_dropped_and_counted(program: Path, ahead: float):
    k = at(4.0)
    fed = [*rows()[:k], moved(rows()[k], ahead), *rows()[k:]]
    said, clean = same_in_both(program, fed), same_in_both(program, rows())
    np.testing.assert_array_equal(said[-1, TIME:], clean[-1, TIME:])
    assert (said[k, JUMPS], said[-1, JUMPS], clean[-1, JUMPS]) == (0, 1, 0)


@needs_gcc
@pytest.mark.parametrize("ahead", [10.5, 1e9])
def test_one_fix_far_ahead_is_dropped_and_counted(program: Path, ahead: float):
    k = at(4.0)
    fix = next(row for row in rows()[k:] if row.startswith("fix"))
    fed = [*rows()[:k], moved(fix, ahead), moved(fix, ahead), *rows()[k:]]  # a repeated message counts once
    said, clean = same_in_both(program, fed), same_in_both(program, rows())
    np.testing.assert_array_equal(said[-1, TIME:], clean[-1, TIME:])
    assert not said[k : k + 2, TAKEN].any()
    assert said[-1, JUMPS] == 1


@needs_gcc
def test_a_smaller_jump_is_used_at_once(program: Path):
    k = at(4.0)
    said = same_in_both(program, [*rows()[:k], *(moved(row, 9.9) for row in rows()[k:])])
    assert said[k, TIME] > said[k - 1, TIME] + 9.0
    assert said[-1, JUMPS] == 0


@needs_gcc
def test_a_gap_is_accepted_if_a_second_sample_agrees(program: Path):
    k = at(4.0)
    fed = [*rows()[:k], *(moved(row, 60.0) for row in rows()[k:])]
    said = same_in_both(program, fed)
    samples = [i for i in range(k, len(fed)) if fed[i].startswith("imu")]
    assert said[samples[0], TIME] == said[k - 1, TIME]
    assert said[samples[1], TIME] == float(fed[samples[1]].split(",")[1])
    assert said[-1, JUMPS] == 0
    assert (
        np.abs(said[samples[1], X : X + 2] - said[k - 1, X : X + 2]).max() > 100.0
    )  # a minute at that speed


def test_after_a_gap_it_equals_the_run():
    drive = clip(equipped(), 0.0, 20.0)
    later = drive.imu.time > 14.0
    imu = replace(drive.imu, time=drive.imu.time + 30.0 * later)
    gps = replace(drive.gps, time=drive.gps.time + 30.0 * (drive.gps.time > 14.0), speed=None, course=None)
    silent = replace(drive, imu=imu, gps=gps, truth=None)
    run = run_filter(silent, P, initial=replace(initial_state(silent), gyro=None), recover=False)
    assert silent.duration == drive.duration + 30.0
    start, *others = replay_rows(silent).splitlines()
    said = in_python([start, *others])
    np.testing.assert_allclose(said[-1, X:], run.mean[-1], rtol=0, atol=1e-9)


@needs_gcc
def test_a_fix_before_the_samples_after_a_gap_is_kept(program: Path):
    k = next(i for i in range(at(4.0), len(rows())) if rows()[i].startswith("fix"))
    late = [moved(row, 60.0) for row in rows()[k:]]
    assert late[0].startswith("fix")
    with_it = same_in_both(program, [*rows()[:k], *late])
    without = same_in_both(program, [*rows()[:k], *late[1:]])
    assert with_it[-1, JUMPS] == without[-1, JUMPS] == 0
    assert np.abs(with_it[-1, X:] - without[-1, X:]).max() > 1e-6


@needs_gcc
def test_samples_that_do_not_agree_are_dropped(program: Path):
    k = at(4.0)
    wild = [moved(rows()[k], ahead) for ahead in (100.0, 102.0, 50.0, 50.0, 1e9, 49.0)]
    said = same_in_both(program, [*rows()[:k], *wild, *rows()[k:]])
    assert said[-1, JUMPS] == 5  # one of the six is repeated
    assert said[-1, TIME] == max(float(row.split(",")[1]) for row in rows() if row.startswith("imu"))


@needs_gcc
def test_fixes_in_the_future_do_not_fill_the_queue(program: Path):
    k = at(4.0)
    flood = [f"fix,{1e9 + i},0.0,0.0" for i in range(2000)]
    said = in_c(program, [*rows()[:k], *flood, *rows()[k:]])
    clean = in_c(program, rows())
    np.testing.assert_allclose(said[-1, TIME:], clean[-1, TIME:], rtol=0, atol=1e-12)
    ours = in_python([*rows()[:k], *flood, *rows()[k:]])
    np.testing.assert_allclose(ours[-1, TIME:], said[-1, TIME:], rtol=0, atol=1e-9)
    taken = [row.startswith("fix") for row in rows()[k:]]
    for seen in (said, ours):
        assert seen[k + len(flood) :, TAKEN][taken].all()


def test_a_time_that_is_not_finite_is_ignored():
    live = LiveFilter(P, initial_state(equipped()), nominal_interval=0.01)
    begins = live.state.time
    for t in (math.inf, math.nan, -math.inf):
        live.predict(t, (0.0, 0.0, 0.0))
        assert not live.update(t, (0.0, 0.0))
    live.predict(begins + 0.01, (0.0, 0.0, 0.0))
    assert (live.state.time, live.state.failed) == (begins + 0.01, False)
    assert (live.too_late, live.time_jumps) == (3, 0)


CALL = st.tuples(
    st.sampled_from(["imu", "imu", "imu", "fix"]),
    st.sampled_from([0.01, 0.01, 0.01, 0.01, 0.5, 0.0, -0.02, -0.3, 9.99, 10.5, 11.0, 11.4, 12.3, 60.0, 1e6]),
    st.floats(-3.0, 3.0),
    st.booleans(),
)


@needs_gcc
@settings(max_examples=25, deadline=None)
@given(calls=st.lists(CALL, max_size=60))
def test_python_and_c_agree_for_any_jumps(program: Path, calls: list[tuple[str, float, float, bool]]):
    start = rows()[0]
    t, fed = float(start.split(",")[1]), [start]
    for name, step, value, stays in calls:
        fed.append(
            f"{name},{t + step!r},{value!r},{0.3 * value!r}" + (f",{0.1 * value!r}" if name == "imu" else "")
        )
        if stays and step < 100.0:
            t += step
    same_in_both(program, fed)
