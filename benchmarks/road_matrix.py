"""Tune on every real drive and test on all others, to find filters that are less accurate than the fixes.

    python benchmarks/road_matrix.py ../shared/drives --use lateral standstill robust accuracy
    python benchmarks/road_matrix.py ../shared/drives --model tilted12 --use lateral standstill robust --inflation 0

A filter is tuned without truth on one drive and tested on each drive with truth; drives that lack an axis of the model
are omitted. `accuracy` is used if both drives state it. Prints Markdown tables of the ratio of the position RMSE to
that of the raw fixes, of the heading error (deg), and of the drift over 5 s (RMS over the windows of seeds 0 to 3):
rows are training drives, columns are test drives, values are medians over the seeds. A cell is bold if the filter is
worse than the fixes by more than 10%, or if its heading error exceeds 30 degrees. The last table contains geometric
means for tests on the training drive, on another drive of the same car, and on another car.
"""

import argparse
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, read_drive, run_filter, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.models import MODELS
from sigmaswarm.scoring.score import score_estimate, score_raw_gps
from switches import drift

RAW_SHARE, LOST = 1.1, 30.0
LEFT_OUT = ("dresden-as-recorded",)  # its signs and units are wrong intentionally


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--objective", default="auto", help="by default that of tune")
    parser.add_argument("--model", default="planar8")
    parser.add_argument("--use", nargs="*", default=[])
    parser.add_argument(
        "--prior", type=float, help="weight of the prior on R; 0: none; by default that of tune"
    )
    parser.add_argument("--inflation", type=float, help="likewise")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    folders = sorted(
        f for f in options.drives.iterdir() if (f / "imu.csv").exists() and f.name not in LEFT_OUT
    )
    drives = [read_drive(folder) for folder in folders]
    drives = [
        d for d in drives if all(getattr(d.imu, axis) is not None for axis in MODELS[options.model].imu)
    ]
    tests = [drive for drive in drives if drive.truth is not None]
    with ThreadPoolExecutor() as pool:
        found = np.array(
            [[row(drive, tests, options, seed, pool) for drive in drives] for seed in range(options.seeds)]
        )
    share, heading, drifts = values = np.median(found, axis=0).transpose(
        2, 0, 1
    )  # (training drives, test drives)
    show("position RMSE / raw fixes'", drives, tests, share, RAW_SHARE)
    show("heading error, deg", drives, tests, heading, LOST)
    show("drift over 5 s, m", drives, tests, drifts, np.inf)
    print(
        "\n| tested on | cells | position RMSE / raw fixes' | heading, deg | 5 s drift, m |\n"
        + "|---" * 5
        + "|"
    )
    for where in dict.fromkeys(relation(one, other) for one in drives for other in tests):
        cells = np.array([[relation(one, other) == where for other in tests] for one in drives])
        means = np.exp(np.nanmean(np.log(values[:, cells]), axis=1))
        print(f"| {where} | {cells.sum()} | " + " | ".join(f"{mean:.3g}" for mean in means) + " |")
    bad = (share > RAW_SHARE) | (heading > LOST)
    print(
        f"In {bad.sum()} of {bad.size} cells the RMSE exceeds 1.1 times that of the fixes or the heading is wrong."
    )


def relation(training: Drive, test: Drive) -> str:
    """Return the relation of the training drive to the test drive."""
    if training is test:
        return "the same drive"
    car, other = (drive.name.split("-")[0] for drive in (training, test))
    return "another of the same car" if car == other else "another car"


def row(
    training: Drive, tests: list[Drive], options: argparse.Namespace, seed: int, pool: ThreadPoolExecutor
):
    """Return, for each test drive, ratio of the RMSE to that of the raw fixes, heading error (deg), and drift (m)."""
    filters: dict[bool, FilterParameters] = {}
    found: list[tuple[float, float, float]] = []
    for test in tests:
        stated = training.gps.std_x is not None and test.gps.std_x is not None
        if stated not in filters:
            use = [option for option in options.use if option != "accuracy" or stated]
            asked = {"objective": options.objective, "model": options.model, "use": use, "seed": seed}
            guards = {"prior": options.prior, "inflation": options.inflation}
            filters[stated] = tune(
                [replace(training, truth=None)], executor=pool, **asked, **guards
            ).parameters
        ready = PreparedDrive(test)
        estimate = run_filter(ready, filters[stated])
        score, raw = score_estimate(test, estimate), score_raw_gps(test, estimate.initial)
        share, heading = score.position_rmse / raw.position_rmse, float(np.degrees(score.heading_rmse))
        found.append((share, heading, drift([ready], filters[stated], 5.0)))
    return found


def show(title: str, drives: list[Drive], tests: list[Drive], values: np.ndarray, limit: float) -> None:
    print(f"\n| {title}: tuned on | " + " | ".join(test.name for test in tests) + " |")
    print("|---" * (len(tests) + 1) + "|")
    for drive, cells in zip(drives, values, strict=True):
        shown = (f"**{v:.2f}**" if not v <= limit else f"{v:.2f}" for v in cells)
        print(f"| {drive.name} | " + " | ".join(shown) + " |", flush=True)


if __name__ == "__main__":
    main()
