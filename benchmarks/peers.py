"""Our filters beside GTSAM's iSAM2, on the same drives from the same start, in one run.

    python benchmarks/peers.py ../shared/drives
    python benchmarks/peers.py ../shared/drives --models planar8 tilted12 --only colorado-1 --seeds 3 --tries 40

KITTI's drives: each is held out once; colorado-1: the first 70% of the time to tune on, the rest to test. Ours is
tuned on the training drives as in `switches.py` (medians over the seeds). GTSAM's noises are searched, too, on the
shortest training drive's first minute, which is what a user with an evening would do: the best of `--tries` random
draws around typical values, by position RMSE + 0.1 m/deg x heading error. Drift is the RMS over the windows of
seeds 0 to 3 (5 s) and 0 to 5 (30 s). The time is processor time per IMU sample, on one core, of running over the
test drives once. GTSAM is in the dependency group `bench-gtsam`; without it only our rows are made.
"""

import argparse
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from sigmaswarm import Drive, SigmaswarmWarning, clip, initial_state, run_filter, tune
from sigmaswarm.drives.outages import hidden_fixes
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.score import HEADING_COUNTS_ABOVE, truth_at
from sigmaswarm.scoring.targets import outage_windows
from switches import TITLES, WINDOWS, cases, measured, quantities

USE = ("lateral", "standstill", "gate")
SEARCHED = 60.0
"""s of the training drive on which GTSAM's noises are searched: its steps get dearer as the graph grows."""
COLUMNS = (*TITLES, "us a sample")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--models", nargs="*", default=["planar8"], help="of ours")
    parser.add_argument("--only", nargs="+", help="names of cases, as in switches.py")
    parser.add_argument("--seeds", type=int, default=3, help="of our tunings")
    parser.add_argument("--tries", type=int, default=40, help="draws of GTSAM's noises")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    for name, splits in cases(options.drives, options.seeds, options.only):
        if any(drive.imu.az is None for part in splits[0] for drive in part):
            continue
        for model in options.models:
            row = np.median([ours(*split, model, seed) for seed, split in enumerate(splits)], axis=0)
            print(f"| {name} | {' + '.join((model, *USE))} | {shown(row)} |", flush=True)
        if find_spec("gtsam") is not None:
            row, noise = theirs(*splits[0], options.tries)
            print(f"| {name} | GTSAM iSAM2 | {shown(row)} |  <!-- {noise} -->", flush=True)


def shown(row: Sequence[float]) -> str:
    return " | ".join([f"{v:.2f}" for v in row[:-1]] + [f"{row[-1]:.3g}"])


def ours(training: Sequence[Drive], test: Sequence[Drive], model: str, seed: int) -> list[float]:
    with ThreadPoolExecutor() as pool:
        tuned = tune(
            training, objective="truth-pose", optimizer="de", model=model, use=USE, seed=seed, executor=pool
        )
    ready = [PreparedDrive(drive) for drive in test]
    row = measured(ready, tuned.parameters)
    begun = time.process_time()
    samples = sum(len(run_filter(each, tuned.parameters).time) for each in ready)
    return [*row, (time.process_time() - begun) / samples * 1e6]


def theirs(training: Sequence[Drive], test: Sequence[Drive], tries: int) -> tuple[list[float], object]:
    import rival_gtsam as rival

    noise = _searched(min(training, key=lambda drive: drive.duration), tries)
    off, turned, samples, begun = [], [], 0, time.process_time()
    for drive in test:
        run = rival.run(drive, initial_state(drive), noise)
        samples += len(run.time)
        distances, angles = _errors(drive, run)
        off.append(distances)
        turned.append(angles)
    spent = (time.process_time() - begun) / samples * 1e6
    heading = float(np.degrees(np.sqrt(np.mean(np.concatenate(turned) ** 2))))
    drifts = [_drift(test, noise, length) for length in WINDOWS]
    return [*quantities(np.concatenate(off)), heading, *drifts, spent], noise


_FOUND: dict[tuple[str, int], object] = {}
"""Noises by the drive that they were searched on: several cases share it."""


def _searched(drive: Drive, tries: int):
    import rival_gtsam as rival

    key = drive.name, len(drive.imu)
    if key not in _FOUND:
        start = initial_state(drive).time
        drive = clip(drive, drive.imu.time[0], start + SEARCHED)
        candidates = [rival.Noise(), *(_drawn(rival.Noise(), np.random.default_rng(i)) for i in range(tries))]
        _FOUND[key] = min(candidates, key=lambda each: _cost(drive, each))
    return _FOUND[key]


def _drawn(typical, rng: np.random.Generator):
    """Noises around typical ones: by factors up to ten, the fixes' up to two; the car slides 0 to 2 m behind."""
    factors = {
        name: 10 ** rng.uniform(-1, 1) for name in ("accel", "gyro", "accel_walk", "gyro_walk", "slide")
    }
    changed = {name: factor * getattr(typical, name) for name, factor in factors.items()}
    return replace(typical, fix=typical.fix * 2 ** rng.uniform(-1, 1), behind=rng.uniform(0, 2), **changed)


def _cost(drive: Drive, noise) -> float:
    import rival_gtsam as rival

    try:
        off, turned = _errors(drive, rival.run(drive, initial_state(drive), noise))
    except RuntimeError:  # GTSAM's own: a system that it can't solve
        return np.inf
    return float(np.sqrt(np.mean(off**2)) + 0.1 * np.degrees(np.sqrt(np.mean(turned**2))))


def _errors(drive: Drive, run) -> tuple[np.ndarray, np.ndarray]:
    """Position errors, m, and heading errors where they count, rad, at the truth's times."""
    truth = drive.truth.select((drive.truth.time >= run.time[0]) & (drive.truth.time <= run.time[-1]))
    x, y, theta = (np.interp(truth.time, run.time, v) for v in (run.x, run.y, run.theta))
    counts = np.hypot(truth.vx, truth.vy) > HEADING_COUNTS_ABOVE
    return np.hypot(x - truth.x, y - truth.y), wrap_angle(theta - truth.theta)[counts]


def _drift(test: Sequence[Drive], noise, length: float) -> float:
    """RMS over all windows of a length that fit, m."""
    import rival_gtsam as rival

    squares = []
    for drive in test:
        start = initial_state(drive)
        for seed in WINDOWS[length]:
            windows = outage_windows(drive, start, length=length, seed=seed)
            if len(windows):
                run = rival.run(drive, start, noise, hidden_fixes(drive.gps.time, windows))
                x, y = truth_at(drive.truth, windows[:, 1])
                ends = [np.interp(windows[:, 1], run.time, v) for v in (run.x, run.y)]
                squares.append((ends[0] - x) ** 2 + (ends[1] - y) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else float("nan")


if __name__ == "__main__":
    main()
