"""Measure the effect of outliers on filters and objectives, and the cost of robust filters without outliers.

    python benchmarks/outliers.py ../shared/drives --seeds 10

colorado-1: planar8 with lateral and standstill is tuned on the first 70% of the time and tested on the rest, without
outliers and with errors of 20 m in 6% of the fixes, in bursts of 0.2 to 1 s (seeded). Scale of Student's t: the mean
NIS at which each objective has its minimum as a function of a common factor on all noise variances of a filter, on
simulated drives with white fix errors. Prints Markdown: medians over the seeds, with lowest and highest value in
brackets.
"""

import argparse
import warnings
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import minimize_scalar

from objectives import spread
from sigmaswarm import (
    Drive,
    FilterParameters,
    SigmaswarmWarning,
    read_drive,
    run_innovations,
    simulate,
    split_time,
    tune,
)
from sigmaswarm.filters import constants
from sigmaswarm.scoring.batch import BatchScorer, PassOptions
from sigmaswarm.scoring.score import negative_log_t, score_raw_gps
from sigmaswarm.simulation import with_outliers

BASE = ("lateral", "standstill")
OPTIONS: dict[str, tuple[str, ...]] = {"none": (), "gate": ("gate",), "robust": ("robust",)}
OBJECTIVES = ("truth-pose", "innovation-nll", "innovation-t")
SCALES = {
    "innovation-nll (Gaussian)": None,
    "innovation-t, v = 4, c = 2.907": (constants.INNOVATION_DOF, constants.INNOVATION_SCALE),
    "v = c = 4": (4.0, 4.0),
    "forecast-t, v = 8, c = 6.610": (constants.FORECAST_DOF, constants.FORECAST_SCALE),
    "v = c = 8": (8.0, 8.0),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--kind", default="ukf")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    drive = read_drive(options.drives / "colorado-1")
    with ThreadPoolExecutor() as pool:
        for title, one in (
            ("as it is", drive),
            ("6% outliers", with_outliers(drive, np.random.default_rng(0))),
        ):
            table(title, *split_time(one), options, pool)
        scales(pool)


def table(title: str, training: Drive, test: Drive, options: argparse.Namespace, pool: Executor) -> None:
    """Print a table with a row for each objective and option."""
    replayer = BatchScorer.prepare([test], PassOptions(outages=True))
    raw = score_raw_gps(test, replayer.initial[0]).position_rmse
    print(f"\ncolorado-1, last 30%, {title} (raw {raw:.2f} m)\n")
    print(
        "| tuned by | other options than lateral and standstill | position RMSE, m | heading, deg | 5 s drift, m |"
    )
    print("|---|---|---|---|---|")
    for objective in OBJECTIVES:
        for name, use in OPTIONS.items():
            tuned = [
                tune(training, objective=objective, model="planar8", kind=options.kind, use=BASE + use, seed=seed,
                     executor=pool).parameters
                for seed in range(options.seeds)
            ]  # fmt: skip
            scores = replayer.scores(tuned, pool)
            cells = [spread(scores.position_rmse[:, 0], "{:.2f}")]
            cells += [spread(np.degrees(scores.heading_rmse[:, 0]), "{:.2f}")]
            cells += [spread(scores.outage_drift[:, 0], "{:.2f}")]
            print(f"| `{objective}` | {name} | " + " | ".join(cells) + " |", flush=True)


def scales(pool: Executor) -> None:
    """Print the mean NIS at which each objective has its minimum."""
    drives = [
        simulate("urban", run=k, duration=90, imu="icm-20602", gps="white-1m", seed=3) for k in range(10)
    ]
    tuned = tune(drives, objective="innovation-nll", model="planar8", use=BASE, executor=pool).parameters
    print("\n| objective | mean NIS where it is least |\n|---|---|")
    for name, scale in SCALES.items():
        print(f"| {name} | {least(drives, tuned, scale):.2f} |", flush=True)


def least(drives: list[Drive], p: FilterParameters, scale: tuple[float, float] | None) -> float:
    """Return the mean NIS at the common factor of all noise variances that minimizes an objective."""
    found = minimize_scalar(
        lambda log: cost(drives, scaled(p, np.exp(log)), scale)[0], bounds=(-1.5, 1.5), method="bounded"
    )
    return cost(drives, scaled(p, np.exp(found.x)), scale)[1]


def scaled(p: FilterParameters, factor: float) -> FilterParameters:
    """Multiply all noise variances by a factor."""
    assert p.lateral_noise is not None
    assert p.standstill_noise is not None
    return replace(
        p,
        process_noise=tuple(factor * q for q in p.process_noise),
        measurement_noise=tuple(factor * r for r in p.measurement_noise),
        lateral_noise=factor * p.lateral_noise,
        standstill_noise=factor * p.standstill_noise,
    )


def cost(drives: list[Drive], p: FilterParameters, scale: tuple[float, float] | None) -> tuple[float, float]:
    """Return the cost and the mean NIS. ``scale``: v and c of Student's t, or None for the Gaussian likelihood."""
    costs, nis = [], []
    for drive in drives:
        found = run_innovations(drive, p)
        nu, s = found.innovation, found.covariance
        gaussian = 0.5 * (found.nis + np.log(np.linalg.det(s)))
        costs.append((gaussian if scale is None else negative_log_t(nu, s, *scale)).mean())
        nis.append(found.nis.mean())
    return float(np.mean(costs)), float(np.mean(nis))


if __name__ == "__main__":
    main()
