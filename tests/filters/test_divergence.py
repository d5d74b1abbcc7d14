"""Divergence: planted divergence is detected, reported and ended by a reset; other filters are not changed."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sigmaswarm
from exported import tuned
from sigmaswarm.drives.alignment import MAX_DURATION, Alignments, InitialState, initial_state
from sigmaswarm.drives.drive import Drive, Gps, Imu, Truth
from sigmaswarm.drives.gyro_bias import GyroBiasEvidence
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.filters.divergence import DivergenceMonitor, StateCheck, check_times
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_filter
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.batch import BatchScorer
from sigmaswarm.scoring.score import score_estimate
from support import DRIVES, make_drive, needs_shared, quickly

SET = FilterParameters(
    0.67, 1.2, 2.5, (5e-11, 5e-11, 2e-3, 2e-3, 3.4e-7, 6e-5, 3.4e-13, 1.5e-12), (0.95, 0.95), "planar8",
    nominal_interval=0.01, bias_std=(0.98, 0.0074), lateral_noise=1e-3, rear_axle=0.1, standstill_noise=6.4e-3,
    gate=13.1,
)  # fmt: skip
"""Tuned on two KITTI drives with innovation-nll."""
TRUSTING = replace(SET, gate=None)
TILTED = replace(
    tuned("tilted12", "ekf", 0.01, everything=False), lateral_noise=0.01, standstill_noise=6.4e-3, gate=13.1
)
REAL = ["colorado-1", "kitti-09-30-0033", "kitti-09-30-0018"]
Planted = tuple[Drive, InitialState]


@cache
def drive_of(name: str) -> Drive:
    if name == "simulated":
        return sigmaswarm.simulate("urban", run=1, gps="white-1m", duration=180)
    return read_drive(DRIVES / name)


def turned(drive: Drive) -> Planted:
    """Turn the initial heading and velocity by 120 degrees."""
    start, angle = initial_state(drive), np.radians(120.0)
    turn = np.eye(5)
    turn[2:4, 2:4] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    mean = turn @ start.mean + np.array([0, 0, 0, 0, angle])
    return drive, InitialState(mean, turn @ start.covariance @ turn.T, start.time)


def aside(drive: Drive) -> Planted:
    """Shift the fixes by 200 m for 60 s."""
    start, gps = initial_state(drive), drive.gps
    off = (gps.time >= start.time + 20) & (gps.time < start.time + 80)
    return replace(drive, gps=replace(gps, x=gps.x + 120.0 * off, y=gps.y + 160.0 * off)), start


def silent(drive: Drive) -> Planted:
    """Remove the 20 s of IMU samples in which the car turns most."""
    start, imu = initial_state(drive), drive.imu
    heading = np.append(0.0, np.cumsum(imu.gz[1:] * np.diff(imu.time)))
    tried = np.arange(start.time + 15, imu.time[-1] - 60, 1.0)
    change = np.abs(np.interp(tried + 20, imu.time, heading) - np.interp(tried, imu.time, heading))
    begin = tried[int(np.argmax(change))]
    return replace(drive, imu=imu.select((imu.time <= begin) | (imu.time >= begin + 20))), start


PLANTS: dict[str, Callable[[Drive], Planted]] = {"turned": turned, "aside": aside, "silent": silent}


def rmse(truth: Truth, time: np.ndarray, x: np.ndarray, y: np.ndarray) -> float:
    off = (x - np.interp(time, truth.time, truth.x)) ** 2 + (y - np.interp(time, truth.time, truth.y)) ** 2
    return float(np.sqrt(np.mean(off)))


def after(drive: Drive, estimate: Estimate, restart: float) -> tuple[float, float]:
    """Return the RMSE of the estimate and of the fixes in the 10 s after a restart, m."""
    assert drive.truth is not None
    part, gps = (estimate.time >= restart) & (estimate.time <= restart + 10), drive.gps
    fixes = (gps.time >= restart) & (gps.time <= restart + 10)
    own = rmse(drive.truth, estimate.time[part], estimate.mean[part, 0], estimate.mean[part, 1])
    return own, rmse(drive.truth, gps.time[fixes], gps.x[fixes], gps.y[fixes])


def check_planted(name: str, plant: str, p: FilterParameters) -> None:
    drive, start = PLANTS[plant](drive_of(name))
    estimate = run_filter(drive, p, initial=start)
    lost = run_filter(drive, p, initial=start, recover=False)
    silence = float(estimate.time[np.argmax(np.diff(estimate.time)) + 1])
    if plant == "silent" and not estimate.restarts:  # the filter accounts for the gap and need not diverge
        own, raw = after(drive, estimate, silence + MAX_DURATION)
        assert own <= raw
        return
    assert estimate.restarts, "the divergence is not detected"
    assert estimate.failure is None
    for restart in estimate.restarts:
        own, raw = after(drive, estimate, restart)
        assert own <= raw * (1.001 if raw > 100 else 1.0), restart  # 0.1% of a large error is noise
    assert lost.restarts == ()
    before = estimate.time < estimate.restarts[0]
    np.testing.assert_array_equal(estimate.mean[before], lost.mean[before])
    last = estimate.time > estimate.time[-1] - 10
    own = rmse(drive.truth, estimate.time[last], estimate.mean[last, 0], estimate.mean[last, 1])
    assert own < 2.0


@pytest.mark.parametrize(
    ("plant", "p"),
    quickly(
        product(["turned", "silent"], [SET, TRUSTING]), lambda plant, p: (plant == "turned") == (p is SET)
    ),
)
def test_planted_divergence_in_a_simulated_drive_is_detected(plant: str, p: FilterParameters):
    check_planted("simulated", plant, p)


def test_planted_divergence_is_detected_by_a_tilted_filter():
    check_planted("simulated", "turned", TILTED)


@needs_shared
@pytest.mark.filterwarnings("ignore::sigmaswarm.DriveWarning")
@pytest.mark.parametrize(
    ("name", "plant"),
    quickly(
        [("colorado-1", "turned"), ("kitti-09-30-0018", "aside"), ("kitti-09-30-0018", "silent")],
        lambda _, plant: plant == "aside",
    ),
)
def test_planted_divergence_in_a_recording_is_detected(name: str, plant: str):
    check_planted(name, plant, SET)


RECEIVERS = ["white-1m", "ublox-m8", "f9p-rtk", "carla", "gnss-ins-sim"]
ROADS = ["urban", "turns", "cruise", "brake", "outages"]


@pytest.mark.parametrize(
    ("maneuver", "gps"),
    quickly(
        product(ROADS, RECEIVERS),
        lambda *case: case in (("turns", "f9p-rtk"), ("outages", "ublox-m8")),
    ),
)
def test_a_sound_filter_is_not_reset_on_a_simulated_drive(maneuver: str, gps: str):
    drive = sigmaswarm.simulate(maneuver, run=2, gps=gps)
    for p in (SET, TRUSTING):
        estimate = run_filter(drive, p)
        assert estimate.restarts == ()
        assert estimate.lost is not None
        assert not estimate.lost.any()


@needs_shared
@pytest.mark.filterwarnings("ignore::sigmaswarm.DriveWarning")
@pytest.mark.parametrize(
    "name",
    quickly(
        [
            (n,)
            for n in (
                *REAL,
                "kitti-09-26-0022",
                "kitti-09-26-0101",
                "kitti-09-30-0034",
                "comma2k19",
                "dresden",
            )
        ],
        lambda name: name == "colorado-1",
    ),
)
def test_a_sound_filter_is_not_reset_on_a_recording(name: str):
    for p in (SET, TRUSTING):
        assert run_filter(drive_of(name), p).restarts == ()


def test_a_large_gyro_bias_that_the_filter_estimates_causes_no_reset():
    """The alignment subtracts the bias only if fixes contradict a gyro without bias far beyond their noise."""
    drive = sigmaswarm.simulate("urban", duration=200.0, gps="white-1m", seed=5)
    off = replace(drive, imu=replace(drive.imu, gz=drive.imu.gz + 0.3))
    noise = (1e-6, 1e-6, 1e-4, 1e-4, 1e-7, 1e-8, 1e-8, 1e-10)
    p = FilterParameters(0.5, 2.0, 1.0, noise, (1.0, 1.0), "planar8", bias_std=(0.5, 0.3), lateral_noise=0.05)
    found = run_filter(off, p)
    assert not found.restarts
    assert np.degrees(score_estimate(off, found).heading_rmse) < 2.0


@pytest.mark.parametrize("samples", [1, 333, 10_000])
def test_the_monitor_changes_no_bit(samples: int):
    from sigmaswarm.filters.filter_run import FilterRun
    from sigmaswarm.filters.run import whole_pass

    drive_pass = whole_pass(make_drive(duration=40.0, seed=3))
    plain = FilterRun(drive_pass, SET)
    watched = FilterRun(drive_pass, SET, recover=True, samples=samples)
    a, b = plain.whole(), watched.whole()
    np.testing.assert_array_equal(a.mean, b.mean)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    np.testing.assert_array_equal(plain.sums["NIS"], watched.sums["NIS"])
    np.testing.assert_array_equal(plain.innovations.innovation, watched.innovations.innovation)


def test_restarts_do_not_depend_on_the_length_of_pieces():
    from sigmaswarm.filters.filter_run import FilterRun
    from sigmaswarm.filters.run import whole_pass

    drive_pass = whole_pass(*turned(drive_of("simulated")))
    runs = [FilterRun(drive_pass, SET, recover=True, samples=n) for n in (77, 10_000)]
    a, b = (run.whole() for run in runs)
    assert runs[0].restarts == runs[1].restarts != []
    np.testing.assert_array_equal(a.mean, b.mean)


def test_no_filter_is_reset_during_tuning():
    drive, start = turned(drive_of("simulated"))
    scored = BatchScorer.prepare([prepare_drive(drive, start)]).scores([SET])
    lost = score_estimate(drive, run_filter(drive, SET, initial=start, recover=False))
    found = score_estimate(drive, run_filter(drive, SET, initial=start))
    assert scored.position_rmse[0, 0] == pytest.approx(lost.position_rmse, rel=1e-9)
    assert lost.position_rmse > 1.2 * found.position_rmse


def stops_and_goes() -> tuple[Drive, InitialState]:
    """Return a drive with a stop from 40 to 80 s; the fixes are shifted by 200 m from 45 s on."""
    rng = np.random.default_rng(0)
    time = np.arange(14001) / 100
    accelerates = 2.0 * (time < 5) - 2.0 * ((time > 35) & (time < 40)) + 2.0 * ((time > 80) & (time < 85))
    speed = np.append(0.0, np.cumsum((accelerates[1:] + accelerates[:-1]) / 2) / 100).clip(0)
    rate = 0.02 * speed * np.sin(time / 7) / 10
    theta = 0.4 + np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2) / 100)
    v = speed * np.exp(1j * theta)
    p = np.append(0.0, np.cumsum((v[1:] + v[:-1]) / 2) / 100)
    noise = rng.standard_normal((3, len(time)))
    imu = Imu(time, accelerates + 0.02 * noise[0], speed * rate + 0.02 * noise[1], rate + 1e-3 * noise[2])
    fix_time = np.arange(0.05, 140, 0.2)
    fix = np.interp(fix_time, time, p) + 200.0j * (fix_time > 45)
    fix = fix + rng.standard_normal((len(fix_time), 2)) @ [1.0, 1j]
    drive = Drive(
        "stops", imu, Gps(fix_time, fix.real, fix.imag), Truth(time, p.real, p.imag, v.real, v.imag, theta)
    )
    return drive, initial_state(drive)


def test_while_it_can_not_align_the_estimate_is_the_last_fix_and_is_marked():
    drive, start = stops_and_goes()
    p = replace(SET, gate=9.2)
    estimate = run_filter(drive, p, initial=start)
    assert estimate.lost is not None
    (restart,) = estimate.restarts
    lost = estimate.time[estimate.lost]
    assert 55 < lost[0] < 58, "about 10 s after the fixes jump"
    assert 83 < restart < 92, "about 4 s and 20 m after the car departs"
    assert lost[-1] < restart
    assert estimate.lost.sum() == np.count_nonzero((estimate.time >= lost[0]) & (estimate.time < restart))
    for t in lost[::100]:
        row, last = np.searchsorted(estimate.time, t), np.searchsorted(drive.gps.time, t, side="right") - 1
        np.testing.assert_allclose(
            estimate.mean[row, :2], [drive.gps.x[last], drive.gps.y[last]], rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(estimate.covariance[row, :2, :2], np.diag(p.measurement_noise), rtol=1e-9)
    own, raw = after(drive, estimate, restart)
    assert own <= raw * 1.001


def live(
    drive: Drive, start: InitialState, late: float = 0.0, p: FilterParameters = SET
) -> tuple[LiveFilter, np.ndarray, np.ndarray]:
    """Return the filter, its means after each sample and whether it was lost; fixes arrive ``late`` s late."""
    lever = [*drive.lever_arm, drive.antenna_height]
    filter = LiveFilter(p, start, nominal_interval=drive.nominal_interval, lever_arm=lever)
    gps, imu = drive.gps, drive.imu
    axes = [getattr(imu, axis) for axis in MODELS[p.model].imu]
    events = sorted(
        [(t + late, 0, i) for i, t in enumerate(gps.time)] + [(t, 1, i) for i, t in enumerate(imu.time)]
    )
    means, lost = [], []
    for _, is_imu, i in events:
        if not is_imu:
            filter.update(gps.time[i], (gps.x[i], gps.y[i]))
            continue
        filter.predict(imu.time[i], [axis[i] for axis in axes])
        if imu.time[i] > start.time:
            state = filter.state
            means.append(state.mean)
            lost.append(state.lost)
    return filter, np.array(means), np.array(lost)


@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_the_rough_heading_of_a_stream_is_that_of_an_alignment(bias: float):
    drive = make_drive(duration=60.0, seed=3, gps_rate=5.0, jitter=0.2)
    gps, imu, start = drive.gps, drive.imu, initial_state(drive)
    filter = LiveFilter(SET, start, nominal_interval=drive.nominal_interval, lever_arm=list(drive.lever_arm))
    alignments, fix, seen = Alignments(drive), 0, []
    for k, t in enumerate(imu.time):
        while fix < len(gps) and gps.time[fix] <= t:
            filter.update(gps.time[fix], (gps.x[fix], gps.y[fix]))
            fix += 1
        filter.predict(t, (imu.ax[k], imu.ay[k], imu.gz[k] + bias))
        last = int(np.searchsorted(alignments.time, t, side="right")) - 1
        if k % 37 or last < 0:
            continue
        since = imu.time[(imu.time >= alignments.time[last]) & (imu.time <= t)]
        turn = np.diff(since, prepend=alignments.time[last]) @ imu.gz[k + 1 - len(since) : k + 1]
        expected = alignments.course[last] + turn
        heading = filter._calls.heading(filter._memory.handle, bias)
        assert np.isnan(heading) == np.isnan(expected)
        if np.isfinite(expected):
            seen.append(wrap_angle(float(heading - expected)))
    assert len(seen) > 50
    assert np.max(np.abs(seen)) < 1e-9


LIVE = {plant: (plant, SET) for plant in PLANTS} | {"turned-tilted12": ("turned", TILTED)}


@pytest.mark.parametrize(
    ("plant", "p"), quickly(LIVE.values(), lambda plant, p: plant == "turned" and p is SET), ids=LIVE
)
def test_the_live_filter_equals_the_run(plant: str, p: FilterParameters):
    drive, start = PLANTS[plant](drive_of("simulated"))
    run = run_filter(drive, p, initial=start)
    filter, means, lost = live(drive, start, p=p)
    assert filter.restarts == list(run.restarts)
    gap = np.flatnonzero(np.diff(run.time) > 10)  # after a gap, the live filter resets one sample later
    there = ~np.isin(np.arange(len(run.time)), gap + 1)
    np.testing.assert_allclose(means[there], run.mean[there], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(lost, run.lost)


@pytest.mark.long
def test_the_live_filter_equals_the_run_while_no_alignment_is_possible():
    drive, start = stops_and_goes()
    run = run_filter(drive, SET, initial=start)
    filter, means, lost = live(drive, start)
    assert filter.restarts == list(run.restarts) != []
    np.testing.assert_allclose(means, run.mean, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(lost, run.lost)
    assert lost.any()


@pytest.mark.parametrize("late", quickly([(0.1,), (0.5,)], lambda late: late == 0.5))
def test_late_fixes_are_checked_for_divergence(late: float):
    drive, start = turned(drive_of("simulated"))
    (at,) = run_filter(drive, SET, initial=start).restarts
    filter, means, _ = live(drive, start, late)
    (restart,) = filter.restarts
    assert at < restart < at + late + 1.1
    time = drive.imu.time[drive.imu.time > start.time]
    part = (time > restart) & (time < restart + 10)
    fixes = (drive.gps.time > restart) & (drive.gps.time < restart + 10)
    assert drive.truth is not None
    own = rmse(drive.truth, time[part], means[part, 0], means[part, 1])
    assert own <= rmse(drive.truth, drive.gps.time[fixes], drive.gps.x[fixes], drive.gps.y[fixes])


def test_a_fix_from_before_a_restart_comes_too_late():
    drive, start = turned(drive_of("simulated"))
    filter = LiveFilter(SET, start, nominal_interval=drive.nominal_interval, lever_arm=drive.lever_arm)
    gps, imu = drive.gps, drive.imu
    fix = 0
    for i, t in enumerate(imu.time):
        while fix < len(gps) and gps.time[fix] <= t:
            filter.update(gps.time[fix], (gps.x[fix], gps.y[fix]))
            fix += 1
        filter.predict(t, (imu.ax[i], imu.ay[i], imu.gz[i]))
        if filter.restarts:
            break
    state = filter.state
    assert not filter.update(filter.restarts[0] - 0.05, (gps.x[fix], gps.y[fix]))
    assert filter.too_late == 1
    np.testing.assert_array_equal(filter.state.mean, state.mean)


def seen(time: float, *, heading: float = 0.0, off: float = 0.0, aligns: bool = True) -> StateCheck:
    """Return a check of a filter that estimates 10 m/s to the east; fixes contradict it by these amounts."""
    alignment = InitialState(np.array([0, 0, 10, 0, heading]), 1e-4 * np.eye(5), time)
    return StateCheck(
        time=time, mean=np.array([0.0, off, 10.0, 0.0, 0.0]), covariance=1e-4 * np.eye(5), fix_time=time,
        fix=np.zeros(2), fix_variance=np.ones(2), lever=np.zeros(2), latency=0.0,
        since=lambda: np.zeros((1, 4)), heading=lambda: heading if aligns else np.nan,
        align=lambda: alignment if aligns else None,
    )  # fmt: skip


@pytest.mark.parametrize("taken", [None, 0.2])
def test_a_reset_propagates_the_alignment_to_the_present_without_gyro_bias(taken: float | None):
    gyro = None if taken is None else GyroBiasEvidence(np.zeros(3), np.ones(3), taken, np.zeros(5))
    aligned = InitialState(np.array([0.0, 0.0, 10.0, 0.0, 0.0]), np.eye(5), 5.0, gyro)
    steps = np.tile([0.01, 0.0, 0.0, 0.5], (100, 1))
    start = replace(seen(6.0), align=lambda: aligned, since=lambda: steps).start
    assert start is not None and start.time == 6.0 and start.gyro is gyro
    np.testing.assert_allclose(start.mean, [10.0, 0.0, 10.0, 0.0, 0.5 - (taken or 0.0)], rtol=0, atol=1e-12)


@pytest.mark.parametrize("wrong", [{"heading": 0.36}, {"off": 20.5}])
def test_it_is_lost_after_ten_seconds_of_uninterrupted_contradiction(wrong: dict):
    monitor = DivergenceMonitor()
    assert all(monitor.take(seen(t, **wrong)) is None for t in np.arange(0.0, 10.0))
    assert monitor.take(seen(10.0)) is None  # the fixes agree once
    assert all(monitor.take(seen(t, **wrong)) is None for t in np.arange(11.0, 21.0))
    found = monitor.take(seen(21.0, **wrong))
    assert found is not None
    assert monitor.restarts == [21.0] == [found.time]
    assert all(monitor.take(seen(t, **wrong)) is None for t in np.arange(22.0, 32.0))  # the 10 s start again


@pytest.mark.parametrize("right", [{"heading": 0.34}, {"off": 19.5}, {}])
def test_smaller_deviations_are_no_divergence(right: dict):
    monitor = DivergenceMonitor()
    assert all(monitor.take(seen(t, **right)) is None for t in np.arange(0.0, 100.0))
    assert monitor.restarts == []
    assert not monitor.lost


def test_deviations_within_the_covariance_are_no_contradiction():
    monitor = DivergenceMonitor()
    wide = np.diag([16.0, 25.0, 1.0, 1.0, 0.04])  # 5 m, 0.2 rad
    for t in np.arange(0.0, 100.0):
        assert monitor.take(replace(seen(t, heading=0.9, off=24.0), covariance=wide)) is None
    assert monitor.restarts == []


def test_checks_without_alignment_neither_interrupt_nor_prove_a_contradiction():
    monitor = DivergenceMonitor()
    for t in np.arange(0.0, 60.0):
        assert monitor.take(seen(t, heading=1.0, aligns=t < 5)) is None
    assert monitor.take(seen(60.0, heading=1.0)) is not None


def test_few_checks_are_not_enough():
    monitor = DivergenceMonitor()
    assert [monitor.take(seen(t, off=50.0)) for t in (0.0, 5.0, 10.0, 15.0)] == [None] * 4
    assert monitor.take(seen(20.0, off=50.0)) is not None


def test_without_alignment_it_is_lost_until_there_is_one():
    monitor = DivergenceMonitor()
    for t in np.arange(0.0, 30.0):
        assert monitor.take(seen(t, off=50.0, aligns=False)) is None
        assert monitor.lost == (t >= 10.0)
    assert monitor.take(seen(30.0, aligns=True)) is not None
    assert not monitor.lost


def test_a_failed_filter_is_not_checked():
    monitor = DivergenceMonitor()
    broken = [replace(seen(t, off=50.0), mean=np.full(5, np.nan)) for t in np.arange(0.0, 30.0)]
    assert [monitor.take(one) for one in broken] == [None] * 30
    assert not monitor.lost


RUNS = st.tuples(st.integers(1, 12), st.floats(0.3, 4.0), st.sampled_from("tfn"), st.sampled_from("tf"))
"""Runs of checks: number, interval in s, heading (t contradicts, f agrees, n no alignment), position (t or f)."""


@given(st.lists(RUNS, max_size=8), st.data())
def test_checks_of_a_batch_equal_checks_one_by_one(
    runs: list[tuple[int, float, str, str]], data: st.DataObject
):
    said = [look for n, *look in runs for _ in range(n)]
    times = np.cumsum([wait for wait, _, _ in said]).tolist()
    each = [
        seen(t, heading=0.4 if turned == "t" else 0.0, off=25.0 if far == "t" else 0.0, aligns=turned != "n")
        for t, (_, turned, far) in zip(times, said, strict=True)
    ]
    one_by_one, back, at = DivergenceMonitor(), DivergenceMonitor(), 0
    while at < len(each):
        end = at + 1 if back.lost else data.draw(st.integers(at + 1, len(each)))
        first, start = back.take_all(times[at:end], lambda k, at=at: each[at + k])
        end = end if first is None else at + first + 1
        found = [one_by_one.take(one) for one in each[at:end]]
        assert (back.lost, back.restarts) == (one_by_one.lost, one_by_one.restarts)
        assert [one is not None for one in found] == [False] * (end - at - 1) + [start is not None]
        at = end


READY = """
from sigmaswarm.drives import alignment_fit, gyro_bias, tilt_evidence
from sigmaswarm.filters import divergence, tilted

functions = [alignment_fit.fit_path, gyro_bias.mix_biases, gyro_bias.update_biases]
functions += [tilt_evidence.mean_forces, tilted.add_tilt_evidence]
assert not any(function.signatures for function in functions)
divergence.DivergenceMonitor()
assert all(function.signatures for function in functions)
"""


def test_a_reset_during_a_drive_compiles_nothing():
    subprocess.run([sys.executable, "-c", READY], check=True)


def test_most_checks_of_a_sound_filter_are_skipped():
    times, asked = np.arange(0.0, 100.0).tolist(), list[int]()

    def at(k: int) -> StateCheck:
        asked.append(k)
        return seen(times[k])

    assert DivergenceMonitor().take_all(times, at) == (None, None)
    assert len(set(asked)) <= 11


def test_checks_are_once_a_second_at_samples_after_fixes():
    line = prepare_drive(make_drive(duration=30.0, seed=0, gps_rate=5.0, jitter=0.2)).timeline()
    step, fix = check_times(line)
    assert line.sampled[step].all()
    time = line.end[step]
    assert len(time) == pytest.approx(30 - line.start, abs=1.5)
    assert np.all(np.diff(time) > 0.7)
    wait = time - line.fix_time[fix]
    assert np.all((wait >= 0) & (wait < 0.02))
    assert np.all(np.diff(fix) > 0)
