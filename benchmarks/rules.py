"""What the rules for frozen fixes and for gaps in the IMU are worth: the same drives with them and as recorded.

    python benchmarks/rules.py ../shared/drives --seeds 10

planar8 with lateral, standstill and gate, tuned with `truth-pose`. kitti-09-30-0018 is held out, the filter tuned on
the other four KITTI drives; kingston-1 and colorado-1 are tuned on the first 70% of the time, tested on the rest.
Drift: RMS over the windows of the outage seeds 0 to 3. Prints a Markdown table: medians over the seeds, with lowest and
highest in brackets for the first three measures.
"""

import argparse
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from sigmaswarm import SigmaswarmWarning, evaluate, read_drive, split_time, tune
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.replay import run_replays
from sigmaswarm.scoring.targets import outage_replay
from switches import errors, quantiles, spread

KITTI = ("kitti-09-26-0022", "kitti-09-26-0101", "kitti-09-30-0018", "kitti-09-30-0033", "kitti-09-30-0034")
USE = ("lateral", "standstill", "gate")
OUTAGE_SEEDS = range(4)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--objective", default="truth-pose")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    titles = ("tested on", "rules", "position RMSE, m", "heading error, deg", "5 s outage drift, m")
    print("| " + " | ".join((*titles, "position error 50% / 95%, m")) + " |")
    print("|---" * 6 + "|")
    with ThreadPoolExecutor() as pool:
        for name, training, test in cases(options.drives):
            for as_recorded in (True, False):
                rows = []
                for seed in range(options.seeds):
                    tuning = tune(
                        training,
                        objective=options.objective,
                        model="planar8",
                        use=USE,
                        seed=seed,
                        as_recorded=as_recorded,
                        executor=pool,
                    )
                    rows.append(measured(test, tuning.parameters, as_recorded))
                label = "as recorded" if as_recorded else "both"
                print(f"| {name} | {label} | {spread(np.array(rows, float))} |", flush=True)


def cases(folder: Path):
    """Name, training drives, test drive."""
    held_out = "kitti-09-30-0018"
    yield (
        held_out,
        [read_drive(folder / name) for name in KITTI if name != held_out],
        read_drive(folder / held_out),
    )
    for name in ("kingston-1", "colorado-1"):
        train, test = split_time(read_drive(folder / name))
        yield f"{name}, last 30%", [train], test


def measured(test, parameters, as_recorded: bool):
    """RMSE (m), heading error (deg), drift (m), and the quantiles of the position error (m)."""
    ready = PreparedDrive(test, as_recorded=as_recorded)
    scores = evaluate(test, parameters, as_recorded=as_recorded)
    replays = [outage_replay(ready, seed=seed) for seed in OUTAGE_SEEDS]
    squares = run_replays(replays, [parameters]).squared_position.sum()
    drift = np.sqrt(squares / sum(replay.targets.n_positions for replay in replays))
    return [
        scores.mean("tuned", "position_rmse_m"),
        scores.mean("tuned", "heading_rmse_deg"),
        drift,
        *quantiles([errors(ready, parameters)]),
    ]


if __name__ == "__main__":
    main()
