"""Measure the effect of hills: models tuned and tested on simulated flat, rolling and hilly roads, by grade of IMU.

    python benchmarks/hills.py --models planar8 tilted12 --seeds 3

On each terrain, the same ten town drives of 90 s (with the same horizontal path), with the vibration of real cars and
fixes with 1 m of white noise. Each filter is tuned on seven drives and tested on three; each seed has another split.
Prints a Markdown table of medians over the seeds. Drift is the RMS over the windows of seeds 0 to 3 (5 s) and 0 to 5
(30 s).
"""

import argparse
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from sigmaswarm import SigmaswarmWarning, simulate, split_drives, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.simulation import IMU_GRADES, TERRAINS
from switches import TITLES, measured, shown

USE = ("lateral", "standstill")
DRIVES = 10


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", nargs="+", default=["planar8"])
    parser.add_argument("--imus", nargs="+", default=[name for name in IMU_GRADES if name != "ideal"])
    parser.add_argument("--terrains", nargs="+", default=list(TERRAINS))
    parser.add_argument("--objective", default="truth-pose")
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    print("| IMU, terrain | " + " | ".join(TITLES[1:]) + " |\n" + "|---" * len(TITLES) + "|")
    with ThreadPoolExecutor() as pool:
        for imu in options.imus:
            for terrain in options.terrains:
                drives = list(
                    pool.map(
                        lambda i, imu=imu, terrain=terrain: simulate(
                            "urban",
                            seed=i,
                            imu=imu,
                            gps="white-1m",
                            duration=90.0,
                            vibration=1.0,
                            terrain=terrain,
                        ),
                        range(DRIVES),
                    )
                )
                splits = [
                    split_drives(drives, 0.7, rng=np.random.default_rng(s)) for s in range(options.seeds)
                ]
                for model in options.models:
                    rows = [
                        measured(
                            [PreparedDrive(drive) for drive in test],
                            tune(
                                training, objective=options.objective, optimizer="de", model=model, use=USE,
                                seed=seed, executor=pool,
                            ).parameters,
                        )
                        for seed, (training, test) in enumerate(splits)
                    ]  # fmt: skip
                    print(
                        f"| {imu}, {terrain} | {model} | {shown(np.median(np.array(rows), axis=0))} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
