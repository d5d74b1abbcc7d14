"""PX4's flight logs, ``.ulg``, through pyulog.

Messages of PX4-Autopilot, msg/: times in us since start; sensor_combined in the body's forward, right, down
(m/s2, rad/s); fixes in degrees (or 1e-7 degrees, mm in older logs), velocity north and east; in simulation also
the true place, north and east of a reference.
"""

import struct
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.messages import broken
from sigmaswarm.importing.readers.uorb import IMU, TURNED, T, fix
from sigmaswarm.importing.source import Frames, Guess, Part, Role, Source, first_bytes, library

MAGIC = b"ULog\x01\x12\x35"
_TOPICS = ("sensor_combined", "vehicle_gps_position", "sensor_gps", "vehicle_local_position_groundtruth")


def recognizes(path: Path) -> bool:
    """Return True if it begins as ULog does."""
    return first_bytes(path, 7) == MAGIC or (path.is_file() and path.suffix == ".ulg")


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Read the topics that a drive is made of; the others are skipped."""
    core = library("pyulog.core", "logs")
    _require_whole_definitions(path)
    try:
        with path.open("rb") as file:
            log = core.ULog(file, message_name_filter_list=list(_TOPICS))
    except Exception as error:  # the library raises anything on damaged bytes
        raise broken(path, error) from None
    if log.file_corruption:
        raise InputError(f"{path}: is cut short or broken; copy the log again")
    frames = {
        f"{data.name}{data.multi_id or ''}": pl.DataFrame({k: v for k, v in data.data.items() if v.ndim == 1})
        for data in log.data_list
    }
    if not frames:
        raise InputError(
            f"{path}: holds none of {', '.join(_TOPICS)}; log them (SDLOG_PROFILE), and fly again"
        )
    yield Frames(path, frames, _guess(frames), dict.fromkeys(frames, "uORB topic"))


def _require_whole_definitions(path: Path) -> None:
    """Refuse a definition that is longer than the rest of the file: pyulog goes back behind it, again and again."""
    size, at = path.stat().st_size, 16
    with path.open("rb") as file:
        while at + 3 <= size:
            file.seek(at)
            length, kind = struct.unpack("<Hc", file.read(3))
            at += 3 + length
            if kind in b"ALC":  # data begin
                return
            if at > size or kind not in b"BFIMPQ":
                raise InputError(
                    f"{path}: is cut short or broken at byte {at - 3 - length}; copy the log again"
                )


def _guess(frames: dict[str, pl.DataFrame]) -> Guess:
    roles: dict[Role, tuple[Part, ...]] = {}
    origin = None
    notes = [TURNED]
    if "sensor_combined" in frames:
        roles["imu"] = (Part("sensor_combined", {"t": T, **IMU}),)
    fixes = next((t for t in ("vehicle_gps_position", "sensor_gps") if t in frames), None)
    if fixes:
        roles["gps"] = (Part(fixes, {"t": T, **fix(frames[fixes].columns)}),)
        notes.append(f"{fixes}: the stated horizontal accuracy is split evenly between east and north")
    truth = frames.get("vehicle_local_position_groundtruth")
    if truth is not None and {"ref_lat", "ref_lon", "ref_alt"} <= set(truth.columns) and len(truth):
        columns = {"t": T, "x": "y", "y": "x", "vx": "vy", "vy": "vx", "theta": "pi/2 - heading"}
        roles["truth"] = (Part("vehicle_local_position_groundtruth", columns),)
        origin = _place(truth.row(len(truth) - 1, named=True))
    return Guess(roles, tuple(notes), origin)


def _place(row: dict[str, Any]) -> tuple[float, float, float]:
    return float(row["ref_lat"]), float(row["ref_lon"]), float(row["ref_alt"])
