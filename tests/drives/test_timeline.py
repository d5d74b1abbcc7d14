"""The merged timeline, compared with a loop over all times."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.drives.stale_fixes import STALE
from support import make_drive, timeline_of

TICK = 1 / 64  # s; sums and differences of ticks are exact


@dataclass
class Naive:
    """A literal implementation of the specified steps."""

    dt: list[float] = field(default_factory=list)
    sample: list[int] = field(default_factory=list)
    gap: list[float] = field(default_factory=list)
    fix: list[int | None] = field(default_factory=list)
    sampled: list[bool] = field(default_factory=list)


def walk(drive: Drive, start: float) -> Naive:
    imu, gps = drive.imu.time.tolist(), drive.gps.time.tolist()
    steps, now, usual = Naive(), start, None
    for k, t_k in enumerate(imu):
        interval = t_k - imu[k - 1] if k else 0.0
        gap = interval if usual is not None and interval > max(5 * usual, 0.05) else 0.0
        if k:
            usual = interval if usual is None else usual + (min(interval, 3 * usual) - usual) / 32
        if t_k <= start:
            continue
        waiting = [j for j, t in enumerate(gps) if now < t <= t_k]
        for j in waiting:
            steps.dt.append(gps[j] - now)
            steps.sample.append(k)
            steps.gap.append(gap)
            steps.fix.append(j)
            steps.sampled.append(gps[j] == t_k and j == waiting[-1])
            now = gps[j]
        if now < t_k:
            steps.dt.append(t_k - now)
            steps.sample.append(k)
            steps.gap.append(gap)
            steps.fix.append(None)
            steps.sampled.append(True)
            now = t_k
    return steps


def drive_of(imu_ticks: list[int], gps_ticks: list[int]) -> Drive:
    imu, gps = np.array(sorted(imu_ticks)) * TICK, np.array(sorted(gps_ticks)) * TICK
    number = np.arange(len(imu), dtype=float)
    return Drive(
        "ticks",
        Imu(time=imu, ax=number, ay=number + 1000, gz=number + 2000),
        Gps(time=gps, x=np.arange(len(gps)) + 0.25, y=-np.arange(len(gps)) - 0.5),
    )


@st.composite
def drives_and_starts(draw) -> tuple[Drive, float]:
    imu = draw(st.lists(st.integers(-100, 300), min_size=2, max_size=40, unique=True))
    gps = draw(st.lists(st.integers(-150, 350), min_size=1, max_size=40))  # maybe of two receivers
    start = draw(st.integers(min(imu), max(imu) - 1)) * TICK
    return drive_of(imu, gps), start


@given(drives_and_starts())
def test_the_steps_are_those_of_a_plain_loop(case: tuple[Drive, float]):
    drive, start = case
    line, naive = timeline_of(drive, start), walk(drive, start)
    assert line.start == start
    assert line.dt.tolist() == naive.dt
    driving = [k - 0.5 if gap else float(k) for k, gap in zip(naive.sample, naive.gap, strict=True)]
    assert line.ax.tolist() == driving
    assert line.ay.tolist() == [1000.0 + k for k in driving]
    assert line.gz.tolist() == [2000.0 + k for k in driving]
    assert line.gap.tolist() == naive.gap
    assert line.updates.tolist() == [j is not None for j in naive.fix]
    assert line.sampled.tolist() == naive.sampled
    absorbed = [j for j in naive.fix if j is not None]
    assert line.fixes[:, :2].tolist() == [[j + 0.25, -j - 0.5] for j in absorbed]
    assert line.fix_time.tolist() == drive.gps.time[absorbed].tolist()
    gaps = sorted(np.diff(drive.imu.time).tolist())
    middle = len(gaps) // 2
    median = gaps[middle] if len(gaps) % 2 else (gaps[middle - 1] + gaps[middle]) / 2
    assert line.nominal_interval == median
    assert line.q_scale.tolist() == [dt / median for dt in naive.dt]


@given(drives_and_starts())
def test_invariants_of_every_timeline(case: tuple[Drive, float]):
    drive, start = case
    line = timeline_of(drive, start)
    end = drive.imu.time[-1]
    again = np.flatnonzero(line.dt == 0)  # only for two fixes at one time
    assert np.all(line.dt >= 0)
    assert np.all(line.updates[again] & line.updates[again - 1])
    assert line.dt.sum() == end - start
    assert line.sampled[-1]
    assert line.imu_time.tolist() == [t for t in drive.imu.time if t > start]
    assert line.sampled.sum() == len(line.imu_time)
    assert line.fix_time.tolist() == [t for t in drive.gps.time if start < t <= end]
    # The steps that use a sample add up to the time since the sample before it, for every split.
    driven = {
        k: line.dt[np.ceil(line.ax) == k].sum() for k in np.ceil(line.ax)
    }  # a half: mean of two samples
    times = drive.imu.time
    assert driven == {
        k: times[k] - max(times[k - 1] if k else start, start) for k in range(len(times)) if times[k] > start
    }


def test_a_fix_between_two_samples_splits_the_step():
    line = timeline_of(drive_of([0, 8, 16], [11]), 0.0)
    assert (line.dt / TICK).tolist() == [8, 3, 5]
    assert line.ax.tolist() == [1, 2, 2]  # both parts use the sample at the end of the interval
    assert line.updates.tolist() == [False, True, False]
    assert line.sampled.tolist() == [True, False, True]
    assert line.q_scale.tolist() == [1, 3 / 8, 5 / 8]  # the sum is the Q of the whole step


def test_a_fix_at_the_time_of_a_sample_splits_no_step():
    line = timeline_of(drive_of([0, 8, 16], [8]), 0.0)
    assert (line.dt / TICK).tolist() == [8, 8]
    assert line.updates.tolist() == [True, False]
    assert line.sampled.tolist() == [True, True]


def test_several_fixes_in_one_interval():
    line = timeline_of(drive_of([0, 8, 16], [9, 10, 15]), 0.0)
    assert (line.dt / TICK).tolist() == [8, 1, 1, 5, 1]
    assert line.ax.tolist() == [1, 2, 2, 2, 2]
    assert line.fixes[:, 0].tolist() == [0.25, 1.25, 2.25]


def test_two_fixes_at_one_time():
    line = timeline_of(drive_of([0, 8, 16], [3, 3, 8, 8, 11]), 0.0)
    line = line.hiding(np.array([0, 1, 1, 0, 0], dtype=bool))
    assert (line.dt / TICK).tolist() == [3, 0, 5, 0, 3, 5]
    assert line.updates.tolist() == [True, False, False, True, True, False]
    assert line.hides.tolist() == [False, True, True, False, False, False]
    assert line.sampled.tolist() == [False, False, False, True, False, True]
    assert line.fixes[:, 0].tolist() == [0.25, 1.25, 2.25, 3.25, 4.25]


def test_fixes_up_to_the_start_and_after_the_last_sample_are_dropped():
    drive = drive_of([0, 8, 16], [-3, 2, 3, 16, 17])
    line = timeline_of(drive, 3 * TICK)  # the initial state already contains the fix at the start
    assert (line.fix_time / TICK).tolist() == [16]
    assert (line.dt / TICK).tolist() == [5, 8]


def test_process_noise_grows_with_a_gap():
    line = timeline_of(drive_of([0, 8, 16, 24, 104, 112], [64]), 0.0)
    assert line.q_scale.tolist() == [1, 1, 1, 5, 5, 1]  # a gap of ten intervals, split by a fix
    assert line.nominal_interval == 8 * TICK


def test_a_gap_is_driven_by_the_mean_of_the_samples_around_it():
    drive = drive_of([0, 8, 16, 24, 104, 112], [64])
    line = timeline_of(drive, 0.0)
    assert line.ax.tolist() == [1, 2, 3, 3.5, 3.5, 5]
    assert (line.gap / TICK).tolist() == [0, 0, 0, 80, 80, 0]
    plain = timeline_of(drive, 0.0, as_recorded=True)
    assert plain.ax.tolist() == [1, 2, 3, 4, 4, 5]
    assert not plain.gap.any()


def test_stale_fixes_are_left_out():
    drive = make_drive(duration=12.0, gps_rate=5.0, seed=1)
    gps = drive.gps
    frozen = np.isin(np.arange(len(gps)), [30, 31, 32])
    stuck = replace(gps, x=np.where(frozen, gps.x[29], gps.x), y=np.where(frozen, gps.y[29], gps.y))
    line, without = (timeline_of(replace(drive, gps=fixes), 2.0) for fixes in (stuck, gps.select(~frozen)))
    assert (line.kinds >= STALE).tolist() == frozen.tolist()
    for name in ("steps", "ax", "updates", "fixes", "fix_time", "sampled"):
        np.testing.assert_array_equal(getattr(line, name), getattr(without, name))
    hidden = np.isin(np.arange(len(gps)), [28, 31, 40])
    assert line.hiding(hidden).hides.sum() == 2
    plain = timeline_of(replace(drive, gps=stuck), 2.0, as_recorded=True)
    assert len(plain.fixes) == len(line.fixes) + 3


@pytest.mark.parametrize("seed", range(3))
def test_a_drive_with_jitter_is_merged_like_in_the_loop(seed: int):
    drive = make_drive(duration=8.0, jitter=0.4, gps_rate=7.0, seed=seed)
    line, naive = timeline_of(drive, 1.234), walk(drive, 1.234)
    np.testing.assert_array_equal(line.dt, naive.dt)
    np.testing.assert_array_equal(line.ax, drive.imu.ax[naive.sample])
    np.testing.assert_array_equal(line.updates, [j is not None for j in naive.fix])
    assert line.dt.sum() == pytest.approx(drive.imu.time[-1] - 1.234, abs=1e-12)
