"""UBX streams of u-blox receivers, read with pyubx2: NAV-PVT, or NAV-POSLLH with NAV-SOL and NAV-VELNED of u-blox 6.

NAV-PVT (u-blox M8 Receiver description, UBX-13003221, 32.17.15) contains UTC, degrees, mm and mm/s; hAcc is the
receiver's estimate of the horizontal standard deviation. In the messages of u-blox 6 (Receiver description,
GPS.G6-SW-10018, 35), POSLLH is in mm and VELNED in cm/s; times are ms since the start of the GPS week. SOL or TIMEGPS
contains the week; otherwise TIMEUTC determines the week. NAV-RELPOSNED (F9 HPG interface description, UBX-21019746)
contains the heading from one antenna to the other. Other messages, such as NMEA, are skipped.
"""

import calendar
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import date
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import GPS_EPOCH, WEEK, gps_to_unix
from sigmaswarm.importing.source import Guess, Limits, Log, Part, first_bytes, import_library, log_of_rows
from sigmaswarm.wording import list_names

SYNC = b"\xb5\x62"
NAV_PVT, NAV_RELPOSNED = b"\x01\x07", b"\x01\x3c"
NAV_POSLLH, NAV_SOL, NAV_STATUS, NAV_VELNED = b"\x01\x02", b"\x01\x06", b"\x01\x03", b"\x01\x12"
NAV_TIMEGPS, NAV_TIMEUTC = b"\x01\x20", b"\x01\x21"
FIX_MESSAGES = (NAV_POSLLH, NAV_SOL, NAV_STATUS, NAV_VELNED, NAV_TIMEGPS, NAV_TIMEUTC)
COLUMNS = ("t", "lat", "lon", "height", "hAcc", "velE", "velN", "gSpeed", "fixType", "gnssFixOk", "carrSoln")
HEADING = ("relPosHeading", "accHeading")
COLUMNS_6 = ("t", "lat", "lon", "height", "hAcc", "velE", "velN", "gpsFix")
_FIX = {
    **{"t": "t", "lat": "lat", "lon": "lon", "alt": "height*1e-3"},
    **dict.fromkeys(("std_x", "std_y"), "hAcc*1e-3/sqrt(2)"),
}
PVT = _FIX | {
    **{"vx": "velE*1e-3", "vy": "velN*1e-3"},
    **{"heading": "radians(90 - relPosHeading)", "std_heading": "radians(accHeading)"},
    "keep": "gnssFixOk == 1 and fixType >= 2 and fixType <= 4",
}
POSLLH = _FIX | {"vx": "velE*1e-2", "vy": "velN*1e-2", "keep": "gpsFix >= 2 and gpsFix <= 4"}
RAW = "to use the raw measurements, compute fixes with RTKLIB (convbin, rnx2rtkp) and import the .pos file"


def recognizes(path: Path) -> bool:
    head = first_bytes(path, 65536)
    return path.suffix.lower() == ".ubx" or SYNC + NAV_PVT in head or SYNC + NAV_POSLLH in head


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    pyubx2 = import_library("pyubx2", "logs")
    if SYNC not in first_bytes(path, 1 << 20):
        raise InputError(f"{path}: contains no UBX messages; specify the format with --format")
    remarks: list[str] = []
    accuracy = "the receiver's horizontal accuracy / sqrt(2) is used as the standard deviation east and north"
    kinds = {raw[2:4] for raw, _ in _messages(path) if raw is not None}
    if NAV_PVT in kinds:
        fixed = "gnssFixOk == 1 and carrSoln == 2"
        guess = Guess({"gps": (Part("NAV-PVT", PVT),)}, (f"NAV-PVT: times are UTC; {accuracy}",), fixed=fixed)
        columns = (*COLUMNS, *HEADING)
        return log_of_rows(path, "NAV-PVT", columns, lambda: _rows(path, pyubx2, remarks), guess, remarks)
    if NAV_POSLLH in kinds:
        guess = Guess(
            {"gps": (Part("NAV-POSLLH", POSLLH),)}, (f"NAV-POSLLH: GPS time is converted to UTC; {accuracy}",)
        )
        return log_of_rows(
            path, "NAV-POSLLH", COLUMNS_6, lambda: _rows_6(path, pyubx2, remarks), guess, remarks
        )
    there = sorted(pyubx2.UBX_MSGIDS.get(kind, kind.hex()) for kind in kinds)
    raw = any(kind[:1] == b"\x02" for kind in kinds)
    what = RAW if raw else "configure the receiver to send NAV-PVT, or NAV-POSLLH and NAV-SOL"
    raise InputError(
        f"{path}: contains neither NAV-PVT nor NAV-POSLLH (complete messages: {list_names(there) or 'none'}); {what}"
    )


def _rows(path: Path, pyubx2: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    broken = undated = 0
    headings = _headings(path, pyubx2)
    for raw, done in _messages(path):
        if raw is None or raw[2:4] != NAV_PVT:
            broken += raw is None
            continue
        try:
            message = pyubx2.UBXReader.parse(raw)
            if message.validDate and message.validTime:
                row = (_time(message), *(float(getattr(message, name)) for name in COLUMNS[1:]))
                row += headings.get(message.iTOW, (np.nan, np.nan))
            else:
                undated += 1
                continue
        except Exception:  # a wrong length, or no date
            broken += 1
            continue
        yield row, done
    if broken:
        remarks.append(f"{path.name}: {broken} damaged messages are skipped")
    if undated:
        remarks.append(f"{path.name}: {undated} messages without a valid date are skipped")


def _headings(path: Path, pyubx2: Any) -> dict[int, tuple[float, float]]:
    """Return the heading of two antennas and its accuracy, deg, by time of week, if the ambiguities are fixed."""
    found: dict[int, tuple[float, float]] = {}
    for raw, _ in _messages(path):
        if raw is None or raw[2:4] != NAV_RELPOSNED:
            continue
        try:
            message = pyubx2.UBXReader.parse(raw)
            # isMoving: the other antenna is on the vehicle, not at a base station
            if message.relPosHeadingValid and message.carrSoln == 2 and message.isMoving:
                found[message.iTOW] = message.relPosHeading, message.accHeading
        except Exception:  # a wrong length, or version 0, which has no heading
            continue
    return found


def _time(message: Any) -> float:
    """Return s since 1970. Raises ValueError for an impossible date or time."""
    day = date(message.year, message.month, message.day)
    if not (message.hour < 24 and message.min < 60 and message.second <= 60):  # 60 is a leap second
        raise ValueError("impossible time of day")
    clock = (message.hour, message.min, message.second)
    return calendar.timegm((*day.timetuple()[:3], *clock)) + message.nano * 1e-9


def _rows_6(path: Path, pyubx2: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    """Yield one row per time of week, from all messages with this time. The week is the last week that was stated."""
    week = broken = 0
    fix: dict[str, float] = {}
    for raw, done in _messages(path):
        if raw is None:
            broken += 1
            continue
        if raw[2:4] not in FIX_MESSAGES or len(raw) < 12:
            continue
        try:
            message = pyubx2.UBXReader.parse(raw)
        except Exception:  # a wrong length
            broken += 1
            continue
        tow = int.from_bytes(raw[6:10], "little")
        if fix and tow != fix["tow"]:
            if "lat" in fix:
                yield _row_6(fix, week), done
            fix = {}
        week = _week_of(message, tow * 1e-3) or week
        fix |= {"tow": tow} | {n: float(getattr(message, n)) for n in COLUMNS_6[1:] if hasattr(message, n)}
    if "lat" in fix:
        yield _row_6(fix, week), 1.0
    if broken:
        remarks.append(f"{path.name}: {broken} damaged messages are skipped")
    if not week:
        remarks.append(
            f"{path.name}: no NAV-SOL, NAV-TIMEGPS or NAV-TIMEUTC message contains the GPS week, so times count from "
            "the start of the week; --gps-offset adds seconds to them"
        )


def _week_of(message: Any, tow: float) -> int:
    """Return the GPS week that a message states, directly or by date and time of day; 0 if it states none."""
    if not getattr(message, "validUTC", 0):
        return int(getattr(message, "week", 0))
    try:
        day = date(message.year, message.month, message.day)
    except ValueError:
        return 0
    seconds = calendar.timegm((*day.timetuple()[:3], message.hour, message.min, message.sec))
    return round((seconds - GPS_EPOCH - tow) / WEEK)


def _row_6(fix: dict[str, float], week: int) -> tuple[float, ...]:
    seconds = fix["tow"] * 1e-3
    if week:
        seconds = float(gps_to_unix(np.array([GPS_EPOCH + week * WEEK + seconds]))[0])
    return (seconds, *(fix.get(name, 3.0 if name == "gpsFix" else np.nan) for name in COLUMNS_6[1:]))


def _messages(path: Path) -> Iterator[tuple[bytes | None, float]]:
    """Yield messages with a correct checksum, and None for damaged bytes, each with the fraction of the file read.

    The length of a damaged message is unreliable, so the search for the next message begins after its first bytes.
    """
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as stream:
        at, damaged = stream.find(SYNC), False
        while at >= 0:
            end = at + 8 + int.from_bytes(stream[at + 4 : at + 6], "little")
            raw = stream[at:end]
            sound = len(raw) == end - at and raw[-2:] == _checksum(raw[2:-2])
            if sound or not damaged:
                yield raw if sound else None, min(end / len(stream), 1.0)
            damaged = not sound
            at = stream.find(SYNC, end if sound else at + len(SYNC))


def _checksum(content: bytes) -> bytes:
    """Return Fletcher's 8-bit checksum (section 32.4 of the description)."""
    values = np.frombuffer(content, dtype=np.uint8).astype(np.int64)
    return bytes([int(values.sum()) & 255, int(np.cumsum(values).sum()) & 255])
