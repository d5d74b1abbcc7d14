"""Compare the default filter, causal and smoothed, with GTSAM's iSAM2 and batch smoother.

    python benchmarks/peers.py ../shared/drives --out peers.jsonl
    python benchmarks/peers.py ../shared/drives --out peers.jsonl --table

Each KITTI drive is held out once; for colorado-1, the first 70% of the time is for tuning, the rest for testing. Our
filter is tuned by default, with truth (T) and without (B). GTSAM's noise parameters are searched with truth by
`de-qpso`, from typical values; GTSAM also runs with the typical values. The cost is position RMSE + 0.1 m/deg x heading
error + 0.1 x drift over 5 s. The search uses one minute of each of the two shortest training drives (or two minutes of
a single drive), since GTSAM's steps take longer as the graph grows. All filters start at the same time; drifts are RMS
over all placements of the outages. Each result is a line of the file and is not repeated. Prints Markdown: medians over
the seeds, the mean over KITTI's drives, and the number of columns in which our filter is better than both of GTSAM's.
The time is processor time per IMU sample of the causal filter. GTSAM is in the dependency group `bench-gtsam`.
"""

import argparse
import time
import warnings
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from real_drives import KITTI, cases
from sigmaswarm import (
    Drive,
    FilterParameters,
    SigmaswarmWarning,
    clip,
    initial_state,
    run_filter,
    smooth,
    tune,
)
from sigmaswarm.drives.outages import hidden_fixes
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.smoothing import SmootherRun
from sigmaswarm.scoring.drifts import OutageDrifts
from sigmaswarm.scoring.methods import SMOOTHED
from sigmaswarm.scoring.score import truth_at
from sigmaswarm.scoring.targets import outage_windows, placements
from sigmaswarm.tuning.optimizers import create_optimizer
from slip_and_start import errors, lines, note, rms_deg
from switches import quantities

SEARCHED = 60.0
"""Length (s) of each part on which GTSAM's noise parameters are searched."""
PIECES = 2
"""Number of these parts."""
LENGTHS = (5.0, 30.0)
RIVALS = ("GTSAM", "GTSAM, typical noises")
COLUMNS = ("RMSE, m", "50%, m", "95%, m", "heading, deg", "5 s, m", "30 s, m")
SCALED = ("accel", "gyro", "accel_walk", "gyro_walk", "slide")
"""Searched noise parameters, within a factor of ten; that of the fixes within a factor of two, ``behind`` up to 2 m."""
TYPICAL = np.array([0.0] * (len(SCALED) + 1) + [0.5])
"""Search point of the default `rival_gtsam.Noise`, with the point without slip 0.5 m behind the IMU."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds of our tuning runs")
    parser.add_argument(
        "--evaluations", type=int, default=100, help="number of evaluations of GTSAM's noise parameters"
    )
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    if not options.table:
        six = [case for case in cases(options.drives) if all(d.imu.az is not None for d in case[1])]
        with ThreadPoolExecutor() as pool:
            for seed, (name, training, test), known in product(range(options.seeds), six, "TB"):
                if (name, known, seed) not in lines(options.out):
                    note(options.out, (name, known, seed), ours(training, test, known, seed, pool))
        for name, training, test in six:
            if (name, RIVALS[0], 0) not in lines(options.out):
                note(options.out, (name, RIVALS[0], 0), theirs(test, searched(training, options.evaluations)))
            if (name, RIVALS[1], 0) not in lines(options.out):
                note(options.out, (name, RIVALS[1], 0), theirs(test, noise_at(TYPICAL)))
    table(lines(options.out))


def ours(
    training: Sequence[Drive], test: Sequence[Drive], known: str, seed: int, pool: Executor
) -> dict[str, list[float]]:
    """Return the columns of the causal and of the smoothed filter, and the time per sample, us."""
    drives = training if known == "T" else [replace(drive, truth=None) for drive in training]
    tuned = tune(drives, seed=seed, executor=pool).parameters
    ready = [PreparedDrive(drive) for drive in test]
    begun = time.process_time()
    causal = [run_filter(one, tuned) for one in ready]
    spent = (time.process_time() - begun) / sum(len(one.time) for one in causal)
    drifts = [our_drifts(ready, tuned, length) for length in LENGTHS]
    found = {"causal": causal, SMOOTHED: [smooth(one, tuned) for one in ready]}
    rows = {
        kind: figures(test, estimates, [drift[kind] for drift in drifts]) for kind, estimates in found.items()
    }
    return {**rows, "us": [spent * 1e6]}


def our_drifts(ready: Sequence[PreparedDrive], tuned: FilterParameters, length: float) -> dict[str, float]:
    """Return the RMS drifts over the drives and all placements, m."""
    each = []
    for one in ready:
        outages = OutageDrifts(one, length=length, seed=0)
        outages.run({"tuned": tuned}, {SMOOTHED: partial(SmootherRun, parameters=tuned, recover=True)})
        each.append((outages.drift("tuned"), outages.drift(SMOOTHED)))
    return dict(zip(("causal", SMOOTHED), np.sqrt(np.mean(np.square(each), axis=0)).tolist(), strict=True))


def theirs(test: Sequence[Drive], noise: Any) -> dict[str, Any]:
    """Return the columns of iSAM2 and of the batch smoother, the time per sample (us), and the noise parameters."""
    import rival_gtsam as rival

    runs = [rival.run_batch(drive, initial_state(drive), noise) for drive in test]
    found = {"causal": [one.causal for one in runs], SMOOTHED: [one.run for one in runs]}
    drifts = {kind: [] for kind in found}
    for length in LENGTHS:
        squares: dict[str, list[float]] = {kind: [] for kind in found}
        for drive in test:
            start = initial_state(drive)
            off: dict[str, list[np.ndarray]] = {kind: [] for kind in found}
            for seed in placements(drive, start, length=length, seed=0):
                windows = outage_windows(drive, start, length=length, seed=seed)
                run = rival.run_batch(drive, start, noise, hidden_fixes(drive.gps.time, windows))
                off["causal"].append(off_at(drive, run.causal, windows[:, 1]))
                off[SMOOTHED].append(off_at(drive, run.run, windows[:, 1]))
            for kind, values in off.items():
                squares[kind].append(float(np.mean(np.concatenate(values) ** 2)))
        for kind, values in squares.items():
            drifts[kind].append(float(np.sqrt(np.mean(values))))
    begun = time.process_time()
    samples = sum(len(rival.run(drive, initial_state(drive), noise).time) for drive in test)
    spent = (time.process_time() - begun) / samples
    rows = {kind: figures(test, each, drifts[kind]) for kind, each in found.items()}
    return {**rows, "us": [spent * 1e6], "noise": str(noise)}


def figures(test: Sequence[Drive], runs: Sequence[Any], drifts: Sequence[float]) -> list[float]:
    """Return the scores in the order of `COLUMNS`."""
    off, turned = zip(*map(errors_of, test, runs), strict=True)
    return [*quantities(np.concatenate(off)), rms_deg(turned), *drifts]


def errors_of(drive: Drive, run: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return position errors (m) and scored heading errors (rad) of an estimate or of a run of GTSAM."""
    return errors(drive, run if hasattr(run, "mean") else Tabled(run))


class Tabled:
    """A run of GTSAM in the form of an estimate."""

    def __init__(self, run: Any) -> None:
        nothing = np.zeros_like(run.x)
        self.time, self.mean = run.time, np.column_stack([run.x, run.y, nothing, nothing, run.theta])


def off_at(drive: Drive, run: Any, times: np.ndarray) -> np.ndarray:
    """Return the distances from the truth, m."""
    x, y = truth_at(drive.truth, times)
    return np.hypot(np.interp(times, run.time, run.x) - x, np.interp(times, run.time, run.y) - y)


_FOUND: dict[tuple[str, ...], Any] = {}
"""Noise parameters by the drives of the search, which several cases share."""


def searched(training: Sequence[Drive], evaluations: int) -> Any:
    """Search GTSAM's noise parameters with the lowest mean cost on `PIECES` minutes of the training drives."""
    shortest = sorted(training, key=lambda drive: drive.duration)[:PIECES]
    key = tuple(drive.name for drive in shortest)
    if key not in _FOUND:
        each = PIECES // len(shortest)
        pieces = [piece for drive in shortest for piece in minutes_of(drive)[:each]]
        low, high = np.array([-1.0] * len(SCALED) + [-0.3, 0.0]), np.array([1.0] * len(SCALED) + [0.3, 2.0])
        optimizer = create_optimizer(
            "de-qpso", low, high, population=10, budget=evaluations, rng=np.random.default_rng(0)
        )
        optimizer.begin_near(TYPICAL)
        while len(points := optimizer.ask()):
            costs = [np.mean([cost(piece, noise_at(point)) for piece in pieces]) for point in points]
            optimizer.tell(np.array(costs))
        _FOUND[key] = noise_at(optimizer.global_best)
    return _FOUND[key]


def minutes_of(drive: Drive) -> list[Drive]:
    """Return parts of `SEARCHED` s, each of which begins where a filter can start."""
    begin, end = initial_state(drive).time, float(drive.imu.time[-1])
    first = clip(drive, float(drive.imu.time[0]), min(begin + SEARCHED, end))
    begins = np.arange(begin + SEARCHED, end - SEARCHED, SEARCHED)
    return [first, *(clip(drive, float(t), float(t) + SEARCHED) for t in begins)]


def noise_at(point: np.ndarray) -> Any:
    import rival_gtsam as rival

    typical = rival.Noise()
    factors = dict(zip((*SCALED, "fix"), 10.0 ** point[:-1], strict=True))
    scaled = {name: float(factor * getattr(typical, name)) for name, factor in factors.items()}
    return replace(typical, behind=float(point[-1]), **scaled)


def cost(drive: Drive, noise: Any) -> float:
    """Return position RMSE outside of outages + 0.1 m/deg x heading error + 0.1 x drift of one run with outages."""
    import rival_gtsam as rival

    assert drive.truth is not None
    start = initial_state(drive)
    windows = outage_windows(drive, start, length=LENGTHS[0], seed=0)
    try:
        run = rival.run(drive, start, noise, hidden_fixes(drive.gps.time, windows))
    except RuntimeError:  # GTSAM can't solve the system
        return np.inf
    off, turned = errors_of(drive, run)
    times = drive.truth.time[(drive.truth.time >= run.time[0]) & (drive.truth.time <= run.time[-1])]
    with_fixes = ~np.any((times[:, None] >= windows[:, 0]) & (times[:, None] <= windows[:, 1] + 2.0), axis=1)
    drift = float(np.sqrt(np.mean(off_at(drive, run, windows[:, 1]) ** 2)))
    return float(np.sqrt(np.mean(off[with_fixes] ** 2))) + 0.1 * rms_deg([turned]) + 0.1 * drift


def table(done: dict[tuple[Any, ...], Any]) -> None:
    """Print medians over the seeds, and the number of columns in which our filter is better than both of GTSAM's."""
    print("| tested on | estimate | filter | " + " | ".join(COLUMNS) + " | us a sample |")
    print("|---" * (len(COLUMNS) + 4) + "|")
    whole: dict[tuple[str, str, str], np.ndarray] = {}
    names = dict.fromkeys("KITTI" if name in KITTI else name for name, *_ in done)
    for name, kind, who in product(names, ("causal", SMOOTHED), ("T", "B", *RIVALS)):
        each: dict[str, list[list[float]]] = {}
        for (case, by, _), rows in done.items():
            if by == who and ("KITTI" if case in KITTI else case) == name:
                each.setdefault(case, []).append([*rows[kind], *rows["us"]])
        if each:
            whole[name, kind, who] = np.mean([np.median(rows, axis=0) for rows in each.values()], axis=0)
            cells = " | ".join(f"{v:.3g}" for v in whole[name, kind, who])
            print(f"| {name} | {kind} | {who} | {cells} |")
    for who in "TB":
        own = {(name, kind): row[:-1] for (name, kind, by), row in whole.items() if by == who}
        pairs = [
            (ours, np.min([whole[*key, rival][:-1] for rival in RIVALS if (*key, rival) in whole], axis=0))
            for key, ours in own.items()
            if (*key, RIVALS[0]) in whole
        ]
        lower = sum(int(np.sum(ours < best)) for ours, best in pairs)
        print(
            f"\n{who}: lower than the best of {' and '.join(RIVALS)} in {lower} of {len(COLUMNS) * len(pairs)} columns"
        )


if __name__ == "__main__":
    main()
