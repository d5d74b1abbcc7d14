"""Measure the effect of the prior on R: filters tuned without truth, with the prior and without it.

    python benchmarks/prior.py ../shared/drives [--seeds 10] [--only kingston-1 ...]

The filter is the default filter of `tune`; each drive with truth is held out as in `defaults.py`. Prints Markdown:
medians over the seeds, the standard deviation of R per axis (for the median fix), and the RMS error per axis of the
test fixes, including stale fixes.
"""

import argparse
import warnings
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from defaults import cases, figures
from real_drives import KITTI
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, tune
from sigmaswarm.drives.sensors import receiver_std
from sigmaswarm.scoring.score import truth_at
from sigmaswarm.tuning.receiver import typical_variance

CASES = ("colorado-1", "kingston-1", "comma2k19", *KITTI)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", nargs="+", default=CASES, choices=CASES)
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    print(
        "| tested on | prior | position RMSE, m | heading, deg | 5 s drift, m | NEES | R, m | errors of fixes, m |"
    )
    print("|---" * 8 + "|")
    found = cases(options.drives)
    with ThreadPoolExecutor() as pool:
        for name in options.only:
            training, test = found[name]()
            for prior in (1.0, 0.0):
                rows = list[list[float]]()
                for seed in range(options.seeds):
                    p = tune(
                        training, objective="innovation-t", seed=seed, executor=pool, prior=prior
                    ).parameters
                    rmse, _, _, heading, drift, *_, nees = figures(test, p)
                    rows.append([rmse, heading, drift, nees, deviation(p, test)])
                cells = " | ".join(f"{v:.2f}" for v in np.median(rows, axis=0))
                print(f"| {name} | {'yes' if prior else 'no'} | {cells} | {errors(test):.2f} |", flush=True)


def deviation(parameters: FilterParameters, drives: Sequence[Drive]) -> float:
    """Return the standard deviation of R per axis, m, for the median fix."""
    std = np.array([receiver_std(drive) for drive in drives])
    return float(np.sqrt(np.mean(typical_variance([parameters], std))))


def errors(drives: Sequence[Drive]) -> float:
    """Return the RMS error of the fixes per axis, m."""
    off = list[float]()
    for drive in drives:
        assert drive.truth is not None
        x, y = truth_at(drive.truth, drive.gps.time)
        off += [*np.square(drive.gps.x - x), *np.square(drive.gps.y - y)]
    return float(np.sqrt(np.nanmean(off)))


if __name__ == "__main__":
    main()
