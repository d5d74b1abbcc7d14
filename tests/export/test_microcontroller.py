"""The exported C on emulated Cortex-M boards: the numbers of the run, cost, and no traps.

benchmarks/microcontroller.py runs whole drives and computes all values of docs/export.md.
"""

import subprocess
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from exported import NO_TRAP, SANITIZERS, distance, needs_gcc, tuned, write
from filter_cases import OPTIONS, WEIGHED, parameters
from microcontroller import (
    BOARD,
    COMPILER,
    M4F,
    M7,
    Machine,
    OnBoard,
    build_for,
    emulate,
    has,
    needs_arm,
    replay_on,
    run,
)
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.simulation.scenarios import simulate
from support import DRIVES, needs_shared, quickly

built = partial(build_for, optimize="-O1")
"""Build a program whose size and speed are not tested."""
FLOAT, NO_HISTORY = "-DINS_GPS_FLOAT", "-DINS_GPS_HISTORY=0"
FILTERS = {
    "planar5": ("planar5", "ukf", False),
    "planar8 ekf": ("planar8", "ekf", True),
    "planar8 ukf": ("planar8", "ukf", True),
    "tilted12": ("tilted12", "ekf", True),
    "planar8 with fix error": ("planar8", "ukf", True),
    "tilted12 with fix error": ("tilted12", "ekf", True),
}


def given(name: str, interval: float = 0.01) -> FilterParameters:
    model, kind, everything = FILTERS[name]
    p = tuned(model, kind, interval, everything=everything)
    return replace(p, fix_error=0.3) if "fix error" in name else p


@cache
def city() -> Drive:
    """Return half a minute of an urban drive with a stop."""
    return clip(simulate("urban", duration=60.0, seed=4), 0.0, 40.0)


def off(board: OnBoard, ours: np.ndarray) -> tuple[float, float]:
    """Return the largest differences in m and degrees."""
    error = board.mean - ours
    error[:, 4] = (error[:, 4] + np.pi) % (2 * np.pi) - np.pi
    return float(np.max(np.hypot(*error[:, :2].T))), float(np.degrees(np.abs(error[:, 4]).max()))


@needs_arm
@pytest.mark.parametrize("name", quickly([(n,) for n in FILTERS], lambda n: n == "planar8 ukf"))
def test_a_board_computes_the_estimates_of_the_run(tmp_path: Path, name: str):
    p = given(name)
    ours = run_filter(city(), p, recover=False)
    double = replay_on(M7, built(M7, tmp_path, p), city(), p.model)
    np.testing.assert_array_equal(double.time, ours.time)
    assert distance(double.mean, ours.mean) < 1e-9
    np.testing.assert_allclose(double.variance, np.diagonal(ours.covariance, axis1=1, axis2=2), rtol=1e-8)


@needs_arm
@pytest.mark.parametrize(
    ("name", "machine"),
    quickly(
        product(FILTERS, (M4F, M7)),
        lambda name, machine: (name, machine) == ("tilted12", M4F),
    ),
    ids=lambda each: each.name if isinstance(each, Machine) else each,
)
def test_in_float_a_board_is_within_a_centimeter(tmp_path: Path, name: str, machine: Machine):
    p = given(name)
    single = replay_on(machine, built(machine, tmp_path, p, FLOAT), city(), p.model)
    metres, degrees = off(single, run_filter(city(), p, recover=False).mean)
    assert 0.0 < metres < 0.01 and 0.0 < degrees < 0.01


@pytest.mark.long
@needs_shared
@needs_arm
def test_float_is_accurate_kilometers_from_the_origin(tmp_path: Path):
    drive = clip(read_drive(DRIVES / "kingston-1"), 1600.0, 1720.0)  # with a standstill, 2 km away
    p = given("planar8 ukf", drive.nominal_interval)
    ours = run_filter(drive, p, recover=False).mean
    assert np.hypot(*ours[-1, :2]) > 1500.0
    metres, degrees = off(replay_on(M4F, built(M4F, tmp_path, p, FLOAT), drive, p.model), ours)
    assert metres < 1e-3 and degrees < 1e-3


@pytest.mark.long
@needs_arm
def test_the_cost_stays_within_bounds(tmp_path: Path):
    p = given("planar8 ukf")

    drive = clip(city(), 0.0, 15.0)

    def instructions(q: FilterParameters) -> tuple[float, float]:
        program = build_for(M4F, tmp_path / str(q.gate), q, NO_HISTORY, FLOAT)
        board = replay_on(M4F, program, drive, q.model)
        fixed, both = board.fixes > 0, board.predict + board.update
        assert board.stack < 1024
        return board.predict[~fixed].mean(), both[fixed].mean()

    predict, both = instructions(p)
    without, _ = instructions(tuned(p.model, p.kind, 0.01, everything=False))
    assert both < 9000 and predict < 1.5 * without


@needs_arm
@pytest.mark.parametrize("interval", [0.1, 0.01, 0.001])
def test_memory_without_history_is_bounded_at_any_rate(tmp_path: Path, interval: float):
    write(tmp_path, given("planar8 ukf", interval))
    (tmp_path / "size.c").write_text('#include "ins_gps.h"\nchar fits[sizeof(InsGps) <= 8192 ? 1 : -1];\n')
    for flags in ((FLOAT,), ()):
        run([COMPILER, *M4F.flags, NO_HISTORY, *flags, "-c", tmp_path / "size.c", "-o", tmp_path / "size.o"])


FUZZED = {
    "every option": parameters("planar8", kind="ukf", nominal_interval=0.01, **OPTIONS["all"]),
    "weighed": parameters("planar8", kind="ekf", nominal_interval=0.01, **WEIGHED["both"]),
    "adaptive": parameters("planar8", kind="adaptive-ukf", nominal_interval=0.01, **OPTIONS["all"]),
    "tilted": replace(given("tilted12"), odometer_noise=0.01),
}


@pytest.mark.long
@needs_arm
@pytest.mark.parametrize(
    ("machine", "case", "flags"),
    [
        (M4F, "every option", (FLOAT, "-DCALLS=3000")),
        (M4F, "tilted", (FLOAT, NO_HISTORY, "-DCALLS=1500")),
        (M7, "adaptive", (NO_HISTORY, "-DCALLS=1500")),
    ],
    ids=["every option in float", "tilted in float", "adaptive in double"],
)
def test_random_calls_cause_no_trap_on_a_board(
    tmp_path: Path, machine: Machine, case: str, flags: tuple[str, ...]
):
    program = built(machine, tmp_path, FUZZED[case], *flags, main=BOARD / "fuzz.c")
    assert emulate(machine, program) == 0


@needs_gcc
@pytest.mark.parametrize(
    ("case", "flags", "lanes"),
    quickly(
        [
            ("every option", (FLOAT,), 1),
            ("weighed", (), 1),
            ("adaptive", (NO_HISTORY,), 1),
            ("tilted", (), 1),
            ("weighed", (FLOAT,), 5),
            ("tilted", (), 3),
        ],
        lambda case, flags, lanes: lanes == 1 and case == "every option",
    ),
)
def test_random_calls_cause_no_sanitizer_error(tmp_path: Path, case: str, flags: tuple[str, ...], lanes: int):
    write(tmp_path, FUZZED[case], lanes=lanes)
    program = tmp_path / "fuzz"
    sources = (tmp_path / "ins_gps.c", tmp_path / "ins_gps_align.c", BOARD / "fuzz.c")
    calls = 3000 if lanes == 1 else 20_000  # enough calls for finite lanes whose mixture is not finite
    more = (*has(FUZZED[case]), *flags, f"-DCALLS={calls}", f"-I{tmp_path}", *SANITIZERS, *NO_TRAP)
    run(["gcc", "-std=c99", *more, *sources, "-lm", "-o", program])
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@needs_arm
def test_a_trap_is_detected(tmp_path: Path):
    main = tmp_path / "main.c"
    main.write_text("int main(void) { return *(volatile int *)0xF0000000; }\n")
    assert emulate(M4F, build_for(M4F, tmp_path, given("planar5"), main=main, optimize="-O0")) == 99
