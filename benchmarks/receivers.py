"""Measure the accuracy of `tune` without options on receivers with correlated and with white fix errors.

    python benchmarks/receivers.py ../shared/drives --out receivers.jsonl [--seeds 1 2 3] [--without fix-error]
    python benchmarks/receivers.py ../shared/drives --out receivers.jsonl --only gm --truth yes

The filter is tuned on the first 70% of a drive (comma2k19: the first half) and tested on the rest, with truth and
without. "M8" and "white": tuned on four simulated town drives of 180 s and tested on three others. "gm": the fixes of
kitti-09-30-0033 and -0034 are replaced by the truth plus errors of other simulated receivers. Each tuning is one line
of the file and is not repeated. Prints Markdown: medians over the seeds. "inside": fraction of errors within the stated
95% radius.
"""

import argparse
import json
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from defaults import Parts
from radius_coverage import measured
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, read_drive, simulate, split_time, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.simulation.gps import GpsGrade, with_outliers
from sigmaswarm.simulation.sensors import gauss_markov
from sigmaswarm.tuning.defaults import default_filter_options

REAL = ("kitti-09-30-0034", "kingston-1", "comma2k19", "colorado-1", "kitti-09-30-0033", "dresden")
SIMULATED = {"M8": ("mpu-6050", "ublox-m8"), "white": ("icm-20602", "white-1m")}
RECEIVERS = (
    GpsGrade("0.3 m, 1.5 m over 60 s", 0.3, 1.5, 60.0),
    GpsGrade("0.2 m, 1 m over 200 s", 0.2, 1.0, 200.0),
    GpsGrade("0.5 m, 1.2 m over 20 s", 0.5, 1.2, 20.0),
)
"""Receivers with white noise and a Gauss-Markov error."""
REALIZATIONS = range(4)  # of the errors, for each receiver and drive
COLUMNS = ("RMSE, m", "heading, deg", "5 s drift, m", "NEES", "inside", "radius, m", "innovation-t")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="file with one line of JSON per tuning")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--truth", nargs="+", default=["no", "yes"], choices=("no", "yes"))
    parser.add_argument("--only", nargs="+", help="beginnings of the names of cases")
    parser.add_argument("--without", nargs="+", default=[], help="options of the default filter to leave out")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    label = " ".join(["default", *(f"- {name}" for name in options.without)])
    done = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    with ThreadPoolExecutor() as pool, options.out.open("a", encoding="utf-8") as file:
        for name, make in cases(options.drives).items():
            if options.only and not name.startswith(tuple(options.only)):
                continue
            training, test = make()
            for truth in options.truth if training[0].truth else ["no"]:
                drives = training if truth == "yes" else [replace(one, truth=None) for one in training]
                chosen = default_filter_options({}, drives)[0]
                use = [one for one in chosen["use"] if one not in options.without]
                for seed in options.seeds:
                    key = [name, truth, label, seed]
                    if any(row[:4] == key for row in done):
                        continue
                    p = tune(drives, seed=seed, executor=pool, model=chosen["model"], use=use).parameters
                    done.append([*key, figures(test, p)])
                    file.write(json.dumps(done[-1]) + "\n")
                    file.flush()
    table(done)


def cases(folder: Path) -> dict[str, Callable[[], Parts]]:
    """Return, by name, functions that return training and test drives."""

    def parts(drive: Drive) -> Parts:
        first, rest = split_time(drive, 0.5 if drive.name == "comma2k19" else 0.7)
        return [first], [rest]

    def outliers() -> Parts:
        training, test = parts(read_drive(folder / "colorado-1"))
        return [[with_outliers(one, np.random.default_rng(0)) for one in each] for each in (training, test)]

    def town(grade: str) -> Parts:
        imu, gps = SIMULATED[grade]
        made = [simulate("urban", seed=i, duration=180.0, vibration=1.0, imu=imu, gps=gps) for i in range(7)]
        return made[:4], made[4:]

    found = {name: lambda name=name: parts(read_drive(folder / name)) for name in REAL}
    found["colorado-1 with outliers"] = outliers
    found |= {grade: lambda grade=grade: town(grade) for grade in SIMULATED}
    for grade in RECEIVERS:
        for drive in ("kitti-09-30-0033", "kitti-09-30-0034"):
            for i in REALIZATIONS:
                found[f"gm {grade.name}: {drive} {i}"] = lambda grade=grade, drive=drive, i=i: parts(
                    received(read_drive(folder / drive), grade, i)
                )
    return found


def received(drive: Drive, grade: GpsGrade, seed: int) -> Drive:
    """Return the drive with fixes of another receiver."""
    gps, truth, rng = drive.gps, drive.truth, np.random.default_rng(seed)
    interval = float(np.median(np.diff(gps.time)))
    lasting = grade.markov_std * gauss_markov(rng, len(gps), 2, interval / grade.markov_time)
    error = lasting + rng.normal(0.0, grade.white_std, (len(gps), 2))
    x, y = (np.interp(gps.time, truth.time, each) for each in (truth.x, truth.y))
    return replace(drive, gps=replace(gps, x=x + error[:, 0], y=y + error[:, 1]))


def figures(test: Sequence[Drive], parameters: FilterParameters) -> list[float]:
    """Return the values of `COLUMNS`: RMS over the test drives; for NEES and the following columns, means."""
    scores = BatchScorer.prepare(test, PassOptions(outages=bool(test[0].truth))).scores([parameters])
    lengths = [scores.position_rmse, np.degrees(scores.heading_rmse), scores.outage_drift]
    radii = [
        radius
        for drive in test
        if drive.truth
        for *_, radius, _ in measured("", parameters, {drive.name: PreparedDrive(drive)})
    ]
    inside, radius = (
        float(np.mean([getattr(one, what) for one in radii])) if radii else float("nan")
        for what in ("inside_95", "radius_95_m")
    )
    means = float(np.mean(scores.mean_nees)), inside, radius, float(np.mean(scores.innovation_t))
    return [*(float(np.sqrt(np.mean(each**2))) for each in lengths), *means]


def table(done: Sequence[Sequence]) -> None:
    """Print medians over the seeds and all realizations of the errors of a receiver."""
    print(
        "| tested on | truth | filter | " + " | ".join(COLUMNS) + " |\n" + "|---" * (len(COLUMNS) + 3) + "|"
    )
    rows = dict.fromkeys((row[0].split(":")[0], *row[1:3]) for row in done)
    for name, truth, label in sorted(rows):
        values = [row[4] for row in done if (row[0].split(":")[0], *row[1:3]) == (name, truth, label)]
        cells = " | ".join(f"{v:.2f}" for v in np.median(np.array(values), axis=0))
        print(f"| {name} | {truth} | {label} ({len(values)}) | {cells} |")


if __name__ == "__main__":
    main()
