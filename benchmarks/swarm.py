"""Compare the filter bank with its tuned filter, on cars like those of the training drives and on other cars.

    python benchmarks/swarm.py ../shared/drives --out swarm
    python benchmarks/swarm.py ../shared/drives --out swarm --unseen
    python benchmarks/swarm.py ../shared/drives --out swarm --table

A filter (`planar8` with lateral, standstill and robust, objective `truth-pose + 0.2 nees`) is tuned on the drives of a
fleet, and run over other drives: as a single filter, as a bank of sixteen filters without searches, and as a bank with
searches. J is position RMSE (m) + 0.1 heading RMSE (deg) + 0.1 drift over outages of 5 s (m; RMS over two placements
per seed). The table contains the geometric means of J divided by the J of the fleet's filter, the worst drive in
brackets, and the mean of |ln(NIS / 2)|. Groups:

    KITTI      each of the five drives; the fleet is the other four
    other cars the second half of colorado-1 or kingston-1; the fleet is KITTI and the other of these two
    near       simulated drives with the sensor grades of the fleet and other seeds
    off        simulated drives with another grade of sensors than the fleet
    switching  drives like "near"; in the middle, the receiver's errors increase from 1 to 4 m

The constants of the bank were chosen on these drives (most constants on seed 5 of the simulated drives, KITTI and both
other cars, with one seed and one placement of outages), so these drives are not held out. `--unseen` uses simulated
drives of other grades and seeds, which were not used for this choice.
"""

import argparse
import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from real_drives import KITTI
from sigmaswarm import (
    Drive,
    FilterParameters,
    SigmaswarmWarning,
    read_drive,
    simulate,
    split_time,
    tune,
)
from sigmaswarm.drives.prepared import PreparedDrive, prepare_drive
from sigmaswarm.filters.bank.run import BankRun
from sigmaswarm.filters.filter_run import EstimateChunk, FilterRun
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.scoring.score import PieceErrors
from sigmaswarm.scoring.targets import outage_pass, outage_windows, tracking_pass
from sigmaswarm.simulation.gps import GpsGrade

GRADES = {
    "icm, white": {"imu": "icm-20602", "gps": "white-1m"},
    "mpu, m8": {"imu": "mpu-6050", "gps": "ublox-m8"},
    "adis, rtk": {"imu": "adis16488", "gps": "f9p-rtk"},
}
CHANGES = {"fleet": {}, "16, no search": {"searches": False}, "16 and search": {"searches": True}}
UNSEEN = {
    "sim-low, 5 m": {"imu": "gnss-ins-sim-low", "gps": "gnss-ins-sim"},
    "adis16405, 2 m slow": {"imu": "adis16405", "gps": GpsGrade("slow", 0.3, 2.0, markov_time=120.0)},
    "adis16465, 0.3 m": {"imu": "adis16465", "gps": GpsGrade("short", 0.3, 0.3, markov_time=10.0)},
}
"""Grades that were not used to choose the constants of the bank."""


class Fleet(NamedTuple):
    name: str
    drives: Sequence[Drive]


Case = tuple[str, str, Fleet, Sequence[Drive]]
"""Group, name, fleet, held-out drives."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        help="folder of the tuning runs and of a file with one line of JSON per run",
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", help="parts of the names of groups")
    parser.add_argument("--methods", nargs="+", default=list(CHANGES), choices=CHANGES)
    parser.add_argument("--placements", type=int, default=2, help="placements of outages; 0: J without drift")
    parser.add_argument(
        "--unseen", action="store_true", help="use simulated drives that were not used to choose constants"
    )
    parser.add_argument("--table", action="store_true", help="only print the existing results")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    options.out.mkdir(exist_ok=True)
    lines = options.out / ("unseen.jsonl" if options.unseen else "runs.jsonl")
    done = known(lines)
    if not options.table:
        for group, name, fleet, tests in unseen_cases() if options.unseen else cases(options.drives):
            if options.only and not any(part in group for part in options.only):
                continue
            for seed, drive, method in product(range(options.seeds), tests, options.methods):
                key = group, name, drive.name, method, seed
                if key in done:
                    continue
                tuned = tuning(fleet, seed, options.out)
                line = json.dumps([*key, *measured(drive, tuned, method, seed, options.placements)])
                with lines.open("a") as file:
                    file.write(line + "\n")
                print(line, flush=True)
    table(known(lines))


def tuning(fleet: Fleet, seed: int, folder: Path) -> FilterParameters:
    """Return the filter of a fleet; tune it if the folder does not contain it."""
    file = folder / f"{fleet.name}, seed {seed}.toml"
    if not file.exists():
        with ThreadPoolExecutor() as pool:
            found = tune(
                fleet.drives,
                model="planar8",
                use=("lateral", "standstill", "robust"),
                objective="truth-pose + 0.2 nees",
                seed=seed,
                executor=pool,
            )
        found.parameters.save(file)
    return FilterParameters.load(file)


def cases(folder: Path) -> Iterator[Case]:
    real = {name: read_drive(folder / name) for name in (*KITTI, "colorado-1", "kingston-1")}
    for name in KITTI:
        fleet = [real[other] for other in KITTI if other != name]
        yield "KITTI", name, Fleet(f"KITTI without {name}", fleet), [real[name]]
    others = "colorado-1", "kingston-1"
    for name in others:
        fleet = [real[one] for one in (*KITTI, *others) if one != name]
        yield "other cars", name, Fleet(f"real without {name}", fleet), [split_time(real[name], 0.5)[1]]
    yield from simulated_cases({grade: simulated(range(7), **options) for grade, options in GRADES.items()})


def unseen_cases() -> Iterator[Case]:
    yield from simulated_cases(
        {grade: simulated(range(20, 27), **options) for grade, options in UNSEEN.items()}
    )


def simulated_cases(made: Mapping[str, Sequence[Drive]]) -> Iterator[Case]:
    """Yield the simulated cases; the first four drives of each grade are its fleet."""
    fleets = {grade: Fleet(grade, drives[:4]) for grade, drives in made.items()}
    for grade, drives in made.items():
        yield "near", grade, fleets[grade], drives[4:]
    for grade, other in permutations(made, 2):
        yield "off", f"{grade} > {other}", fleets[grade], made[other][4:]
    for grade, drives in made.items():
        yield "switching", grade, fleets[grade], [worse_midway(drive) for drive in drives[4:]]


def simulated(seeds: Iterable[int], **options: str | GpsGrade) -> list[Drive]:
    made = {i: simulate("urban", seed=i, duration=180.0, vibration=1.0, **options) for i in seeds}
    return [replace(drive, name=f"{drive.name} {i}") for i, drive in made.items()]


def worse_midway(drive: Drive) -> Drive:
    """Return the drive with white fix errors of 4 m per axis in its second half."""
    gps, rng = drive.gps, np.random.default_rng(5)
    late = gps.time > gps.time[len(gps) // 2]
    off = rng.standard_normal((2, len(gps))) * np.sqrt(15.0) * late
    return replace(drive, gps=replace(gps, x=gps.x + off[0], y=gps.y + off[1]))


def measured(
    drive: Drive, tuned: FilterParameters, method: str, seed: int, n_placements: int
) -> tuple[float, float, float, float]:
    """Return position RMSE (m), heading RMSE (deg), drift (m) and mean NIS."""
    ready = prepare_drive(drive)

    def run(drive_pass: FilterPass) -> BankRun | FilterRun:
        if method == "fleet":
            return FilterRun(drive_pass, tuned, recover=True)
        return BankRun(drive_pass, tuned, seed=seed, recover=True, **CHANGES[method])

    found = run(tracking_pass(ready))
    errors = PieceErrors(drive.truth, ready.initial)
    for piece in found:
        errors.add(piece.time, piece.mean)
    score = errors.score
    off = [drift(ready, run, (seed, i)) for i in range(n_placements)]
    drifted = float(np.sqrt(np.mean(np.concatenate(off)))) if off else 0.0
    nis = float(np.mean(found.innovations.nis))
    return score.position_rmse, float(np.degrees(score.heading_rmse)), drifted, nis


def drift(
    ready: PreparedDrive, run: Callable[[FilterPass], Iterator[EstimateChunk]], seed: tuple[int, int]
) -> np.ndarray:
    """Return the squared position errors at the ends of outages of 5 s, m2."""
    ends = outage_windows(ready.drive, ready.initial, length=5.0, seed=seed)[:, 1]
    found = run(outage_pass(ready, length=5.0, seed=seed))
    pieces = [(piece.time, piece.mean[:, :2]) for piece in found]
    time, place = (np.concatenate(column) for column in zip(*pieces, strict=True))
    truth = ready.drive.truth
    here = place[np.searchsorted(time, ends)]
    true = np.column_stack([np.interp(ends, truth.time, column) for column in (truth.x, truth.y)])
    return np.square(here - true).sum(axis=1)


def known(path: Path) -> dict[tuple, list[float]]:
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    return {tuple(row[:5]): row[5:] for row in rows}


def table(done: dict[tuple, list[float]]) -> None:
    groups = list(dict.fromkeys(key[0] for key in done))
    print("\n| | " + " | ".join(groups) + " |\n|---|" + "---|" * len(groups))
    for method in CHANGES:
        cells: list[str] = []
        for group in groups:
            ratios: dict[tuple[str, str], list[float]] = {}
            consistent: list[float] = []
            for key, found in done.items():
                fleet = done.get((*key[:3], "fleet", key[4]))
                if key[0] == group and key[3] == method and fleet is not None:
                    ratios.setdefault(key[1:3], []).append(j(found) / j(fleet))
                    consistent.append(abs(np.log(found[3] / 2)))
            if not ratios:
                cells.append("")
                continue
            each = [float(np.exp(np.mean(np.log(one)))) for one in ratios.values()]
            mean = np.exp(np.mean(np.log(each)))
            cells.append(f"{mean:.2f} ({max(each):.2f}), NIS {np.mean(consistent):.2f}")
        print(f"| {method} | " + " | ".join(cells) + " |")


def j(found: Sequence[float]) -> float:
    return found[0] + 0.1 * found[1] + 0.1 * found[2]


if __name__ == "__main__":
    main()
