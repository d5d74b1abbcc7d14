"""Measure the benefit of an odometer: filters tuned and tested with it, without it, and with a faulty odometer.

    python benchmarks/odometer.py grades --imus mpu-6050 icm-20602 adis16488
    python benchmarks/odometer.py faults --imus icm-20602 --objective "truth-pose + 0.2 nees"
    python benchmarks/odometer.py real drives/comma2k19
    python benchmarks/odometer.py speed

grades: ten simulated town drives of 120 s for each grade of IMU, with the vibration of real cars, fixes with 1 m of
white noise, and an odometer that counts pulses (a random scale error per drive, standard deviation 1%); filters are
tuned on seven drives and tested on three, with another split for each seed. faults: the filters of one grade are tested
on drives with a faulty odometer. real: a filter is tuned on the first part of a drive and tested on the rest. speed:
time of a step if the odometer is used, present but not used, and absent. Prints Markdown tables of medians over the
seeds. Drift is the RMS over the windows of outages in `switches.py`.
"""

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from sigmaswarm import (
    Drive,
    FilterParameters,
    SigmaswarmWarning,
    diagnose,
    read_drive,
    simulate,
    split_drives,
    split_time,
    tune,
)
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.passes import run_passes
from sigmaswarm.scoring.targets import tracking_pass
from sigmaswarm.simulation import IMU_GRADES
from sigmaswarm.tuning.space import search_space
from switches import TITLES, measured, shown

PLAIN = ("lateral", "standstill")
WHEELS = (*PLAIN, "odometer")
DRIVES = 10
GRADES = [name for name in IMU_GRADES if name not in ("ideal", "carla")]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["grades", "faults", "real", "speed"])
    parser.add_argument("drive", nargs="?", type=Path)
    parser.add_argument("--model", default="planar8")
    parser.add_argument("--imus", nargs="+", default=GRADES)
    parser.add_argument("--odometer", default="pulses")
    parser.add_argument(
        "--objective",
        default="truth-pose",
        help="for faults: an objective that determines the scale of the covariance",
    )
    parser.add_argument("--only", nargs="+", default=[*FAULTS], help="names of faults")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    with ThreadPoolExecutor() as pool:
        if options.what == "speed":
            print(speed())
            return
        print("| drives | " + " | ".join(TITLES[1:]) + " |\n" + "|---" * len(TITLES) + "|")
        if options.what == "grades":
            for imu in options.imus:
                grade(imu, options, pool)
        if options.what == "faults":
            faults(options, pool)
        if options.what == "real":
            real(options, pool)


def town(imu: str, options: argparse.Namespace, pool: ThreadPoolExecutor) -> list[Drive]:
    def one(seed: int) -> Drive:
        more = {"gps": "white-1m", "duration": 120.0, "vibration": 1.0, "odometer": options.odometer}
        return simulate("urban", seed=seed, imu=imu, **more)

    return list(pool.map(one, range(DRIVES)))


def tuned(
    training: Sequence[Drive],
    use: Sequence[str],
    seed: int,
    options: argparse.Namespace,
    pool: ThreadPoolExecutor,
) -> FilterParameters:
    asked = {"objective": options.objective, "model": options.model, "use": use}
    return tune(training, seed=seed, executor=pool, **asked).parameters


def print_row(name: str, what: str, rows: Sequence[Sequence[float]]) -> None:
    print(f"| {name} | {what} | {shown(np.median(np.array(rows), axis=0))} |", flush=True)


def splits(drives: Sequence[Drive], seeds: int) -> list[tuple[list[Drive], list[Drive]]]:
    return [split_drives(drives, 0.7, rng=np.random.default_rng(seed)) for seed in range(seeds)]


def grade(imu: str, options: argparse.Namespace, pool: ThreadPoolExecutor) -> None:
    drives = town(imu, options, pool)
    for use in (PLAIN, WHEELS):
        rows = [
            measured([PreparedDrive(drive) for drive in test], tuned(training, use, seed, options, pool))
            for seed, (training, test) in enumerate(splits(drives, options.seeds))
        ]
        print_row(imu, " + ".join((options.model, *use)), rows)


def with_faulty_odometer(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Callable[[Drive], Drive]:
    """Return a function that replaces the odometer's speeds of a drive by a function of times and speeds."""

    def plant(drive: Drive) -> Drive:
        wheels = drive.odometer
        assert wheels is not None
        return replace(drive, odometer=replace(wheels, speed=change(wheels.time, wheels.speed)))

    return plant


def slipping(t: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Simulate wheels that spin 50% too fast for 2 s, and lock for 2 s, in every 24 s."""
    phase = t % 24.0
    return np.where(phase < 2.0, 1.5 * v, np.where((phase > 12.0) & (phase < 14.0), 0.0, v))


def held(begin: float, length: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    def change(t: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.where((t > begin) & (t < begin + length), np.interp(begin, t, v), v)

    return change


FAULTS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "as it is": lambda t, v: v,
    "3% high": lambda t, v: 1.03 * v,
    "slip, 4 s of 24": slipping,
    "zero below 1 m/s": lambda t, v: np.where(v < 1.0, 0.0, v),
    "stuck for 20 s": held(60.0, 20.0),
    "dead from 60 s on": lambda t, v: np.where(t > 60.0, 0.0, v),
    "late by 0.3 s": lambda t, v: np.interp(t - 0.3, t, v),
    "unsigned noise of 1 m/s": lambda t, v: np.abs(v + np.random.default_rng(0).standard_normal(len(v))),
}


def exact(drive: Drive) -> Drive:
    """Return the drive without the scale error of its odometer; an estimated scale could not be more accurate."""
    scale = drive.metadata["odometer"]["scale"]
    return with_faulty_odometer(lambda t, v: v / scale)(drive)


def faults(options: argparse.Namespace, pool: ThreadPoolExecutor) -> None:
    """Test filters that were tuned without faults on drives with a fault; print the doctor's findings on them."""
    for imu in options.imus:
        parts = splits(town(imu, options, pool), options.seeds)
        filters = {
            use: [tuned(training, use, seed, options, pool) for seed, (training, _) in enumerate(parts)]
            for use in (PLAIN, WHEELS)
        }
        known = [
            measured(
                [PreparedDrive(exact(drive)) for drive in test],
                tuned([exact(drive) for drive in training], WHEELS, seed, options, pool),
            )
            for seed, (training, test) in enumerate(parts)
        ]
        print_row(imu, "each drive's scale known, tuned and tested", known)
        for use, name in [(PLAIN, "as it is"), *((WHEELS, name) for name in options.only)]:
            plant, rows, codes = with_faulty_odometer(FAULTS[name]), list[list[float]](), list[str]()
            for (_, test), parameters in zip(parts, filters[use], strict=True):
                planted = [plant(drive) for drive in test]
                rows.append(measured([PreparedDrive(drive) for drive in planted], parameters))
                if not codes:  # only for the first split
                    codes += [
                        c for drive in planted for c in diagnose(drive).codes if c.startswith("odometer")
                    ]
                    codes += [""]
            codes, tests = [code for code in codes if code], len(parts[0][1])
            seen = ", ".join(f"{c} {codes.count(c)}/{tests}" for c in sorted(set(codes)))
            label = "without" if use is PLAIN else name + (f" ({seen})" if seen else "")
            print_row(imu, label, rows)


def real(options: argparse.Namespace, pool: ThreadPoolExecutor) -> None:
    """Tune on the first part of a drive, and test on the rest."""
    training, test = split_time(read_drive(options.drive), 0.5)
    for use in (PLAIN, WHEELS):
        found = [tuned([training], use, seed, options, pool) for seed in range(options.seeds)]
        print_row(
            test.name, " + ".join((options.model, *use)), [measured([PreparedDrive(test)], p) for p in found]
        )
        if use is WHEELS:
            print("scales:", ", ".join(f"{p.odometer_scale:.4f}" for p in found))
            print("latencies:", ", ".join(f"{p.odometer_latency:.2f} s" for p in found))


def speed() -> str:
    """Return a table of processor times (ns per set and step, shortest of many): no odometer, not used, used."""
    drive = simulate("urban", seed=1, duration=120.0, odometer="can")
    lines = ["| filter | without odometer.csv, ns | with it, not used | used |", "|---|---|---|---|"]
    for model, kind in (("planar5", "ukf"), ("planar8", "ukf"), ("tilted12", "ekf")):
        figures = []
        for one, use in ((replace(drive, odometer=None), PLAIN), (drive, PLAIN), (drive, WHEELS)):
            space = search_space(model, "log10", one.nominal_interval, kind=kind, use=use)
            points = np.random.default_rng(0).uniform(space.low, space.high, (32, len(space.names)))
            sets, drive_pass = space.decode(points), tracking_pass(PreparedDrive(one))
            run_passes([drive_pass], sets)
            turns = []
            for _ in range(15):
                begin = time.thread_time()
                run_passes([drive_pass], sets)
                turns.append(time.thread_time() - begin)
            figures.append(1e9 * min(turns) / len(sets) / len(drive_pass.timeline.dt))
        lines.append(f"| {model} {kind} | " + " | ".join(f"{f:.1f}" for f in figures) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
