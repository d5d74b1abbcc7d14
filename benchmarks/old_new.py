"""Compare the times of two environments, in alternating processes: batch, tune, evaluate, run, live.

    python benchmarks/old_new.py OLD/.venv NEW/.venv
    python benchmarks/old_new.py OLD/.venv NEW/.venv --rounds 7 --only batch-planar5 tune-default --workers 1

Each round starts one process of each environment, in alternating order. A process runs each job once to compile, then
`REPEATS` times (tuning jobs once), and records the shortest time. The table shows times in s (minimum and median over
the rounds) and two ratios new / old: that of the minima, and the median of the ratios of the rounds. The code in OLD
simulates two drives of ten minutes.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

JOBS = (
    "batch-planar5",
    "batch-planar8",
    "batch-tilted12",
    "tune-planar5",
    "tune-default",
    "evaluate",
    "run",
    "live",
)
REPEATS = 3

SIMULATE = """
import sys
import sigmaswarm as ss
for run in range(2):
    drive = ss.simulate("urban", run=run, duration=600.0, gps="white-1m", vibration=True)
    ss.write_drive(drive, f"{sys.argv[1]}/{run}")
"""

JOB = """
import json, sys, time, warnings
from dataclasses import replace
import numpy as np
import sigmaswarm as ss
warnings.simplefilter("ignore")
folder, repeats, workers, *jobs = sys.argv[1:]
workers = int(workers) or None
drives = [ss.read_drive(f"{folder}/{run}") for run in range(2)]
run_filter = getattr(ss, "run_filter", None) or ss.run
baseline = getattr(ss, "datasheet", None) or ss.baseline
more = {"workers": workers} if workers else {}

def filter_of(model):
    states = {"planar5": 5, "planar8": 8, "tilted12": 12}[model]
    noise = (1e-5, 1e-5, 1e-4, 1e-4, 1e-7, 1e-10, 1e-10, 1e-12, 1e-8, 1e-8, 1e-12, 1e-12)[:states]
    kind = "ekf" if model == "tilted12" else "ukf"
    return ss.FilterParameters(1.0, 0.0, 0.0, noise, (1.0, 1.0), model, kind=kind,
                               nominal_interval=drives[0].nominal_interval)

def batch(model):
    rng = np.random.default_rng(0)
    base = filter_of(model)
    sets = [replace(base, process_noise=tuple(q * 10 ** rng.uniform(-1, 1) for q in base.process_noise))
            for _ in range(64)]
    return lambda: ss.run_batch(drives, sets)

def live():
    drive = drives[0]
    start = ss.initial_state(drive)
    imu = np.column_stack([drive.imu.ax, drive.imu.ay, drive.imu.gz]).tolist()
    times = drive.imu.time.tolist()
    fixes = np.column_stack([drive.gps.time, drive.gps.x, drive.gps.y]).tolist()
    def run():
        filt = ss.LiveFilter(filter_of("planar8"), start, nominal_interval=drive.nominal_interval)
        k = 0
        for t, sample in zip(times, imu):
            while k < len(fixes) and fixes[k][0] <= t:
                filt.update(fixes[k][0], fixes[k][1:])
                k += 1
            filt.predict(t, sample)
    return run

work = {
    "batch-planar5": lambda: batch("planar5"),
    "batch-planar8": lambda: batch("planar8"),
    "batch-tilted12": lambda: batch("tilted12"),
    "tune-planar5": lambda: lambda: ss.tune(drives, model="planar5", particles=30, generations=50, **more),
    "tune-default": lambda: lambda: ss.tune(drives, particles=30, generations=50, **more),
    "evaluate": lambda: lambda: ss.evaluate(drives, filter_of("planar8")),
    "run": lambda: lambda: [run_filter(drive, filter_of("planar8")) for drive in drives],
    "live": live,
}
found = {}
for job in jobs:
    do = work[job]()
    do()
    times = []
    for _ in range(1 if job.startswith("tune") else int(repeats)):
        begun = time.perf_counter()
        do()
        times.append(time.perf_counter() - begun)
    found[job] = min(times)
print(json.dumps(found))
"""


def run(environment: Path, code: str, *words: str) -> str:
    """Run code with the Python of an environment; return its output."""
    done = subprocess.run(
        [str(environment / "bin/python"), "-c", code, *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{environment}: {done.stderr[-2000:]}")
    return done.stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="*", choices=JOBS, default=JOBS)
    parser.add_argument("--workers", type=int, default=0, help="threads of tune; all cores by default")
    parser.add_argument(
        "--drives", type=Path, help="folder of the two drives, which are simulated if missing"
    )
    asked = parser.parse_args()
    sides = [asked.old.resolve(), asked.new.resolve()]
    seconds: dict[str, list[list[float]]] = {job: [[], []] for job in asked.only}
    with tempfile.TemporaryDirectory() as temporary:
        folder = (asked.drives or Path(temporary) / "drives").resolve()
        if not folder.exists():
            run(sides[0], SIMULATE, str(folder))
        for number in range(asked.rounds):
            for side in (0, 1) if number % 2 == 0 else (1, 0):
                words = (str(folder), str(REPEATS), str(asked.workers), *asked.only)
                for job, time in json.loads(run(sides[side], JOB, *words)).items():
                    seconds[job][side].append(time)
            print(f"round {number + 1} of {asked.rounds}", file=sys.stderr, flush=True)
    head = ("old, s: min", "median", "new, s: min", "median", "new / old: min", "median")
    print(f"{'job':16}", *(f"{name:>14}" for name in head))
    for job, (old, new) in seconds.items():
        ratios = [b / a for a, b in zip(old, new, strict=True)]
        values = (min(old), statistics.median(old), min(new), statistics.median(new))
        values += (min(new) / min(old), statistics.median(ratios))
        print(f"{job:16}", *(f"{value:14.3f}" for value in values))


if __name__ == "__main__":
    main()
