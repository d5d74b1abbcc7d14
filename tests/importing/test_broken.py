"""Damaged and incomplete logs: a drive without the damaged data, or one line that states the damage."""

import json
import struct
import warnings
import zipfile
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from importing.bags import messages, write_mcap
from importing.logs import EPOCH, a_drive, assert_close, imported
from importing.test_datasets import imu_csv, write_comma, write_kitti, write_pos
from importing.test_phones import gnss_logger, ns, phyphox, sensor_logger, zipped
from importing.test_px4 import write_ulog
from importing.test_receivers import nmea, ubx
from sigmaswarm import read_drive, write_drive
from sigmaswarm.errors import DriveWarning, InputError
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.recipe import Recipe
from support import make_drive, quickly

DRIVE = a_drive()
IMU, GPS = DRIVE.imu, DRIVE.gps
LONGEST = 700
"""Characters of a message at most, with a long path in it."""


def refused(said: str, request: Callable[[], Any]) -> None:
    """It ends in one line of a length that can be read."""
    with pytest.raises(InputError) as caught:
        request()
    message = str(caught.value)
    assert said in message and message.isprintable() and len(message) < LONGEST, message


# -- MCAP with messages in JSON


def json_log(path: Path, change: Callable[[int, dict[str, Any]], Any]) -> Path:
    """IMU and fixes as JSON, each message changed; what is no mapping any more is written as it is."""
    from mcap.writer import Writer

    def force(i: int) -> dict[str, Any]:
        names = {
            "linear_acceleration": (IMU.ax, IMU.ay, IMU.az),
            "angular_velocity": (IMU.gx, IMU.gy, IMU.gz),
        }
        return {
            kind: dict(zip("xyz", (float(c[i]) for c in three), strict=True)) for kind, three in names.items()
        }

    def fix(i: int) -> dict[str, Any]:
        return {"latitude": GPS.lat[i], "longitude": GPS.lon[i], "altitude": GPS.alt[i]}

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("any", "jsonschema", b"{}")
        for topic, time, content in (("/imu", IMU.time, force), ("/fix", GPS.time, fix)):
            channel = writer.register_channel(topic, "json", schema)
            for i, t in enumerate(time):
                ns = round(t * 1e9) + EPOCH * 10**9
                stamp = {"header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}}
                changed = change(i, {**stamp, **content(i)})
                data = changed if isinstance(changed, bytes) else json.dumps(changed).encode()
                writer.add_message(channel, ns, data, ns)
        writer.finish()
    return path


@pytest.mark.parametrize("first", [[], [1, 2, 3]])
def test_lists_in_json_may_vary_in_length(tmp_path: Path, first: list[int]):
    log = json_log(tmp_path / "log.mcap", lambda i, m: {**m, "values": [first, [], [4], [1, 2, 3]][i % 4]})
    got = imported(log, maps=["az=where(`values[2]` == 3, 1, 2)"] if first else [])
    assert len(got.drive.imu) <= len(IMU)
    got = imported(
        log, maps=["imu.keep=`values[2]` == 3"]
    )  # whatever the first message has, the column is there
    kept = slice(3, None, 4) if not first else [i for i in range(len(IMU)) if i == 0 or i % 4 in (0, 3)]
    np.testing.assert_allclose(got.drive.imu.ax, IMU.ax[kept])
    assert any(t.table == "/imu" for t in inspect_request(Request(log)).tables)


@pytest.mark.parametrize(
    "odd",
    [
        {},
        [1, 2],
        {"linear_acceleration": {"x": "abc", "y": None, "z": [1]}},
        {"linear_acceleration": {"x": 10**400, "y": 10**30, "z": True}},
        {"header": {"stamp": 1.5}},
        {"header": {"stamp": {"sec": "a", "nanosec": 1}}},
        {"header": {"stamp": {"sec": [1] * 8}}},
        {"header": {"stamp": {"sec": 10**300}}},
    ],
)
def test_an_odd_message_in_json_is_left_out(tmp_path: Path, odd: Any):
    def change(i: int, message: dict[str, Any]) -> Any:
        return message if i != 20 else odd if not isinstance(odd, dict) else {**message, **odd} if odd else {}

    log = json_log(tmp_path / "log.mcap", change)
    got = imported(log)
    left = [i for i in range(len(IMU)) if i != 20]
    np.testing.assert_array_equal(got.drive.imu.ax, IMU.ax[left])
    assert any("left out" in note for note in got.notes), got.notes
    assert inspect_request(Request(log)).tables


@pytest.mark.parametrize(
    "data", [b"nope", b'{"a":"\xff"}', b'{"a":' * 100_000, b'{"v[x]": 1, "": 2, "a.b": {"`": 3}}']
)
def test_data_that_are_no_json_are_one_line(tmp_path: Path, data: bytes):
    for place in (0, 50):
        log = json_log(tmp_path / f"{place}.mcap", lambda i, m, at=place: data if i == at else m)
        if data.startswith(b'{"v'):
            assert len(imported(log).drive.imu) == len(IMU) - 1
        else:
            refused("is cut short or broken", lambda log=log: imported(log))
            if place == 0:
                refused("is cut short or broken", lambda log=log: inspect_request(Request(log)))


def test_a_definition_that_is_no_text_leaves_its_topic_out(tmp_path: Path):
    log = write_mcap(tmp_path / "log.mcap", messages(DRIVE))
    data = log.read_bytes()
    log.write_bytes(data.replace(b"float64 latitude", b"float64 lat\xfftude"))
    refused("", lambda: imported(log))
    assert look_or_line(log)


def look_or_line(log: Path) -> bool:
    try:
        return bool(inspect_request(Request(log)).tables)
    except InputError as error:
        return str(error).isprintable()


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_a_flipped_bit_in_an_mcap_is_found(tmp_path: Path, compression: str, monkeypatch: pytest.MonkeyPatch):
    """Its checksums are there to be looked at: values must not change without a word."""
    import mcap.writer

    plain = mcap.writer.Writer
    kind = mcap.writer.CompressionType[compression]
    monkeypatch.setattr(mcap.writer, "Writer", lambda file: plain(file, compression=kind))
    log = write_mcap(tmp_path / "log.mcap", messages(DRIVE))
    data = bytearray(log.read_bytes())
    data[len(data) // 3] ^= 1
    log.write_bytes(data)
    refused("is cut short or broken", lambda: imported(log))


# -- zips


def damaged(path: Path, marks: tuple[bytes, bytes], places: tuple[int, int], value: int, add: bool) -> None:
    """Change a byte of every header of a zip: beside the files, and in the directory at its end."""
    data = bytearray(path.read_bytes())
    for mark, place in zip(marks, places, strict=True):
        at = -1
        while (at := data.find(mark, at + 1)) >= 0:
            data[at + place] = data[at + place] | value if add else value
    path.write_bytes(data)


HEADERS = (b"PK\x03\x04", b"PK\x01\x02")


def test_an_encrypted_zip(tmp_path: Path):
    log = zipped(phyphox(tmp_path / "export"))
    damaged(log, HEADERS, (6, 8), 1, True)
    refused(".csv, which is encrypted; unpack the zip", lambda: imported(log))


def test_a_zip_of_an_unknown_method(tmp_path: Path):
    log = zipped(phyphox(tmp_path / "export"))
    damaged(log, HEADERS, (8, 10), 97, False)
    refused("is damaged or not a zip file", lambda: imported(log))


@pytest.mark.parametrize("place", [0.1, 0.3, 0.6, 0.9, 0.999])
def test_a_zip_with_a_damaged_byte(tmp_path: Path, place: float):
    log = zipped(phyphox(tmp_path / "export"))
    whole = log.read_bytes()
    for i in range(8):
        data = bytearray(whole)
        data[int(len(data) * place) + i] ^= 0xFF
        log.write_bytes(data)
        try:
            got = imported(log).drive
        except InputError as error:
            assert str(error).isprintable() and len(str(error)) < LONGEST
        else:  # a byte that says nothing of the wanted files
            assert_close(got.imu, IMU, "ax ay gz", 1e-9)


def test_nothing_is_unpacked_that_nobody_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    log = zipped(phyphox(tmp_path / "export"))
    with zipfile.ZipFile(log, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("Camera/video.mp4", bytes(50_000_000))
        archive.writestr("Camera/Accelerometer.csv", "no,such,table\n1,2,3\n")
        archive.writestr("../../evil.csv", "a,b\n")
        link = zipfile.ZipInfo("Location2.csv")
        link.external_attr = 0o120777 << 16
        archive.writestr(link, "/etc/passwd")
    opened: list[str] = []
    before = zipfile.ZipFile.open

    def watched(self: zipfile.ZipFile, name: Any, *rest: Any, **more: Any) -> Any:
        opened.append(getattr(name, "filename", name))
        return before(self, name, *rest, **more)

    monkeypatch.setattr(zipfile.ZipFile, "open", watched)
    assert_close(imported(log).drive.imu, IMU, "ax ay az", 1e-9)
    assert sorted(opened) == ["Accelerometer.csv", "Gyroscope.csv", "Location.csv"]


def test_a_table_in_a_zip_is_named_by_the_zip(tmp_path: Path):
    folder = phyphox(tmp_path / "export")
    (folder / "Gyroscope.csv").write_bytes(b'"Time (s)","Gyroscope x (rad/s)\n0,1\n')
    refused(f"{tmp_path / 'export.zip'}/Gyroscope.csv: a quote", lambda: imported(zipped(folder)))


# -- receivers


def test_ubx_without_a_calendar_day_or_cut_short(tmp_path: Path):
    stream = [ubx(i) for i in range(len(GPS))]
    stream[3] = ubx(3, month=0)
    stream[5] = ubx(5, day=0)
    stream[7] = ubx(7, hour=25)
    stream[9] = ubx(9, year=34791)
    stream[11] = short_ubx(10)
    (tmp_path / "log.ubx").write_bytes(b"".join(stream))
    got = imported(imu_csv(tmp_path), gps=tmp_path / "log.ubx")
    left = [i for i in range(len(GPS)) if i not in (3, 5, 7, 9, 11)]
    np.testing.assert_allclose(got.drive.gps.time, GPS.time[left], atol=1e-6)
    said = " ".join(got.notes)
    assert "4 damaged messages" in said and "1 messages without a valid date" in said, got.notes


def short_ubx(length: int) -> bytes:
    """A NAV-PVT message with a shorter payload than the receiver's description has, and a right checksum."""
    body = b"\x01\x07" + struct.pack("<H", length) + bytes(length)
    a = b = 0
    for byte in body:
        a = (a + byte) & 255
        b = (b + a) & 255
    return b"\xb5\x62" + body + bytes((a, b))


def checked(body: str) -> bytes:
    """A sentence with its checksum."""
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n".encode()


def test_nmea_with_fields_missing(tmp_path: Path):
    odd = (
        "GNGGA",
        "GNGGA,120000.00",
        "GNRMC",
        "GNRMC,120000.00,A",
        "GNGST,1",
        "GNGNS,120000.00",
        "GNZDA",
        "GNVTG",
    )
    odd += ("GNZDA,120000.00,32,13,2023", "GNZDA,120000.00,01,01,9999", "GNZDA,,,,", "GNGGA,,,,,,,,,,,,,,")
    lines = [line for i in range(len(GPS)) for line in (*nmea(i), checked(odd[i % len(odd)]))]
    (tmp_path / "log.nmea").write_bytes(b"".join(lines))
    got = imported(imu_csv(tmp_path), gps=tmp_path / "log.nmea").drive
    at = np.searchsorted(GPS.time, got.gps.time - 0.006)
    assert len(at) > 20
    np.testing.assert_allclose(got.gps.lat, GPS.lat[at], atol=1e-7)
    np.testing.assert_allclose(got.gps.lon, GPS.lon[at], atol=1e-7)


@pytest.mark.parametrize("write", [write_pos, gnss_logger])
def test_a_header_that_names_a_column_twice(tmp_path: Path, write: Callable[[Path], Path]):
    log = write(tmp_path / ("log.pos" if write is write_pos else "log.txt"))
    text = log.read_text()
    text = text.replace(" sde(m)", " sdn(m)", 1).replace("UncalAccelYMps2", "UncalAccelXMps2", 1)
    log.write_text(text)
    request = {"source": imu_csv(tmp_path), "gps": log} if write is write_pos else {"source": log}
    refused("appears twice", lambda: imported(**request))


def test_a_time_of_day_that_is_none_is_told_with_its_row(tmp_path: Path):
    log = write_pos(tmp_path / "rtk.pos")
    lines = log.read_text().splitlines()
    cells = lines[9].split(" ")
    lines[9] = " ".join([cells[0], "99:10:11.000", *cells[2:]])
    log.write_text("\n".join(lines))
    refused("row 10", lambda: imported(imu_csv(tmp_path), gps=log))


# -- times


@pytest.mark.parametrize("system", ["android", "ios"])
def test_times_beyond_64_bits_are_left_out(tmp_path: Path, system: str):
    folder = sensor_logger(tmp_path / "export", system)
    lines = (folder / "Gyroscope.csv").read_text().splitlines()
    lines[20] = "1" + lines[20]
    lines[21] = "9" * 30 + "," + lines[21].partition(",")[2]
    (folder / "Gyroscope.csv").write_text("\n".join(lines))
    got = imported(folder)
    assert any(
        "2 rows of Gyroscope.csv are left out, since the time is missing" in note for note in got.notes
    ), got.notes
    np.testing.assert_allclose(got.drive.imu.ax, IMU.ax, atol=1e-9)
    assert inspect_request(Request(folder)).tables


def test_times_of_px4_beyond_64_bits_are_left_out(tmp_path: Path):
    write_ulog(tmp_path / "f.ulg")
    whole = imported(tmp_path / "f.ulg").drive
    data = bytearray((tmp_path / "f.ulg").read_bytes())
    stamp = struct.pack("<Q", round(whole.imu.time[50] * 1e6))
    candidates = [at for at in range(len(data) - 8) if data[at : at + 8] == stamp]
    assert candidates
    for at in candidates:
        data[at : at + 8] = struct.pack("<Q", 2**64 - 7)
    (tmp_path / "f.ulg").write_bytes(data)
    got = imported(tmp_path / "f.ulg")
    assert any("since the time is missing" in note for note in got.notes)
    np.testing.assert_array_equal(got.drive.imu.ax, np.delete(whole.imu.ax, 50))
    assert inspect_request(Request(tmp_path / "f.ulg")).tables


def test_times_in_a_wrong_unit_do_not_wrap_round(tmp_path: Path):
    """ns taken as ms leave 64 bits: they were other times, and nobody was told."""
    table = {"stamp": ns(IMU.time), "ax": IMU.ax, "ay": IMU.ay, "gz": IMU.gz, "x": IMU.time, "y": IMU.time}
    pl.DataFrame(table).write_csv(tmp_path / "log.csv")
    refused('write --time "stamp*1e-9"', lambda: imported(tmp_path / "log.csv", time="stamp*1e-3"))
    assert len(imported(tmp_path / "log.csv", time="stamp*1e-9").drive.imu) == len(IMU)


@pytest.mark.parametrize("unit", quickly([("ms",), ("us",), ("ns",)], lambda unit: unit == "ms"))
def test_dates_of_a_parquet_keep_their_unit(tmp_path: Path, unit: str):
    stamp = pl.Series(ns(IMU.time) // 1000).cast(pl.Datetime("us")).cast(pl.Datetime(unit))
    table = {"t": stamp, "ax": IMU.ax, "ay": IMU.ay, "gz": IMU.gz, "x": IMU.time, "y": 0 * IMU.time}
    pl.DataFrame(table).write_parquet(tmp_path / "log.parquet")
    got = imported(tmp_path / "log.parquet").drive
    np.testing.assert_allclose(np.diff(got.imu.time), np.diff(IMU.time), atol=2e-6)


@pytest.mark.parametrize("offset", [1e300, float("inf"), float("nan"), -1e10])
def test_an_offset_of_centuries(tmp_path: Path, offset: float):
    phyphox(tmp_path / "export")
    refused("offset", lambda: imported(tmp_path / "export", recipe=Recipe(gps_offset_s=offset)))


def test_fixes_are_not_made_of_a_truth_without_end(tmp_path: Path):
    log = write_kitti(tmp_path, make_drive(duration=12.0, imu_rate=10.0))
    lines = (log / "oxts" / "timestamps.txt").read_text().splitlines()
    pauses = [timedelta(minutes=59 * max(k - 80, 0)) for k in range(len(lines))]
    later = [
        str(datetime.fromisoformat(line[:26]) + pause) for line, pause in zip(lines, pauses, strict=True)
    ]
    (log / "oxts" / "timestamps.txt").write_text("\n".join(later))
    recipe = Recipe(gps_from_truth=(1000.0, 1.0))
    refused("would make more than", lambda: imported(log, recipe=recipe))


# -- texts that are none


@pytest.mark.parametrize("place", ["oxts/timestamps.txt", "oxts/data/0000000005.txt"])
def test_kitti_that_is_no_text(tmp_path: Path, place: str):
    log = write_kitti(tmp_path, make_drive(duration=12.0, imu_rate=10.0))
    content = (log / place).read_bytes()
    (log / place).write_bytes(content[:5] + b"\xb1" + content[6:])
    refused("unpack the drive again", lambda: imported(log))


@pytest.mark.parametrize("name", ["²", "9" * 200, "-1", "1e3"])
def test_kitti_with_a_text_of_no_number(tmp_path: Path, name: str):
    log = write_kitti(tmp_path, make_drive(duration=12.0, imu_rate=10.0))
    (log / "oxts" / "data" / "0000000005.txt").rename(log / "oxts" / "data" / f"{name}.txt")
    refused("no line for this file", lambda: imported(log))


def test_kitti_beyond_what_ns_can_count(tmp_path: Path):
    log = write_kitti(tmp_path, make_drive(duration=12.0, imu_rate=10.0))
    times = log / "oxts" / "timestamps.txt"
    times.write_text(times.read_text().replace("2023-", "1500-"))
    refused("outside the years 1678 to 2262", lambda: imported(log))


def test_kitti_with_a_time_zone(tmp_path: Path):
    log = write_kitti(tmp_path, make_drive(duration=12.0, imu_rate=10.0))
    times = log / "oxts" / "timestamps.txt"
    first, *rest = times.read_text().splitlines()
    times.write_text("\n".join([f"{first[:19]}Z", *rest]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refused("timezone", lambda: imported(log))


def test_a_stamp_years_before_all_others_costs_them_no_digit(tmp_path: Path):
    """The clock begins with the log, as if that fix were not there."""
    epoch, time = 1_683_000_000, np.arange(0, 30, 0.01)
    zero = 0 * time
    ns = np.int64(epoch) * 10**9 + np.round(time * 1e9).astype(np.int64)
    imu = pl.DataFrame({"stamp": ns, "ax": zero, "ay": zero, "gz": zero})
    gps = pl.DataFrame({"stamp": ns[::20], "x": 10 * time[::20], "y": zero[::20]})
    (tmp_path / "log").mkdir()
    imu.write_csv(tmp_path / "log" / "imu.csv")
    stamps = np.where(np.arange(len(gps)) == 3, 17_000_000, gps["stamp"])
    gps.with_columns(stamp=stamps).write_csv(tmp_path / "log" / "gps.csv")
    options = {"form": "csv", "time": "stamp*1e-9"}
    drive = imported(tmp_path / "log", **options).drive
    np.testing.assert_allclose(drive.imu.time, time, rtol=0, atol=1e-12)
    assert len(drive.gps) == len(gps) - 1


@pytest.mark.parametrize(("encoding", "cut"), [("utf-32", 0), ("utf-16", 1)])
def test_tables_in_another_encoding(tmp_path: Path, encoding: str, cut: int):
    """UTF-16 is read (`test_dialects`), unless its last byte is missing."""
    text = "t,ax,ay,gz,x,y,é\n" + "\n".join(f"{i / 100},0,0,0,{i},0,é" for i in range(300)) + "\n"
    content = text.encode(encoding)
    (tmp_path / "log.csv").write_bytes(content[: len(content) - cut])
    refused("log.csv", lambda: imported(tmp_path / "log.csv", form="csv"))


# -- comma2k19


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("global_pose/frame_positions", (1201, 2)),
        ("global_pose/frame_positions", (5,)),
        ("global_pose/frame_orientations", (1201, 3)),
        ("global_pose/frame_velocities", (1201,)),
        ("global_pose/frame_times", (1201, 1)),
        ("global_pose/frame_times", (0,)),
        ("processed_log/IMU/gyro/t", ()),
        ("processed_log/IMU/gyro/t", (1200, 1)),
        ("processed_log/IMU/gyro/value", (1200, 2)),
    ],
)
def test_comma_with_an_array_of_another_shape(tmp_path: Path, name: str, shape: tuple[int, ...]):
    log = write_comma(tmp_path)
    with (log / name).open("wb") as file:
        np.save(file, np.ones(shape))
    refused("unpack the segment again", lambda: imported(log))


HEAD = "{{'descr': {!r}, 'fortran_order': False, 'shape': {}, }}"


@pytest.mark.parametrize(
    "header",
    [
        HEAD.format("<f8", s)
        for s in ("(1000000000000,)", "(3000000000,)", "(-1,)", "(2, 2, 2)", "(((", "(0,)")
    ]
    + [HEAD.format(d, "(10,)") for d in ("|S10", "<U4", "<M8[s]", "<c16", "|O", "no")]
    + ["{'descr", "", "[" * 5000, "9" * 5000],
)
def test_comma_with_a_header_of_another_kind(tmp_path: Path, header: str):
    log = write_comma(tmp_path)
    text = header.encode().ljust(117) + b"\n"
    content = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(800)
    (log / "processed_log/IMU/gyro/t").write_bytes(content)
    refused("gyro", lambda: imported(log))


# -- tables


ROWS = [f"{i / 100},0,0,0,{i},0" for i in range(300)]


def table(folder: Path, *lines: str) -> Path:
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return folder / "log.csv"


@pytest.mark.parametrize(
    ("header", "other"),
    [("t,ax,ay,gz,x,y,ax ", "ax_duplicated_0"), ("t,ax,ay,gz,x,y,ax", "ax_duplicated_0")],
)
def test_a_name_with_and_without_a_space(tmp_path: Path, header: str, other: str):
    log = table(tmp_path, header, *(row + ",7" for row in ROWS))
    got = imported(log)
    said = f"column 'ax' appears twice; the second is called '{other}'"
    assert any(said in note for note in got.notes), got.notes
    assert not got.drive.imu.ax.any()
    assert np.all(imported(log, maps=[f"ax={other}"]).drive.imu.ax == 7)


def test_columns_without_names(tmp_path: Path):
    log = table(tmp_path, "t,ax,ay,gz,x,y,, ,\t", *(row + ",1,2,3" for row in ROWS))
    got = imported(log)
    assert len(got.drive.imu) == 300 and not any("twice" in note for note in got.notes)


@pytest.mark.long
def test_one_name_thousands_of_times(tmp_path: Path):
    """Told in one line; finding other names took a minute."""
    log = table(tmp_path, "t,ax,ay,gz,x,y" + ",ax" * 2000, *(row + ",7" * 2000 for row in ROWS))
    notes = [note for note in imported(log).notes if "ax" in note]
    assert len(notes) == 1
    called = "the others are called 'ax_duplicated_0', 'ax_duplicated_1'"
    assert f"column 'ax' appears 2001 times; {called}" in notes[0]


def test_no_complete_row(tmp_path: Path):
    rows = [f"{i / 100},0,0,0,{i if i % 2 else ''},{'' if i % 2 else i}" for i in range(300)]
    refused("no row has values in all columns", lambda: imported(table(tmp_path, "t,ax,ay,gz,x,y", *rows)))


def test_tables_without_a_time_in_common(tmp_path: Path):
    sensor_logger(tmp_path / "export", "android")
    late = pl.read_csv(tmp_path / "export" / "Gyroscope.csv").with_columns(pl.col("time") + 10**12)
    late.write_csv(tmp_path / "export" / "Gyroscope.csv")
    refused("do not overlap in time", lambda: imported(tmp_path / "export"))


@pytest.mark.parametrize("row", [150, 299])
def test_an_unclosed_quote_in_a_table(tmp_path: Path, row: int):
    rows = [r + (',"ok' if i == row else ",ok") for i, r in enumerate(ROWS)]
    refused("is not closed", lambda: imported(table(tmp_path, "t,ax,ay,gz,x,y,note", *rows)))


def test_quotes_that_are_closed_may_hold_line_breaks(tmp_path: Path):
    rows = [f'{r},"o\nk, ""so"""' for r in ROWS]
    assert len(imported(table(tmp_path, "t,ax,ay,gz,x,y,note", *rows)).drive.imu) == 300


@pytest.mark.parametrize("lone", ["vx", "vy"])
def test_a_velocity_of_one_axis_is_left_out(tmp_path: Path, lone: str):
    got = imported(table(tmp_path, f"t,ax,ay,gz,x,y,{lone}", *(row + ",1" for row in ROWS)))
    assert got.drive.gps.speed is None
    assert any(f"gps: {lone} is left out" in note for note in got.notes)


def test_an_endless_cell_is_shown_cut(tmp_path: Path):
    rows = [*ROWS[:100], "1.005,0,0,0,1" + "[/x]" * 5000 + ",0", *ROWS[101:]]
    refused(
        "row 101 of the data, column x: '1[/x]", lambda: imported(table(tmp_path, "t,ax,ay,gz,x,y", *rows))
    )


def test_names_that_steer_a_terminal_are_shown_escaped(tmp_path: Path):
    log = table(tmp_path, "t,ax,ay,gz,x,y,\x1b[2J\x9b31m" + "n" * 5000, *(row + ",a" for row in ROWS))
    refused("\\x1b[2J", lambda: imported(log, maps=["az=nope"]))


def test_categories_are_read_by_their_names(tmp_path: Path):
    rows = {"t": IMU.time, "ax": IMU.ax, "ay": IMU.ay, "gz": IMU.gz, "x": IMU.time, "y": 0 * IMU.time}
    mode = pl.Series(["3", "7"] * 300 + ["3"], dtype=pl.Categorical)
    frame = pl.DataFrame(rows).with_columns(az=mode, tags=pl.lit([1, 2]))
    frame.write_parquet(tmp_path / "log.parquet")
    got = imported(tmp_path / "log.parquet").drive
    np.testing.assert_array_equal(got.imu.az[:4], [3, 7, 3, 7])
    refused("can't be converted to numbers", lambda: imported(tmp_path / "log.parquet", maps=["gx=tags"]))
    assert inspect_request(Request(tmp_path / "log.parquet")).tables


# -- drives


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_drive(make_drive(duration=20.0), tmp_path / "good")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("a = " + "[" * 3000 + "]" * 3000, "not valid TOML"),
        ("a = " + "9" * 5000, "not valid TOML"),
        ("gps_std_m = []", "gps_std_m = [] is not valid"),
        ("gps_std_m = [1.0]", "is not valid"),
        ("gps_std_m = 0x" + "f" * 5000, "is not valid"),
        ("gps_lever_arm_m = [1, 0x" + "f" * 400 + "]", "is not valid"),
        ("origin = [50, 8, 0x" + "f" * 400 + "]", "is not a position"),
        ("origin = [50, 8, 1e300]", "is not a position"),
        ("frame = [[1], [2]]", "is unknown"),
        ('frame = "' + "x" * 5000 + '"', "is unknown"),
    ],
)
def test_a_description_that_is_none(drive: Path, line: str, said: str):
    text = (drive / "drive.toml").read_text()
    key = line.partition(" ")[0]
    kept = [old for old in text.splitlines() if not old.startswith(key)]
    (drive / "drive.toml").write_text("\n".join([*kept, line]))
    refused(said, lambda: read_drive(drive))
    if key in ("a", "origin"):
        (drive / "r.toml").write_text(line)
        refused("r.toml", lambda: Recipe.load(drive / "r.toml"))


@pytest.mark.parametrize("file", ["imu.csv", "gps.csv"])
@pytest.mark.parametrize("unknown", [True, False])
def test_an_unclosed_quote_in_a_drive(drive: Path, file: str, unknown: bool):
    """In a column that is not read it would swallow all rows after it, and nobody would see."""
    lines = (drive / file).read_text().splitlines()
    lines = [line + (",note" if i == 0 else ",ok") for i, line in enumerate(lines)]
    row = len(lines) // 2
    lines[row] = lines[row].replace(",ok", ',"ok') if unknown else lines[row].replace(",", ',"', 1)
    (drive / file).write_text("\n".join(lines) + "\n")
    refused(f"{file}", lambda: read_drive(drive))


def test_cells_and_columns_without_end_in_a_drive(drive: Path):
    whole = (drive / "gps.csv").read_text()
    for old, new in (
        ("t,x,y", "t,x,y" + "y" * 9000),
        ("t,x,y", "\x1b[2Jt,x,y"),
        ("\n0", "\n" + "true" * 9000),
    ):
        (drive / "gps.csv").write_text(whole.replace(old, new, 1))
        refused("gps.csv", lambda: read_drive(drive))


def test_a_cell_beyond_the_csv_modules_limit(drive: Path):
    lines = (drive / "gps.csv").read_text().splitlines()
    lines[5] = '"' + "0" * 200_000 + "," + lines[5]
    (drive / "gps.csv").write_text("\n".join(lines) + "\n")
    refused("gps.csv", lambda: read_drive(drive))


@pytest.mark.parametrize("unit", [1e9, 1e6])
def test_times_in_another_unit_cost_nothing(tmp_path: Path, unit: float):
    """A grid over their span would be of 4 billion windows; the drive is read, with a warning."""
    good = make_drive(duration=40.0, truth=False)
    imu = type(good.imu)(good.imu.time * unit, good.imu.ax, good.imu.ay, good.imu.gz)
    gps = type(good.gps)(good.gps.time * unit, good.gps.x, good.gps.y)
    folder = write_drive(type(good)("d", imu, gps), tmp_path / "d")
    with pytest.warns(DriveWarning, match="as if t were in"):
        assert len(read_drive(folder).imu) == len(imu)


@pytest.mark.parametrize("content", [b"", b"\n\n \n", b"\xef\xbb\xbf\r\n"])
def test_an_empty_file_is_named(tmp_path: Path, content: bytes):
    log = tmp_path / "log"
    log.mkdir()
    imu_csv(log)
    (log / "gps.csv").write_bytes(content)
    refused("no position fixes found in imu.csv; gps.csv is empty; copy it again", lambda: imported(log))
    refused("gps.csv is empty; copy the log again", lambda: imported(log / "imu.csv", gps=log / "gps.csv"))
