"""Compare the wall times of a batch with one thread and with two threads.

Since other jobs increase the wall time, each measurement waits until both cores are idle (if the operating system
reports it), but at most `PATIENCE` seconds.
"""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm import simulate
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.tuning.space import search_space

PATIENCE = 6.0  # s

pytestmark = [
    pytest.mark.usefixtures("turn"),
    pytest.mark.benchmark(group="cores"),
    pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core only"),
]


@pytest.fixture
def all_cores():
    """Undo `one_core` during a test."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    one = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    yield
    os.sched_setaffinity(0, one)


def idle_share():
    """Return the fraction of idle time of the busiest core in a short interval."""

    def ticks():
        lines = Path("/proc/stat").read_text().splitlines()
        return np.array([line.split()[1:9] for line in lines if line[:3] == "cpu" and line[3] != " "], int)

    before = ticks()
    time.sleep(0.3)
    spent = ticks() - before
    return float((spent[:, 3] / spent.sum(axis=1)).min())


def wait_for_calm():
    """Wait until both cores are idle; return False after `PATIENCE` seconds."""
    end = time.monotonic() + PATIENCE
    while Path("/proc/stat").exists() and time.monotonic() < end:
        if idle_share() > 0.97:
            return True
    return False


@pytest.fixture(scope="session")
def drives(drive):
    """Return the drive of all benchmarks, and four other drives of ten minutes."""
    return [drive, *(simulate("urban", duration=600.0, seed=1, run=run) for run in range(1, 5))]


@pytest.mark.parametrize(
    ("n_sets", "n_drives"), [(64, 1), (512, 1), (30, 5)], ids=["64", "512", "30 on 5 drives"]
)
def test_cores(benchmark, all_cores, drives, n_sets, n_drives):
    space = search_space("planar5", "log10", drives[0].nominal_interval)
    points = np.random.default_rng(0).uniform(space.low, space.high, (n_sets, len(space.names)))
    sets, replayer = space.decode(points), BatchScorer.prepare(drives[:n_drives])
    times = []
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(2) as two:

        def both():
            for pool in (one, two):
                start = time.perf_counter()
                replayer.scores(sets, pool)
                times.append(time.perf_counter() - start)

        both()  # starts the threads
        calm = wait_for_calm()
        times.clear()
        benchmark.pedantic(both, rounds=15)  # in the first rounds, a core may be in a sleep state
    ones, twos = times[::2], times[1::2]
    benchmark.extra_info.update(
        calm=calm, one=float(np.median(ones)), two=float(np.median(twos)),
        ratio=float(np.median(np.array(ones) / np.array(twos))),
    )  # fmt: skip
