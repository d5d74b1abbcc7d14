"""u-blox receivers' UBX streams: NAV-PVT messages, through pyubx2.

u-blox M8 Receiver description, UBX-13003221, 32.17.15 UBX-NAV-PVT: UTC, degrees, mm, mm/s; hAcc and sAcc are
standard deviations as the receiver sees them. Other messages in the stream, NMEA among them, are passed over.
"""

import calendar
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.source import Guess, Part, Rows, Source, first_bytes, library

SYNC = b"\xb5\x62"
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
)


def recognizes(path: Path) -> bool:
    """Whether UBX messages begin in its first bytes, or its name says so."""
    return path.suffix.lower() == ".ubx" or SYNC + b"\x01\x07" in first_bytes(path, 65536)


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open a stream; it is decoded when its rows are wanted."""
    pyubx2 = library("pyubx2", "logs")
    if SYNC not in first_bytes(path, 1 << 20):
        raise InputError(f"{path}: holds no UBX messages; name the format with --format")
    remarks: list[str] = []
    yield Rows(path, "NAV-PVT", COLUMNS, lambda: _rows(path, pyubx2, remarks), GUESS, remarks)


def _time(message: Any) -> float:
    """s since 1970; ValueError where the calendar has no such day or the day no such time."""
    day = date(message.year, message.month, message.day)
    if not (message.hour < 24 and message.min < 60 and message.second <= 60):  # 60 is a leap second
        raise ValueError("no time of day")
    clock = (message.hour, message.min, message.second)
    return calendar.timegm((*day.timetuple()[:3], *clock)) + message.nano * 1e-9


def _rows(path: Path, pyubx2: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    """One row a NAV-PVT message with a valid date and time."""
    size, broken, undated = path.stat().st_size, 0, 0
    with path.open("rb") as file:
        reader = pyubx2.UBXReader(
            file, protfilter=pyubx2.UBX_PROTOCOL, quitonerror=pyubx2.ERR_RAISE, parsing=False
        )
        while True:
            try:
                raw, _ = reader.read()
                if raw is None:
                    break
                if raw[2:4] != b"\x01\x07":
                    continue
                message = pyubx2.UBXReader.parse(raw)
                dated = message.validDate and message.validTime
                row = (
                    (_time(message), *(float(getattr(message, name)) for name in COLUMNS[1:]))
                    if dated
                    else None
                )
            except Exception:  # a damaged message; the next one begins at its own sync bytes
                broken += 1
                continue
            if row is None:
                undated += 1
                continue
            yield row, min(file.tell() / size, 1.0)
    if broken:
        remarks.append(f"{path.name}: {broken} damaged messages passed over")
    if undated:
        remarks.append(f"{path.name}: {undated} messages without a valid date passed over")
