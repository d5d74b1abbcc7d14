"""Measure the benefit of tuning on real drives: tuned on some drives and evaluated on others, with several seeds.

    python benchmarks/real_drives.py ../shared/drives --seeds 10

Each of the five KITTI drives is held out once, and the filter is tuned on the other four. On colorado-1 and kingston-1,
the filter is tuned on the first 70% of the time and evaluated on the rest, where it starts with a new alignment. Prints
a Markdown table. Figures of tuned filters are medians over the seeds, with lowest and highest value in brackets; the
other figures do not depend on a seed.
"""

import argparse
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from sigmaswarm import SigmaswarmWarning, evaluate, read_drive, split_time, tune
from sigmaswarm.scoring.methods import BASELINE, MEASURES, METHODS

KITTI = ("kitti-09-26-0022", "kitti-09-26-0101", "kitti-09-30-0018", "kitti-09-30-0033", "kitti-09-30-0034")


def cases(folder: Path):
    """Yield the name of the held-out drive, the training drives and the test drives."""
    kitti = {name: read_drive(folder / name) for name in KITTI}
    for held_out in KITTI:
        yield held_out, [d for name, d in kitti.items() if name != held_out], [kitti[held_out]]
    for name in ("colorado-1", "kingston-1"):
        train, test = split_time(read_drive(folder / name))
        yield f"{name}, last 30%", [train], [test]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--objectives", nargs="+", default=["truth-rmse", "truth-pose"])
    parser.add_argument("--optimizer", default="de")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    print("| held out | method | position RMSE, m | heading error, deg | 5 s outage drift, m |")
    print("|---|---|---|---|---|")
    for name, training, test in cases(options.drives):
        for method, row in rows(training, test, options):
            print(f"| {name} | {method} | " + " | ".join(row) + " |", flush=True)


def rows(training, test, options):
    with ThreadPoolExecutor() as pool:
        for objective in options.objectives:
            tunings = [
                tune(
                    training,
                    model="planar5",
                    objective=objective,
                    optimizer=options.optimizer,
                    seed=s,
                    executor=pool,
                )
                for s in range(options.seeds)
            ]
            evaluations = [evaluate(test, tuning.parameters) for tuning in tunings]
            figures = [[e.mean("tuned", m) for m in MEASURES] for e in evaluations]
            yield f"**tuned, {objective}**", [spread(column) for column in np.array(figures, float).T]
    for method in ("raw_gps", BASELINE, "imu_only"):
        values = [evaluations[0].mean(method, m) for m in MEASURES]
        yield METHODS[method], ["-" if v is None else f"{v:.2f}" for v in values]


def spread(values: np.ndarray) -> str:
    return f"{np.median(values):.2f} [{values.min():.2f}, {values.max():.2f}]"


if __name__ == "__main__":
    main()
