"""PX4's ULog, written byte by byte as its file format says (docs.px4.io, "ULog File Format")."""

import struct
from pathlib import Path

import numpy as np
import pytest

from importing.logs import ORIGIN, a_drive, assert_close, imported
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import wrap_angle

pytest.importorskip("pyulog", reason="pyulog is not installed")

DRIVE = a_drive(5.0)
IMU, GPS, TRUTH = DRIVE.imu, DRIVE.gps, DRIVE.truth
CODES = {"uint64_t": "Q", "uint8_t": "B", "int32_t": "i", "float": "f", "double": "d", "float[3]": "3f"}
SENSORS = "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
NEW = "double latitude_deg;double longitude_deg;double altitude_msl_m;double altitude_ellipsoid_m;"
OLD = "int32_t lat;int32_t lon;int32_t alt;int32_t alt_ellipsoid;"
FIX = "uint64_t timestamp;{}float eph;float vel_n_m_s;float vel_e_m_s;uint8_t fix_type;"
PLACE = "uint64_t timestamp;double ref_lat;double ref_lon;float ref_alt;"
PLACE += "double x;double y;float vx;float vy;float heading;"


def record(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


def us(time: float) -> int:
    return round(time * 1e6) + 7_000_000


def write_ulog(path: Path, old: bool = False, truth: bool = True) -> Path:
    """Header, flags, formats, subscriptions, and data in the order of their times."""
    fix = FIX.format(OLD if old else NEW)
    gps = "vehicle_gps_position" if old else "sensor_gps"
    topics = {"sensor_combined": SENSORS, gps: fix, "vehicle_local_position_groundtruth": PLACE}
    rows: list[tuple[float, str, tuple]] = []
    for i, t in enumerate(IMU.time):
        rates, force = (IMU.gx[i], -IMU.gy[i], -IMU.gz[i]), (IMU.ax[i], -IMU.ay[i], -IMU.az[i])
        rows.append((t, "sensor_combined", (us(t), *rates, *force)))
    for i, t in enumerate(GPS.time):
        lat, lon, alt = GPS.lat[i], GPS.lon[i], GPS.alt[i]
        place = (lat, lon, alt - 48, alt)
        if old:
            place = (round(lat * 1e7), round(lon * 1e7), round(alt * 1e3) - 48000, round(alt * 1e3))
        velocity = GPS.speed[i] * np.exp(1j * GPS.course[i])
        accuracy = GPS.std_x[i] * np.sqrt(2)
        rows.append((t, gps, (us(t), *place, accuracy, velocity.imag, velocity.real, 3 if i else 1)))
    for i, t in enumerate(TRUTH.time if truth else ()):
        heading = wrap_angle(np.pi / 2 - TRUTH.theta[i])
        motion = (TRUTH.y[i], TRUTH.x[i], TRUTH.vy[i], TRUTH.vx[i], heading)
        rows.append((t, "vehicle_local_position_groundtruth", (us(t), *ORIGIN, *motion)))
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", us(0.0)) + record(b"B", bytes(40))
    for name, fields in topics.items():
        content += record(b"F", f"{name}:{fields}".encode())
    for number, name in enumerate(topics):
        content += record(b"A", struct.pack("<BH", 0, number) + name.encode())
    numbers = {name: number for number, name in enumerate(topics)}
    codes = {n: "<" + "".join(CODES[f.split()[0]] for f in t.split(";") if f) for n, t in topics.items()}
    data = [
        record(b"D", struct.pack("<H", numbers[n]) + struct.pack(codes[n], *row))
        for _, n, row in sorted(rows, key=lambda r: r[0])
    ]
    path.write_bytes(content + b"".join(data))
    return path


@pytest.mark.parametrize("old", [False, True])
def test_px4(tmp_path: Path, old: bool):
    got = imported(write_ulog(tmp_path / "flight.ulg", old))
    drive = got.drive
    np.testing.assert_allclose(drive.imu.time, IMU.time + 7.0, atol=1e-6)
    assert_close(drive.imu, IMU, "ax ay az gx gy gz", 1e-6)  # logged as float32
    fixes = GPS.select(slice(1, None))  # the first was no 3D fix
    np.testing.assert_allclose(drive.gps.time, fixes.time + 7.0, atol=1e-6)
    assert_close(drive.gps, fixes, "lat lon", 1e-7)
    assert_close(drive.gps, fixes, "alt", 1e-3)
    assert_close(drive.gps, fixes, "std_x speed course", 1e-5)
    assert drive.origin is not None
    np.testing.assert_allclose(drive.origin, ORIGIN)
    assert_close(drive.truth, TRUTH, "x y", 1e-9)
    assert_close(drive.truth, TRUTH, "vx vy", 1e-5)
    np.testing.assert_allclose(wrap_angle(drive.truth.theta - TRUTH.theta), 0, atol=1e-6)


def test_a_real_flight_has_no_truth(tmp_path: Path):
    assert imported(write_ulog(tmp_path / "flight.ulg", truth=False)).drive.truth is None


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda content: b"", "is empty"),
        (lambda content: b"no ulog" * 99, "cut short or broken"),
        (lambda content: content[:60], "cut short or broken"),
        (lambda content: content[:20], "cut short or broken|contains none of"),
        (lambda content: content.replace(b"sensor_combined", b"sensor_elsewhere"[:15]), "no IMU"),
        (lambda content: content[: len(content) // 20], "no IMU|no position|too few|usable"),
    ],
)
def test_broken(tmp_path: Path, edit, said: str):
    path = write_ulog(tmp_path / "flight.ulg")
    path.write_bytes(edit(path.read_bytes()))
    with pytest.raises(InputError, match=said) as caught:
        imported(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "content"),
    [(b"D", b""), (b"D", b"\0"), (b"D", b"\0\0"), (b"D", b"\0\0\1\2\3"), (b"O", b"\0"), (b"L", b"\0" * 3)],
)
def test_a_message_that_is_too_short_does_not_end_the_log(tmp_path: Path, kind: bytes, content: bytes):
    """The library stops there without a word: a part of the log would be the drive."""
    path = write_ulog(tmp_path / "flight.ulg")
    whole = path.read_bytes()
    at = whole.rindex(record(b"A", struct.pack("<BH", 0, 2) + b"vehicle_local_position_groundtruth"))
    size = 3 + 3 + len("vehicle_local_position_groundtruth")
    for _ in range(1000):  # messages ahead of the short one
        at, size = at + size, 3 + struct.unpack_from("<H", whole, at + size)[0]
    path.write_bytes(whole[:at] + record(kind, content) + whole[at:])
    with pytest.raises(InputError, match=r"flight\.ulg: is cut short or broken"):
        imported(path)
