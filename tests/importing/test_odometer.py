"""The odometer in logs: a column, a separate table, a topic of a bag."""

from itertools import chain
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.bags import ROS2, messages, write_ros
from importing.logs import EPOCH, a_drive, imported
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.source import TableChoice

DRIVE = a_drive(5.0)
assert DRIVE.truth is not None
SPEED = np.hypot(DRIVE.truth.vx, DRIVE.truth.vy)[::3]
TIME = DRIVE.truth.time[::3]


def tables(folder: Path, wheels: pl.DataFrame, name: str = "wheels.csv") -> Path:
    """A folder of CSV files: IMU, fixes, and the wheels' table."""
    imu, gps = DRIVE.imu, DRIVE.gps
    folder.mkdir(exist_ok=True)
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}).write_csv(folder / "imu.csv")
    pl.DataFrame({"t": gps.time, "lat": gps.lat, "lon": gps.lon}).write_csv(folder / "gps.csv")
    wheels.write_csv(folder / name)
    return folder


def assert_wheels(got: Drive, atol: float = 1e-9) -> None:
    assert got.odometer is not None
    np.testing.assert_allclose(got.odometer.time - got.odometer.time[0], TIME - TIME[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(got.odometer.speed, SPEED, rtol=0, atol=atol)


def test_a_table_by_its_name_and_a_column_by_its_own(tmp_path: Path):
    assert_wheels(imported(tables(tmp_path / "a", pl.DataFrame({"t": TIME, "speed": SPEED}))).drive)
    kmh = pl.DataFrame({"t": TIME, "vehicle_speed_kmh": 3.6 * SPEED})
    assert_wheels(imported(tables(tmp_path / "b", kmh, "bus.csv")).drive)


def test_a_log_of_its_own_with_an_offset(tmp_path: Path):
    folder = tables(tmp_path / "log", pl.DataFrame())
    (folder / "wheels.csv").unlink()
    alone = tmp_path / "speeds.csv"
    pl.DataFrame({"t": TIME, "v": SPEED}).write_csv(alone)
    assert imported(folder).drive.odometer is None
    assert_wheels(imported(folder, odometer=alone).drive)


def test_mapped(tmp_path: Path):
    folder = tables(tmp_path / "log", pl.DataFrame({"t": TIME, "pulses": 100 * SPEED}))
    maps = ["odometer.speed=pulses/100"]
    got = imported(folder, maps=maps, odometer=folder / "wheels.csv").drive
    assert_wheels(got)
    with pytest.raises(InputError, match="a drive has no column 'pulse'"):
        imported(folder, maps=["odometer.pulse=pulses"])


def bag(folder: Path, topic: str) -> Path:
    """A bag with the speed as TwistStamped on a topic."""
    t = ROS2.types

    def twists():
        for time, speed in zip(TIME, SPEED, strict=True):
            ns = round(time * 1e9) + EPOCH * 10**9
            stamp = t["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
            header = t["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")
            zero = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
            moving = t["geometry_msgs/msg/Vector3"](x=float(speed), y=0.0, z=0.0)
            twist = t["geometry_msgs/msg/Twist"](linear=moving, angular=zero)
            yield topic, time, t["geometry_msgs/msg/TwistStamped"](header=header, twist=twist)

    return write_ros(folder, chain(messages(DRIVE), twists()))


def test_a_topic(tmp_path: Path):
    named = imported(bag(tmp_path / "a", "/wheel/twist"))
    assert_wheels(named.drive)
    assert any("/wheel/twist is used as the wheel speed" in note for note in named.notes)
    other = bag(tmp_path / "b", "/base/twist")  # it may as well be of a camera
    assert imported(other).drive.odometer is None
    assert_wheels(imported(other, choice=TableChoice(tables={"odometer": "/base/twist"})).drive)
    with pytest.raises(InputError, match=r"has none of the fields twist\.linear\.x"):
        imported(other, choice=TableChoice(tables={"odometer": "/imu/data"}))
