"""Compare tuning with the smoothed track of a drive as truth and tuning with innovation-t, scored with the real truth.

On each drive, a filter is tuned with innovation-t, and the drive is smoothed with this filter. Then a filter is tuned
with the smoothed track as truth (with the smoother's standard deviations). Held-out drives are those of
docs/results.md.

    python benchmarks/own_truth.py ../shared/drives --seeds 2
"""

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from real_drives import cases
from sigmaswarm import FilterParameters, SigmaswarmWarning, smooth, tune
from sigmaswarm.drives.drive import Drive, Truth
from sigmaswarm.scoring.batch import BatchScorer, PassOptions

HELD_OUT = ("kitti-09-30-0033", "colorado-1, last 30%", "kingston-1, last 30%")


def with_own_truth(drive: Drive, parameters: FilterParameters) -> Drive:
    """Return the drive with its smoothed estimate as truth."""
    found = smooth(drive, parameters)
    std = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
    kept = slice(None, None, 5)  # 20 Hz, which suffices
    columns = [*found.mean[:, :5].T, std[:, 0], std[:, 1], std[:, 4]]
    return replace(drive, truth=Truth(found.time[kept], *(column[kept] for column in columns)))


def main() -> None:
    """Print a row for each held-out drive: median over the seeds of position and heading RMSE."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--generations", type=int, default=50)
    parser.add_argument("--model", default="planar8")
    asked = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    options = {
        "model": asked.model,
        "use": ("lateral", "standstill", "robust"),
        "generations": asked.generations,
    }
    for name, training, test in cases(asked.drives):
        if name not in HELD_OUT:
            continue
        replayer, rows = BatchScorer.prepare(test, PassOptions(outages=True)), dict[str, list[list[float]]]()
        for seed in range(asked.seeds):
            blind = tune(
                [replace(drive, truth=None) for drive in training],
                objective="innovation-t",
                seed=seed,
                **options,
            )
            own = tune([with_own_truth(drive, blind.parameters) for drive in training], seed=seed, **options)
            scores = replayer.scores([blind.parameters, own.parameters])
            for i, way in enumerate(("innovation-t", "own smoothed track")):
                figures = scores.position_rmse, np.degrees(scores.heading_rmse), scores.outage_drift
                rows.setdefault(way, []).append([float(each[i].mean()) for each in figures])
        for way, found in rows.items():
            position, heading, drift = np.median(found, axis=0)
            spread = ", ".join(f"{row[0]:.3f}" for row in found)
            print(
                f"{name} | {way} | {position:.3f} m ({spread}) | {heading:.3f} deg | {drift:.3f} m",
                flush=True,
            )


if __name__ == "__main__":
    main()
