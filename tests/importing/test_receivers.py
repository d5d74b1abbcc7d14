"""u-blox and NMEA streams beside a table of IMU samples, written with pyubx2 and pynmeagps."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from importing.logs import EPOCH, a_drive, assert_close, imported
from importing.test_datasets import imu_csv
from sigmaswarm.errors import InputError
from sigmaswarm.importing.recipe import Recipe

pyubx2 = pytest.importorskip("pyubx2", reason="pyubx2 is not installed")
pynmeagps = pytest.importorskip("pynmeagps", reason="pynmeagps is not installed")

DRIVE = a_drive()
GPS = DRIVE.gps
EAST, NORTH = GPS.speed * np.cos(GPS.course), GPS.speed * np.sin(GPS.course)


def moment(i: int, begin: int = EPOCH) -> datetime:
    return datetime.fromtimestamp(round(GPS.time[i] + begin, 2), UTC)


def ubx(i: int, **changed) -> bytes:
    """A NAV-PVT message of one fix; its time is rounded to the s, with the rest in ``nano`` of either sign."""
    whole = round(GPS.time[i] + EPOCH)
    t = datetime.fromtimestamp(whole, UTC)
    nano = round((GPS.time[i] + EPOCH - whole) * 1e9)
    values = {
        **{
            "year": t.year,
            "month": t.month,
            "day": t.day,
            "hour": t.hour,
            "min": t.minute,
            "second": t.second,
        },
        **{"nano": nano, "validDate": 1, "validTime": 1, "fixType": 3, "gnssFixOk": 1},
        **{
            "lat": GPS.lat[i],
            "lon": GPS.lon[i],
            "height": round(GPS.alt[i] * 1e3),
            "hAcc": round(GPS.std_x[i] * 1e3),
        },
        **{"velN": round(NORTH[i] * 1e3), "velE": round(EAST[i] * 1e3), "gSpeed": round(GPS.speed[i] * 1e3)},
    }
    return pyubx2.UBXMessage("NAV", "NAV-PVT", pyubx2.GET, **(values | changed)).serialize()


def test_ubx(tmp_path: Path):
    other = pyubx2.UBXMessage(
        "NAV", "NAV-CLOCK", pyubx2.GET, iTOW=0, clkB=1, clkD=2, tAcc=3, fAcc=4
    ).serialize()
    text = pynmeagps.NMEAMessage(
        "GN", "TXT", pynmeagps.GET, numMsg=1, msgNum=1, msgType=1, text="hello"
    ).serialize()
    stream = b"".join(other + ubx(i) + text for i in range(len(GPS)))
    (tmp_path / "log.ubx").write_bytes(stream)
    got = imported(imu_csv(tmp_path), gps=tmp_path / "log.ubx").drive
    assert_close(got.gps, GPS, "time", 1e-6)
    assert_close(got.gps, GPS, "lat lon", 1e-7)
    assert_close(got.gps, GPS, "alt", 1e-3)
    np.testing.assert_allclose(got.gps.std_x, GPS.std_x / np.sqrt(2), atol=1e-3)
    np.testing.assert_allclose(got.gps.speed * np.exp(1j * got.gps.course), EAST + 1j * NORTH, atol=2e-3)


@pytest.mark.parametrize("length", [0, 4, 300, 65535])
def test_ubx_with_a_length_that_is_wrong_loses_one_message(tmp_path: Path, length: int):
    messages = [ubx(i) for i in range(len(GPS))]
    messages[7] = messages[7][:4] + length.to_bytes(2, "little") + messages[7][6:]
    (tmp_path / "log.ubx").write_bytes(b"".join(messages))
    got = imported(imu_csv(tmp_path), gps=tmp_path / "log.ubx")
    assert len(got.drive.gps) == len(GPS) - 1
    assert "log.ubx: 1 damaged messages are skipped" in got.notes


def test_ubx_without_a_fix_damaged_or_cut_short(tmp_path: Path):
    messages = [ubx(i, **({"fixType": 0} if i % 5 == 0 else {})) for i in range(len(GPS))]
    messages[7] = messages[7][:40] + b"\x00\x01" + messages[7][42:]
    messages[11] = ubx(11, validDate=0)
    (tmp_path / "log.ubx").write_bytes(b"".join(messages)[:-30])
    got = imported(imu_csv(tmp_path), gps=tmp_path / "log.ubx")
    left = [i for i in range(len(GPS) - 1) if i % 5 and i not in (7, 11)]
    np.testing.assert_allclose(got.drive.gps.time, GPS.time[left], atol=1e-6)
    said = " ".join(got.notes)
    assert "2 damaged messages" in said and "1 messages without a valid date" in said


def nmea(i: int, begin: int = EPOCH, talker: str = "GN") -> list[bytes]:
    """The sentences of one fix: GGA, GST, RMC, GLL."""
    t = moment(i, begin)
    clock = f"{t:%H%M%S}.{t.microsecond // 10000:02d}"
    course = np.degrees(np.pi / 2 - GPS.course[i]) % 360
    place = {"lat": GPS.lat[i], "lon": GPS.lon[i], "NS": "N", "EW": "E"}
    sentences = [
        ("GGA", {**place, "quality": 1, "numSV": 9, "HDOP": 0.8, "alt": round(GPS.alt[i] - 48.0, 3), "altUnit": "M",
                 "sep": 48.0, "sepUnit": "M"}),
        ("GST", {"rangeRms": 1.0, "stdLat": round(GPS.std_y[i], 3), "stdLong": round(GPS.std_x[i], 3)}),
        ("RMC", {**place, "status": "A", "spd": round(GPS.speed[i] * 3600 / 1852, 3), "cog": round(course, 2),
                 "date": f"{t:%Y-%m-%d}"}),
        ("GLL", {**place, "status": "A", "posMode": "A"}),
    ]  # fmt: skip
    return [
        pynmeagps.NMEAMessage(talker, kind, pynmeagps.GET, hpnmeamode=1, time=clock, **values).serialize()
        for kind, values in sentences
    ]


def test_nmea(tmp_path: Path):
    lines = [line for i in range(len(GPS)) for line in nmea(i)]
    (tmp_path / "log.nmea").write_bytes(b"".join(lines))
    got = imported(imu_csv(tmp_path), gps=tmp_path / "log.nmea").drive
    kept = slice(1, None)  # the date is known from the first RMC on, at the end of the first fix
    for name, atol in (
        ("time", 0.006),
        ("lat", 1e-7),
        ("lon", 1e-7),
        ("alt", 1e-2),
        ("std_x", 1e-3),
        ("std_y", 1e-3),
    ):
        wanted = getattr(GPS, name)[len(GPS) - len(got.gps) :]
        np.testing.assert_allclose(getattr(got.gps, name), wanted, atol=atol, err_msg=name)
    assert len(got.gps) >= len(GPS.select(kept))
    velocity = (EAST + 1j * NORTH)[len(GPS) - len(got.gps) :]
    np.testing.assert_allclose(got.gps.speed * np.exp(1j * got.gps.course), velocity, atol=5e-3)


def test_nmea_over_midnight(tmp_path: Path):
    """The date comes once, in the first fix; the log runs past midnight."""
    midnight = EPOCH - EPOCH % 86400 - 6
    lines: list[bytes] = []
    for i in range(len(GPS)):
        gga, gst, rmc, _ = nmea(i, midnight)
        lines += [gga, gst, rmc] if i == 0 else [gga, gst]
    (tmp_path / "log.nmea").write_bytes(b"".join(lines))
    table = imu_csv(tmp_path)
    got = imported(table, gps=tmp_path / "log.nmea", time=None, maps=[f"imu.t=t-{EPOCH - midnight}"]).drive
    assert np.all(np.diff(got.gps.time) < 0.5)
    np.testing.assert_allclose(
        got.gps.time[-1] + got.metadata["time_origin_s"], GPS.time[-1] + midnight, atol=0.006
    )


def test_nmea_damaged(tmp_path: Path):
    lines = [line for i in range(len(GPS)) for line in nmea(i)]
    lines[30] = lines[30].replace(b"5", b"6", 1)  # its checksum no longer fits
    lines[-1] = lines[-1][:20]
    (tmp_path / "log.nmea").write_bytes(b"garbage \xff\n".join([b"".join(lines[:50]), b"".join(lines[50:])]))
    got = imported(imu_csv(tmp_path), gps=tmp_path / "log.nmea")
    assert any("3 damaged lines" in note for note in got.notes)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("log.ubx", b"", "is empty"),
        ("log.ubx", b"no ubx here", "no UBX messages"),
        ("log.ubx", ubx(0)[:50], "complete messages: none"),
        ("log.ubx", b"".join(ubx(i, fixType=0) for i in range(20)), "no usable row"),
        ("log.nmea", b"", "is empty"),
        ("log.nmea", b"\xff\x00\n" * 9, "no complete NMEA sentence"),
        ("log.nmea", b"".join(line for i in range(20) for line in nmea(i)[:2]), "--gps-offset"),
    ],
)
def test_broken(tmp_path: Path, name: str, content: bytes, said: str):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        imported(imu_csv(tmp_path), gps=tmp_path / name)


@pytest.mark.parametrize(
    ("taken", "begin"),
    [((0,), EPOCH), ((0, 1), EPOCH), ((3,), EPOCH), ((0,), EPOCH - EPOCH % 86400 - 6)],
)
def test_nmea_without_a_date_counts_from_midnight(tmp_path: Path, taken: tuple[int, ...], begin: int):
    lines = [nmea(i, begin)[k] for i in range(len(GPS)) for k in taken]
    (tmp_path / "rtk.nmea").write_bytes(b"".join(lines))
    table = imu_csv(tmp_path)
    got = imported(table, gps=tmp_path / "rtk.nmea", maps=[f"imu.t=t - {EPOCH} + {begin % 86400}"])
    np.testing.assert_allclose(got.drive.gps.time, GPS.time + begin % 86400, atol=0.006)
    assert any("times count from midnight UTC; --gps-offset" in note for note in got.notes)
    midnight = EPOCH - begin % 86400
    moved = imported(table, gps=tmp_path / "rtk.nmea", recipe=Recipe(gps_offset_s=midnight))
    np.testing.assert_allclose(moved.drive.gps.time, GPS.time, atol=0.006)


def ubx6(i: int, *, velocity: bool, week: bool) -> bytes:
    """The messages of one fix of a u-blox 6: NAV-POSLLH, NAV-SOL, NAV-VELNED."""
    leaps = 18
    tow = round((GPS.time[i] + EPOCH + leaps - 315964800) * 1e3)
    at = {"iTOW": tow % 604_800_000}
    place = {
        "lat": GPS.lat[i],
        "lon": GPS.lon[i],
        "height": round(GPS.alt[i] * 1e3),
        "hAcc": round(GPS.std_x[i] * 1e3),
    }
    messages = [pyubx2.UBXMessage("NAV", "NAV-POSLLH", pyubx2.GET, **at, **place)]
    if week:
        messages.append(
            pyubx2.UBXMessage("NAV", "NAV-SOL", pyubx2.GET, **at, week=tow // 604_800_000, gpsFix=3)
        )
    if velocity:
        motion = {"velN": round(NORTH[i] * 1e2), "velE": round(EAST[i] * 1e2)}
        messages.append(pyubx2.UBXMessage("NAV", "NAV-VELNED", pyubx2.GET, **at, **motion))
    return b"".join(m.serialize() for m in messages)


@pytest.mark.parametrize(("velocity", "week"), [(True, True), (False, True), (True, False)])
def test_ublox_6(tmp_path: Path, velocity: bool, week: bool):
    (tmp_path / "neo.ubx").write_bytes(
        b"".join(ubx6(i, velocity=velocity, week=week) for i in range(len(GPS)))
    )
    ahead = 0 if week else (EPOCH + 18 - 315964800) // 604_800 * 604_800 + 315964800 - 18
    got = imported(imu_csv(tmp_path), gps=tmp_path / "neo.ubx", recipe=Recipe(gps_offset_s=ahead)).drive.gps
    np.testing.assert_allclose(got.time, GPS.time, atol=1e-3)
    np.testing.assert_allclose(got.lat, GPS.lat, atol=1e-7)
    assert (got.speed is not None) == velocity
    if velocity:
        np.testing.assert_allclose(got.speed * np.exp(1j * got.course), EAST + 1j * NORTH, atol=2e-2)


def test_ublox_6_with_utc_instead_of_the_week(tmp_path: Path):
    leaps, day = 18, datetime.fromtimestamp(EPOCH, UTC)
    when = {n: getattr(day, n) for n in ("year", "month", "day", "hour")} | {
        "min": day.minute,
        "sec": day.second,
    }
    tow = round((EPOCH + leaps - 315964800) * 1e3) % 604_800_000
    utc = pyubx2.UBXMessage("NAV", "NAV-TIMEUTC", pyubx2.GET, iTOW=tow, **when, validUTC=1).serialize()
    fixes = b"".join(ubx6(i, velocity=False, week=False) for i in range(len(GPS)))
    (tmp_path / "neo.ubx").write_bytes(utc + fixes)
    got = imported(imu_csv(tmp_path), gps=tmp_path / "neo.ubx").drive.gps
    np.testing.assert_allclose(got.time, GPS.time, atol=1e-3)


@pytest.mark.parametrize("row", [b"1714000000.25,%s", b'3.5,"%s"', b"3.5;GGA;%s;7"])
def test_nmea_sentences_behind_the_time_of_a_computer(tmp_path: Path, row: bytes):
    """In a text or in a column of a table, also in quotes or with cells after it."""
    sentences = [line.strip() for i in range(len(GPS)) for line in nmea(i)]
    (tmp_path / "gps.txt").write_bytes(b"".join(row % line + b"\r\n" for line in sentences))
    got = imported(imu_csv(tmp_path), gps=tmp_path / "gps.txt").drive.gps
    np.testing.assert_allclose(got.lat, GPS.lat, atol=1e-6)


def test_ubx_without_fixes_names_what_it_holds_and_the_way(tmp_path: Path):
    clock = pyubx2.UBXMessage("NAV", "NAV-CLOCK", pyubx2.GET, iTOW=0, clkB=1).serialize()
    raw = pyubx2.UBXMessage("RXM", "RXM-RAWX", pyubx2.GET, numMeas=0).serialize()
    for stream, said in (
        (clock, "messages: NAV-CLOCK.* send NAV-PVT"),
        (raw, "messages: RXM-RAWX.* RTKLIB"),
    ):
        (tmp_path / "log.ubx").write_bytes(stream)
        with pytest.raises(InputError, match=said):
            imported(imu_csv(tmp_path), gps=tmp_path / "log.ubx")


def test_a_receivers_log_alone_has_no_imu(tmp_path: Path):
    (tmp_path / "log.ubx").write_bytes(ubx(0))
    with pytest.raises(InputError, match="no IMU samples"):
        imported(tmp_path / "log.ubx")
