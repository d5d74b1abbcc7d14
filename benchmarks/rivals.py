"""Compare tuned filters of every type, and networks that assist a filter, on the same held-out drives.

    python benchmarks/rivals.py DRIVES --out rivals.jsonl [--seeds 3] [--search 8] [--only kitti sim]
    python benchmarks/rivals.py DRIVES --out curve.jsonl --curve 2 5 10 20

Cases: KITTI, each drive held out once; colorado-1 and kingston-1, divided at 70% of the time; simulated drives on
rolling roads, six for training and four held out; the filters of these six drives on drives with another grade of
sensors, or another car. All filters are planar8 with lateral, standstill and robust, tuned with truth. Each row is a
line of JSON; a repeated command adds the missing lines. `sigmaswarm study --rivals` compares the methods in the paper's
setting, with planar5 and planar8 without options and tuned with `truth-rmse`; the filters here have the recommended
options.
"""

import argparse
import json
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np

from real_drives import KITTI
from sigmaswarm import Drive, FilterParameters, SigmaswarmWarning, read_drive, simulate, split_time, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.names import FilterKind, NetworkName
from sigmaswarm.filters.parameters import incompatibility
from sigmaswarm.learned.folder import LearnedNetwork, load_learned
from sigmaswarm.learned.learn import LearnConfig, learn
from sigmaswarm.scoring.drifts import OutageDrifts
from sigmaswarm.scoring.score import PieceErrors
from sigmaswarm.scoring.targets import tracking_pass

LENGTHS = (5.0, 15.0, 30.0, 60.0)
MEASURES = ("position, m", "heading, deg", *(f"{length:g} s, m" for length in LENGTHS), "NIS", "us a sample")
USE = ("lateral", "standstill", "robust")


@dataclass(frozen=True)
class Case:
    """Training drives, and test drives with the same sensors and with other sensors."""

    name: str
    train: Sequence[Drive]
    tests: dict[str, Sequence[Drive]]


def cases(folder: Path, only: Sequence[str]) -> Iterator[Case]:
    def wanted(name: str) -> bool:
        return not only or any(part in name for part in only)

    if wanted("sim"):
        adis = made("adis16488", range(20, 22))
        yield Case(
            "sim icm-20602",
            made("icm-20602", range(6)),
            {
                "same": made("icm-20602", range(20, 24)),
                "mpu-6050": made("mpu-6050", range(20, 22)),
                "adis16488": adis,
            },
        )
    for name in ("colorado-1", "kingston-1"):
        if wanted(name):
            first, rest = split_time(read_drive(folder / name), 0.7)
            yield Case(name, [first], {"same": [rest]})
    for held_out in KITTI:
        if wanted(held_out):
            others = [read_drive(folder / name) for name in KITTI if name != held_out]
            tests = {
                "same": [read_drive(folder / held_out)],
                "colorado-1": [read_drive(folder / "colorado-1")],
            }
            yield Case(held_out, others, tests)


def made(imu: str, seeds: Sequence[int]) -> list[Drive]:
    options = {"duration": 180.0, "vibration": 1.0, "terrain": "rolling", "gps": "white-1m"}
    return [replace(simulate("urban", seed=i, imu=imu, **options), name=f"{imu} {i}") for i in seeds]


def measured(drive: Drive, parameters: FilterParameters, learned: LearnedNetwork | None) -> list[float]:
    ready = PreparedDrive(drive)
    make: Callable = (
        partial(FilterRun, parameters=parameters, recover=True)
        if learned is None
        else partial(learned.run, parameters=parameters, recover=True)
    )
    drive_pass = tracking_pass(ready)
    make(drive_pass).finished()  # compiles
    errors, began = PieceErrors(drive.truth, ready.initial), time.process_time()
    run = make(drive_pass)
    for piece in run:
        errors.add(piece.time, piece.mean)
    took = 1e6 * (time.process_time() - began) / len(drive_pass.timeline.imu_time)
    score = errors.score
    drifts = []
    for length in LENGTHS:
        outages = OutageDrifts(ready, length=length, seed=0)
        outages.run({"filter": parameters}, {"network": make} if learned else {})
        drifts.append(outages.drift("network" if learned else "filter"))
    return [
        score.position_rmse,
        float(np.degrees(score.heading_rmse)),
        *drifts,
        float(run.innovations.nis.mean()),
        took,
    ]


def tuned(drives: Sequence[Drive], kind: FilterKind, seed: int) -> tuple[FilterParameters, float, int]:
    began = time.process_time()
    use = tuple(
        option for option in USE if not incompatibility(kind, (option,))
    )  # robust can be combined only with ukf and ekf
    with ThreadPoolExecutor() as pool:
        found = tune(
            list(drives),
            model="planar8",
            kind=kind,
            use=use,
            objective="truth-pose + 0.2 nees",
            seed=seed,
            executor=pool,
        )
    return found.parameters, time.process_time() - began, len(found.trials[0].point)


def rows(case: Case, seed: int, search: int, done: set[tuple], networks: Sequence[str]) -> Iterator[list]:
    """Yield case, test, method, seed, drive s, training s, number of parameters, means over the test drives."""
    driven = sum(float(d.imu.time[-1] - d.imu.time[0]) for d in case.train)
    base: tuple[FilterParameters, float, int] | None = None
    for method in (*get_args(FilterKind), *networks):
        if all((case.name, test, method, seed) in done for test in case.tests):
            continue
        base = base or tuned(case.train, "ukf", seed)
        learned = None
        if method in get_args(NetworkName):
            with tempfile.TemporaryDirectory() as folder:
                out = Path(folder) / "learned"
                learn(LearnConfig(method, base[0], case.train, search=search, seed=seed), out)
                took = json.loads((out / "timings.json").read_text())["processor_s"]
                learned = load_learned(out)
            parameters, cost, numbers = base[0], base[1] + took, base[2] + learned.record.network.numbers
        else:
            parameters, cost, numbers = base if method == "ukf" else tuned(case.train, method, seed)
        for test, drives in case.tests.items():
            found = np.array([measured(drive, parameters, learned) for drive in drives])
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # drives too short for an outage of 60 s
                mean = np.nanmean(found, axis=0)
            yield [case.name, test, method, seed, driven, cost, numbers, *mean.tolist()]


def table(lines: Sequence[list]) -> None:
    heads = ("training drives", "tested on", "method", "seeds", "drive s", "training s", "numbers", *MEASURES)
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for key in dict.fromkeys((line[0], line[1], line[2]) for line in lines):
        own = np.array([line[4:] for line in lines if tuple(line[:3]) == key], dtype=np.float64)
        middle, low, high = np.median(own, axis=0), own.min(axis=0), own.max(axis=0)
        spread = [
            f"{m:.3g}" if len(own) == 1 or i < 3 else f"{m:.3g} [{a:.3g}, {b:.3g}]"
            for i, (m, a, b) in enumerate(zip(middle, low, high, strict=True))
        ]
        print("| " + " | ".join([*key, str(len(own)), *spread]) + " |")


def shortened(case: Case, minutes: float) -> Case:
    """Return the case with ``minutes`` of training data: complete drives, and the beginning of one more."""
    left, kept = 60.0 * minutes, []
    for drive in case.train:
        length = float(drive.imu.time[-1] - drive.imu.time[0])
        if left >= length:
            kept.append(drive)
        elif left > 60.0:
            kept.append(split_time(drive, left / length)[0])
        left -= min(left, length)
    return replace(case, name=f"{case.name}, {minutes:g} min", train=kept, tests={"same": case.tests["same"]})


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--search", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--networks", nargs="+", default=list(get_args(NetworkName)))
    parser.add_argument("--curve", nargs="+", type=float, default=[], help="minutes of training data")
    parser.add_argument("--table", action="store_true", help="only print the results in the file")
    asked = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    lines = [json.loads(line) for line in asked.out.read_text().splitlines()] if asked.out.exists() else []
    if not asked.table:
        for case in cases(asked.drives, asked.only):
            for one in [shortened(case, minutes) for minutes in asked.curve] or [case]:
                for seed in range(asked.seeds):
                    done = {tuple(line[:4]) for line in lines}
                    for row in rows(one, seed, asked.search, done, asked.networks):
                        lines.append(row)
                        with asked.out.open("a") as file:
                            file.write(json.dumps(row) + "\n")
                        print(json.dumps(row), flush=True)
    table(lines)


if __name__ == "__main__":
    main()
