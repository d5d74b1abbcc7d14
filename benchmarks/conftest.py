"""What all benchmarks share: one core, one drive, and turns that put the rivals side by side."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm import baseline, simulate
from sigmaswarm.tuning.space import search_space

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # for the rivals
os.environ["LOG_CFG"] = str(HERE / "pyswarms-logging.yml")  # PySwarms looks there when it is imported

TURNS = 7


@pytest.fixture(scope="session", autouse=True)
def one_core():
    """Stay on one core, where the system lets a process choose."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    yield
    os.sched_setaffinity(0, before)


@pytest.fixture(scope="session", params=range(TURNS), ids=lambda turn: f"turn{turn}")
def turn(request):
    """Every benchmark once, then every one again: a busy moment of the machine then hits all rivals alike."""
    return request.param


@pytest.fixture(scope="session")
def drive():
    """Ten minutes through a town, IMU at 100 Hz, GPS at 5 Hz."""
    return simulate("urban", duration=600.0, imu_rate=100.0, gps_rate=5.0, seed=1)


@pytest.fixture(scope="session")
def parameter_sets(drive):
    """32 sets: what a careful engineer writes, and 31 random ones of the paper's box."""
    space = search_space("planar5", "log10", drive.nominal_interval)
    points = np.random.default_rng(0).uniform(space.low, space.high, (31, len(space.names)))
    return [baseline(drive), *space.decode(points)]


@pytest.fixture
def measure(benchmark):
    """Time a function: ``work`` parameter sets times samples (or calls); ``times`` scales it to the whole job."""

    def run(function, *, work, rounds, times=1):
        benchmark.pedantic(function, rounds=rounds, warmup_rounds=1)
        if benchmark.stats:  # none with --benchmark-disable
            ns = round(benchmark.stats.stats.median / work * 1e9, 3)
            benchmark.extra_info.update(work=work, times=times, ns=ns)

    return run
