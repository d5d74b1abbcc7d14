"""Headings of two antennas: in tables, NMEA, UBX and bags."""

from pathlib import Path

import numpy as np
import pytest

from importing.bags import ROS2, messages, write_ros
from importing.logs import EPOCH, a_drive, imported
from importing.test_datasets import imu_csv
from importing.test_receivers import GPS, nmea, pynmeagps, pyubx2, ubx
from sigmaswarm.drives.drive import Gps
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.truth import _motion

HEADING = np.linspace(-3.0, 3.0, len(GPS))  # rad from east
NORTH = np.degrees(np.pi / 2 - HEADING) % 360.0
LOST = np.isin(np.arange(len(GPS)), (3, 4, 20))


def assert_headings(gps: Gps, heading: np.ndarray, lost: np.ndarray, std: float, atol: float = 1e-3) -> None:
    assert gps.heading is not None and gps.std_heading is not None
    np.testing.assert_array_equal(gps.std_heading >= np.pi, lost)
    assert np.abs(wrap_angle(gps.heading - heading))[~lost].max() < atol
    np.testing.assert_allclose(gps.std_heading[~lost], std, atol=1e-5)


@pytest.mark.parametrize("named", ["std_heading", "heading_accuracy (deg)"])
def test_a_table_with_a_heading_and_its_deviation(tmp_path: Path, named: str):
    rows = [
        f"{t + EPOCH:.3f},{lat:.9f},{lon:.9f},{'' if lost else f'{h:.4f}'},0.4"
        for t, lat, lon, h, lost in zip(GPS.time, GPS.lat, GPS.lon, NORTH, LOST, strict=True)
    ]
    (tmp_path / "fix.csv").write_text("\n".join([f"t,lat,lon,heading,{named}", *rows]) + "\n")
    got = imported(imu_csv(tmp_path), gps=tmp_path / "fix.csv")
    assert_headings(got.drive.gps, HEADING, LOST, np.radians(0.4))
    assert got.drive.gps.course is None
    assert any("clockwise from north" in note for note in got.notes)


def test_a_column_heading_alone_is_a_course_as_before(tmp_path: Path):
    rows = zip(GPS.time, GPS.lat, GPS.lon, NORTH, strict=True)
    text = "\n".join(f"{t + EPOCH:.3f},{lat:.9f},{lon:.9f},{h:.4f}" for t, lat, lon, h in rows)
    (tmp_path / "fix.csv").write_text("t,lat,lon,heading\n" + text + "\n")
    gps = imported(imu_csv(tmp_path), gps=tmp_path / "fix.csv").drive.gps
    assert gps.heading is None and gps.course is not None


@pytest.mark.parametrize("kind", ["HDT", "THS", "PASHR"])
def test_nmea(tmp_path: Path, kind: str):
    def sentence(i: int) -> bytes:
        if kind == "PASHR":
            text = f"PASHR,000000.00,{NORTH[i]:.2f},T,0,0,0,0.1,0.1,0.4,{0 if LOST[i] else 4},0"
        else:
            text = f"GN{kind},{NORTH[i]:.2f},{'V' if LOST[i] and kind == 'THS' else 'TA'[kind == 'THS']}"
        check = 0
        for byte in text.encode():
            check ^= byte
        return f"${text}*{check:02X}\r\n".encode()

    lines = [b"".join([*nmea(i), sentence(i)]) for i in range(len(GPS))]
    (tmp_path / "log.nmea").write_bytes(b"".join(lines))
    gps = imported(imu_csv(tmp_path), gps=tmp_path / "log.nmea").drive.gps
    kept = slice(len(GPS) - len(gps), None)
    if kind == "HDT":
        assert gps.heading is not None and gps.std_heading is None
        assert np.abs(wrap_angle(gps.heading - HEADING[kept])).max() < 1e-3
    else:
        assert_headings(gps, HEADING[kept], LOST[kept], np.radians(0.4) if kind == "PASHR" else 1e-6)
    assert pynmeagps


def test_ubx(tmp_path: Path):
    def relative(i: int) -> bytes:
        fixed = {
            "relPosHeadingValid": int(i != 3),
            "carrSoln": 1 if i == 4 else 2,
            "gnssFixOK": 1,
            "isMoving": 1,
        }
        heading = {"relPosHeading": NORTH[i], "accHeading": 0.4}
        itow = 1000 if i != 20 else 1
        message = pyubx2.UBXMessage(
            "NAV", "NAV-RELPOSNED", pyubx2.GET, version=1, iTOW=itow * (i + 1), **heading, **fixed
        )
        return message.serialize()

    stream = b"".join(ubx(i, iTOW=1000 * (i + 1)) + relative(i) for i in range(len(GPS)))
    (tmp_path / "log.ubx").write_bytes(stream)
    gps = imported(imu_csv(tmp_path), gps=tmp_path / "log.ubx").drive.gps
    assert_headings(gps, HEADING, LOST, np.radians(0.4))


def test_a_bag_with_a_heading_topic(tmp_path: Path):
    drive, t = a_drive(), ROS2.types
    sent = list(messages(drive))
    imu = next(message for topic, _, message in sent if topic == "/imu/data")
    covariance = np.zeros(9)
    covariance[8] = np.radians(0.4) ** 2
    for i, time in enumerate(drive.gps.time):
        half = HEADING[i] / 2
        turn = t["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(half), np.cos(half))
        ns = round(time * 1e9) + EPOCH * 10**9
        stamp = t["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        header = t["std_msgs/msg/Header"](stamp=stamp, frame_id="gps")
        nine = [imu.angular_velocity, np.zeros(9), imu.linear_acceleration, np.zeros(9)]
        sent.append(("/gps/heading", time, t["sensor_msgs/msg/Imu"](header, turn, covariance, *nine)))
    got = imported(write_ros(tmp_path / "bag", iter(sent)))
    assert_headings(got.drive.gps, HEADING, np.zeros(len(GPS), bool), np.radians(0.4))
    assert len(got.drive.imu) == len(drive.imu)
    assert "/gps/heading is used as the dual-antenna heading" in got.notes


def test_a_heading_of_a_slow_robot_in_unwrapped_radians_is_not_read_as_degrees():
    """Its rows reach more than a turn, so the proposal converts them from degrees; the positions contradict this."""
    time = np.arange(0.0, 200.0, 0.05)
    theta = 0.5 + 0.1 * time
    x, y = (np.cumsum(0.4 * part(theta)) * 0.05 for part in (np.cos, np.sin))
    said = list[str]()
    values = {"x": x, "y": y, "theta": np.radians(theta)}
    found = _motion(time, values, {}, said.append)["theta"]
    assert np.abs(np.angle(np.exp(1j * (found - theta)))).max() < 1e-9
    assert "truth: the heading is converted from unwrapped radians" in " ".join(said)
