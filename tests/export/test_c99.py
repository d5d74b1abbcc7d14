"""The exported C library: the numbers of the library, no compiler warnings, and no findings of sanitizers."""

import re
import subprocess
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from exported import (
    NO_TRAP,
    OPTIMIZED,
    SANITIZERS,
    STRICT,
    build,
    distance,
    jumping,
    needs_clang,
    needs_gcc,
    replay,
    tuned,
    twin,
    write,
)
from filter_cases import (
    KINDS,
    OPTIONS,
    WEIGHED,
    WEIGHED_CASES,
    equipped,
    parameters,
    rough,
    straying,
    two_receivers,
)
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.exports.c99 import c99, replay_rows
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from support import DRIVES, needs_shared, quickly

CASES = [(model, kind, "all") for model in ("planar5", "planar8") for kind in KINDS]
CASES += [("planar5", "ukf", option) for option in OPTIONS if option != "all"]
CASES += [("planar8", "ekf", "lateral"), ("planar8", "adaptive-ukf", "plain")]
WEIGHED_TOO = [*CASES, *(("planar8", kind, option) for kind, option in WEIGHED_CASES)]

REAL = {
    "kitti-09-30-0033": (0.0, 45.0),
    "colorado-1": (30.0, 75.0),
    "dresden": (0.0, 60.0),
    "kingston-1": (560.0, 900.0),  # with a standstill
}


def given(model: str, kind: str, option: str) -> FilterParameters:
    return parameters(model, kind=kind, nominal_interval=0.01, **(OPTIONS | WEIGHED)[option])


@cache
def real(name: str) -> Drive:
    return clip(read_drive(DRIVES / name), *REAL[name])


@needs_gcc
@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(
        CASES,
        lambda *case: (
            case in (("planar8", "ukf", "all"), ("planar8", "ekf", "all"), ("planar5", "ukf", "plain"))
        ),
    ),
)
def test_it_equals_the_run(tmp_path: Path, model: str, kind: str, option: str):
    p = given(model, kind, option)
    ours = run_filter(equipped(), p, recover=False)
    flags = OPTIMIZED if (model, kind, option) == ("planar8", "ukf", "all") else ()
    theirs = replay(build(tmp_path, p, *flags), equipped())
    np.testing.assert_array_equal(theirs.time, ours.time)
    assert distance(theirs.mean, ours.mean) < 1e-11
    np.testing.assert_allclose(theirs.variance, np.diagonal(ours.covariance, axis1=1, axis2=2), rtol=1e-9)


@needs_gcc
@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(
        [(model, *case) for model in ("planar5", "planar8") for case in WEIGHED_CASES],
        lambda *case: case == ("planar8", "ukf", "both") or case[:2] == ("planar8", "fuzzy-ukf"),
    ),
)
def test_it_weights_fixes_as_the_run_does(tmp_path: Path, model: str, kind: str, option: str):
    p = given(model, kind, option)
    ours = run_filter(straying(), p)
    theirs = replay(build(tmp_path, p), straying())
    assert distance(theirs.mean, ours.mean) < 1e-10
    np.testing.assert_allclose(theirs.variance, np.diagonal(ours.covariance, axis1=1, axis2=2), rtol=1e-9)


@needs_gcc
def test_the_replay_names_a_fix_without_the_required_accuracy(tmp_path: Path):
    program = build(tmp_path, given("planar5", "ukf", "accuracy"))
    done = subprocess.run(
        [program], input=replay_rows(equipped()), capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.startswith("replay: a fix lacks std_x,std_y, which this filter uses: fix,")


@needs_shared
@needs_gcc
@pytest.mark.parametrize(
    ("name", "kind"),
    quickly(
        product(REAL, ("ukf", "strong-tracking-ukf")),
        lambda *case: case == ("kingston-1", "ukf"),
    ),
)
def test_it_equals_the_run_on_real_drives(tmp_path: Path, name: str, kind: str):
    p = tuned("planar8", kind, real(name).nominal_interval)
    ours, of_twin = twin(real(name), p)
    assert of_twin < 1e-12
    assert distance(replay(build(tmp_path, p), real(name)).mean, ours) < 1e-9


@needs_gcc
def test_the_gate_accepts_a_jump_as_in_the_run(tmp_path: Path):
    p, drive = given("planar8", "ukf", "gate"), jumping(equipped())
    ours = run_filter(drive, p, recover=False)
    assert distance(replay(build(tmp_path, p), drive).mean, ours.mean) < 1e-11
    assert (
        np.max(np.abs(ours.mean - run_filter(equipped(), p, recover=False).mean)) > 30.0
    )  # the filter follows the jump


@needs_gcc
@pytest.mark.parametrize("kind", quickly([(kind,) for kind in KINDS], lambda kind: kind == "ekf"))
def test_two_fixes_of_one_time_are_both_used(tmp_path: Path, kind: str):
    p = given("planar8", kind, "all")
    theirs = replay(build(tmp_path, p), two_receivers())
    assert distance(theirs.mean, run_filter(two_receivers(), p, recover=False).mean) < 1e-11


@needs_gcc
@pytest.mark.parametrize(
    ("model", "kind"),
    quickly(
        product(("planar5", "planar8"), KINDS),
        lambda model, kind: model == "planar8" and kind == "strong-tracking-ukf",
    ),
)
def test_stale_fixes_and_gaps_are_treated_as_in_the_run(tmp_path: Path, model: str, kind: str):
    p, ready = given(model, kind, "all"), PreparedDrive(rough())
    assert ready.stale.sum() == 5
    assert ready.timeline().gap.any()
    assert distance(replay(build(tmp_path, p), rough()).mean, run_filter(ready, p).mean) < 1e-11
    plain = run_filter(PreparedDrive(rough(), ready.initial, as_recorded=True), p).mean
    as_recorded = replay(build(tmp_path, p, "-DINS_GPS_AS_RECORDED"), rough()).mean
    assert distance(as_recorded, plain) < 1e-11
    assert distance(plain, run_filter(ready, p).mean) > 1e-3


def test_the_header_of_a_filter_tuned_without_preprocessing_defines_as_recorded():
    p = given("planar5", "ukf", "plain")
    wanted = "#define INS_GPS_AS_RECORDED"
    assert [
        wanted in c99(p, 0.01, as_recorded=as_recorded)["ins_gps.h"] for as_recorded in (False, True)
    ] == [
        False,
        True,
    ]


@needs_gcc
@pytest.mark.parametrize("option", ["plain", "all"])
def test_a_repeated_message_is_ignored(tmp_path: Path, option: str):
    program = build(tmp_path, given("planar5", "ukf", option))
    rows = replay_rows(equipped()).splitlines()
    twice = [row for row in rows for _ in range(2 if row.startswith("fix") else 1)]
    np.testing.assert_array_equal(_last_row(program, twice), _last_row(program, rows))


@needs_gcc
@pytest.mark.parametrize(("begin", "end"), [(0.0, 13.0), (11.5, 25.0)])
def test_fixes_and_speeds_outside_the_time_of_the_imu_are_not_used(tmp_path: Path, begin: float, end: float):
    p, imu = given("planar8", "ukf", "all"), equipped().imu
    drive = replace(equipped(), imu=imu.select((imu.time >= begin) & (imu.time < end)))
    ours, program = run_filter(drive, p, recover=False), build(tmp_path, p)
    assert distance(replay(program, drive).mean, ours.mean) < 1e-11
    start, *rows = replay_rows(drive).splitlines()
    align = "align," + ",".join(start.split(",")[2:4])
    for first in (start, align):
        fed = "\n".join([first, *rows]) + "\n"
        done = subprocess.run([program], input=fed, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        assert float(done.stdout.splitlines()[1].split(",")[0]) == ours.time[0]


@needs_gcc
def test_float_differs_by_millimeters(tmp_path: Path):
    p = given("planar8", "ukf", "all")
    off = (
        replay(build(tmp_path, p, "-DINS_GPS_FLOAT"), equipped()).mean
        - run_filter(equipped(), p, recover=False).mean
    )
    assert 1e-9 < np.max(np.abs(off[:, :2])) < 3e-3


def rows_with_late_fixes(late: float) -> list[str]:
    """Return the rows of the replay, where each fix arrives ``late`` s after its time."""
    first, *rows = replay_rows(equipped()).splitlines()
    when = {row: _time(row) + (late if row.startswith("fix") else 0.0) for row in rows}
    return [first, *sorted(rows, key=lambda row: (when[row], row))]


@needs_gcc
@pytest.mark.parametrize(
    ("kind", "late"),
    quickly(
        product(("adaptive-ukf", "strong-tracking-ukf"), (0.003, 0.31)),
        lambda kind, late: (kind == "adaptive-ukf") == (late > 0.1),
    ),
)
def test_late_fixes_are_applied_at_their_time(tmp_path: Path, kind: str, late: float):
    p = given("planar8", kind, "all")
    rows = [row for row in rows_with_late_fixes(late) if not row.startswith("fix") or _time(row) < 23.0]
    program = build(tmp_path, p)
    final = _last_row(program, rows)
    in_time = _last_row(
        program, [rows[0], *sorted(rows[1:], key=lambda row: (float(row.split(",")[1]), row))]
    )
    np.testing.assert_allclose(final, in_time, rtol=0, atol=1e-13)
    forgetful = build(tmp_path, p, "-DINS_GPS_HISTORY=0")
    assert np.max(np.abs(_last_row(forgetful, rows) - in_time)) > 1e-3


def _time(row: str) -> float:
    return float(row.split(",")[1])


def _last_row(program: Path, rows: list[str]) -> np.ndarray:
    done = subprocess.run([program], input="\n".join(rows) + "\n", capture_output=True, text=True, check=True)
    return np.array([float(cell) for cell in done.stdout.splitlines()[-1].split(",")])


@needs_clang
@pytest.mark.parametrize(
    "flags",
    quickly(
        [((),), (("-DINS_GPS_FLOAT",),), (("-DINS_GPS_HISTORY=0", "-DINS_GPS_FLOAT"),)],
        lambda flags: len(flags) != 1,
    ),
)
def test_clang_gives_no_warning(tmp_path: Path, flags: tuple[str, ...]):
    for model, kind, option in WEIGHED_TOO:
        write(tmp_path, given(model, kind, option))
        command = ["clang", *STRICT, *flags, "-fsyntax-only", *sorted(tmp_path.glob("*.c"))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


@needs_gcc
@pytest.mark.parametrize("flags", [("-DINS_GPS_FLOAT",), ("-DINS_GPS_HISTORY=0",)], ids=str)
@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(
        WEIGHED_TOO, lambda *case: case[0] == "planar8" and case[1:] in (("ukf", "all"), ("ekf", "both"))
    ),
)
def test_gcc_gives_no_warning_for_any_filter(
    tmp_path: Path, model: str, kind: str, option: str, flags: tuple[str, ...]
):
    write(tmp_path, given(model, kind, option))
    command = ["gcc", *STRICT, *flags, "-fsyntax-only", *sorted(tmp_path.glob("*.c"))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs_gcc
def test_the_sanitizers_find_nothing_over_a_drive(tmp_path: Path):
    p = given("planar8", "adaptive-ukf", "all")
    sanitized = replay(build(tmp_path, p, *SANITIZERS), equipped())
    assert distance(sanitized.mean, run_filter(equipped(), p, recover=False).mean) < 1e-11


HOSTILE = r"""
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "ins_gps.h"

static unsigned long seed = 1;
static unsigned pick(unsigned n)
{
    seed = (seed * 1103515245UL + 12345UL) & 0x7fffffffUL;
    return (unsigned)(seed >> 8) % n;
}

int main(void)
{
    static InsGps f;
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 5e-324, 0.0, -0.0, 1.0, 1e10};
    const ins_gps_real mean[5] = {0, 0, 10, 0, 0}, velocity[2] = {10, (ins_gps_real)NAN};
    const ins_gps_real P[25] = {1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1};
    InsGpsState before, after;
    /* What is refused changes nothing. */
    ins_gps_init(&f, 0.0, mean, P, 0);
    for (int k = 1; k < 200; k++) {
        ins_gps_update(&f, 0.01 * k - 0.004, (ins_gps_real)(0.1 * k), 0, 0);
        ins_gps_predict(&f, 0.01 * k, 0, 0, 0);
    }
    memset(&before, 0, sizeof before);
    memset(&after, 0, sizeof after);
    ins_gps_state(&f, &before);
    const ins_gps_real nan = (ins_gps_real)NAN;
    const bool samples = ins_gps_predict(&f, NAN, 0, 0, 0) || ins_gps_predict(&f, INFINITY, 0, 0, 0)
                         || ins_gps_predict(&f, 1.99, 1, 1, 1) || ins_gps_predict(&f, 1.5, 1, 1, 1)
                         || ins_gps_predict(&f, 3.0, nan, 0, 0) || ins_gps_predict(&f, 3.0, 0, 0, nan);
    const bool fixes = ins_gps_update(&f, NAN, 0, 0, 0) || ins_gps_update(&f, 3.0, nan, 0, 0)
                       || ins_gps_update(&f, 3.0, 0, nan, 0) || ins_gps_update(&f, 3.0, 0, 0, velocity)
                       || ins_gps_update(&f, 0.1, 0, 0, 0);
    if (samples || fixes) {
        return 1;
    }
    ins_gps_state(&f, &after);
    if (memcmp(&before, &after, sizeof before) || after.failed || f.left_out != 5) {
        return 2;
    }
    /* Anything at all, in any order. */
    unsigned long failures = 0;
    for (int run = 0; run < 100; run++) {
        ins_gps_init(&f, pick(3) ? 0.0 : odd[3 + pick(5)], mean, P, pick(2) ? mean : 0);
        double t = 0.0;
        for (int k = 0; k < 300; k++) {
            double x[4];
            for (int i = 0; i < 4; i++) {
                x[i] = pick(40) ? (double)pick(1000) * 0.01 - 5.0 : odd[pick(10)];
            }
            t += 0.001 * (double)pick(20) - 0.003;
            const double at = pick(60) ? t : odd[pick(10)];
            const ins_gps_real z[2] = {(ins_gps_real)x[2], (ins_gps_real)x[3]};
            if (pick(3)) {
                ins_gps_predict(&f, at, (ins_gps_real)x[0], (ins_gps_real)x[1], z[0]);
            } else {
                for (unsigned n = pick(50) ? 1 : 100; n > 0; n--) {
                    const double when = at - 0.1 * (double)pick(3) + 1e-4 * n;
                    ins_gps_update(&f, when, (ins_gps_real)x[0], (ins_gps_real)x[1], pick(2) ? z : 0);
                }
            }
        }
        ins_gps_state(&f, &after);
        bool finite = true;
        for (int i = 0; i < INS_GPS_STATES; i++) {
            finite = finite && isfinite(after.mean[i]) && isfinite(after.covariance[i][i]);
        }
        if (!finite && !after.failed) {
            return 3;
        }
        failures += after.failed;
    }
    printf("%lu of 100 failed, and said so\n", failures);
    return failures == 100 ? 4 : 0;
}
"""


@needs_gcc
@pytest.mark.parametrize(
    ("case", "flags"),
    quickly(
        product(
            (
                ("ukf", "all"),
                ("adaptive-ukf", "all"),
                ("strong-tracking-ukf", "all"),
                ("ukf", "both"),
                ("ekf", "both"),
            ),
            ((), ("-DINS_GPS_HISTORY=0",)),
        ),
        lambda case, flags: case == ("ekf", "both") and not flags,
    ),
)
def test_invalid_input_causes_no_error(tmp_path: Path, case: tuple[str, str], flags: tuple[str, ...]):
    kind, option = case
    main = HOSTILE
    if option == "both":  # each fix states its accuracy
        main = re.sub(r"(ins_gps_update\(&f, [^;|]*?)\)(?=;| \||\n)", r"\1, stated)", HOSTILE)
        main = main.replace(
            "int main(void)", "static const ins_gps_real stated[2] = {1, 2};\n\nint main(void)"
        )
    program = build(tmp_path, given("planar8", kind, option), *SANITIZERS, *NO_TRAP, *flags, main=main)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
