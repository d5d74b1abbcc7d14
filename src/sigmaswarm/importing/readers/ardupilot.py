"""ArduPilot's dataflash logs, ``.bin``, through pymavlink.

Messages of ArduPilot, libraries/AP_Logger/LogStructure.h: TimeUS in us since start; IMU in the body's forward, right,
down (m/s2, rad/s); GPS in degrees, m/s, degrees from north; GPA with the stated accuracies; SIM the true place of a
simulation.
"""

from collections.abc import Generator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.messages import broken
from sigmaswarm.importing.source import Frames, Guess, Part, Role, Source, first_bytes, library

MAGIC = b"\xa3\x95\x80"
_TABLES = {
    "IMU": ("TimeUS", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "GPS": ("TimeUS", "Status", "Lat", "Lng", "Alt", "Spd", "GCrs"),
    "GPA": ("TimeUS", "HAcc"),
    "SIM": ("TimeUS", "Lat", "Lng", "Alt", "Yaw"),
}
_T = "TimeUS*1e-6"
_IMU = {"ax": "AccX", "ay": "-AccY", "az": "-AccZ", "gx": "GyrX", "gy": "-GyrY", "gz": "-GyrZ"}
_FIX = {
    "lat": "Lat",
    "lon": "Lng",
    "alt": "Alt",
    "speed": "Spd",
    "course": "radians(90 - GCrs)",
    "keep": "Status >= 3",
}
_ACCURACY = {"std_x": "HAcc/sqrt(2)", "std_y": "HAcc/sqrt(2)"}
_TRUTH = {"lat": "Lat", "lon": "Lng", "alt": "Alt", "theta": "radians(90 - Yaw)"}


def recognizes(path: Path) -> bool:
    """Return True if it begins as a dataflash log does."""
    return first_bytes(path, 3) == MAGIC


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Read the messages that a drive is made of, of the first IMU and the first receiver."""
    kind = library("pymavlink.DFReader", "logs").DFReader_binary
    log = kind.__new__(kind)  # so that its files can be closed where its own beginning fails
    log.init_arrays_fast = log.init_arrays  # the compiled one prints skipped data, which cannot be caught
    try:
        with redirect_stderr(StringIO()), redirect_stdout(StringIO()):  # it prints skipped data
            log.__init__(str(path), zero_time_base=True)
            rows = _rows(log, path, limits)
    except InputError:
        raise
    except Exception as error:  # the library raises anything on damaged bytes
        raise broken(path, error) from None
    finally:
        for name in ("data_map", "filehandle"):
            if (stream := getattr(log, name, None)) is not None:
                with suppress(BufferError):  # a failed message may still hold the map
                    stream.close()
    frames = {
        name: pl.DataFrame(values, schema=dict.fromkeys(_TABLES[name], pl.Float64), orient="row")
        for name, values in rows.items()
        if values
    }
    if not frames:
        raise InputError(
            f"{path}: holds none of {', '.join(_TABLES)}; log them (LOG_BITMASK), and drive again"
        )
    yield Frames(path, frames, _guess(frames), dict.fromkeys(frames, "dataflash message"))


def _rows(log: Any, path: Path, limits: Limits) -> dict[str, list[tuple[float, ...]]]:
    """The fields of the messages, by their kinds."""
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in _TABLES}
    while (message := log.recv_match(type=list(_TABLES))) is not None:
        kind = message.get_type()
        if getattr(message, "I", 0) == 0:
            rows[kind].append(tuple(float(_field(message, name)) for name in _TABLES[kind]))
            limits.check_rows(len(rows[kind]), path, kind)
    return rows


def _field(message: Any, name: str) -> Any:
    return getattr(message, name, float("nan"))


def _guess(frames: dict[str, pl.DataFrame]) -> Guess:
    roles: dict[Role, tuple[Part, ...]] = {}
    if "IMU" in frames:
        roles["imu"] = (Part("IMU", {"t": _T, **_IMU}),)
    if "GPS" in frames:
        accuracy = (Part("GPA", {"t": _T, **_ACCURACY}),) if "GPA" in frames else ()
        roles["gps"] = (Part("GPS", {"t": _T, **_FIX}), *accuracy)
    if "SIM" in frames:
        roles["truth"] = (Part("SIM", {"t": _T, **_TRUTH}),)
    return Guess(roles, ("ArduPilot's axes turned from forward, right, down",))
