"""Every real drive as training, every other one as test: is a filter ever worse than the fixes that it is given?

    python benchmarks/road_matrix.py ../shared/drives --use lateral standstill robust accuracy
    python benchmarks/road_matrix.py ../shared/drives --model tilted12 --use lateral standstill robust --inflation 0

Tuned without truth on one drive, tested on each drive that has truth; drives that lack an axis of the model are
left out. `accuracy` is used where both state one. Prints Markdown tables for the position RMSE over that of the raw
fixes, the heading error in degrees, and the drift over 5 s (RMS over the windows of seeds 0 to 3): rows are training
drives, columns test drives, medians over the seeds. A cell that is worse than the fixes by more than 10%, or has lost
the heading by more than 30 degrees, is bold. At the end geometric means: tested where it was tuned, on another drive of
the same car, on another car.
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
LEFT_OUT = ("dresden-as-recorded",)  # its signs and units are wrong on purpose


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--objective", default="auto", help="by default what tune takes")
    parser.add_argument("--model", default="planar8")
    parser.add_argument("--use", nargs="*", default=[])
    parser.add_argument("--prior", type=float, help="of R; 0: none; by default as tune has it")
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
    print(f"{bad.sum()} of {bad.size} cells are worse than the fixes by over 10%, or have lost the heading.")


def relation(training: Drive, test: Drive) -> str:
    """Of what a filter was tuned on to what it is tested on."""
    if training is test:
        return "the same drive"
    car, other = (drive.name.split("-")[0] for drive in (training, test))
    return "another of the same car" if car == other else "another car"


def row(
    training: Drive, tests: list[Drive], options: argparse.Namespace, seed: int, pool: ThreadPoolExecutor
):
    """Share of the raw fixes' RMSE, heading error in degrees, and drift in m, on each test drive."""
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
