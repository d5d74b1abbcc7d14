"""The driving swarm against the one filter that it comes from: on cars like those it was tuned on, and on others.

    python benchmarks/swarm.py ../shared/drives --out swarm.jsonl
    python benchmarks/swarm.py ../shared/drives --out swarm.jsonl --table

A filter is tuned on a fleet (`planar8` with lateral, standstill and robust, objective `truth-pose + 0.2 nees`), and run
over drives that the fleet has not: by itself, as sixteen that are only weighed, and as sixteen that search.
J is position RMSE (m) + 0.1 heading RMSE (deg) + 0.1 drift over outages of 5 s (m; RMS over four placements). The table
has the geometric means of J over that of the fleet's filter, and the worst drive in brackets; and the mean NIS. Groups:

    KITTI      each of the five drives, the fleet being the other four
    other cars the second half of colorado-1 or kingston-1, the fleet being KITTI and the other one
    near       simulated drives of the grades that the fleet has, other seeds
    off        simulated drives of a grade that the fleet has not
    switching  drives as near; halfway through the receiver's errors grow from 1 to 4 m

The swarm's own constants were chosen on two of each three simulated drives, on KITTI and on both other cars, with one
or two seeds and without the outages; of kept-back drives nothing was looked at.
"""

import argparse
import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path

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
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.filters.recording import Piece, Recording
from sigmaswarm.filters.replay import Replay
from sigmaswarm.filters.swarm.run import SwarmRun
from sigmaswarm.scoring.score import PieceErrors
from sigmaswarm.scoring.targets import outage_replay, outage_windows, tracking_replay

GRADES = {
    "icm, white": {"imu": "icm-20602", "gps": "white-1m"},
    "mpu, m8": {"imu": "mpu-6050", "gps": "ublox-m8"},
    "adis, rtk": {"imu": "adis16488", "gps": "f9p-rtk"},
}
CHANGES = {"fleet": {}, "16, no search": {"searches": False}, "16 and search": {"searches": True}}
Case = tuple[str, str, Sequence[Drive], Sequence[Drive]]
"""Group, name, fleet, held-out drives."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="one line of JSON a run")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", help="parts of groups' names")
    parser.add_argument("--methods", nargs="+", default=list(CHANGES), choices=CHANGES)
    parser.add_argument("--table", action="store_true", help="only print what the file has")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    done = known(options.out)
    if not options.table:
        for group, name, fleet, tests in cases(options.drives):
            if options.only and not any(part in group for part in options.only):
                continue
            for seed in range(options.seeds):
                tuned = None
                for drive, method in product(tests, options.methods):
                    key = group, name, drive.name, method, seed
                    if key in done:
                        continue
                    tuned = tuned or tuning(fleet, seed)
                    line = json.dumps([*key, *measured(drive, tuned, method, seed)])
                    with options.out.open("a") as file:
                        file.write(line + "\n")
                    print(line, flush=True)
    table(known(options.out))


def tuning(fleet: Sequence[Drive], seed: int) -> FilterParameters:
    with ThreadPoolExecutor() as pool:
        found = tune(
            list(fleet),
            model="planar8",
            use=("lateral", "standstill", "robust"),
            objective="truth-pose + 0.2 nees",
            seed=seed,
            executor=pool,
        )
    return found.parameters


def cases(folder: Path) -> Iterator[Case]:
    real = {name: read_drive(folder / name) for name in (*KITTI, "colorado-1", "kingston-1")}
    for name in KITTI:
        yield "KITTI", name, [real[other] for other in KITTI if other != name], [real[name]]
    others = "colorado-1", "kingston-1"
    for name in others:
        fleet = [real[one] for one in (*KITTI, *others) if one != name]
        yield "other cars", name, fleet, [split_time(real[name], 0.5)[1]]
    made = {grade: simulated(**options) for grade, options in GRADES.items()}
    for grade, (fleet, tests) in made.items():
        yield "near", grade, fleet, tests
    for grade, (fleet, _) in made.items():
        for other, (_, tests) in made.items():
            if other != grade:
                yield "off", f"{grade} > {other}", fleet, tests
    for grade, (fleet, tests) in made.items():
        yield "switching", grade, fleet, [worse_midway(drive) for drive in tests]


def simulated(**options: str) -> tuple[list[Drive], list[Drive]]:
    made = [simulate("urban", seed=i, duration=180.0, vibration=1.0, **options) for i in range(7)]
    named = [replace(drive, name=f"{drive.name} {i}") for i, drive in enumerate(made)]
    return named[:4], named[4:]


def worse_midway(drive: Drive) -> Drive:
    """The same drive, whose receiver has white errors of 4 m per axis in its second half."""
    gps, rng = drive.gps, np.random.default_rng(5)
    late = gps.time > gps.time[len(gps) // 2]
    off = rng.standard_normal((2, len(gps))) * np.sqrt(15.0) * late
    return replace(drive, gps=replace(gps, x=gps.x + off[0], y=gps.y + off[1]))


def measured(
    drive: Drive, tuned: FilterParameters, method: str, seed: int
) -> tuple[float, float, float, float]:
    """Position (m), heading (deg), drift (m), mean NIS."""
    ready = prepared(drive)

    def run(replay: Replay) -> SwarmRun | Recording:
        if method == "fleet":
            return Recording(replay, tuned, recover=True)
        return SwarmRun(replay, tuned, seed=seed, recover=True, **CHANGES[method])

    found = run(tracking_replay(ready))
    errors = PieceErrors(drive.truth, ready.initial)
    for piece in found:
        errors.add(piece.time, piece.mean)
    score = errors.score
    off = [drift(ready, run, (seed, i)) for i in range(4)]
    drifted = float(np.sqrt(np.mean(np.concatenate(off)))) if off else float("nan")
    nis = float(np.mean(found.innovations.nis))
    return score.position_rmse, float(np.degrees(score.heading_rmse)), drifted, nis


def drift(
    ready: PreparedDrive, run: Callable[[Replay], Iterator[Piece]], seed: tuple[int, int]
) -> np.ndarray:
    """Squared errors at the ends of outages of 5 s, m2."""
    ends = outage_windows(ready.drive, ready.initial, length=5.0, seed=seed)[:, 1]
    found = run(outage_replay(ready, length=5.0, seed=seed))
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
