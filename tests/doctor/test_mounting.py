"""The mounting: one rotation, the same for a turned drive, and never a mirror image or the reverse."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sigmaswarm
from sigmaswarm import Drive
from sigmaswarm.doctor.checks.mounting import moved
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.doctor.fixes import course_of
from sigmaswarm.doctor.mounting import angle_of, mounting_of, turned
from sigmaswarm.drives.split import clip
from support import DRIVES, needs_shared, quickly

GRADES = ["mpu-6050", "icm-20602", "adis16405", "ideal"]


@cache
def drive_of(grade: str, terrain: str = "rolling") -> Drive:
    return sigmaswarm.simulate("urban", duration=150, imu=grade, gps="white-1m", terrain=terrain, run=4)


def estimate(drive: Drive, rotation: np.ndarray):
    """The mounting of a drive whose IMU is turned by a rotation, and its error, rad."""
    course = course_of(drive.gps.time, drive.gps.x + 1j * drive.gps.y)
    found = mounting_of(replace(drive, imu=turned(drive.imu, rotation)), course)
    return found, angle_of(found.rotation @ rotation) if found else 0.0


@pytest.mark.parametrize(
    ("grade", "seed"),
    quickly(
        [(g, s) for g in GRADES for s in range(4)], lambda g, s: (g, s) in {("mpu-6050", 0), ("adis16405", 1)}
    ),
)
def test_a_random_rotation_is_found(grade: str, seed: int):
    found, error = estimate(drive_of(grade), Rotation.random(random_state=seed).as_matrix())
    assert found.confidence in ("sure", "likely")
    assert np.degrees(error) < 5
    assert np.linalg.det(found.repair) == pytest.approx(1)


def test_the_estimate_of_a_turned_drive_is_the_turned_estimate():
    plain, _ = estimate(drive_of("icm-20602"), np.eye(3))
    for seed in range(3):
        rotation = Rotation.random(random_state=seed).as_matrix()
        found, _ = estimate(drive_of("icm-20602"), rotation)
        assert np.degrees(angle_of(found.rotation @ rotation @ plain.rotation.T)) < 0.1


@pytest.mark.parametrize("sign", ["force", "rate"])
def test_a_sensor_that_reports_the_opposite_turns_no_axis(sign: str):
    drive = drive_of("icm-20602", "flat")
    names = ("ax", "ay", "az") if sign == "force" else ("gx", "gy", "gz")
    flipped = replace(drive, imu=replace(drive.imu, **{n: -getattr(drive.imu, n) for n in names}))
    found, error = estimate(flipped, Rotation.random(random_state=5).as_matrix())
    assert found is not None
    assert np.degrees(error) < 5


def test_a_mirror_image_is_no_mounting():
    drive = drive_of("icm-20602", "flat")
    mirrored = replace(drive, imu=replace(drive.imu, ay=-drive.imu.ay))
    found, _ = estimate(mirrored, Rotation.random(random_state=6).as_matrix())
    assert found.confidence == "no"


def test_a_straight_road_gives_no_yaw():
    found, _ = estimate(sigmaswarm.simulate("cruise", gps="white-1m"), np.eye(3))
    assert found.confidence == "no"


@needs_shared
@pytest.mark.parametrize(
    "name",
    quickly(
        [("colorado-1",), ("dresden",), ("kitti-09-30-0018",), ("kitti-09-30-0033",)],
        lambda name: "kitti" not in name,
    ),
)
def test_a_recording_is_found_within_3_degrees(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)  # gaps
        drive = sigmaswarm.read_drive(DRIVES / name)
    evidence = gather(drive)
    assert not evidence.mounted
    found, error = estimate(drive, Rotation.random(random_state=1).as_matrix())
    assert found.confidence in ("sure", "likely")
    assert np.degrees(error) < 3


@pytest.mark.parametrize(
    "angles", quickly([((0, -65, 0),), ((10, -20, 5),), ((180, 0, 90),)], lambda angles: angles[0] != 10)
)
def test_a_phone_in_a_holder_is_one_finding_whose_repair_is_a_rotation(angles: tuple[float, float, float]):
    drive = drive_of("icm-20602", "flat")
    rotation = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    sick = replace(drive, imu=turned(drive.imu, rotation))
    found = sigmaswarm.diagnose(sick)
    assert [f.code for f in found.findings if f.severity == "serious"] == ["mounting"]
    mended = sigmaswarm.repair(sick, found)
    before, after = (np.array([d.imu.ax, d.imu.ay, d.imu.az]) for d in (sick, mended))
    np.testing.assert_allclose(np.linalg.norm(after, axis=0), np.linalg.norm(before, axis=0), rtol=1e-12)
    assert not sigmaswarm.diagnose(mended).serious
    for column in ("ax", "ay", "az"):
        off = getattr(mended.imu, column) - getattr(drive.imu, column)
        assert np.sqrt(np.mean(off**2)) < 9.81 * np.sin(np.radians(5))


@pytest.mark.parametrize("angle", quickly([(25.0,), (60.0,)], lambda angle: angle == 25.0))
def test_an_imu_that_was_moved_within_a_log_is_reported_with_its_time(angle: float):
    drive = drive_of("icm-20602", "flat")
    late = drive.imu.time > 80
    other = turned(drive.imu, Rotation.from_euler("y", angle, degrees=True).as_matrix())
    columns = {
        n: np.where(late, getattr(other, n), getattr(drive.imu, n))
        for n in ("ax", "ay", "az", "gx", "gy", "gz")
    }
    found = {
        f.code: f for f in sigmaswarm.diagnose(replace(drive, imu=replace(drive.imu, **columns))).findings
    }
    assert found["mounting-changed"].span[0] == pytest.approx(80, abs=6)
    assert "split" in found["mounting-changed"].remedy
    assert moved(drive) is None


def test_windows_of_a_minute_are_never_called_sure_and_reversed():
    drive, wrong = drive_of("mpu-6050", "hilly"), []
    for start in (0.0, 20.0, 60.0, 80.0):
        found, error = estimate(
            clip(drive, start, start + 60), Rotation.random(random_state=int(start)).as_matrix()
        )
        if found and found.confidence != "no" and error > np.radians(20):
            wrong.append((start, error))
    assert not wrong
