"""What tuning is worth on real drives: tuned on some, evaluated on others, several seeds.

    python benchmarks/real_drives.py ../shared/drives --seeds 10

KITTI's five drives: each is held out once, tuned on the other four. colorado-1 and kingston-1: tuned on the
first 70% of the time, evaluated on the rest, where the filter aligns anew. Prints a Markdown table; the tuned
figures are the median over the seeds with lowest and highest in brackets, the others have no seed.
"""

import argparse
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from sigmaswarm import SigmaswarmWarning, evaluate, read_drive, split_time, tune
from sigmaswarm.scoring.measures import MEASURES
from sigmaswarm.scoring.methods import BASELINE, METHODS

KITTI = ("kitti-09-26-0022", "kitti-09-26-0101", "kitti-09-30-0018", "kitti-09-30-0033", "kitti-09-30-0034")


def cases(folder: Path):
    """Name of the held-out drive, training drives, test drives."""
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
