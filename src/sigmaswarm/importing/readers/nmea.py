"""NMEA 0183 sentences of a receiver, read with pynmeagps.

The position is in GGA, GNS, GLL or RMC, the velocity in RMC, and the date in RMC or ZDA. Standard deviations are in
GST, and the heading of two antennas is in HDT, THS or PASHR. Sentences with the same time of day make one fix. The date
advances at midnight.
"""

import math
import re
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, date, datetime, time, timedelta
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.source import Guess, Limits, Log, Part, first_bytes, import_library, log_of_rows

KNOT = 1852 / 3600  # m/s
MIN_SPEED = 0.5  # m/s; below this speed, an empty course is no error
COLUMNS = (
    *("t", "lat", "lon", "alt", "quality", "hdop", "speed", "course", "std_lat", "std_lon"),
    *("heading", "std_heading"),
)
GUESS = Guess(
    {
        "gps": (
            Part(
                "fixes",
                {
                    **{name: name for name in ("t", "lat", "lon", "alt", "speed")},
                    **{"course": "radians(90 - course)", "std_x": "std_lon", "std_y": "std_lat"},
                    **{"heading": "radians(90 - heading)", "std_heading": "radians(std_heading)"},
                    "keep": "quality > 0",
                },
            ),
        )
    },
    (
        "NMEA: times are UTC; altitudes are above the ellipsoid if GGA or GNS messages contain the geoid separation",
    ),
    fixed="quality == 4",
)
# A sentence, perhaps after the time at which a computer received the sentence
_SENTENCE = re.compile(rb"(?:^|[\d\s,;:\"])\$..(?:GGA|RMC|GSA|GSV|GLL|VTG|GNS|TXT|ZDA),")
_WHOLE = re.compile(rb"\$[^*]*\*[0-9A-Fa-f]{2}")  # further cells of a table may follow


def recognizes(path: Path) -> bool:
    lines = first_bytes(path, 1024).split(b"\n")
    begun = any(line[:1] == b"$" and _SENTENCE.match(line) for line in lines)
    sentences = sum(_SENTENCE.search(line) is not None for line in lines)
    return begun or sentences > 0.5 * len(lines) or path.suffix.lower() in (".nmea", ".nma")


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    pynmeagps = import_library("pynmeagps", "logs")
    remarks: list[str] = []
    return log_of_rows(path, "fixes", COLUMNS, lambda: _rows(path, pynmeagps, remarks), GUESS, remarks)


def _rows(path: Path, pynmeagps: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    day: date | None = None
    if not any(_day(message) for message, _ in _messages(path, pynmeagps, [])):
        day = date(1970, 1, 1)
        remarks.append(
            f"{path.name}: no sentence (RMC, ZDA) contains the date, so times count from midnight UTC; "
            "--gps-offset adds seconds to them"
        )
    clock: time | None = None
    fix: dict[str, float] = {}
    undated = 0
    for message, done in _messages(path, pynmeagps, remarks):
        now = getattr(message, "time", None)
        if isinstance(now, time) and now != clock:
            if fix and day is not None and clock is not None:
                yield _row(day, clock, fix), done
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
        remarks.append(f"{path.name}: {undated} fixes before the first date are left out")


def _messages(path: Path, pynmeagps: Any, remarks: list[str]) -> Iterator[tuple[Any, float]]:
    """Yield the complete sentences, each with the fraction of the file that has been read."""
    broken = complete = read = 0
    size = path.stat().st_size
    with path.open("rb") as file:
        for line in file:
            read += len(line)
            begin = line.find(b"$")
            message = None
            if begin >= 0:
                try:
                    whole = _WHOLE.match(line, begin)
                    text = whole[0] if whole else line[begin:].rstrip()
                    message = pynmeagps.NMEAReader.parse(text + b"\r\n", msgmode=0)
                except Exception:  # a damaged sentence
                    message = None
            if message is None:
                broken += begin >= 0 or bool(line.strip())
                continue
            complete += 1
            yield message, read / size
    if not complete:
        raise InputError(f"{path}: contains no complete NMEA sentence; specify the format with --format")
    if broken:
        remarks.append(f"{path.name}: {broken} damaged lines are skipped")


def _day(message: Any) -> date | None:
    if message.msgID == "RMC" and isinstance(stated := getattr(message, "date", ""), date):
        return stated
    if message.msgID != "ZDA":
        return None
    try:
        stated = date(*(int(getattr(message, name, "")) for name in ("year", "month", "day")))
    except (TypeError, ValueError):  # empty, or not a valid date
        return None
    return stated if 1980 <= stated.year < 2100 else None


def _values(message: Any) -> dict[str, float]:
    """Return the values of a sentence in m, m/s and degrees; course and heading are clockwise from north."""

    def number(name: str) -> float:
        try:
            return float(getattr(message, name, ""))  # a sentence may be too short to have a field
        except (TypeError, ValueError):
            return math.nan

    kind = message.msgID
    if kind in ("GGA", "GNS"):
        modes = str(getattr(message, "posMode", ""))
        quality = number("quality") if kind == "GGA" else float(any(m not in "N" for m in modes))
        height = number("alt") + (number("sep") if getattr(message, "sep", "") != "" else 0.0)
        place = {"lat": number("lat"), "lon": number("lon"), "alt": height}
        return {**place, "quality": quality, "hdop": number("HDOP")}
    if kind in ("RMC", "GLL") and getattr(message, "status", "") == "A":
        place = {"rmc_lat": number("lat"), "rmc_lon": number("lon"), "rmc_quality": 1.0}
        if kind == "GLL":
            return place
        speed, course = number("spd") * KNOT, number("cog")
        if math.isnan(course) and speed < MIN_SPEED:
            course = 0.0  # receivers leave the course empty at standstill
        return {"speed": speed, "course": course, **place}
    if kind == "GST":
        return {"std_lat": number("stdLat"), "std_lon": number("stdLong")}
    if kind == "HDT":
        return {"heading": number("headingT")}
    if kind == "THS" and getattr(message, "mi", "") == "A":
        return {"heading": number("headt")}
    if kind == "ASHR" and number("gnssQual") > 0:
        return {"heading": number("trueHdg"), "std_heading": number("hdgAcc")}
    return {}


def _row(day: date, clock: time, fix: dict[str, float]) -> tuple[float, ...]:
    """Return the row of a fix. The position is from RMC or GLL only if no other sentence has one."""
    seconds = datetime.combine(day, clock, UTC).timestamp()
    return (seconds, *(fix.get(name, fix.get(f"rmc_{name}", math.nan)) for name in COLUMNS[1:]))
