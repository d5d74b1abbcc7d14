"""Measure the benefit of tuning robot_localization, and the speed of a batch of its filters.

    python benchmarks/robot_localization.py DRIVES

Tunes on kitti-09-30-0033 with and without truth, and on the first half of colorado-1, with three seeds each; tests on
held-out drives, or on the other half. Then runs 1500 filters over ten minutes of driving at 100 Hz.
"""

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import sigmaswarm
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.passes import run_array
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.scoring.batch import cores
from sigmaswarm.tuning.space import search_space

MODEL = "robot-localization"
USE = ("lateral", "gate")
COLUMNS = ("position_rmse_m", "heading_rmse_deg", "outage_drift_m")


def show(label: str, evaluation: sigmaswarm.Evaluation, drive: str) -> None:
    for method in ("untuned", "tuned"):
        values = [evaluation.value(drive, method, column) for column in COLUMNS]
        print(
            f"{label:34} {drive:22} {method:8}", *(f"{value:7.2f}" for value in values if value), flush=True
        )


def accuracy(drives: Path) -> None:
    """Print position RMSE (m), heading error (deg) and drift after 5 s (m) by seed."""
    kitti, *held = (
        sigmaswarm.read_drive(drives / f"kitti-{n}") for n in ("09-30-0033", "09-26-0022", "09-26-0101")
    )
    first, second = sigmaswarm.split(sigmaswarm.read_drive(drives / "colorado-1"), 0.5)
    for train, tests, objective in (
        (kitti, held, "truth-pose + 0.2 nees"),
        (kitti, held, "innovation-t"),
        (first, [second], "truth-pose + 0.2 nees"),
        (first, [second], "innovation-t"),
    ):
        for seed in range(3):
            tuning = sigmaswarm.tune(train, model=MODEL, use=USE, objective=objective, seed=seed)
            evaluation = sigmaswarm.evaluate(tests, tuning)
            for test in tests:
                show(f"{objective}, seed {seed}", evaluation, test.name)


def speed(drives: Path) -> None:
    """Print the time of 30 x 50 filters, extrapolated to ten minutes at 100 Hz."""
    drive_pass = whole_pass(sigmaswarm.read_drive(drives / "kitti-09-30-0033"))
    space = search_space(MODEL, "log10", drive_pass.timeline.nominal_interval, kind="ekf", use=USE)
    points = space.low + (space.high - space.low) * 0.5
    sets = space.decode(points[None].repeat(1500, axis=0))
    parts = [KernelArray(sets[k : k + 32]) for k in range(0, 1500, 32)]
    with ThreadPoolExecutor(cores()) as pool:
        list(pool.map(lambda part: run_array([drive_pass], part), parts[:2]))
        begin, busy = time.perf_counter(), time.process_time()
        list(pool.map(lambda part: run_array([drive_pass], part), parts))
    share = 60_000 / len(drive_pass.timeline.dt)
    wall, busy = share * (time.perf_counter() - begin), share * (time.process_time() - busy)
    print(f"1500 filters, ten minutes at 100 Hz: {wall:.2f} s on {cores()} cores; {busy:.2f} s of one core")


if __name__ == "__main__":
    speed(Path(sys.argv[1]))
    accuracy(Path(sys.argv[1]))
