"""Compile each kernel and each test file once, before the tests run in parallel: ``python tests/warm.py``."""

import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from filter_cases import equipped, parameters
from sigmaswarm import simulate
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.fixes_alone import fitted_noise
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.smoothing import smooth

COLLECT = [sys.executable, "-m", "pytest", "--collect-only", "-qq"]
"""Collects the tests, so that pytest writes the bytecode of all test files, whose asserts it rewrites."""


def run(p: FilterParameters) -> None:
    run_filter(equipped(), p)


def live(p: FilterParameters) -> None:
    LiveFilter(p, initial_state(equipped()), nominal_interval=0.01)


def lagged(p: FilterParameters) -> None:
    LiveFilter(p, initial_state(equipped()), nominal_interval=0.01, lag=1.0)


def smoothed(p: FilterParameters) -> None:
    smooth(equipped(), p)


def drive(maneuver: str) -> None:
    simulate(maneuver)


def many(p: FilterParameters) -> None:
    LiveFilterBank(p, initial_state(equipped()), nominal_interval=0.01)


def alone(p: FilterParameters) -> None:
    fitted_noise(PreparedDrive(equipped()))


LASTING: dict[str, Any] = {"kind": "ekf", "fix_error": 1.3, "fix_error_time": 2.0}
FILTERS = [
    (parameters("tilted12", kind="ukf"), (run,)),
    (parameters("tilted12"), (lagged, run, smoothed, live)),
    (parameters("tilted12", **LASTING), (run,)),
    (parameters("planar8", **LASTING), (run, smoothed, live)),
    (parameters("planar8"), (run, lagged, smoothed, live, many)),
    (parameters("planar5"), (run, smoothed, many)),
    (parameters("planar5", **LASTING), (run, alone)),
    (parameters("robot-localization"), (run,)),
]
"""Filters and passes of the quick tests, the longest first."""


def main() -> None:
    with ProcessPoolExecutor() as pool:
        first = pool.submit(lagged, parameters("planar5"))  # functions of all live filters
        jobs = [pool.submit(drive, "turns"), pool.submit(subprocess.call, COLLECT, stdout=subprocess.DEVNULL)]
        first.result()
        jobs += [pool.submit(way, p) for p, ways in FILTERS for way in ways]
        for job in jobs:
            job.result()


if __name__ == "__main__":
    main()
