"""tilted12 as an extended and as an unscented filter: accuracy, consistency and time.

    python benchmarks/unscented.py DRIVES

On each real drive, the filter is tuned on the first half and tested on the second. For simulated drives, the filter is
tuned on one drive and tested on two others: without changes; with an IMU whose mounting is rotated by 12 degrees in
roll and in pitch; and from initial states whose heading has an error of 20 to 90 degrees and a standard deviation of
the same size. Three seeds, searches of 30 x 50 evaluations, no divergence monitor.
"""

import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import sigmaswarm
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters import tilted
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_filter
from sigmaswarm.scoring.score import score_estimate

REAL = ("colorado-1", "kitti-09-26-0022", "kitti-09-26-0101", "kitti-09-30-0018", "kitti-09-30-0033")
REAL += ("kitti-09-30-0034",)
USE = ("lateral", "standstill")
SEEDS = range(3)
MOUNTED = np.radians([12.0, 12.0])
OFF = np.radians([20.0, 45.0, 90.0])


def tuned(drive: Drive, kind: str, seed: int) -> tuple[FilterParameters, float]:
    """Tune a filter; return its parameters and the duration of the search, s."""
    began = time.perf_counter()
    tuning = sigmaswarm.tune(
        drive, model="tilted12", kind=kind, use=USE, objective="truth-pose + 0.2 nees", seed=seed
    )
    assert isinstance(tuning.parameters, FilterParameters)
    return tuning.parameters, time.perf_counter() - began


def mounted_off(drive: Drive) -> Drive:
    """Return the drive with its IMU rotated in roll and pitch."""
    state = np.zeros(tilted.N)
    state[[8, 9]] = MOUNTED
    turn = tilted.rotation(state)
    columns = np.array([getattr(drive.imu, axis) for axis in tilted.AXES])
    axes = np.vstack([turn.T @ columns[:3], turn.T @ columns[3:]])
    return replace(drive, imu=replace(drive.imu, **dict(zip(tilted.AXES, axes, strict=True))))


def starts(drive: Drive, off: float, seed: int) -> InitialState:
    """Return an initial state whose heading has the error and the standard deviation ``off``."""
    start = initial_state(drive)
    mean, covariance = start.mean.copy(), start.covariance.copy()
    mean[THETA] += off * (1 if seed % 2 else -1)
    covariance[THETA, :], covariance[:, THETA] = 0.0, 0.0
    covariance[THETA, THETA] = off**2
    return replace(start, mean=mean, covariance=covariance)


def nees(drive: Drive, estimate: Estimate) -> float:
    """Return the mean NEES e^T P^-1 e of the position at the times of the truth; 2 for a consistent filter."""
    truth = drive.truth
    assert truth is not None
    known = (estimate.time >= truth.time[0]) & (estimate.time <= truth.time[-1])
    true = np.column_stack([np.interp(estimate.time[known], truth.time, each) for each in (truth.x, truth.y)])
    error, covariance = estimate.mean[known, :2] - true, estimate.covariance[known, :2, :2]
    return float(np.mean(np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=1)))


def judged(drives: list[Drive], p: FilterParameters, off: float = 0.0, seed: int = 0) -> list[float]:
    """Return position RMSE (m), heading RMSE (deg) and NEES / 2, medians over the drives."""
    rows: list[list[float]] = []
    for drive in drives:
        initial = starts(drive, off, seed) if off else None
        estimate = run_filter(drive, p, initial=initial, recover=False)
        score = score_estimate(drive, estimate)
        rows.append([score.position_rmse, np.degrees(score.heading_rmse), nees(drive, estimate) / 2])
    return np.median(rows, axis=0).tolist()


def cases(drives: Path) -> Iterator[tuple[str, Drive, list[Drive]]]:
    """Yield name, training drive and test drives."""
    for name in REAL:
        train, test = sigmaswarm.split(sigmaswarm.read_drive(drives / name), 0.5)
        yield name, train, [test]
    for imu, gps in (("mpu-6050", "ublox-m8"), ("icm-20602", "white-1m")):
        made = [
            sigmaswarm.simulate("urban", run=run, duration=240, imu=imu, gps=gps, terrain="hilly", seed=5)
            for run in range(3)
        ]
        yield f"simulated {imu}", made[0], made[1:]
        off = [mounted_off(one) for one in made]
        yield f"simulated {imu}, mounted off", off[0], off[1:]


def main() -> None:
    """Print a row for each drive, start and kind: the values of the three seeds."""
    for name, train, tests in cases(Path(sys.argv[1])):
        for kind in ("ekf", "ukf"):
            found = [tuned(train, kind, seed) for seed in SEEDS]
            seconds = " ".join(f"{took:.1f}" for _, took in found)
            simulated = name.startswith("simulated")
            for off in (0.0, *OFF) if simulated else (0.0,):
                each = np.array([judged(tests, p, off, seed) for seed, (p, _) in enumerate(found)]).T
                shown = " | ".join(" ".join(f"{value:.3g}" for value in row) for row in each)
                print(f"{name}, heading {np.degrees(off):.0f} off, {kind} | {shown} | {seconds}", flush=True)


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
