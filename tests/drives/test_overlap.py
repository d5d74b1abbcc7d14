"""Overlap: every copy of a drive is recognized after clipping, repair or renaming, and other drives are not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.doctor.repairs import repair
from sigmaswarm.doctor.split import split_time
from sigmaswarm.drives import overlap
from sigmaswarm.drives.drive import Drive, Gps, Imu
from sigmaswarm.drives.overlap import (
    Landmarks,
    Overlap,
    known_overlap,
    landmarks,
    load_landmarks,
    overlap_of,
    save_landmarks,
    whole_drive,
)
from sigmaswarm.drives.reader import read_with_warnings
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.simulation.maneuvers import MANEUVERS
from sigmaswarm.simulation.scenarios import simulate
from support import DRIVES, make_drive, needs_shared, quickly

ORIGIN = 50.0, 8.0, 100.0


def shifted(drive: Drive, seconds: float) -> Drive:
    imu, gps = drive.imu, drive.gps
    return replace(
        drive,
        imu=replace(imu, time=imu.time + seconds),
        gps=replace(gps, time=gps.time + seconds),
        truth=None,
    )


def decimated(drive: Drive, imu: int, gps: int) -> Drive:
    return replace(
        drive, imu=drive.imu.select(slice(1, None, imu)), gps=drive.gps.select(slice(1, None, gps))
    )


def in_other_units(drive: Drive) -> Drive:
    """Return the drive in g and deg/s clockwise, with 6 decimals like in a file."""
    imu = drive.imu
    other = {"ax": imu.ax / 9.80665, "ay": -imu.ay / 9.80665, "gz": -np.degrees(imu.gz)}
    return replace(drive, imu=replace(imu, **{name: np.round(v, 6) for name, v in other.items()}))


def in_the_other_frame(drive: Drive) -> Drive:
    """Convert meters to degrees or degrees to meters."""
    gps = drive.gps
    if gps.lat is not None:
        return replace(drive, gps=replace(gps, lat=None, lon=None), frame="enu")
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), ORIGIN).T
    return replace(
        drive, gps=replace(gps, lat=np.round(lat, 9), lon=np.round(lon, 9)), frame="wgs84", origin=ORIGIN
    )


def interpolated(drive: Drive) -> Drive:
    """Interpolate the IMU at other times."""
    imu = drive.imu
    t = np.arange(imu.time[0], imu.time[-1], 0.025)
    return replace(
        drive, imu=Imu(t, **{n: np.interp(t, imu.time, getattr(imu, n)) for n in ("ax", "ay", "gz")})
    )


def with_new_fixes(drive: Drive) -> Drive:
    """Return the drive with the fixes of a different receiver."""
    gps, rng = drive.gps, np.random.default_rng(0)
    x, y = (column + rng.standard_normal(len(gps)) for column in (gps.x, gps.y))
    return replace(drive, gps=replace(gps, x=x, y=y, lat=None, lon=None), origin=None)


COPIES: dict[str, Callable[[Drive], Drive]] = {
    "whole": lambda d: d,
    "first part": lambda d: split_time(d)[0],
    "last part": lambda d: split_time(d)[1],
    "20 s": lambda d: clip(d, d.imu.time[0] + 0.55 * d.duration, d.imu.time[0] + 0.55 * d.duration + 20),
    "mended": lambda d: repair(d, diagnose(d)),
    "shifted": lambda d: shifted(d, 1234.567),
    "fixes shifted": lambda d: replace(d, gps=replace(d.gps, time=d.gps.time + 0.65)),
    "renamed": lambda d: replace(d, name="another"),
    "decimated": lambda d: decimated(d, 2, 2),
    "decimated much": lambda d: decimated(d, 10, 3),
    "other units": in_other_units,
    "other frame": in_the_other_frame,
    "interpolated": interpolated,
    "new fixes": lambda d: with_new_fixes(in_other_units(d)),
    "several": lambda d: in_other_units(decimated(shifted(split_time(d)[0], -77.7), 2, 2)),
}
REAL = [(name,) for name in ("dresden", "kingston-1", "comma2k19", "colorado-1", "kitti-09-26-0022")]


def read(name: str) -> Drive:
    return read_with_warnings(DRIVES / name)[0]


@needs_shared
@pytest.mark.parametrize("name", quickly(REAL, lambda name: name == "comma2k19"))
def test_every_copy_of_a_real_drive_is_recognized_with_its_length(name: str):
    drive = read(name)
    whole = landmarks(drive)
    for kind, copy in COPIES.items():
        other = copy(drive)
        for one, of in ((landmarks(other), whole), (whole, landmarks(other))):
            found = overlap_of(one, [of])
            assert found.seconds == pytest.approx(other.duration, abs=1.0), kind
            assert found.of == (of.name,), kind


@needs_shared
def test_no_two_different_real_drives_overlap():
    marks = [landmarks(read(f.name)) for f in sorted(DRIVES.iterdir()) if (f / "imu.csv").exists()]
    found = {(a.name, b.name) for a in marks for b in marks if a is not b and overlap_of(a, [b])}
    assert found == {
        ("dresden", "dresden-as-recorded"),
        ("dresden-as-recorded", "dresden"),
    }  # these are the same drive


@pytest.mark.long
def test_simulated_drives_of_one_seed_are_different_drives():
    """Runs of a maneuver have one road and nearly one speed; in different environments, both are equal bit for bit."""
    drives = [
        simulate(maneuver, environment=environment, run=run, gps="white-1m", imu_rate=50.0)
        for maneuver in MANEUVERS
        if maneuver != "urban"
        for environment in ("clear", "night")
        for run in range(2)
    ]
    drives += [simulate("urban", run=run, duration=60.0, gps="white-1m", imu_rate=50.0) for run in range(3)]
    marks = [landmarks(drive) for drive in drives]
    assert not [(a.name, b.name) for a in marks for b in marks if a is not b and overlap_of(a, [b])]
    assert all(overlap_of(one, [one]).seconds > 0 for one in marks)
    for copy in ("first part", "shifted", "decimated", "other units"):
        assert overlap_of(landmarks(COPIES[copy](drives[-1])), marks).of == (drives[-1].name,)


def test_one_road_driven_twice_is_not_one_drive():
    """Receivers that round to 1 m give many equal positions; for copies of one drive, all positions are equal."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 200.0)
    drives = [make_drive(duration=200.0, gps_rate=1.0, name=name) for name in ("there", "again")]
    drives = [
        replace(drive, gps=Gps(time, *np.rint([7 * time, 7 * time] + 0.7 * rng.standard_normal((2, 200)))))
        for drive in drives
    ]
    gz = [drive.imu.gz + 0.01 * rng.standard_normal(len(drive.imu)) for drive in drives]
    first, second = (landmarks(replace(d, imu=replace(d.imu, gz=g))) for d, g in zip(drives, gz, strict=True))
    assert not overlap_of(first, [second])
    assert overlap_of(first, [first]).seconds == pytest.approx(200.0, abs=0.1)


def test_parts_that_overlap_each_other_count_once():
    drive = simulate("urban", duration=60.0)
    parts = [clip(drive, start, start + 30.0, f"{start:g}") for start in (0.0, 10.0, 45.0)]
    found = overlap_of(landmarks(drive), map(landmarks, parts))
    assert found.seconds == pytest.approx(40.0 + drive.imu.time[-1] - 45.0, abs=0.2)
    assert found.of == ("0", "10", "45")
    assert not overlap_of(landmarks(parts[0]), [landmarks(parts[2])])


@pytest.mark.parametrize(("resolution", "alone"), [(0.0625, False), (0.001, True)])
def test_few_pairs_are_compared_for_an_hour_of_a_coarse_gyro(
    resolution: float, alone: bool, monkeypatch: pytest.MonkeyPatch
):
    """A coarse gyro (0.0625 deg/s) gives 46 million pairs, which are skipped; the fixes recognize the drive."""
    pairs: list[int] = []

    def counted(*arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        i, j = equal(*arguments)
        pairs.append(len(i))
        return i, j

    equal = overlap._equal
    monkeypatch.setattr(overlap, "_equal", counted)
    rng = np.random.default_rng(0)
    drive = make_drive(duration=3600.0, imu_rate=100.0, gps_rate=1.0, name="hour")
    turn = 5 * np.sin(0.1 * drive.imu.time) + 2 * rng.standard_normal(len(drive.imu))
    drive = replace(drive, imu=replace(drive.imu, gz=np.radians(resolution * np.rint(turn / resolution))))
    part = shifted(clip(drive, 600.0, 3000.0, "part"), 12.345)
    assert overlap_of(landmarks(part), [landmarks(drive)]).seconds == pytest.approx(2400.0, abs=0.1)
    assert overlap._by_rates(landmarks(part), landmarks(drive)) == (pytest.approx(12.345) if alone else None)
    assert pairs
    assert max(pairs) <= 2_000_000


def test_between_whole_drives_only_a_match_is_conclusive():
    """A fingerprint contains all numbers, so it cannot prove that a part of a drive is new."""
    drive, stranger = simulate("urban", duration=60.0), simulate("urban", duration=30.0, run=1)
    marks, part = landmarks(drive), landmarks(clip(drive, 0.0, 40.0, "part"))
    whole = whole_drive("drive", marks.sha256, 60.0)
    found = known_overlap(marks, [whole])
    assert found is not None
    assert found.seconds == pytest.approx(60.0, abs=0.1)
    assert known_overlap(part, [whole]) is None
    assert known_overlap(landmarks(stranger), [marks, whole]) is None
    assert known_overlap(part, [marks, whole]) == overlap_of(part, [marks])
    assert known_overlap(landmarks(stranger), [marks]) == Overlap()


def test_landmarks_are_stored_in_a_file(tmp_path: Path):
    drives = [simulate("urban", duration=30.0, run=run) for run in range(2)]
    marks = [landmarks(drive) for drive in drives]
    save_landmarks(marks, tmp_path / "a.npz")
    save_landmarks(marks, tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = load_landmarks(tmp_path / "a.npz")
    assert back is not None
    for one, again in zip(marks, back, strict=True):
        assert_same(one, again)
    assert load_landmarks(tmp_path / "none.npz") is None
    (tmp_path / "a.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"a.npz: is not readable; delete it"):
        load_landmarks(tmp_path / "a.npz")


def assert_same(one: Landmarks, other: Landmarks) -> None:
    for name, value in vars(one).items():
        np.testing.assert_array_equal(getattr(other, name), value, err_msg=name)


@pytest.mark.parametrize("spread", [6, 100, 10**9])
def test_all_nearby_places_are_found(spread: int):
    rng = np.random.default_rng(5)
    a, b = (rng.integers(-spread, spread, (n, 2)).astype(float) for n in (80, 70))
    b[:30] = a[:30] + rng.integers(-4, 5, (30, 2))
    apart = np.abs(a[:, np.newaxis] - b).max(axis=2)
    expected = {(int(i), int(j)) for i, j in np.argwhere(apart <= overlap.POSITION_TOLERANCE)}
    found = list(zip(*(of.tolist() for of in overlap._equal(a, b, overlap.POSITION_TOLERANCE)), strict=True))
    assert len(expected) > 5
    assert (len(found), {*found}) == (len(expected), expected)


def test_places_with_extreme_coordinates_are_not_near():
    far = np.array([[9e18, 0.0], [-9e18, 0.0]])
    assert [len(of) for of in overlap._equal(far[:1], far[1:], overlap.POSITION_TOLERANCE)] == [0, 0]
