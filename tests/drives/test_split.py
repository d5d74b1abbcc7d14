"""Splitting: no row is lost or is in both parts, and the order is unchanged."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.doctor.split import split_time
from sigmaswarm.drives.split import clip, split_drives
from sigmaswarm.errors import DriveError, InputError
from sigmaswarm.geodesy import rotation_of
from sigmaswarm.simulation import simulate
from support import make_drive

DRIVE = make_drive(duration=20.0, jitter=0.4)
MANY = [make_drive(duration=1.0, gps_rate=20.0, name=f"{i:02d}") for i in range(30)]
fractions = st.floats(0.001, 0.999)


@given(st.integers(2, 30), fractions, st.integers(0, 2**32))
def test_whole_drives_go_to_one_part_each_in_order(count: int, fraction: float, seed: int):
    train, test = split_drives(MANY[:count], fraction, rng=np.random.default_rng(seed))
    parts = [[d.name for d in train], [d.name for d in test]]
    assert all(part == sorted(part) and part for part in parts)
    assert sorted(parts[0] + parts[1]) == [d.name for d in MANY[:count]]
    assert abs(len(train) - fraction * count) < 1 or 1 in (len(train), len(test))


def test_seven_of_ten_drives_by_default_drawn_by_the_generator():
    draws = [split_drives(MANY[:10], rng=np.random.default_rng(seed)) for seed in (1, 1, 2, 3)]
    assert [(len(train), len(test)) for train, test in draws] == [(7, 3)] * 4
    names = [tuple(d.name for d in test) for _, test in draws]
    assert names[0] == names[1]
    assert len(set(names)) > 1


def test_each_drive_is_drawn_with_equal_probability():
    rng = np.random.default_rng(0)
    drawn = [d.name for _ in range(2000) for d in split_drives(MANY[:10], rng=rng)[0]]
    counts = np.unique(drawn, return_counts=True)[1]
    assert len(counts) == 10
    assert np.all(np.abs(counts - 1400) < 5 * np.sqrt(2000 * 0.7 * 0.3))  # 5 sigma


@pytest.mark.filterwarnings("ignore:.*can't be used as a drive")
@given(fractions)
def test_the_parts_in_time_make_up_the_drive(fraction: float):
    train, test = split_time(DRIVE, fraction) if 0.002 < fraction < 0.998 else split_time(DRIVE)
    assert (train.name, test.name) == ("synthetic-train", "synthetic-test")
    for table in ("imu", "gps", "truth"):
        whole, parts = getattr(DRIVE, table), [getattr(part, table) for part in (train, test)]
        for f in fields(whole):
            column = getattr(whole, f.name)
            joined = (
                [] if column is None else np.concatenate([getattr(p, f.name) for p in parts if p is not None])
            )
            np.testing.assert_array_equal([] if column is None else column, joined)
    cut = test.imu.time[0]
    assert all(t[-1] < cut for t in (train.imu.time, train.truth.time))
    assert train.gps.time[-1:].max(initial=0) < test.gps.time[:1].min(initial=np.inf)


def test_seventy_percent_of_the_time_by_default():
    train, test = split_time(DRIVE)
    assert train.imu.time[-1] < 14.0 <= test.imu.time[0]
    assert train.gps.time[-1] < 14.0 <= test.gps.time[0]
    assert train.imu.time[-1] > 13.98


@pytest.mark.filterwarnings("ignore:.*can't be used as a drive")
def test_split_at_a_time_of_the_drive_s_clock():
    train, test = split_time(replace(DRIVE, imu=replace(DRIVE.imu, time=DRIVE.imu.time + 100.0)), at=103.0)
    assert train.imu.time[-1] < 103.0 <= test.imu.time[0]
    assert train.imu.time[-1] > 102.98
    with pytest.raises(DriveError, match=r"fewer than two IMU samples; choose times within t = 0 to"):
        split_time(DRIVE, at=103.0)


@pytest.mark.filterwarnings("ignore:.*can't be used as a drive")
def test_fixes_outside_the_imu_are_in_neither_part():
    imu = DRIVE.imu.select((DRIVE.imu.time >= 2.0) & (DRIVE.imu.time < 15.0))
    train, test = split_time(replace(DRIVE, imu=imu))
    assert 2.0 <= train.gps.time[0] < train.gps.time[-1] < test.gps.time[0] < test.gps.time[-1] < 15.0


def test_adjacent_clips_share_no_rows():
    t = DRIVE.imu.time[1000]
    before, after = clip(DRIVE, end=t), clip(DRIVE, start=t)
    assert len(before.imu) == 1000
    assert after.imu.time[0] == t
    assert clip(DRIVE, 5.0, 6.0).name == "synthetic"
    assert clip(DRIVE, 5.0, 6.0, name="lap").name == "lap"
    assert len(clip(DRIVE, 5.0, 6.0).gps) == 5


def test_truth_without_rows_becomes_none():
    assert clip(DRIVE, 5.0, 6.0).truth is not None
    assert clip(replace(DRIVE, truth=DRIVE.truth.select(DRIVE.truth.time < 4.0)), 5.0, 6.0).truth is None
    assert clip(make_drive(duration=5.0, truth=False), 1.0, 2.0).truth is None


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.5, float("nan")])
def test_each_part_of_a_fraction_has_rows(fraction: float):
    with pytest.raises(InputError, match=r"train_fraction = .* between 0 and 1"):
        split_time(DRIVE, fraction)
    with pytest.raises(InputError, match=r"train_fraction = .* between 0 and 1"):
        split_drives(MANY, fraction, rng=np.random.default_rng(0))


def test_one_drive_can_not_be_split_into_whole_drives():
    with pytest.raises(InputError, match="needs at least 2 drives, not 1; pass more drives"):
        split_drives(MANY[:1], rng=np.random.default_rng(0))


@pytest.mark.parametrize(("start", "end"), [(50.0, 60.0), (5.0, 5.0), (6.0, 5.0), (5.0, 5.001)])
def test_an_empty_clip(start: float, end: float):
    with pytest.raises(
        DriveError, match=r"synthetic: .* fewer than two IMU samples; choose times within t = 0 to 20 s"
    ):
        clip(DRIVE, start, end)


@pytest.mark.filterwarnings("ignore:.*can't be used as a drive")
def test_the_part_between_two_times_is_omitted():
    before, after = split_time(DRIVE, at=[3.0, 7.0])
    assert (before.name, after.name) == ("synthetic-before", "synthetic-after")
    assert before.imu.time[-1] < 3.0
    assert after.imu.time[0] >= 7.0
    assert after.metadata["cut_from"]["start_s"] == after.imu.time[0]
    with pytest.raises(InputError, match="the first time is after the second"):
        split_time(DRIVE, at=(7.0, 3.0))
    with pytest.raises(InputError, match="at has 3 times"):
        split_time(DRIVE, at=(3.0, 4.0, 7.0))


def test_the_parts_of_a_log_with_a_moved_imu_are_repaired_separately():
    drive = simulate("urban", duration=80.0, imu_rate=50.0, imu="icm-20602", gps="white-1m", run=4)
    tilted, late = rotate_imu(drive.imu, rotation_of(0, 40, 0)), drive.imu.time > 40
    names = ("ax", "ay", "az", "gx", "gy", "gz")
    moved = {n: np.where(late, getattr(tilted, n), getattr(drive.imu, n)) for n in names}
    parts = split_time(replace(drive, imu=replace(drive.imu, **moved)), at=40.0)
    assert [part.metadata["cut_from"].get("repair_alone") for part in parts] == [True, True]
    assert [part.metadata["cut_from"].get("repair_alone") for part in split_time(drive)] == [None, None]
