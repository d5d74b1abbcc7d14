"""Measure the benefit of each model and option of a filter, tuned and tested with several seeds.

    python benchmarks/switches.py ../shared/drives --seeds 10
    python benchmarks/switches.py ../shared/drives --objective innovation-t --only kingston-1
    python benchmarks/switches.py ../shared/drives --only kitti-09-30-0018 --as-recorded

Each KITTI drive is held out once, and the filter is tuned on the other four. On colorado-1 and kingston-1, the filter
is tuned on the first 70% of the time and tested on the rest; colorado-1 is also used with bursts of outliers in 6% of
its fixes. For each grade of GPS, ten town drives of 120 s with a car-grade MEMS IMU (ICM-20602) are simulated; the
filter is tuned on seven and tested on three, with another split for each seed. Prints a Markdown table: medians over
the seeds. Drift is the RMS over the windows of seeds 0 to 3 (5 s) and 0 to 5 (30 s).
"""

import argparse
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from real_drives import KITTI
from sigmaswarm import (
    Drive,
    FilterParameters,
    SigmaswarmWarning,
    initial_state,
    read_drive,
    run_filter,
    simulate,
    split_drives,
    split_time,
    tune,
)
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.passes import run_passes
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.score import MIN_HEADING_SPEED, truth_at
from sigmaswarm.scoring.targets import outage_pass, outage_windows
from sigmaswarm.simulation.gps import with_outliers

FILTERS = (
    ("planar5", ()),
    ("planar8", ()),
    ("planar8", ("lateral", "standstill")),
    ("planar8", ("lateral", "standstill", "gate")),
    ("planar8", ("lateral", "standstill", "robust")),
    ("planar8", ("lateral", "standstill", "accuracy")),
    ("planar8", ("lateral", "standstill", "robust", "accuracy")),
    ("tilted12", ("lateral", "standstill")),
    ("tilted12", ("lateral", "standstill", "gate")),
    ("tilted12", ("lateral", "standstill", "robust")),
)
GRADES = ("white-1m", "ublox-m8", "f9p-rtk")
WINDOWS = {5.0: range(4), 30.0: range(6)}
"""Length of outages (s), and the seeds of their placement."""
TITLES = (
    "tested on", "filter", "position RMSE, m", "50%, m", "95%, m", "heading, deg", "5 s drift, m", "30 s drift, m",
)  # fmt: skip

Split = tuple[Sequence[Drive], Sequence[Drive]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--objective", default="truth-pose")
    parser.add_argument("--only", nargs="+", help="names of cases")
    parser.add_argument("--filters", nargs="+", type=int, default=range(len(FILTERS)), help="their numbers")
    parser.add_argument("--optimizer", default="de")
    parser.add_argument("--as-recorded", action="store_true", help="no rules for stale fixes and gaps")
    parser.add_argument(
        "--prior", type=float, help="weight of the prior on R; 0: none; by default that of tune"
    )
    parser.add_argument("--inflation", type=float, help="likewise")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    print("| " + " | ".join(TITLES) + " |\n" + "|---" * len(TITLES) + "|")
    with ThreadPoolExecutor() as pool:
        for name, splits in cases(options.drives, options.seeds, options.only):
            print(f"| {name} | raw fixes | {shown([*quantities(raw(splits[0][1]))])} |", flush=True)
            for model, use in (FILTERS[i] for i in options.filters):
                if any(drive.imu.gx is None for part in splits[0] for drive in part) and model == "tilted12":
                    continue
                if "accuracy" in use and any(d.gps.std_x is None for part in splits[0] for d in part):
                    continue
                asked = {
                    "objective": options.objective,
                    "optimizer": options.optimizer,
                    "model": model,
                    "use": use,
                    "as_recorded": options.as_recorded,
                    "prior": options.prior,
                    "inflation": options.inflation,
                }
                rows = [
                    measured(
                        [PreparedDrive(drive, as_recorded=options.as_recorded) for drive in test],
                        tune(training, seed=seed, executor=pool, **asked).parameters,
                    )
                    for seed, (training, test) in enumerate(splits)
                ]
                label = " + ".join((model, *use))
                print(f"| {name} | {label} | {shown(np.median(np.array(rows), axis=0))} |", flush=True)


def cases(folder: Path, seeds: int, only: Sequence[str] | None) -> Iterator[tuple[str, list[Split]]]:
    """Yield names, and a training and test set for each seed; only the requested drives are read or simulated."""

    def asked(name: str) -> bool:
        return not only or name in only

    for held_out in filter(asked, KITTI):
        training = [read_drive(folder / name) for name in KITTI if name != held_out]
        yield held_out, [(training, [read_drive(folder / held_out)])] * seeds
    for name in filter(asked, ("colorado-1", "kingston-1")):
        training, test = split_time(read_drive(folder / name))
        yield name, [([training], [test])] * seeds
    if asked("outliers"):
        training, test = split_time(
            with_outliers(read_drive(folder / "colorado-1"), np.random.default_rng(0))
        )
        yield "colorado-1 with outliers", [([training], [test])] * seeds
    for grade in filter(lambda grade: asked(f"simulated-{grade}"), GRADES):
        drives = [simulate("urban", seed=i, gps=grade, duration=120.0) for i in range(10)]
        splits = [split_drives(drives, 0.7, rng=np.random.default_rng(s)) for s in range(seeds)]
        yield f"simulated, {grade}", splits


def measured(ready: Sequence[PreparedDrive], parameters: FilterParameters) -> list[float]:
    """Return RMSE, quantiles and drifts (m), and heading error (deg), over all test drives together."""
    off, turned = zip(*(errors(drive, parameters) for drive in ready), strict=True)
    heading = np.degrees(np.sqrt(np.mean(np.concatenate(turned) ** 2)))
    return [
        *quantities(np.concatenate(off)),
        float(heading),
        *(drift(ready, parameters, each) for each in WINDOWS),
    ]


def errors(ready: PreparedDrive, parameters: FilterParameters) -> tuple[np.ndarray, np.ndarray]:
    """Return position errors (m) and scored heading errors (rad) at the times of the truth."""
    estimate, truth = run_filter(ready, parameters), ready.drive.truth
    scored = truth.select((truth.time >= estimate.time[0]) & (truth.time <= estimate.time[-1]))
    x, y = (np.interp(scored.time, estimate.time, estimate.mean[:, i]) for i in (0, 1))
    theta = np.interp(scored.time, estimate.time, np.unwrap(estimate.mean[:, 4]))
    counts = np.hypot(scored.vx, scored.vy) > MIN_HEADING_SPEED
    return np.hypot(x - scored.x, y - scored.y), wrap_angle(theta - scored.theta)[counts]


def drift(ready: Sequence[PreparedDrive], parameters: FilterParameters, length: float) -> float:
    """Return the RMS drift (m) over all outages of a length (s) that fit."""
    squares, count = 0.0, 0
    for one in ready:
        for seed in WINDOWS[length]:
            if len(outage_windows(one.drive, one.initial, length=length, seed=seed)):
                drive_pass = outage_pass(one, length=length, seed=seed)
                squares += float(run_passes([drive_pass], [parameters])["SQ_POSITION"][0, 0])
                count += drive_pass.targets.n_positions
                one.forget()
    return float(np.sqrt(squares / count)) if count else float("nan")


def raw(test: Sequence[Drive]) -> np.ndarray:
    """Return the errors of the raw fixes, m."""
    each = []
    for drive in test:
        fixes = drive.gps.select(drive.gps.time >= initial_state(drive).time)
        x, y = truth_at(drive.truth, fixes.time)
        each.append(np.hypot(fixes.x - x, fixes.y - y))
    together = np.concatenate(each)
    return together[np.isfinite(together)]


def quantities(off: np.ndarray) -> tuple[float, float, float]:
    """Return RMSE, median and 95% quantile."""
    return float(np.sqrt(np.mean(off**2))), float(np.median(off)), float(np.quantile(off, 0.95))


def shown(values: Sequence[float]) -> str:
    return " | ".join([f"{v:.2f}" for v in values] + ["-"] * (len(TITLES) - 2 - len(values)))


if __name__ == "__main__":
    main()
