"""Compare tuning without truth and tuning with truth on held-out drives.

    python benchmarks/objectives.py simulated [--model planar8] [--seeds 10]
    python benchmarks/objectives.py real ../shared/drives [--model planar8] [--use lateral] [--seeds 10]
    python benchmarks/objectives.py best [../shared/drives] [--model planar8] [--seeds 3]

simulated: three grades of sensors, with 30 town drives of 90 s each; for each seed, the filter is tuned on ten of them
and tested on the other twenty. real: each KITTI drive is held out once, and the filter is tuned on the others;
colorado-1 and kingston-1 are split in time, 70 to 30. best: the error of the tuned filter divided by the lowest error
that a search with four times the budget finds on the test drives themselves; on simulated drives or, if a folder is
given, on real drives. Prints Markdown: medians over the seeds, with lowest and highest value in brackets.
"""

import argparse
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from sigmaswarm import (
    Drive,
    FilterParameters,
    SigmaswarmWarning,
    consistency,
    read_drive,
    simulate,
    split_time,
    tune,
)
from sigmaswarm.scoring.batch import BatchScorer, PassOptions

OBJECTIVES = ("truth-rmse", "truth-pose", "innovation-nll", "outage-rmse", "gps-rmse")
GRADES = {
    "MPU-6050, u-blox M8": ("mpu-6050", "ublox-m8"),
    "ICM-20602, 1 m white": ("icm-20602", "white-1m"),
    "ADIS16488, RTK": ("adis16488", "f9p-rtk"),
}
KITTI = ("09-26-0022", "09-26-0101", "09-30-0018", "09-30-0033", "09-30-0034")
DRIVES, TRAINING = 30, 10

Split = tuple[list[Drive], list[Drive]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("simulated", "real", "best"))
    parser.add_argument("drives", type=Path, nargs="?")
    parser.add_argument("--model", default="planar5")
    parser.add_argument("--use", nargs="*", default=())
    parser.add_argument("--optimizer", default="de")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--objectives", nargs="*", default=OBJECTIVES)
    options = parser.parse_args()
    if (options.what == "real" and not options.drives) or (options.what == "simulated" and options.drives):
        parser.error("real needs a folder of drives, and simulated takes none")
    warnings.simplefilter("ignore", SigmaswarmWarning)
    cases = real(options.drives, options.seeds) if options.drives else simulated(options.seeds)
    asked = {"model": options.model, "use": tuple(options.use), "optimizer": options.optimizer}
    with ThreadPoolExecutor() as pool:
        for name, splits in cases:
            if options.what == "best":
                print(best(name, splits, asked, pool), flush=True)
            else:
                table(name, splits, options.objectives, asked, pool)


def table(name: str, splits: Sequence[Split], objectives: Sequence[str], asked: dict, pool: Executor) -> None:
    """Print a table with a row for each objective."""
    print(f"\n{name}, {asked['model']}{' + ' if asked['use'] else ''}{' + '.join(asked['use'])}\n")
    print(
        "| tuned by | position RMSE, m | over truth-rmse's | heading, deg | 5 s drift, m | NIS | in gate | NEES |"
    )
    print("|---|---|---|---|---|---|---|---|")
    reference = None
    for objective in objectives:
        rows = []
        for seed, (training, test) in enumerate(splits):
            tuning = tune(training, objective=objective, seed=seed, executor=pool, **asked)
            rows.append(figures(test, tuning.parameters, pool))
        found = np.array(rows)
        reference = found[:, 0] if reference is None else reference
        ratio = found[:, 0] / reference
        cells = [spread(found[:, 0], "{:.3g}"), spread(ratio, "{:.3f}"), spread(found[:, 1], "{:.2f}")]
        cells += [spread(found[:, 2], "{:.2f}"), spread(found[:, 3], "{:.2f}")]
        cells += [f"{100 * np.median(found[:, 4]):.1f}%", f"{np.median(found[:, 5]):.2f}"]
        print(f"| `{objective}` | " + " | ".join(cells) + " |", flush=True)


def figures(drives: Sequence[Drive], parameters: FilterParameters, pool: Executor) -> list[float]:
    """Return position RMSE (m), heading error (deg), drift (m), mean NIS, fraction of fixes in the 95% gate, NEES."""
    scores = BatchScorer.prepare(drives, PassOptions(outages=True)).scores([parameters], pool)
    inside = [c.inside_gate for d in drives if (c := consistency(d, parameters))]
    return [
        float(scores.position_rmse.mean()),
        float(np.degrees(np.nanmean(scores.heading_rmse))),
        float(np.nanmean(scores.outage_drift)),
        float(scores.mean_nis.mean()),
        float(np.mean(inside)) if inside else np.nan,
        float(scores.mean_nees.mean()),
    ]


def best(name: str, splits: Sequence[Split], asked: dict, pool: Executor) -> str:
    """Return a row that compares the tuned filter with the best filter for the test drives."""
    ratios: dict[str, list[float]] = {"truth-rmse": [], "innovation-nll": []}
    for seed, (training, test) in enumerate(splits):
        replayer = BatchScorer.prepare(test)
        searched = tune(test, objective="truth-rmse", particles=30, generations=100, trials=2, seed=seed,
                        executor=pool, **asked)  # fmt: skip
        tuned = {o: tune(training, objective=o, seed=seed, executor=pool, **asked) for o in ratios}
        errors = {o: replayer.scores([t.parameters], pool).position_rmse.mean() for o, t in tuned.items()}
        lowest = min(searched.cost, *errors.values())
        for objective, error in errors.items():
            ratios[objective].append(error / lowest)
    cells = " | ".join(spread(np.array(r), "{:.3f}") for r in ratios.values())
    return f"| {name}, {asked['model']} | {cells} |"


def spread(values: np.ndarray, number: str) -> str:
    """Format the median, with lowest and highest value in brackets."""
    middle, low, high = (number.format(v) for v in (np.median(values), values.min(), values.max()))
    return f"{middle} [{low}, {high}]"


def simulated(seeds: int) -> Iterator[tuple[str, list[Split]]]:
    """Yield the splits of simulated drives for three grades of sensors."""
    for name, (imu, gps) in GRADES.items():
        drives = [simulate("urban", run=k, duration=90, imu=imu, gps=gps, seed=3) for k in range(DRIVES)]
        orders = [np.random.default_rng(seed).permutation(DRIVES) for seed in range(seeds)]
        yield name, [([drives[k] for k in o[:TRAINING]], [drives[k] for k in o[TRAINING:]]) for o in orders]


def real(folder: Path, seeds: int) -> Iterator[tuple[str, list[Split]]]:
    """Yield the splits of real drives: KITTI by drive, the others in time."""
    kitti = [read_drive(folder / f"kitti-{name}") for name in KITTI]
    for held_out in kitti:
        yield held_out.name, [([d for d in kitti if d is not held_out], [held_out])] * seeds
    for name in ("colorado-1", "kingston-1"):
        training, test = split_time(read_drive(folder / name), 0.7)
        yield name, [([training], [test])] * seeds


if __name__ == "__main__":
    main()
