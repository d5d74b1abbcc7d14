"""ArduPilot's dataflash logs, binary (``.bin``) or as text (``.log``), read with pymavlink.

Messages (ArduPilot, libraries/AP_Logger/LogStructure.h): the time is TimeUS in us since boot. Before version 3.3 the
time is TimeMS in ms, or T in GPS messages, in which TimeMS is the time of week. The axes of IMU are forward, right,
down (m/s2, rad/s). GPS is in degrees, m/s and degrees clockwise from north. GPA contains the accuracies that the
receiver reports, and SIM contains the true position and yaw of a simulation.
"""

from contextlib import ExitStack, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.source import (
    Guess,
    Limits,
    Log,
    Role,
    errors_as_damage,
    first_bytes,
    import_library,
    log_of_frames,
    roles_of,
)

# Largest number of bytes outside of messages; pymavlink needs about 1 s to skip so many
MAX_SKIPPED = 200_000
MAGIC, TEXTS = b"\xa3\x95\x80", (b"FMT, 128,", b"FMT,128,")
_T = {"t": "TimeUS*1e-6"}
_PLACE = _T | {"lat": "Lat", "lon": "Lng", "alt": "Alt"}
PARTS: tuple[tuple[Role, str, dict[str, str]], ...] = (
    (
        "imu",
        "IMU",
        _T | {"ax": "AccX", "ay": "-AccY", "az": "-AccZ", "gx": "GyrX", "gy": "-GyrY", "gz": "-GyrZ"},
    ),
    ("gps", "GPS", _PLACE | {"speed": "Spd", "course": "radians(90 - GCrs)", "keep": "Status >= 3"}),
    ("gps", "GPA", _T | {"std_x": "HAcc/sqrt(2)", "std_y": "HAcc/sqrt(2)"}),
    ("truth", "SIM", _PLACE | {"theta": "radians(90 - Yaw)"}),
)
_COLUMNS = {
    "IMU": ("TimeUS", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "GPS": ("TimeUS", "Status", "Lat", "Lng", "Alt", "Spd", "GCrs"),
    "GPA": ("TimeUS", "HAcc"),
    "SIM": ("TimeUS", "Lat", "Lng", "Alt", "Yaw"),
}


class _Skipped(StringIO):
    """Replacement for stderr that counts the bytes skipped by pymavlink and raises `ValueError` above `MAX_SKIPPED`."""

    count = 0

    def write(self, text: str, /) -> int:
        self.count += text.startswith("bad header")
        if self.count > MAX_SKIPPED:
            raise ValueError(f"more than {MAX_SKIPPED} bytes belong to no message")
        return len(text)


def recognizes(path: Path) -> bool:
    return first_bytes(path, 3) == MAGIC or first_bytes(path, 12).removeprefix(b"\xef\xbb\xbf").startswith(
        TEXTS
    )


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    module = import_library("pymavlink.DFReader", "logs")
    kind = module.DFReader_binary if first_bytes(path, 3) == MAGIC else module.DFReader_text
    log = kind.__new__(kind)  # created first, so that its files can be closed if __init__ fails
    log.init_arrays_fast = log.init_arrays  # the compiled function ignores redirect_stderr
    try:
        # pymavlink prints to both streams
        with errors_as_damage(path), redirect_stderr(_Skipped()), redirect_stdout(StringIO()):
            log.__init__(str(path), zero_time_base=True)
            rows = _rows(log, path, limits)
    finally:
        for name in ("data_map", "filehandle"):
            if (stream := getattr(log, name, None)) is not None:
                with suppress(
                    BufferError
                ):  # a message that can't be decoded may still refer to the memory map
                    stream.close()
    frames = {
        name: pl.DataFrame(values, schema=dict.fromkeys(_COLUMNS[name], pl.Float64), orient="row")
        for name, values in rows.items()
        if values
    }
    if not frames:
        raise InputError(
            f"{path}: contains none of the messages {', '.join(_COLUMNS)}; enable IMU and GPS with LOG_BITMASK, and "
            "record again"
        )
    parts = [part for part in PARTS if part[1] != "GPA" or "GPS" in frames]
    guess = Guess(
        roles_of(parts, {name: _COLUMNS[name] for name in frames}),
        ("ArduPilot's axes are converted from forward, right, down to forward, left, up",),
    )
    return log_of_frames(path, frames, "dataflash message", lambda _: guess)


def _rows(log: Any, path: Path, limits: Limits) -> dict[str, list[tuple[float, ...]]]:
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in _COLUMNS}
    while (message := log.recv_match(type=list(_COLUMNS))) is not None:
        kind = message.get_type()
        if getattr(message, "I", 0) == 0:
            old = 1e3 * float(getattr(message, "T" if kind == "GPS" else "TimeMS", "nan"))
            rest = (getattr(message, name, "nan") for name in _COLUMNS[kind][1:])
            rows[kind].append(tuple(map(float, (getattr(message, "TimeUS", old), *rest))))
            limits.check_rows(len(rows[kind]), path, kind)
    return rows
