"""u-blox receivers' UBX streams, through pyubx2: NAV-PVT, or NAV-POSLLH with NAV-SOL and NAV-VELNED of u-blox 6.

u-blox M8 Receiver description, UBX-13003221, 32.17.15 UBX-NAV-PVT: UTC, degrees, mm, mm/s; hAcc and sAcc are
standard deviations as the receiver sees them. u-blox 6 Receiver description, GPS.G6-SW-10018, 35: POSLLH in mm, VELNED
in cm/s, times in GPS week (SOL) and ms of week. Other messages in the stream, NMEA among them, are passed over.
"""

import calendar
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import date
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import GPS_EPOCH, WEEK, gps_to_unix
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.source import Guess, Part, Rows, Source, first_bytes, library
from sigmaswarm.wording import names_shown

SYNC = b"\xb5\x62"
NAV_PVT = b"\x01\x07"
NAV_POSLLH, NAV_SOL, NAV_STATUS, NAV_VELNED = b"\x01\x02", b"\x01\x06", b"\x01\x03", b"\x01\x12"
COLUMNS = ("t", "lat", "lon", "height", "hAcc", "velE", "velN", "gSpeed", "fixType", "gnssFixOk", "carrSoln")
_HALF = "*1e-3/sqrt(2)"  # hAcc is of the distance, each axis has its share
GUESS = Guess(
    {
        "gps": (
            Part(
                "NAV-PVT",
                {
                    **{"t": "t", "lat": "lat", "lon": "lon", "alt": "height*1e-3"},
                    **{
                        "std_x": f"hAcc{_HALF}",
                        "std_y": f"hAcc{_HALF}",
                        "vx": "velE*1e-3",
                        "vy": "velN*1e-3",
                    },
                    "keep": "gnssFixOk == 1 and fixType >= 2 and fixType <= 4",
                },
            ),
        )
    },
    ("NAV-PVT: times are UTC; the stated horizontal accuracy is split evenly between east and north",),
    fixed="gnssFixOk == 1 and carrSoln == 2",
)


COLUMNS_6 = ("t", "lat", "lon", "height", "hAcc", "velE", "velN", "gpsFix")
GUESS_6 = Guess(
    {
        "gps": (
            Part(
                "NAV-POSLLH",
                {
                    **{"t": "t", "lat": "lat", "lon": "lon", "alt": "height*1e-3"},
                    **{
                        "std_x": f"hAcc{_HALF}",
                        "std_y": f"hAcc{_HALF}",
                        "vx": "velE*1e-2",
                        "vy": "velN*1e-2",
                    },
                    "keep": "gpsFix >= 2 and gpsFix <= 4",
                },
            ),
        )
    },
    ("NAV-POSLLH: GPS time made UTC; the stated horizontal accuracy is split evenly between east and north",),
)
NO_FIX = {b"\x02": "raw measurements: make fixes of them with RTKLIB (convbin, rnx2rtkp) and import its .pos"}
"""Classes of messages without fixes, and the way to fixes."""


def recognizes(path: Path) -> bool:
    """Return True if UBX messages begin in its first bytes, or its name says so."""
    head = first_bytes(path, 65536)
    return path.suffix.lower() == ".ubx" or SYNC + NAV_PVT in head or SYNC + NAV_POSLLH in head


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open a stream; it is decoded when its rows are wanted."""
    pyubx2 = library("pyubx2", "logs")
    if SYNC not in first_bytes(path, 1 << 20):
        raise InputError(f"{path}: holds no UBX messages; name the format with --format")
    remarks: list[str] = []
    kinds = _kinds(path)
    if NAV_PVT in kinds:
        yield Rows(path, "NAV-PVT", COLUMNS, lambda: _rows(path, pyubx2, remarks), GUESS, remarks)
    elif NAV_POSLLH in kinds:
        yield Rows(path, "NAV-POSLLH", COLUMNS_6, lambda: _rows_6(path, pyubx2, remarks), GUESS_6, remarks)
    else:
        there = names_shown(_named(kinds, pyubx2)) or "no whole message"
        way = next((text for kind, text in NO_FIX.items() if any(k[:1] == kind for k in kinds)), "")
        what = way or "have the receiver send NAV-PVT, or NAV-POSLLH and NAV-SOL"
        raise InputError(f"{path}: holds {there}, and neither NAV-PVT nor NAV-POSLLH; {what}")


def _kinds(path: Path) -> set[bytes]:
    """Class and id of the messages in a stream."""
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as stream:
        return {raw[2:4] for raw, _ in _messages(stream) if raw is not None}


def _named(kinds: set[bytes], pyubx2: Any) -> list[str]:
    return sorted(pyubx2.UBX_MSGIDS.get(kind, kind.hex()) for kind in kinds)


def _rows_6(path: Path, pyubx2: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    """One row a time of week, of the messages that state it; the week is the last one that NAV-SOL stated."""
    week, broken = 0, 0
    fix: dict[str, float] = {}
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as stream:
        for raw, done in _messages(stream):
            if raw is None:
                broken += 1
                continue
            if raw[2:4] not in (NAV_POSLLH, NAV_SOL, NAV_STATUS, NAV_VELNED) or len(raw) < 12:
                continue
            try:
                message = pyubx2.UBXReader.parse(raw)
            except Exception:  # of a length that is none
                broken += 1
                continue
            tow = int.from_bytes(raw[6:10], "little")
            if fix and tow != fix["tow"]:
                if "lat" in fix:
                    yield _row_6(fix, week), done
                fix = {}
            fix["tow"] = tow
            week = getattr(message, "week", week)
            names = (*COLUMNS_6[1:5], "velE", "velN", "gpsFix")
            fix |= {name: float(getattr(message, name)) for name in names if hasattr(message, name)}
    if "lat" in fix:
        yield _row_6(fix, week), 1.0
    if broken:
        remarks.append(f"{path.name}: {broken} damaged messages passed over")
    if not week:
        remarks.append(
            f"{path.name}: no NAV-SOL states the GPS week: times are those of the week; --gps-offset moves them"
        )


def _row_6(fix: dict[str, float], week: int) -> tuple[float, ...]:
    seconds = fix["tow"] * 1e-3
    if week:
        seconds = float(gps_to_unix(np.array([GPS_EPOCH + week * WEEK + seconds]))[0])
    return (seconds, *(fix.get(name, 3.0 if name == "gpsFix" else np.nan) for name in COLUMNS_6[1:]))


def _time(message: Any) -> float:
    """s since 1970; ValueError where the calendar has no such day or the day no such time."""
    day = date(message.year, message.month, message.day)
    if not (message.hour < 24 and message.min < 60 and message.second <= 60):  # 60 is a leap second
        raise ValueError("no time of day")
    clock = (message.hour, message.min, message.second)
    return calendar.timegm((*day.timetuple()[:3], *clock)) + message.nano * 1e-9


def _rows(path: Path, pyubx2: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    """One row a NAV-PVT message with a valid date and time."""
    broken, undated = 0, 0
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as stream:
        for raw, done in _messages(stream):
            if raw is None:
                broken += 1
                continue
            if raw[2:4] != NAV_PVT:
                continue
            try:
                message = pyubx2.UBXReader.parse(raw)
                dated = message.validDate and message.validTime
                row = (
                    (_time(message), *(float(getattr(message, name)) for name in COLUMNS[1:]))
                    if dated
                    else None
                )
            except Exception:  # of a length or a date that is none
                broken += 1
                continue
            if row is None:
                undated += 1
                continue
            yield row, done
    if broken:
        remarks.append(f"{path.name}: {broken} damaged messages passed over")
    if undated:
        remarks.append(f"{path.name}: {undated} messages without a valid date passed over")


def _messages(stream: mmap) -> Iterator[tuple[bytes | None, float]]:
    """Messages whose checksum is right, and None for damaged bytes between them; each with the share that is done.

    The length of a damaged message is unreliable: the next one is searched right after its first bytes.
    """
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
    """Fletcher's, in 8 bits: section 32.4 of the description."""
    values = np.frombuffer(content, dtype=np.uint8).astype(np.int64)
    return bytes([int(values.sum()) & 255, int(np.cumsum(values).sum()) & 255])
