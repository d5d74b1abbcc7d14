"""Evaluate truth that is computed from the fixes of a reference receiver: errors, coverage, and tuning with this truth.

A simulated car has a cheap receiver and an RTK receiver (f9p-rtk, with outages, and periods of float solutions with
correlated errors). `sigmaswarm.reference` computes truth from the RTK fixes, which is compared with the simulator's
truth.

    python benchmarks/reference.py --seeds 5
"""

import argparse
import warnings
from dataclasses import replace

import numpy as np

import sigmaswarm
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.scoring.score import share_known
from sigmaswarm.simulation.gps import GPS_GRADES
from sigmaswarm.simulation.sensors import gauss_markov

ARM = (0.9, -0.4, 1.2)
"""Lever arm of the RTK antenna, m."""
FLOAT, FLOAT_TIME = 0.4, 40.0
"""Standard deviation (m per axis) and correlation time (s) of the errors of float solutions."""
LASTING_TIME = 60.0
"""Correlation time (s) of the errors of fixed solutions with --lasting (multipath)."""


def rtk(
    maneuver: str, seed: int, run: int, imu: str, duration: float, *, lasting: float, honest: bool
) -> Gps:
    """Simulate RTK fixes at 5 Hz, with outages of 5 to 60 s, and periods of float solutions that state their accuracy.

    ``lasting``: standard deviation (m per axis) of correlated errors of fixed solutions, in addition to 0.01 m of white
    noise; it is stated if ``honest``.
    """
    grade = replace(GPS_GRADES["f9p-rtk"], lever_arm=ARM)
    gps = sigmaswarm.simulate(maneuver, seed=seed, run=run, imu=imu, gps=grade, duration=duration).gps
    rng = np.random.default_rng([19, seed, run])
    t, n = gps.time, len(gps)
    x, y, std = gps.x.copy(), gps.y.copy(), np.array(gps.std_x)
    if lasting:
        x, y = np.array([x, y]) + lasting * gauss_markov(rng, n, 2, 0.2 / LASTING_TIME).T
        std = np.hypot(std, lasting) if honest else std
    wrong = FLOAT * gauss_markov(rng, n, 2, 0.2 / FLOAT_TIME).T
    keep, at = np.ones(n, dtype=bool), 40.0
    while at < t[-1]:
        length = float(rng.uniform(5.0, 60.0))
        inside = (t >= at) & (t < at + length)
        if rng.random() < 0.5:
            keep &= ~inside
        else:
            x[inside], y[inside], std[inside] = (x + wrong[0])[inside], (y + wrong[1])[inside], FLOAT
        at += length + float(rng.exponential(60.0)) + 20.0
    return replace(gps, x=x, y=y, std_x=std, std_y=std).select(keep)


def coverage(made: Drive, true: Drive) -> dict[str, float]:
    """Compare a drive's truth with the simulator's: RMSE, and fraction of times within 2 stated sigma."""
    got, t = made.truth, made.truth.time
    at = np.searchsorted(true.truth.time, t)
    ex, ey = got.x - true.truth.x[at], got.y - true.truth.y[at]
    et = np.abs(wrap_angle(got.theta - true.truth.theta[at]))
    return {
        "known": share_known(got, float(made.imu.time[0]), float(made.imu.time[-1])),
        "rmse_m": float(np.sqrt(np.mean(ex**2 + ey**2))),
        "largest_m": float(np.hypot(ex, ey).max()),
        "heading_deg": float(np.degrees(np.sqrt(np.mean(et**2)))),
        "x_2sigma": float(np.mean(np.abs(ex) <= 2 * got.std_x)),
        "y_2sigma": float(np.mean(np.abs(ey) <= 2 * got.std_y)),
        "theta_2sigma": float(np.mean(et <= 2 * got.std_theta)),
        "stretched": made.metadata["reference"]["stretched"],
    }


def main() -> None:
    """Print a row for each cheap receiver and seed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--duration", type=float, default=600.0)
    parser.add_argument("--imu", default="icm-20602")
    parser.add_argument(
        "--lasting", type=float, default=0.0, help="standard deviation of correlated RTK errors, m"
    )
    parser.add_argument("--honest", action="store_true", help="the receiver states the errors of --lasting")
    parser.add_argument("--gps", nargs="*", default=["ublox-m8", "white-1m"])
    parser.add_argument("--generations", type=int, default=50)
    parser.add_argument("--model", default="planar8", help="model of the filter for the cheap receiver")
    parser.add_argument("--train", type=int, default=3, help="number of training drives")
    asked = parser.parse_args()
    warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)
    ratios: dict[tuple[str, str], list[float]] = {}
    for seed in range(asked.seeds):
        same = {"seed": seed, "imu": asked.imu, "duration": asked.duration}
        made: list[Drive] = []
        for run in range(asked.train):
            true = sigmaswarm.simulate("urban", run=run, gps="white-1m", **same)
            good = rtk(
                "urban", seed, run, asked.imu, asked.duration, lasting=asked.lasting, honest=asked.honest
            )
            made.append(sigmaswarm.reference(replace(true, truth=None), good, lever_arm=ARM))
            figures = ", ".join(f"{k} {v:.3g}" for k, v in coverage(made[-1], true).items())
            print(f"seed {seed}, run {run}: {figures}", flush=True)
        for gps in asked.gps:
            train = [sigmaswarm.simulate("urban", run=run, gps=gps, **same) for run in range(asked.train)]
            last = range(asked.train, asked.train + 2)
            test = [sigmaswarm.simulate("urban", run=run, gps=gps, **same) for run in last]
            known = [
                true.truth.select(np.isin(true.truth.time, one.truth.time))
                for true, one in zip(train, made, strict=True)
            ]
            truths = {
                "truth": [one.truth for one in train],
                "truth where the reference is known": known,
                "reference": [one.truth for one in made],
            }
            rmse: dict[str, float] = {}
            for on, columns in truths.items():
                drives = [replace(drive, truth=truth) for drive, truth in zip(train, columns, strict=True)]
                found = sigmaswarm.tune(
                    drives,
                    seed=seed,
                    generations=asked.generations,
                    model=asked.model,
                    use=("lateral", "standstill"),
                )
                scores = BatchScorer.prepare(test).scores([found.parameters])
                rmse[on] = float(scores.position_rmse.mean())
                ratios.setdefault((gps, on), []).append(rmse[on] / rmse["truth"])
            said = "; ".join(
                f"{on} {v:.3f} m ({100 * (v / rmse['truth'] - 1):+.1f}%)" for on, v in rmse.items()
            )
            print(f"  {gps}, held-out RMSE tuned on: {said}", flush=True)
    for (gps, on), found in ratios.items():
        if on != "truth":
            print(
                f"{gps}, {on}: mean {100 * (np.mean(found) - 1):+.2f}%, worst {100 * (max(found) - 1):+.1f}%"
            )


if __name__ == "__main__":
    main()
