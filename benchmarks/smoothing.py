"""Measure the benefit of smoothing: tuned filters, causal and smoothed, on held-out drives.

    python benchmarks/smoothing.py ../shared/drives --seeds 10
    python benchmarks/smoothing.py ../shared/drives --objectives innovation-t --only kingston-1 --gtsam
    python benchmarks/smoothing.py --ten-hours
    python benchmarks/smoothing.py --lag

Drives and splits are those of `switches.py`, scores those of `sigmaswarm evaluate`. Prints a Markdown table: medians
over the seeds for the filter and for the smoother; processor time of a single run in us per IMU sample. GTSAM's batch
smoother has the noise parameters that `peers.py` searches; its time is that of the optimizer, which starts from iSAM2's
last estimate. --ten-hours: time and peak memory for ten hours at 100 Hz. --lag: time per sample of a live filter with a
lag of 2 s.
"""

import argparse
import resource
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from sigmaswarm import (
    Drive,
    FilterParameters,
    Gps,
    Imu,
    LiveFilter,
    SigmaswarmWarning,
    evaluate,
    initial_state,
    run_filter,
    simulate,
    smooth,
    tune,
)
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.filters.smoothing import SmootherRun
from sigmaswarm.scoring.methods import MEASURES
from switches import cases

FILTERS = (
    ("planar8", ("lateral", "standstill", "gate")),
    ("planar8", ("lateral", "standstill", "robust")),
    ("planar8", ("lateral", "standstill", "robust", "accuracy")),
    ("tilted12", ("lateral", "standstill", "robust")),
)
OBJECTIVES = ("truth-pose", "innovation-nll", "innovation-t")
COLUMNS = (
    *("tested on", "filter", "tuned by", "RMSE, m", "50%, m", "95%, m", "heading, deg", "5 s, m", "30 s, m"),
    "us a sample",
)
ORDER = (
    *("position_rmse_m", "position_median_m", "position_95_m", "heading_rmse_deg"),
    *("outage_drift_m", "long_outage_drift_m"),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path, nargs="?")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--objectives", nargs="+", default=OBJECTIVES)
    parser.add_argument("--only", nargs="+", help="names of cases, as in switches.py")
    parser.add_argument("--filters", nargs="+", type=int, default=range(len(FILTERS)), help="their numbers")
    parser.add_argument("--gtsam", action="store_true", help="also run GTSAM's batch smoother")
    parser.add_argument(
        "--tries", type=int, default=15, help="number of evaluations of GTSAM's noise parameters"
    )
    parser.add_argument("--ten-hours", action="store_true")
    parser.add_argument("--lag", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    if options.ten_hours:
        ten_hours()
    if options.lag:
        lag()
    if options.drives is None:
        return
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    for name, splits in cases(options.drives, options.seeds, options.only):
        for model, use in (FILTERS[i] for i in options.filters):
            drives = [drive for part in splits[0] for drive in part]
            if model == "tilted12" and any(drive.imu.gx is None for drive in drives):
                continue
            if "accuracy" in use and any(drive.gps.std_x is None for drive in drives):
                continue
            for objective in options.objectives:
                rows = np.array([row(*split, model, use, objective, s) for s, split in enumerate(splits)])
                for what, of in (("", rows[:, 0]), (", smoothed", rows[:, 1])):
                    cells = " | ".join(f"{v:.3g}" for v in np.median(of, axis=0))
                    print(
                        f"| {name} | {' + '.join((model, *use))}{what} | {objective} | {cells} |", flush=True
                    )
        if options.gtsam:
            print(f"| {name} | GTSAM batch | - | {batch(*splits[0], options.tries)} |", flush=True)


def row(training, test, model: str, use, objective: str, seed: int) -> list[list[float]]:
    """Return the measures and the time of the filter and of the smoother."""
    with ThreadPoolExecutor() as pool:
        tuned = tune(
            training, objective=objective, optimizer="de", model=model, use=use, seed=seed, executor=pool
        ).parameters
    result = evaluate(test, tuned, smooth=True)
    both = []
    for method, run in (("tuned", run_filter), ("smoothed", smooth)):
        values = [result.mean(method, measure) for measure in ORDER]
        each = [spent(run, PreparedDrive(drive), tuned) for drive in test]
        samples = sum(int(np.sum(drive.imu.time > initial_state(drive).time)) for drive in test)
        both.append([*(np.nan if v is None else v for v in values), sum(each) / samples * 1e6])
    return both


def spent(run, ready: PreparedDrive, parameters: FilterParameters) -> float:
    """Return the processor time (s) of the second run, when code is compiled and the drive is prepared."""
    run(ready, parameters)
    begun = time.process_time()
    run(ready, parameters)
    return time.process_time() - begun


def batch(training, test, tries: int) -> str:
    """Run GTSAM's batch smoother on the test drives."""
    import peers
    import rival_gtsam as rival

    noise = peers.searched(min(training, key=lambda drive: drive.duration), tries)
    off, turned, samples, took = [], [], 0, 0.0
    for drive in test:
        found = rival.run_batch(drive, initial_state(drive), noise)
        samples += len(found.run.time)
        distances, angles = peers.errors_of(drive, found.run)
        off.append(distances)
        turned.append(angles)
        took += found.spent
    took *= 1e6 / samples
    heading = np.degrees(np.sqrt(np.mean(np.concatenate(turned) ** 2)))
    cells = [*peers.quantities(np.concatenate(off)), heading, np.nan, np.nan, took]
    return " | ".join(f"{v:.3g}" for v in cells)


def manual_filter(drive: Drive) -> FilterParameters:
    """Return planar8 with a manual choice of parameters."""
    q = (1e-6,) * 2 + (1e-4,) * 2 + (1e-8,) + (1e-8,) * 2 + (1e-11,)
    return FilterParameters(
        0.5, 2.0, 0.0, q, (1.0, 1.0), "planar8", lateral_noise=0.1, standstill_noise=1e-3,
        nominal_interval=drive.nominal_interval,
    )  # fmt: skip


def driven_again(drive: Drive, times: int) -> Drive:
    """Return a drive that repeats a drive; each repetition begins at the position and heading of the previous end."""
    imu, gps, truth = drive.imu, drive.gps, drive.truth
    assert truth is not None
    length = imu.time[-1] + drive.nominal_interval - imu.time[0]
    fixes, ends = gps.x + 1j * gps.y, truth.x[[0, -1]] + 1j * truth.y[[0, -1]]
    turned, place, x = 1.0 + 0.0j, ends[0], []
    for _ in range(times):
        x.append(place + turned * (fixes - ends[0]))
        place += turned * (ends[1] - ends[0])
        turned *= np.exp(1j * (truth.theta[-1] - truth.theta[0]))
    later = np.arange(times) * length
    whole = np.concatenate(x)
    again = {axis: np.tile(getattr(imu, axis), times) for axis in ("ax", "ay", "gz")}
    return Drive(
        drive.name,
        Imu(np.add.outer(later, imu.time).ravel(), **again),
        Gps(np.add.outer(later, gps.time).ravel(), whole.real, whole.imag),
    )


def ten_hours() -> None:
    """Smooth ten hours at 100 Hz with planar8, in pieces as in `sigmaswarm run --smooth`."""
    drive = driven_again(simulate("urban", duration=600.0, imu_rate=100.0, gps_rate=5.0, seed=1), 60)
    p = manual_filter(drive)
    drive_pass = whole_pass(drive)

    def peak() -> float:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20

    before, begun, cpu = peak(), time.perf_counter(), time.process_time()
    samples = sum(len(piece.time) for piece in SmootherRun(drive_pass, p, recover=True))
    took, cpu = time.perf_counter() - begun, time.process_time() - cpu
    print(
        f"{samples:,} samples: {took:.1f} s ({cpu:.1f} s of processor time, {cpu / samples * 1e6:.2f} us a sample)"
    )
    print(
        f"peak of the process: {peak():.2f} GiB, {before:.2f} GiB of it before, with the drive and its timeline"
    )


def lag() -> None:
    """Print the processor time of a live filter at 100 Hz with a lag of 2 s, over half a minute."""
    drive = simulate("urban", duration=60.0, imu_rate=100.0, gps_rate=5.0, seed=1)
    p, start = manual_filter(drive), initial_state(drive)
    filter = LiveFilter(p, start, nominal_interval=drive.nominal_interval, lever_arm=drive.lever_arm, lag=2.0)
    fixes = iter(zip(drive.gps.time, drive.gps.x, drive.gps.y, strict=True))
    fix = next(fixes, None)
    took: dict[str, list[float]] = {"predict": [], "smoothed": []}
    for t, *imu in zip(drive.imu.time, drive.imu.ax, drive.imu.ay, drive.imu.gz, strict=True):
        while fix is not None and fix[0] <= t:
            filter.update(fix[0], fix[1:])
            fix = next(fixes, None)
        begun = time.thread_time()
        filter.predict(t, imu)
        between = time.thread_time()
        _ = filter.smoothed
        took["predict"].append(between - begun)
        took["smoothed"].append(time.thread_time() - between)
    for name, of in took.items():
        late = np.array(of)[len(of) // 2 :] * 1e6
        print(f"{name}: median {np.median(late):.1f} us, 99.9% {np.quantile(late, 0.999):.0f} us")


assert set(ORDER) == set(MEASURES)

if __name__ == "__main__":
    main()
