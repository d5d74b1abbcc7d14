"""MATLAB files and ArduPilot's dataflash logs, written by SciPy and by hand."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from importing.logs import a_drive, assert_close, imported
from sigmaswarm.errors import InputError
from support import some

DRIVE = a_drive(5.0)
IMU, GPS = DRIVE.imu, DRIVE.gps
FORCE = np.column_stack([IMU.ax, IMU.ay, IMU.az])
RATE = np.column_stack([IMU.gx, IMU.gy, IMU.gz])
PLACE = {"lat": GPS.lat, "lon": GPS.lon, "h": GPS.alt}


def write_mat(path: Path) -> Path:
    savemat(path, {"imu": {"t": IMU.time, "fb": FORCE, "wb": RATE}, "gnss": {"t": GPS.time, **PLACE}})
    return path


@pytest.mark.parametrize(
    "content",
    [
        {"imu": {"t": IMU.time, "fb": FORCE, "wb": RATE}, "gnss": {"t": GPS.time, **PLACE}},
        {"imu": {"t": IMU.time, "fb": FORCE.T, "wb": RATE.T}, "gnss": {"t": GPS.time[:, None], **PLACE}},
        {"log": {"imu": {"time": IMU.time, "acc": FORCE, "gyro": RATE}, "gps": {"time": GPS.time, **PLACE}}},
        {
            "t": IMU.time,
            "acc": FORCE,
            "gyro": RATE,
            "gps": {"t": GPS.time, **PLACE},
            "empty": np.zeros((0, 0)),
        },
        {
            "imu": [{"t": t, "acc": a, "gyro": w} for t, a, w in zip(IMU.time, FORCE, RATE, strict=True)],
            "gps": {"t": GPS.time, "lla": np.column_stack([GPS.lat, GPS.lon, GPS.alt])},
        },
        {
            "imu": {
                "t": IMU.time,
                "accel_x": IMU.ax,
                "accel_y": IMU.ay,
                "accel_z": IMU.az,
                "gyro": RATE,
                "rate_hz": 100.0,
            },
            "gps": {"t": GPS.time, **PLACE, "name": "F9P"},
        },
    ],
)
def test_structs_are_tables(tmp_path: Path, content: dict[str, Any]):
    savemat(tmp_path / "log.mat", content)
    got = imported(tmp_path / "log.mat").drive
    assert_close(got.imu, IMU, "time ax ay az gx gy gz", 1e-12)
    assert_close(got.gps, GPS, "time lat lon", 1e-12)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(600), r"save\('log_v7\.mat', '-struct', 's', '-v7'\)"),
        (b"MATLAB 7.3" + bytes(502) + b"\x89HDF\r\n\x1a\n", r"save\('log_v7\.mat'"),
        (b"MATLAB 5.0 MAT-file" + bytes(300), "cut short or broken"),
    ],
)
def test_what_is_not_read_of_matlab_is_named(tmp_path: Path, content: bytes, said: str):
    (tmp_path / "log.mat").write_bytes(content)
    with pytest.raises(InputError, match=said):
        imported(tmp_path / "log.mat")
    savemat(tmp_path / "log.mat", {"name": "nothing", "one": 1.0})
    with pytest.raises(InputError, match="contains no vectors of equal length"):
        imported(tmp_path / "log.mat")


def element(kind: int, content: bytes) -> bytes:
    """Return an element of a MATLAB file of version 5."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def opaque(*classes: str) -> bytes:
    """Return arrays of MATLAB's own classes."""
    numbers = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1))
    numbers += element(1, b"") + element(6, bytes(24))
    arrays = b""
    for k, kind in enumerate(classes):
        names = (element(1, name) for name in (f"T{k}".encode(), b"MCOS", kind.encode()))
        arrays += element(14, element(6, struct.pack("<II", 17, 0)) + b"".join(names) + element(14, numbers))
    return arrays


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("classes", [("timetable",), ("table",), ("timetable", "datetime", "timetable")])
def test_timetables_are_refused_with_the_line_for_matlab(tmp_path: Path, classes: tuple[str, ...]):
    (tmp_path / "log.mat").write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + opaque(*classes))
    with pytest.raises(InputError, match=r"in MATLAB, write each with writetimetable\(NAME, 'NAME.csv'\)"):
        imported(tmp_path / "log.mat")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("classes", [("string",), ("datetime", "timetable"), ("duration", "string", "table")])
def test_vectors_next_to_objects_of_matlab_are_read(tmp_path: Path, classes: tuple[str, ...]):
    log = write_mat(tmp_path / "log.mat")
    log.write_bytes(log.read_bytes() + opaque(*classes))
    assert_close(imported(log).drive.imu, IMU, "time ax ay az gx gy gz", 1e-12)


FORMATS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "IMU": (130, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "GPS": (131, "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U"),
    "GPA": (132, "QBff", "TimeUS,I,VDop,HAcc"),
}
CODES = {
    "B": "B",
    "Q": "Q",
    "f": "f",
    "I": "I",
    "H": "H",
    "c": "h",
    "L": "i",
    "e": "i",
    "n": "4s",
    "N": "16s",
    "Z": "64s",
}


def packed(name: str, *values: Any) -> bytes:
    number, form, _ = FORMATS[name]
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(CODES[c] for c in form), *values)


def dataflash(*, accuracy: bool = True, instances: int = 1, status: int = 3) -> bytes:
    lines = [
        packed(
            "FMT",
            n,
            3 + struct.calcsize("<" + "".join(CODES[c] for c in f)),
            k.encode(),
            f.encode(),
            c.encode(),
        )
        for k, (n, f, c) in FORMATS.items()
    ]
    events = [(t, "IMU", i) for i, t in enumerate(IMU.time)] + [(t, "GPS", i) for i, t in enumerate(GPS.time)]
    for t, kind, i in sorted(events):
        us = round((t + 100) * 1e6)
        if kind == "IMU":
            values = IMU.gx[i], -IMU.gy[i], -IMU.gz[i], IMU.ax[i], -IMU.ay[i], -IMU.az[i]
            lines += [packed("IMU", us, k, *(v + k for v in values)) for k in range(instances)]
        else:
            place = round(GPS.lat[i] * 1e7), round(GPS.lon[i] * 1e7), round(GPS.alt[i] * 100)
            course = np.degrees(np.pi / 2 - GPS.course[i]) % 360
            lines.append(
                packed("GPS", us, 0, status, 0, 2311, 9, 90, *place, GPS.speed[i], course, 0.0, 0.0, 1)
            )
            if accuracy:
                lines.append(packed("GPA", us, 0, 1.0, GPS.std_x[i]))
    return b"".join(lines)


@pytest.mark.parametrize("options", [{}, {"accuracy": False}, {"instances": 2}])
def test_ardupilot(tmp_path: Path, options: dict[str, Any]):
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    (tmp_path / "00000001.BIN").write_bytes(dataflash(**options))
    got = imported(tmp_path / "00000001.BIN").drive
    assert_close(got.imu, IMU, "ax ay az gx gy gz", 2e-6)
    np.testing.assert_allclose(got.imu.time - got.imu.time[0], IMU.time - IMU.time[0], atol=2e-6)
    assert_close(got.gps, GPS, "lat lon", 1e-7)
    assert_close(got.gps, GPS, "speed course", 1e-5)
    assert (got.gps.std_x is not None) == options.get("accuracy", True)


OLD_FORMATS = {
    "GPS": (
        *(130, "BIHBcLLeeEefI"),
        "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T",
    ),
    "IMU": (131, "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
}


@pytest.mark.parametrize("old", [False, True])
def test_ardupilot_as_text(tmp_path: Path, old: bool):
    """`mavlogdump.py` and Mission Planner write the same messages as lines; before 3.3 with times in ms.

    The old TimeMS of GPS is the time of week, and its T the time since the start.
    """
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    formats = OLD_FORMATS if old else FORMATS
    lines += [f"FMT, {n}, 0, {k}, {f}, {c}" for k, (n, f, c) in formats.items() if k != "FMT"]
    events = [(t, "IMU", i) for i, t in enumerate(IMU.time)] + [(t, "GPS", i) for i, t in enumerate(GPS.time)]
    for t, kind, i in sorted(events):
        if kind == "IMU":
            values = (0, IMU.gx[i], -IMU.gy[i], -IMU.gz[i], IMU.ax[i], -IMU.ay[i], -IMU.az[i])
        else:
            course = np.degrees(np.pi / 2 - GPS.course[i]) % 360
            place = GPS.lat[i], GPS.lon[i], GPS.alt[i]
            values = (0, 3, 0, 2311, 9, 0.9, *place, GPS.speed[i], course, 0.0, 0.0, 1)
        values = (round((t + 100) * 1e6), *values)
        if old and kind == "IMU":
            values = (round((t + 100) * 1e3), *values[2:])
        elif old:
            ms = round((t + 100) * 1e3)
            values = (3, 130_040_903 + ms, 1769, 9, 0.9, *place[:2], 1.0, *place[2:], *values[10:13], ms)
        cells = [str(v) if isinstance(v, int) else repr(float(v)) for v in values]
        lines.append(", ".join([kind, *cells]))
    (tmp_path / "00000001.log").write_text("\n".join(lines) + "\n")
    got = imported(tmp_path / "00000001.log").drive
    assert_close(got.imu, IMU, "ax ay az gx gy gz", 2e-6)
    assert_close(got.gps, GPS, "lat lon speed course", 1e-5)


@pytest.mark.parametrize("filler", some([b"\0", b"\xa3"]))
def test_ardupilot_with_bytes_that_are_no_messages(tmp_path: Path, filler: bytes):
    """A card's unwritten pages are skipped; a file that consists of them is refused before it takes seconds."""
    log, path = dataflash(), tmp_path / "log.bin"
    head = len(FORMATS) * 89
    path.write_bytes(log[:head] + 4096 * filler + log[head:])
    assert_close(imported(path).drive.imu, IMU, "ax gz", 1e-5)
    path.write_bytes(log + 2_000_000 * filler)
    with pytest.raises(InputError, match="more than 200000 bytes belong to no message") as error:
        imported(path)
    assert "\n" not in str(error.value)


def test_ardupilot_without_a_fix_or_cut_short_is_one_line(tmp_path: Path):
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    for content in (dataflash(status=1), dataflash()[:2000], b"\xa3\x95\x80" + bytes(99)):
        (tmp_path / "log.bin").write_bytes(content)
        with pytest.raises(InputError) as caught:
            imported(tmp_path / "log.bin")
        assert "\n" not in str(caught.value)


def test_the_formats_that_are_not_read_are_named_with_the_way(tmp_path: Path):
    for name, said in (
        ("log.xlsx", "save it as CSV"),
        ("f.tlog", "mavlogdump"),
        ("x.rtcm3", "RTKLIB"),
        ("a.csv.gz", "unpack it"),
        ("a.feather", "Parquet or CSV"),
        ("run.vbo", "Racelogic"),
        ("can.blf", "DBC"),
        ("b.mtb", "MT Manager"),
        ("ride.mp4", "telemetry"),
        ("run.tcx", "gpsbabel"),
        ("drive.bag.active", "rosbag reindex"),
        ("log.pickle", "from_arrays"),
        ("buoy.nc", "xarray"),
        ("daq.tdms", "nptdms"),
        ("unknown.gsof", "save it as CSV with the program"),
    ):
        (tmp_path / name).write_bytes(b"anything")
        with pytest.raises(InputError, match=said):
            imported(tmp_path / name)


@pytest.mark.parametrize(
    ("begin", "said"),
    [
        (b"     3.04           OBSERVATION DATA    M: Mixed            RINEX VERSION / TYPE\n", "RTKLIB"),
        (b"CDF\x01\0\0\0\0", "xarray"),
        (b"TDSm\x0e\0\0\0", "nptdms"),
        (b"\x1f\x8b\x08\0", "unpack it"),
    ],
)
def test_formats_are_also_named_by_their_first_bytes(tmp_path: Path, begin: bytes, said: str):
    (tmp_path / "site0010.24o").write_bytes(begin + bytes(100))
    with pytest.raises(InputError, match=said):
        imported(tmp_path / "site0010.24o")
