"""The live filter equals `run_filter` for any order in which fixes arrive."""

import math
import pickle
import tracemalloc
from dataclasses import replace
from functools import cache
from itertools import product

import numba
import numpy as np
import pytest

import processes
from filter_cases import (
    KINDS,
    OPTIONS,
    WEIGHED,
    WEIGHED_CASES,
    equipped,
    parameters,
    rough,
    stands_for_all,
    straying,
    two_receivers,
)
from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.live import live_calls
from sigmaswarm.filters.live import MAX_WAITING_FIXES, LiveFilter
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from support import DRIVES, needs_shared, quickly


@cache
def start() -> InitialState:
    return initial_state(equipped())


def live(drive: Drive, p: FilterParameters, initial: InitialState, late: float = 0.0, **more):
    """Return means and covariances after each IMU sample, and the filter; fixes arrive ``late`` s after their time."""
    lever = drive.metadata.get("gps_lever_arm_m", (0.0, 0.0))[:2]
    filter = LiveFilter(p, initial, nominal_interval=drive.nominal_interval, lever_arm=lever, **more)
    gps = drive.gps
    events = [(t, 1, i) for i, t in enumerate(drive.imu.time)] + [
        (t + late, 0, i) for i, t in enumerate(gps.time)
    ]
    means, covariances = [], []
    for t, is_imu, i in sorted(events):
        if is_imu:
            filter.predict(t, (drive.imu.ax[i], drive.imu.ay[i], drive.imu.gz[i]))
            if t > initial.time:
                state = filter.state
                means.append(state.mean)
                covariances.append(state.covariance)
        else:
            velocity = None
            if gps.speed is not None and gps.course is not None:
                velocity = (gps.speed[i] * math.cos(gps.course[i]), gps.speed[i] * math.sin(gps.course[i]))
            std = None if gps.std_x is None or gps.std_y is None else (gps.std_x[i], gps.std_y[i])
            filter.update(gps.time[i], (gps.x[i], gps.y[i]), velocity, std)
    return np.array(means), np.array(covariances), filter


@pytest.mark.parametrize(
    ("model", "kind", "option"), quickly(product(("planar5", "planar8"), KINDS, OPTIONS), stands_for_all)
)
def test_the_live_filter_equals_the_run(model: str, kind: str, option: str):
    p = parameters(model, kind=kind, **OPTIONS[option])
    run = run_filter(equipped(), p, initial=start())
    means, covariances, _ = live(equipped(), p, start())
    np.testing.assert_allclose(means, run.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(covariances, run.covariance, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize(
    ("model", "kind", "option", "late"),
    quickly(
        [(m, *case, late) for m in ("planar5", "planar8") for case in WEIGHED_CASES for late in (0.0, 0.31)],
        lambda model, kind, option, late: model == "planar8" and (late > 0.0 or option == "both"),
    ),
)
def test_the_live_filter_weights_fixes_as_the_run_does(model: str, kind: str, option: str, late: float):
    p = parameters(model, kind=kind, **WEIGHED[option])
    run = run_filter(straying(), p, initial=start())
    means, covariances, filter = live(straying(), p, start(), late)
    if not late:
        np.testing.assert_allclose(means, run.mean, rtol=0, atol=1e-11)
        np.testing.assert_allclose(covariances, run.covariance, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(filter.state.mean, run.mean[-1], rtol=0, atol=1e-11)
    assert filter.too_late == 0


@pytest.mark.parametrize("std", [None, (1.0, math.nan), (-1.0, 1.0), (math.inf, 1.0)])
def test_a_filter_with_an_accuracy_scale_needs_the_accuracy(std: tuple[float, float] | None):
    filter = LiveFilter(parameters("planar5", accuracy_scale=0.4), start(), nominal_interval=0.01)
    with pytest.raises(InputError, match="pass two standard deviations in m"):
        filter.update(start().time + 0.1, (0.0, 0.0), std=std)
    assert filter.update(start().time + 0.1, (0.0, 0.0), std=(1.0, 2.0))


@pytest.mark.parametrize("late", [0.003, 0.05, 0.31])
@pytest.mark.parametrize("kind", ["ukf", "adaptive-ukf"])
def test_late_fixes_are_applied_at_their_time(kind: str, late: float):
    p = parameters("planar8", kind=kind, **OPTIONS["all"])
    run = run_filter(equipped(), p, initial=start())
    means, _, filter = live(equipped(), p, start(), late)
    np.testing.assert_allclose(filter.state.mean, run.mean[-1], rtol=0, atol=1e-12)
    assert filter.too_late == 0
    assert np.max(np.abs(means - run.mean)) > 1e-3  # before a fix arrives, the estimates differ


@pytest.mark.parametrize(
    ("model", "kind", "late"),
    quickly(
        product(("planar5", "planar8"), KINDS, (0.0, 0.05)),
        lambda model, kind, late: (model == "planar8") == (late > 0),
    ),
)
def test_two_fixes_of_one_time_are_both_used(model: str, kind: str, late: float):
    p, drive = parameters(model, kind=kind, **OPTIONS["all"]), two_receivers()
    run = run_filter(drive, p, initial=start())
    assert run.failure is None
    means, covariances, filter = live(drive, p, start(), late)
    if not late:
        np.testing.assert_allclose(means, run.mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(covariances, run.covariance, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(filter.state.mean, run.mean[-1], rtol=0, atol=1e-12)
    assert filter.too_late == 0
    one = run_filter(replace(drive, gps=drive.gps.select(slice(0, None, 2))), p, initial=start())
    assert np.max(np.abs(one.mean - run.mean)) > 1e-3


@pytest.mark.parametrize("late", [0.0, 0.05])
@pytest.mark.parametrize("model", ["planar5", "planar8"])
def test_stale_fixes_and_gaps_are_treated_as_in_the_run(model: str, late: float):
    p, drive = parameters(model, **OPTIONS["all"]), rough()
    ready = PreparedDrive(drive)
    line = ready.timeline()
    assert ready.stale.sum() == 5
    assert np.unique(line.gap).size == 3
    run = run_filter(ready, p)
    means, covariances, filter = live(drive, p, ready.initial, late)
    if not late:
        np.testing.assert_allclose(means, run.mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(covariances, run.covariance, rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(filter.state.mean, run.mean[-1], rtol=0, atol=1e-12)
    assert (filter.too_late, filter.frozen) == (0, ready.stale.sum())
    as_recorded = run_filter(PreparedDrive(drive, ready.initial, as_recorded=True), p)
    means, _, plain = live(drive, p, ready.initial, as_recorded=True)
    np.testing.assert_allclose(means, as_recorded.mean, rtol=0, atol=1e-12)
    assert np.max(np.abs(as_recorded.mean - run.mean)) > 0.1
    assert plain.frozen == 0


def test_a_late_fix_updates_which_fixes_are_stale():
    p = parameters("planar5")
    t0, north = math.ceil(start().time), 3.0
    rows = [
        (t0 + 0.2 * k, 2.0 * k if k < 8 else 14.0) for k in range(1, 11)
    ]  # those after the seventh are stale
    late = rows[6]
    filters = [LiveFilter(p, start(), nominal_interval=0.01) for _ in range(2)]
    for k in range(1, 300):
        t = t0 + 0.01 * k
        for filter, mine in zip(filters, (rows, [r for r in rows if r is not late]), strict=True):
            for row in mine:
                if t - 0.01 < row[0] <= t:
                    filter.update(row[0], (row[1], north))
        if k == 190:
            assert filters[1].update(late[0], (late[1], north))
        for filter in filters:
            filter.predict(t, (0.0, 0.0, 0.0))
    assert filters[0].frozen == 3
    np.testing.assert_allclose(filters[1].state.mean, filters[0].state.mean, rtol=0, atol=1e-12)


def test_a_repeated_message_is_ignored():
    p = parameters("planar5", **OPTIONS["all"])
    once, twice = (LiveFilter(p, start(), nominal_interval=0.01) for _ in range(2))
    t0 = start().time
    for k in range(1, 101):
        t = t0 + 0.01 * k
        if k % 20 == 5:
            fix = t - 0.004, (0.1 * k, -0.1 * k), (10.0, 1.0)
            assert once.update(*fix)
            assert twice.update(*fix)
            assert not twice.update(*fix)
        for filter in (once, twice):
            filter.predict(t, (0.1, 0.2, 0.05))
        if k % 20 == 7:
            assert not twice.update(*fix)  # late
    assert twice.state.mean.tobytes() == once.state.mean.tobytes()
    assert twice.too_late == 0


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_numbers_of_other_types_cause_no_compilation():
    plain, mixed = (LiveFilter(parameters("planar5"), start(), nominal_interval=0.01) for _ in range(2))
    t0 = math.ceil(start().time)
    plain.update(t0 + 0.5, (1.0, 2.0))
    plain.predict(float(t0 + 1), (0.0, 1.0, 0.5))
    mixed.update(np.float64(t0 + 0.5), np.array([1, 2]))
    mixed.predict(t0 + 1, (0, np.float32(1.0), np.float16(0.5)))
    assert mixed.state.mean.tobytes() == plain.state.mean.tobytes()
    calls = live_calls()
    assert len(calls.sample.signatures) == len(calls.fix.signatures) == 1


ONE_MORE = """
import pickle, sys
filter = pickle.loads(bytes.fromhex(sys.argv[1]))
filter.predict(filter.state.time + 0.01, (0.0, 1.0, 0.5))
print((filter.state.mean.tobytes() + filter.smoothed.mean.tobytes()).hex())
"""


def test_a_pickled_filter_continues_in_another_process():
    filter = LiveFilter(parameters("planar5"), start(), nominal_interval=0.01, lag=0.5)
    filter.predict(start().time + 1.0, (0.0, 1.0, 0.5))
    there = processes.run(ONE_MORE, pickle.dumps(filter).hex())
    filter.predict(filter.state.time + 0.01, (0.0, 1.0, 0.5))
    assert there.stdout.strip() == (filter.state.mean.tobytes() + filter.smoothed.mean.tobytes()).hex()


def test_the_smoothed_state_does_not_change_the_history_for_late_fixes():
    drive, p = equipped(), parameters("planar8")
    asked, silent = (LiveFilter(p, start(), nominal_interval=0.01, lag=1.0, history=2.0) for _ in range(2))
    begin = start().time
    imu, gps = drive.imu, drive.gps
    times = [float(t) for t in imu.time if begin < t < begin + 3.0]
    samples = {
        float(t): tuple(row)
        for t, row in zip(imu.time, np.column_stack([imu.ax, imu.ay, imu.gz]), strict=True)
    }
    early = [k for k, t in enumerate(gps.time) if t <= begin]
    for filter in (asked, silent):
        for t in times:
            filter.predict(t, samples[t])
        for k in early:  # fixes from before the start arrive late; they can only show a standstill
            filter.update(float(gps.time[k]), (gps.x[k], gps.y[k]))
    assert asked.smoothed is not None
    late = next(k for k, t in enumerate(gps.time) if t > times[-1] - 1.0)
    for filter in (asked, silent):
        filter.update(float(gps.time[late]), (gps.x[late], gps.y[late]))
    assert asked.state.mean.tobytes() == silent.state.mean.tobytes()


def test_fixes_older_than_the_history_are_left_out_and_counted():
    drive, p = equipped(), parameters("planar5")
    _, _, filter = live(drive, p, start(), 0.5, history=0.2)
    assert filter.too_late > 50
    assert not filter.state.failed


@needs_shared
def test_the_live_filter_equals_the_run_on_a_real_drive_with_a_standstill():
    drive = clip(read_drive(DRIVES / "kingston-1"), 560.0, 900.0)
    p = parameters("planar8", standstill_noise=1e-3, lateral_noise=0.1, gate=9.0)
    initial = initial_state(drive)
    run = run_filter(drive, p, initial=initial)
    means, _, _ = live(drive, p, initial)
    np.testing.assert_allclose(means, run.mean, rtol=0, atol=1e-9)
    assert (
        np.max(np.abs(run.mean - run_filter(drive, parameters("planar8", lateral_noise=0.1, gate=9.0)).mean))
        > 1e-3
    )


def test_the_number_of_fixes_that_wait_for_the_imu_is_bounded():
    filter = LiveFilter(parameters("planar5"), start(), nominal_interval=0.01)
    t0 = start().time
    taken = [filter.update(t0 + 0.01 + 1e-4 * k, (0.0, 0.0)) for k in range(3000)]
    assert MAX_WAITING_FIXES <= sum(taken) < 2 * MAX_WAITING_FIXES
    assert filter.too_late == 3000 - sum(taken)
    for k in range(500):
        filter.predict(t0 + 0.5 + 0.01 * k, (0.0, 0.0, 0.0))  # the first sample processes all waiting fixes
    assert filter.update(t0 + 6.0, (0.0, 0.0))  # then a fix can wait again
    assert not filter.state.failed


def test_samples_and_fixes_out_of_order_have_no_effect():
    filter = LiveFilter(parameters("planar5"), start(), nominal_interval=0.01)
    t0 = start().time
    assert not filter.update(t0 - 1.0, (0.0, 0.0))
    filter.predict(t0 + 0.01, (0.0, 0.0, 0.0))
    before = filter.state
    for t in (t0 + 0.01, t0, math.nan):  # repeated, old, not a number
        filter.predict(t, (1.0, 1.0, 1.0))
    assert filter.state.mean.tobytes() == before.mean.tobytes()


@pytest.mark.long
def test_memory_is_constant_over_a_long_stream():
    # benchmarks/live_stream.py runs a day; this test runs 200 000 samples with all options of a live filter.
    filter = LiveFilter(parameters("planar8", **OPTIONS["all"]), start(), nominal_interval=0.01)
    t0 = start().time

    def feed(first: int, last: int) -> None:
        for k in range(first, last):
            t = t0 + 0.01 * (k + 1)
            if k % 20 == 10:
                filter.update(t - (0.2 if k % 100 == 10 else 0.004), (0.01 * (k % 7), 0.0), (0.0, 0.0))
            filter.predict(t, (0.01 * math.sin(k), 0.0, 0.0))

    feed(0, 50_000)
    tracemalloc.start()
    feed(50_000, 52_000)
    before = tracemalloc.get_traced_memory()[0]
    feed(52_000, 60_000)
    growth = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    feed(60_000, 200_000)
    assert growth < 50_000  # bytes; a stored sample takes a thousand
    assert not filter.state.failed
    assert filter.too_late == 0
    assert np.isfinite(filter.state.mean).all() and np.isfinite(filter.state.covariance).all()
