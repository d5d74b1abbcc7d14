"""Compile each kernel and each test file once, before the tests race each other to them: ``python tests/warm.py``."""

import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

from filter_cases import equipped, parameters
from sigmaswarm import simulate
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.smoothing import smooth

FILTERS = (
    ("tilted12", "ukf"),
    ("tilted12", "ekf"),
    ("planar8", "ukf"),
    ("planar5", "ukf"),
)  # the longest first


def run(p: FilterParameters) -> None:
    run_filter(equipped(), p)


def live(p: FilterParameters) -> None:
    LiveFilter(p, initial_state(equipped()), nominal_interval=0.01)


def lagged(p: FilterParameters) -> None:
    LiveFilter(p, initial_state(equipped()), nominal_interval=0.01, lag=1.0)


def hindsight(p: FilterParameters) -> None:
    smooth(equipped(), p)


def many(p: FilterParameters) -> None:
    LiveFilterBank(p, initial_state(equipped()), nominal_interval=0.01)


def drive() -> None:
    simulate("turns")


def collect() -> None:
    """Write the bytecode of all test files, whose asserts pytest rewrites."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-qq"]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=False)


def main() -> None:
    ways: list[Callable[[FilterParameters], None]] = [live, run, lagged, hindsight, many]
    with ProcessPoolExecutor() as pool:
        jobs = [pool.submit(collect), pool.submit(drive)]
        jobs += [pool.submit(way, parameters(model, kind=kind)) for model, kind in FILTERS for way in ways]
        for job in jobs:
            job.result()


if __name__ == "__main__":
    main()
