"""What each part of a filter is worth: planar5, planar8 and the constraints, tuned and tested with several seeds.

    python benchmarks/switches.py ../shared/drives --seeds 10

colorado-1 and kingston-1: tuned on the first 70% of the time, tested on the rest. Simulated: ten drives of 120 s in a
town, white GPS noise of 1 m per axis, a car-grade MEMS IMU (ICM-20602), tuned on seven of them, tested on three,
another split each seed. All tuned with `truth-pose`, or as `--objective` says. Prints a Markdown table: medians over
the seeds, with lowest and highest in brackets for the first three measures.
"""

import argparse
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from sigmaswarm import (
    Drive,
    FilterParameters,
    SigmaswarmWarning,
    evaluate,
    initial_state,
    read_drive,
    run_filter,
    simulate,
    split_drives,
    split_time,
    tune,
)
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.scoring.evaluation import MEASURES
from sigmaswarm.scoring.score import truth_at

FILTERS = (
    ("planar5", ()),
    ("planar5", ("lateral", "standstill")),
    ("planar8", ()),
    ("planar8", ("lateral",)),
    ("planar8", ("standstill",)),
    ("planar8", ("gate",)),
    ("planar8", ("lateral", "standstill")),
    ("planar8", ("lateral", "standstill", "gate")),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--objective", default="truth-pose")
    parser.add_argument("--only", nargs="+", help="colorado-1, kingston-1, simulated")
    parser.add_argument("--optimizer", default="de")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    titles = ("tested on", "filter", "position RMSE, m", "heading error, deg", "5 s outage drift, m")
    print("| " + " | ".join((*titles, "position error 50% / 95%, m")) + " |")
    print("|---" * 6 + "|")
    with ThreadPoolExecutor() as pool:
        for name, splits in cases(options.drives, options.seeds):
            if options.only and name.split(",")[0] not in options.only:
                continue
            print(f"| {name} | raw GPS | {raw(splits)} |", flush=True)
            for model, use in FILTERS:
                rows = []
                for seed, (training, test) in enumerate(splits):
                    tuning = tune(
                        training,
                        objective=options.objective,
                        optimizer=options.optimizer,
                        model=model,
                        use=use,
                        seed=seed,
                        executor=pool,
                    )
                    scores = evaluate(test, tuning.parameters)
                    figures = [scores.mean("tuned", m) for m in MEASURES]
                    rows.append([*figures, *quantiles(errors(d, tuning.parameters) for d in test)])
                label = " + ".join((model, *use))
                print(f"| {name} | {label} | {spread(np.array(rows, float))} |", flush=True)


def cases(folder: Path, seeds: int):
    """Name, and a training and test set for each seed."""
    for name in ("colorado-1", "kingston-1"):
        train, test = split_time(read_drive(folder / name))
        yield f"{name}, last 30%", [([train], [test])] * seeds
    drives = [simulate("urban", seed=i, gps="white-1m", duration=120.0) for i in range(10)]
    yield "simulated", [split_drives(drives, 0.7, rng=np.random.default_rng(s)) for s in range(seeds)]


def errors(drive: Drive | PreparedDrive, parameters: FilterParameters) -> np.ndarray:
    """Position errors at the IMU's times, m."""
    ready = prepared(drive)
    estimate = run_filter(ready, parameters)
    x, y = truth_at(ready.drive.truth, estimate.time)
    distance = np.hypot(estimate.mean[:, 0] - x, estimate.mean[:, 1] - y)
    return distance[np.isfinite(distance)]


def raw(splits) -> str:
    """The same measures of the fixes themselves."""
    test = splits[0][1]
    scores = evaluate(test, FilterParameters(0.1, 2.0, 0.0, (1.0,) * 5, (1.0,) * 2))
    gps = []
    for drive in test:
        fixes = drive.gps.select(drive.gps.time >= initial_state(drive).time)
        x, y = truth_at(drive.truth, fixes.time)
        gps.append(np.hypot(fixes.x - x, fixes.y - y))
    half, most = quantiles(e[np.isfinite(e)] for e in gps)
    return f"{scores.mean('raw_gps', 'position_rmse_m'):.2f} | - | - | {half:.2f} / {most:.2f}"


def quantiles(each) -> tuple[float, float]:
    together = np.concatenate(list(each))
    return float(np.median(together)), float(np.quantile(together, 0.95))


def spread(rows: np.ndarray) -> str:
    median, low, high = np.median(rows, axis=0), rows.min(axis=0), rows.max(axis=0)
    cells = [f"{median[k]:.2f} [{low[k]:.2f}, {high[k]:.2f}]" for k in range(3)]
    return " | ".join((*cells, f"{median[3]:.2f} / {median[4]:.2f}"))


if __name__ == "__main__":
    main()
