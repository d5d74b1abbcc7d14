"""Coverage of the stated radius of the position, for all pairs of training and test drives.

    python benchmarks/radius_coverage.py ../shared/drives --tunings DIR [--seeds 1 2]

The default filter is tuned on the first 70% of each drive (comma2k19: the first half), with truth and without, and
tested on the rest of this drive and on every other drive with the sensors that the filter needs. The same is done for
simulated town drives of 180 s with two grades of sensors. Tunings are saved in DIR. Prints Markdown: the fraction of
errors within the 95% radius, the median radius, and a summary over the pairs of drives with the same receiver.
"""

import argparse
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from sigmaswarm import (
    Drive,
    FilterParameters,
    InputError,
    SigmaswarmWarning,
    read_drive,
    simulate,
    split_time,
    tune,
)
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.scoring.consistency import RadiusRecord, lasting_variance, radius_record
from sigmaswarm.scoring.drifts import OutageDrifts
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, tracking_pass
from sigmaswarm.scoring.tracks import Tracker

WHITE = ("kitti-09-26-0022", "kitti-09-26-0101", "kitti-09-30-0018", "kitti-09-30-0033")
REAL = ("kitti-09-30-0034", "kingston-1", "comma2k19", "colorado-1", *WHITE)
GRADES = {"ublox-m8": ("mpu-6050", "ublox-m8"), "white-1m": ("icm-20602", "white-1m")}
TESTS = range(20, 24)
"""Seeds of the simulated test drives."""
Pair = tuple[str, str, RadiusRecord, RadiusRecord | None]
"""Training drive, test drive, and the radii: with all fixes, and at the ends of outages."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--tunings", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    parts = {
        name: split_time(read_drive(options.drives / name), 0.5 if name == "comma2k19" else 0.7)
        for name in REAL
    }
    training = {name: first for name, (first, _) in parts.items()} | {g: simulated(g, 0) for g in GRADES}
    rest = {name: PreparedDrive(second) for name, (_, second) in parts.items()}
    whole = {name: PreparedDrive(read_drive(options.drives / name)) for name in REAL}
    for truth in (False, True):
        found: list[Pair] = []
        for seed in options.seeds:
            for name, drive in training.items():
                p = tuned(
                    options.tunings / f"{name}-{'T' if truth else 'B'}-{seed}", drive, seed, truth=truth
                )
                others = whole | {name: rest[name]} if name in REAL else made(name)
                found += measured(name, p, others)
        print(f"\n**{'With' if truth else 'Without'} truth**, seeds {options.seeds}\n")
        matrix(found)
        summary(found)


def simulated(grade: str, seed: int) -> Drive:
    imu, gps = GRADES[grade]
    return simulate("urban", seed=seed, duration=180.0, vibration=1.0, imu=imu, gps=gps)


def made(grade: str) -> dict[str, PreparedDrive]:
    return {f"{grade} {seed}": PreparedDrive(simulated(grade, seed)) for seed in TESTS}


def tuned(folder: Path, drive: Drive, seed: int, *, truth: bool) -> FilterParameters:
    file = folder / "tuning.toml"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        tune(drive if truth else replace(drive, truth=None), seed=seed).save(file)
    return FilterParameters.load(file)


def measured(name: str, p: FilterParameters, tests: Mapping[str, PreparedDrive]) -> Iterator[Pair]:
    """Yield the radii on each test drive that has the sensors of the filter."""
    for test, ready in tests.items():
        tracker = Tracker(ready)
        try:
            tracker.record("tuned", tracking_pass(ready), p, recover=True)
        except InputError:
            continue
        outages = OutageDrifts(ready, length=OUTAGE_LENGTH, seed=0, most=4)
        outages.run({"tuned": p})
        radii = [
            radius_record(variance, lasting_variance(ready.drive, p, time, variance), error)
            for time, variance, error in (tracker.stated, outages.stated)
        ]
        if radii[0]:
            yield name, test, radii[0], radii[1]


def matrix(found: list[Pair]) -> None:
    tests = list(dict.fromkeys(test.split(" ")[0] for _, test, *_ in found))
    print("| tuned on | " + " | ".join(tests) + " |\n" + "|---" * (len(tests) + 1) + "|")
    for name in dict.fromkeys(name for name, *_ in found):
        cells = []
        for test in tests:
            of = [r for n, t, r, _ in found if n == name and t.split(" ")[0] == test]
            inside, radius = [r.inside_95 or 0.0 for r in of], [r.radius_95_m for r in of]
            cells.append(f"{100 * np.mean(inside):.0f}%, {np.mean(radius):.2g} m" if of else "-")
        print(f"| {name} | " + " | ".join(cells) + " |")


def summary(found: list[Pair]) -> None:
    """Print mean and worst coverage over the pairs with the same receiver; medians over the seeds."""
    print("\n| one receiver | pairs | in 95% radius | lowest | outside 99.9% radius |\n" + "|---" * 5 + "|")
    of_one = [pair for pair in found if one_receiver(*pair[:2])]
    for what, k in (("all fixes", 2), ("end of outages of 5 s", 3)):
        shares: dict[tuple[str, str], list[tuple[float, float]]] = {}
        for pair in of_one:
            if isinstance(record := pair[k], RadiusRecord):
                each = record.inside_95 or 0.0, record.inside_999 or 0.0
                shares.setdefault((pair[0], pair[1]), []).append(each)
        inside, within = np.array([np.median(each, axis=0) for each in shares.values()]).T
        worst = " > ".join([*shares][int(np.argmin(inside))])
        lowest, outside = f"{100 * inside.min():.0f}% ({worst})", 1 - within.mean()
        print(f"| {what} | {len(shares)} | {100 * inside.mean():.1f}% | {lowest} | {100 * outside:.2f}% |")
    alone = [pair[2].sigma_ratio or 0.0 for pair in of_one]
    print(f"\nThe filter's standard deviation / the correct one: {min(alone):.2f} to {max(alone):.2f}.")


def one_receiver(name: str, test: str) -> bool:
    """Return True if both drives have the same receiver: parts of one drive, and KITTI drives with white noise."""
    return test.split(" ")[0] == name or (name in WHITE and test in WHITE)


if __name__ == "__main__":
    main()
