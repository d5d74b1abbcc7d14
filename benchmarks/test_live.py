"""Compare the live filter with FilterPy's filters, one call at a time: median and 99.9% quantile of the call times.

Results are compared for filters that FilterPy also has; it lacks the adaptive and the strong tracking filter.

Times are processor times of the thread, so that other jobs do not affect the quantiles. The time of reading this clock,
measured with an empty call, is subtracted.
"""

from time import thread_time_ns as now

import numpy as np
import pytest

from rival_filterpy import Ekf, Ukf
from rival_pyswarms import Course
from sigmaswarm import FilterParameters, LiveFilter, LiveFilterBank

SECONDS = 40.0
NOISE5 = (1e-4, 1e-4, 1e-3, 1e-3, 1e-7)
BIASES = (1e-9, 1e-9, 1e-11)
CAR = {"lateral_noise": 0.1, "standstill_noise": 1e-3}
FILTERS = {
    "planar5 ukf": FilterParameters(0.5, 2.0, 0.0, NOISE5, (1.0, 1.0)),
    "planar5 ekf": FilterParameters(0.5, 2.0, 0.0, NOISE5, (1.0, 1.0), kind="ekf"),
    "planar5 adaptive-ukf": FilterParameters(0.5, 2.0, 0.0, NOISE5, (1.0, 1.0), kind="adaptive-ukf"),
    "planar5 strong-tracking-ukf": FilterParameters(
        0.5, 2.0, 0.0, NOISE5, (1.0, 1.0), kind="strong-tracking-ukf"
    ),
    "planar8 ukf": FilterParameters(0.5, 2.0, 0.0, NOISE5 + BIASES, (1.0, 1.0), "planar8"),
    "planar8 ukf, lateral and standstill": FilterParameters(
        0.5, 2.0, 0.0, NOISE5 + BIASES, (1.0, 1.0), "planar8", **CAR
    ),
}
RIVALS = [name for name, p in FILTERS.items() if p.kind in ("ukf", "ekf")]

pytestmark = [pytest.mark.usefixtures("turn"), pytest.mark.benchmark(group="live")]


@pytest.fixture(scope="session")
def course(drive):
    return Course(drive, SECONDS)


class Clock:
    """Times of single calls, ns: of predict, of update, and of a sample together with its fix."""

    def __init__(self):
        self.predict, self.update, self.both = [], [], []

    def summary(self):
        empty = float(np.median([-now() + now() for _ in range(1000)]))
        calls = {"predict": self.predict, "update": self.update, "both": self.both}
        calls = {name: np.array(times) - empty for name, times in calls.items()}
        return {f"{k}_median": float(np.median(v)) for k, v in calls.items()} | {
            f"{k}_tail": float(np.quantile(v, 0.999)) for k, v in calls.items()
        }


def events(course):
    """Yield time, dt, IMU sample, and fix or None of each step; the fixes have the times of IMU samples."""
    assert course.sampled.all()
    fixes = iter(course.fixes.tolist())
    end = course.initial.time + np.cumsum(course.dt)
    for t, dt, u, updates in zip(
        end.tolist(), course.dt.tolist(), course.imu.tolist(), course.updates, strict=True
    ):
        yield t, dt, u, next(fixes) if updates else None


def run_filterpy(course, parameters):
    """Run FilterPy's filter: at each sample predict, update with a fix if there is one, and apply constraints."""
    clock = Clock()
    rival = (Ekf if parameters.kind == "ekf" else Ukf)(parameters, course.initial)
    for t, dt, u, z in list(events(course)):
        began = now()
        rival.predict(t, dt, u)
        if z:
            before = now()
            rival.update(t, z)
            clock.update.append(now() - before)
        rival.constrain(t, u)
        (clock.both if z else clock.predict).append(now() - began)
    return clock, rival.mean


def run_live(course, parameters, late, kind=LiveFilter):
    """Run the live filter. A fix arrives before the sample of its time or, with ``late``, so many samples later."""
    clock, due = Clock(), []
    live = kind(parameters, course.initial, nominal_interval=0.01)
    for k, (t, _, u, z) in enumerate(list(events(course))):
        if z:
            due.append((k + late, t, z))
        before = between = now()
        updates = due and due[0][0] == k
        if updates and not late:
            live.update(*due.pop()[1:])
            between = now()
            clock.update.append(between - before)
        live.predict(t, u)
        after = now()
        clock.both.append(after - before) if updates and not late else clock.predict.append(after - between)
        if updates and late:
            before = now()
            live.update(*due.pop()[1:])
            clock.update.append(now() - before)
            clock.both.append(clock.update[-1] + clock.predict[-1])
    return clock, live.state.mean


def record(benchmark, run):
    """Record the call times of one round, after a round to warm up."""
    run()
    clock, mean = benchmark.pedantic(run, rounds=1)
    benchmark.extra_info.update(clock.summary())
    return mean


@pytest.mark.parametrize("name", RIVALS)
def test_filterpy_calls(benchmark, course, name):
    mean = record(benchmark, lambda: run_filterpy(course, FILTERS[name]))
    ours = run_live(course, FILTERS[name], late=0)[1]
    np.testing.assert_allclose(mean[:2], ours[:2], atol=1e-3)  # both do the same work


@pytest.mark.parametrize("name", FILTERS)
def test_live(benchmark, course, name):
    record(benchmark, lambda: run_live(course, FILTERS[name], late=0))


@pytest.mark.parametrize("name", ["planar8 ukf, lateral and standstill"])
def test_swarm(benchmark, course, name):
    record(benchmark, lambda: run_live(course, FILTERS[name], late=0, kind=LiveFilterBank))


def test_live_late(benchmark, course):
    record(benchmark, lambda: run_live(course, FILTERS["planar5 ukf"], late=5))
