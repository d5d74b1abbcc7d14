"""Simulate every condition; print target and achieved values, and the duration of the simulations.

    python benchmarks/simulator_table.py [--runs 20] [--out FOLDER] [--imu GRADE] [--gps GRADE]

Without --out, the drives are written to a temporary folder, which is removed at the end.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.simulation import ENVIRONMENTS, PAPER_MANEUVERS, simulate_many
from sigmaswarm.simulation.dynamics import GRAVITY

SHOWN = ("distance_m", "speed_kmh", "time_s", "left_deg", "right_deg", "outage_1_s", "outage_2_s")
COLUMNS = (
    ("ax m/s2", "peak_longitudinal_ms2"),
    ("ay m/s2", "peak_lateral_ms2"),
    ("a / mu g", "of_friction"),
    ("slip %", "peak_slip_percent"),
    ("slip deg", "peak_slip_angle_deg"),
)


def summary(drive: Drive) -> dict[str, float]:
    """Return the figures of a drive, which are kept after the drive is written."""
    achieved = dict(drive.metadata["achieved"])
    achieved["of_friction"] = achieved["peak_acceleration_g"] / drive.metadata["scenario"]["friction"]
    achieved["length_s"] = drive.duration
    return achieved | {f"target {key}": value for key, value in drive.metadata["target"].items()}


def table(figures: dict[tuple[str, str], list[dict[str, float]]]) -> str:
    """Return a Markdown table: medians over the runs of target and achieved values, and largest peaks."""
    head = ["maneuver", "environment", "s", "wanted -> achieved (median)", *(title for title, _ in COLUMNS)]
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for (maneuver, environment), runs in figures.items():
        wanted = []
        for key in SHOWN:
            if f"target {key}" in runs[0]:
                got = [run[key] for run in runs if key in run]
                told = np.median([run[f"target {key}"] for run in runs])
                wanted.append(
                    f"{key} {told:.4g} -> {np.median(got):.4g}" if got else f"{key} {told:.4g} -> never"
                )
        peaks = [f"{max(run[key] for run in runs):.2f}" for _, key in COLUMNS]
        seconds = f"{np.mean([run['length_s'] for run in runs]):.1f}"
        lines.append("| " + " | ".join([maneuver, environment, seconds, "; ".join(wanted), *peaks]) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--imu", default="icm-20602")
    parser.add_argument("--gps", default="ublox-m8")
    options = parser.parse_args()

    with tempfile.TemporaryDirectory() as temporary:
        folder = options.out or Path(temporary)

        def keep(drive: Drive) -> dict[str, float]:
            write_drive(drive, folder / drive.name)
            return summary(drive)

        began = time.perf_counter()
        found = list(simulate_many(runs=options.runs, use=keep, imu=options.imu, gps=options.gps))
        took = time.perf_counter() - began

    names = [(m, e) for m in PAPER_MANEUVERS for e in ENVIRONMENTS]
    figures = {name: found[i * options.runs : (i + 1) * options.runs] for i, name in enumerate(names)}
    print(table(figures))
    print()
    print(f"{len(found)} drives written as folders with truth in {took:.1f} s")
    print(f"mean length {np.mean([run['length_s'] for run in found]):.1f} s")
    print(
        f"largest acceleration over friction x g ({GRAVITY} m/s2): {max(r['of_friction'] for r in found):.4f}"
    )
    print(f"largest tire force over friction x weight: {max(r['peak_friction_use'] for r in found):.6f}")


if __name__ == "__main__":
    main()
