"""``--mount auto``: the mounting is found in the log, or refused with the reason."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import sigmaswarm
from sigmaswarm.doctor.mounting import angle_of, rotate_imu
from sigmaswarm.importing.mounting import find_mount, parse_mount
from support import quickly, several


def log_of(drive: sigmaswarm.Drive, folder: Path) -> Path:
    """A table of the IMU beside one of the fixes."""
    imu, gps = drive.imu, drive.gps
    columns = {"time_s": imu.time} | {n: getattr(imu, n) for n in ("ax", "ay", "az", "gx", "gy", "gz")}
    folder.mkdir()
    pl.DataFrame(columns).write_csv(folder / "imu.csv")
    pl.DataFrame({"time_s": gps.time, "lat": 48 + gps.y / 111_194.9, "lon": 11 + gps.x / 74_404.6}).write_csv(
        folder / "fixes.csv"
    )
    return folder


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw"),
    quickly([(0, -66, 0), (180, 0, 0), (12, 30, 100)], lambda roll, pitch, yaw: yaw == 100),
)
def test_the_mounting_is_found(tmp_path: Path, roll: float, pitch: float, yaw: float):
    drive = sigmaswarm.simulate("urban", duration=120, gps="white-1m", run=4)
    rotation = Rotation.from_euler("xyz", (roll, pitch, yaw), degrees=True).as_matrix()
    log = log_of(replace(drive, imu=rotate_imu(drive.imu, rotation.T)), tmp_path / "log")
    with pytest.warns(sigmaswarm.SigmaswarmWarning, match="was estimated from the log"):
        made = sigmaswarm.import_log(log / "imu.csv", gps=log / "fixes.csv", mount="auto")
    assert np.sqrt(np.mean((made.imu.ax - drive.imu.ax) ** 2)) < 9.81 * np.sin(np.radians(5))
    assert made.imu.az is not None
    assert np.median(made.imu.az) == pytest.approx(9.8, abs=0.2)
    raw = replace(drive, imu=rotate_imu(drive.imu, rotation.T)).imu
    mount = ",".join(map(str, made.mounting))
    np.testing.assert_allclose(rotate_imu(raw, parse_mount(mount)).gx, made.imu.gx, atol=1e-9)


@pytest.mark.long
def test_a_log_that_does_not_show_it_is_refused_with_the_reason(tmp_path: Path):
    log = log_of(sigmaswarm.simulate("cruise", gps="white-1m"), tmp_path / "log")
    with pytest.raises(
        sigmaswarm.InputError,
        match=r"does not show the mounting .the course hardly changes.*specify the mounting",
    ):
        sigmaswarm.import_log(log / "imu.csv", gps=log / "fixes.csv", mount="auto")


@pytest.mark.parametrize(("axis", "at"), several([("y", 40.0), ("z", 40.0), ("z", 80.0), ("x", 80.0)], 4))
def test_no_mounting_is_estimated_for_a_log_whose_imu_was_moved(axis: str, at: float):
    """The error names the time of the movement. Its command leads to two parts with a mounting each."""
    drive = sigmaswarm.simulate("urban", duration=120, gps="white-1m", run=4)
    other = rotate_imu(drive.imu, Rotation.from_euler(axis, 90, degrees=True).as_matrix())
    names, late = ("ax", "ay", "az", "gx", "gy", "gz"), drive.imu.time > at
    moved = {n: np.where(late, getattr(other, n), getattr(drive.imu, n)) for n in names}
    drive = replace(drive, imu=replace(drive.imu, **moved), truth=None)
    with pytest.raises(
        sigmaswarm.InputError, match=r"the IMU was moved at t = .*split DRIVE --at"
    ) as refused:
        find_mount(drive)
    cut = float(str(refused.value).split("--at ")[1].split()[0])
    assert cut == pytest.approx(at, abs=6)
    for part in sigmaswarm.split_time(drive, at=cut):
        assert "mounting-changed" not in sigmaswarm.diagnose(part).codes


def test_the_text_of_a_mounting_is_the_rotation_it_names():
    for seed in range(5):
        rotation = Rotation.random(random_state=seed).as_matrix()
        roll, pitch, yaw = Rotation.from_matrix(rotation).as_euler("xyz", degrees=True)
        assert angle_of(parse_mount(f"{roll},{pitch},{yaw}") @ rotation.T) < 1e-6
