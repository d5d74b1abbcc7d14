"""Fixtures of all benchmarks: one core, one drive, and rounds in which all benchmarks run one after the other."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm import baseline, simulate
from sigmaswarm.tuning.space import search_space

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # to import the modules `rival_*`
os.environ["LOG_CFG"] = str(HERE / "pyswarms-logging.yml")  # PySwarms reads this variable when it is imported

TURNS = 7


@pytest.fixture(scope="session", autouse=True)
def one_core():
    """Run on one core, if the operating system has processor affinity."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    yield
    os.sched_setaffinity(0, before)


@pytest.fixture(scope="session", params=range(TURNS), ids=lambda turn: f"turn{turn}")
def turn(request):
    """Run every benchmark once, then all again, so that a busy period of the machine affects all programs equally."""
    return request.param


@pytest.fixture(scope="session")
def drive():
    """Simulate ten minutes in a town, with an IMU at 100 Hz and GPS at 5 Hz."""
    return simulate("urban", duration=600.0, imu_rate=100.0, gps_rate=5.0, seed=1)


@pytest.fixture(scope="session")
def parameter_sets(drive):
    """Return 32 parameter sets: a careful manual choice, and 31 random sets within the paper's bounds."""
    space = search_space("planar5", "log10", drive.nominal_interval)
    points = np.random.default_rng(0).uniform(space.low, space.high, (31, len(space.names)))
    return [baseline(drive), *space.decode(points)]


@pytest.fixture
def measure(benchmark):
    """Time a function. ``work``: parameter sets times samples, or calls; ``times``: whole job / timed part."""

    def run(function, *, work, rounds, times=1):
        benchmark.pedantic(function, rounds=rounds, warmup_rounds=1)
        if benchmark.stats:  # None with --benchmark-disable
            ns = round(benchmark.stats.stats.median / work * 1e9, 3)
            benchmark.extra_info.update(work=work, times=times, ns=ns)

    return run
