"""RTKLIB's solutions (``.pos``), as fixes or truth.

The format is defined in the RTKLIB ver. 2.4.2 Manual, B.1. Comments begin with %, and the last comment names the
columns. Times are dates, or GPS week and seconds. Latitude and longitude are in degrees, heights are above the
ellipsoid, and standard deviations are north, east and up. Q is 1 for fixed and 2 for float solutions.
"""

import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.importing.dates import GPS_EPOCH, WEEK, gps_to_unix
from sigmaswarm.importing.source import Guess, Limits, Log, Part, first_bytes, log_of_rows, require_distinct
from sigmaswarm.wording import list_names

_UNIT = re.compile(r"^(latitude|longitude|height|sd[neu]|age|v[neu])\((?:deg|m|s|m/s)\)$")
_TARGETS = {
    **{"lat": "latitude", "lon": "longitude", "alt": "height", "std_x": "sde", "std_y": "sdn"},
    **{"vx": "ve", "vy": "vn"},
}


def recognizes(path: Path) -> bool:
    head = first_bytes(path)
    return path.suffix == ".pos" or (head.startswith(b"%") and b"latitude(deg)" in head)


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    system, columns = _header(path)
    targets = {target: name for target, name in _TARGETS.items() if name in columns}
    notes = {
        "GPST": f"{path.name}: GPS time is converted to UTC. If the other sensors use GPS time, add --truth-offset 18 "
        "or --gps-offset 18 (leap seconds since 2017)",
        "UTC": f"{path.name}: times are UTC",
    }
    fixed = "Q == 1" if "Q" in columns else ""
    guess = Guess({"gps": (Part("solution", {"t": "t", **targets}),)}, (notes[system],), fixed=fixed)
    return log_of_rows(
        path, "solution", ("t", *columns), lambda: _rows(path, len(columns), system == "GPST"), guess, []
    )


def _header(path: Path) -> tuple[str, list[str]]:
    header = ""
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            if not line.startswith("%"):
                break
            if re.match(r"%\s*(GPST|UTC|JST)\b", line):
                header = line
    words = re.sub(r"[%,;]", " ", header).split()
    if len(words) < 3 or words[0] not in ("GPST", "UTC"):
        raise InputError(f"{path}: has no RTKLIB header with GPST or UTC; write the solution with its header")
    columns = [re.sub(_UNIT, r"\1", word) for word in words[1:]]
    if not {"latitude", "longitude"} <= set(columns):
        raise InputError(
            f"{path}: has the columns {list_names(words[1:4])}; write the solution as latitude, longitude, height"
        )
    require_distinct(columns, path)
    return words[0], columns


def _rows(path: Path, width: int, gps: bool) -> Iterator[tuple[tuple[float, ...], float]]:
    """Yield the time and numbers of each line; GPS time becomes UTC."""
    size, read = path.stat().st_size, 0
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            read += len(line)
            if line.startswith("%") or not line.strip():
                continue
            cells = re.split(r"[\s,;]+", line.strip())
            try:
                time, values = _seconds(*cells[:2]), [float(cell) for cell in cells[2:]]
                time = float(gps_to_unix(np.array([time]))[0]) if gps else time
            except (ValueError, TypeError, OverflowError):
                time, values = 0.0, []
            if len(values) != width:
                raise InputError(
                    f"{path}, row {number}: {line.strip()[:40]!r}... does not have the {width} numbers of the header's "
                    "columns; delete the row"
                )
            yield (time, *values), min(read / size, 1.0)


def _seconds(first: str, second: str) -> float:
    """Return the seconds since 1970, without leap seconds, from date and time of day, or from GPS week and seconds."""
    if "/" not in first:
        return GPS_EPOCH + int(first) * WEEK + float(second)
    day = np.datetime64(first.replace("/", "-"), "s").astype(np.int64)
    hours, minutes, seconds = second.split(":")
    if not (0 <= int(hours) < 24 and 0 <= int(minutes) < 60 and 0 <= float(seconds) <= 60):
        raise ValueError("impossible time of day")
    return float(day) + int(hours) * 3600 + int(minutes) * 60 + float(seconds)
