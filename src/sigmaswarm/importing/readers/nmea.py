"""NMEA 0183 sentences of a receiver, through pynmeagps: GGA or GNS for position, RMC for date and velocity, GST.

Sentences with one time of day make one fix. The day comes from RMC or ZDA and goes on at midnight.
"""

import math
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.source import Guess, Part, Rows, Source, first_bytes, library

KNOT = 1852 / 3600
"""m/s."""
STILL = 0.5
"""m/s."""
COLUMNS = ("t", "lat", "lon", "alt", "quality", "hdop", "speed", "course", "std_lat", "std_lon")
_NAN = float("nan")
GUESS = Guess(
    {
        "gps": (
            Part(
                "fixes",
                {
                    **{"t": "t", "lat": "lat", "lon": "lon", "alt": "alt"},
                    **{
                        "speed": "speed",
                        "course": "radians(90 - course)",
                        "std_x": "std_lon",
                        "std_y": "std_lat",
                    },
                    "keep": "quality > 0",
                },
            ),
        )
    },
    ("NMEA: times are UTC; altitudes are above the ellipsoid where GGA states the geoid",),
    fixed="quality == 4",
)


def recognizes(path: Path) -> bool:
    """Return True if its first lines are sentences."""
    lines = first_bytes(path, 1024).split(b"\n")
    return path.suffix.lower() in (".nmea", ".nma") or any(
        line[:1] == b"$"
        and line[3:6] in (b"GGA", b"RMC", b"GSA", b"GSV", b"GLL", b"VTG", b"GNS", b"TXT", b"ZDA")
        for line in lines
    )


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open a log; it is decoded when its rows are wanted."""
    pynmeagps = library("pynmeagps", "logs")
    remarks: list[str] = []
    yield Rows(path, "fixes", COLUMNS, lambda: _rows(path, pynmeagps, remarks), GUESS, remarks)


def _rows(path: Path, pynmeagps: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    """One row a fix."""
    day: date | None = None
    if _first_day(path, pynmeagps) is None:
        day = date(1970, 1, 1)
        remarks.append(
            f"{path.name}: no sentence (RMC, ZDA) states the date: times count from midnight UTC; "
            "--gps-offset moves them"
        )
    clock: time | None = None
    fix: dict[str, float] = {}
    size, undated = path.stat().st_size, 0
    for message, done in _messages(path, pynmeagps, remarks):
        now = getattr(message, "time", None)
        if isinstance(now, time) and now != clock:
            if fix and day is not None and clock is not None:
                yield _row(day, clock, fix), done / size
            elif fix:
                undated += 1
            if day is not None and clock is not None and now < clock and clock.hour - now.hour > 12:
                day += timedelta(days=1)
            clock, fix = now, {}
        day = _day(message) or day
        fix |= _values(message)
    if fix and day is not None and clock is not None:
        yield _row(day, clock, fix), 1.0
    if undated:
        remarks.append(f"{path.name}: {undated} fixes before the first date left out")


def _first_day(path: Path, pynmeagps: Any) -> date | None:
    """The first date that a sentence states; None where none does."""
    return next(
        (day for message, _ in _messages(path, pynmeagps, []) if (day := _day(message)) is not None), None
    )


def _messages(path: Path, pynmeagps: Any, remarks: list[str]) -> Iterator[tuple[Any, int]]:
    """The sentences that are whole, and how far the file is read."""
    broken = whole = read = 0
    with path.open("rb") as file:
        for line in file:
            read += len(line)
            begin = line.find(b"$")
            if begin < 0:
                broken += bool(line.strip())
                continue
            try:
                message = pynmeagps.NMEAReader.parse(line[begin:].rstrip() + b"\r\n", msgmode=0)
            except Exception:  # a damaged sentence; the next line is another
                message = None
            if message is None:
                broken += 1
                continue
            whole += 1
            yield message, read
    if not whole:
        raise InputError(f"{path}: holds no whole NMEA sentence; name the format with --format")
    if broken:
        remarks.append(f"{path.name}: {broken} damaged lines passed over")


def _day(message: Any) -> date | None:
    if message.msgID == "RMC" and isinstance(said := _field(message, "date"), date):
        return said
    if message.msgID == "ZDA":
        try:
            said = date(*(int(_field(message, name)) for name in ("year", "month", "day")))
        except (TypeError, ValueError):  # empty, or none of a calendar
            return None
        return said if 1980 <= said.year < 2100 else None
    return None


def _field(message: Any, name: str) -> Any:
    """A sentence's field, empty where the sentence is too short to have it."""
    return getattr(message, name, "")


def _values(message: Any) -> dict[str, float]:
    """The fix of a sentence, in a drive's units, except the course in degrees from north."""
    kind = message.msgID

    def said(name: str) -> float:
        return _number(_field(message, name))

    if kind in ("GGA", "GNS"):
        modes = str(_field(message, "posMode"))
        quality = said("quality") if kind == "GGA" else float(any(m not in "N" for m in modes))
        height = said("alt") + (said("sep") if _field(message, "sep") != "" else 0.0)
        place = {"lat": said("lat"), "lon": said("lon"), "alt": height}
        return {**place, "quality": quality, "hdop": said("HDOP")}
    if kind == "RMC" and _field(message, "status") == "A":
        speed, course = said("spd") * KNOT, said("cog")
        if math.isnan(course) and speed < STILL:
            course = 0.0  # receivers leave the course empty at standstill, where it means nothing
        place = {"rmc_lat": said("lat"), "rmc_lon": said("lon"), "rmc_quality": 1.0}
        return {"speed": speed, "course": course, **place}
    if kind == "GST":
        return {"std_lat": said("stdLat"), "std_lon": said("stdLong")}
    return {}


def _row(day: date, clock: time, fix: dict[str, float]) -> tuple[float, ...]:
    """A fix; RMC's position where no other sentence has one."""
    seconds = datetime.combine(day, clock, UTC).timestamp()
    return (seconds, *(fix.get(name, fix.get(f"rmc_{name}", _NAN)) for name in COLUMNS[1:]))


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        return _NAN
