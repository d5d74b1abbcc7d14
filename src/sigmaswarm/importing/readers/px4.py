"""PX4's flight logs (``.ulg``), read with pyulog, and PX4's messages in ROS 2 bags.

Messages (PX4-Autopilot, msg/): times are in us since boot. The axes of sensor_combined are forward, right, down (m/s2,
rad/s). Fixes are in degrees and m (in older logs 1e-7 degrees and mm), with velocity north and east. Simulations also
contain the true position, m north and east of a reference.
"""

import io
from contextlib import ExitStack, redirect_stdout
from pathlib import Path

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.source import (
    Guess,
    Limits,
    Log,
    Part,
    Role,
    Table,
    errors_as_damage,
    first_bytes,
    import_library,
    log_of_frames,
    roles_of,
)

MAGIC = b"ULog\x01\x12\x35"
AXES_NOTE = "PX4's axes are converted from forward, right, down to forward, left, up"
_T = {"t": "timestamp*1e-6"}
_IMU = _T | {
    **{"ax": "accelerometer_m_s2[0]", "ay": "-accelerometer_m_s2[1]", "az": "-accelerometer_m_s2[2]"},
    **{"gx": "gyro_rad[0]", "gy": "-gyro_rad[1]", "gz": "-gyro_rad[2]"},
}
_FIX: dict[str, str | tuple[str, ...]] = {
    **_T,
    "lat": ("latitude_deg", "lat*1e-7"),  # since PX4 1.14; before PX4 1.14
    "lon": ("longitude_deg", "lon*1e-7"),
    "alt": ("altitude_ellipsoid_m", "alt_ellipsoid*1e-3"),
    "std_x": ("eph/sqrt(2)",),
    "std_y": ("eph/sqrt(2)",),
    "vx": ("vel_e_m_s",),
    "vy": ("vel_n_m_s",),
    "keep": ("fix_type >= 3",),
}
_TRUTH = "vehicle_local_position_groundtruth"
_TRUE = _T | {"x": "y", "y": "x", "vx": "vy", "vy": "vx", "theta": "pi/2 - heading"}
_TOPICS = ("sensor_combined", "vehicle_gps_position", "sensor_gps", _TRUTH)
_KINDS: dict[Role, tuple[str, ...]] = {"imu": ("SensorCombined",), "gps": ("SensorGps", "VehicleGpsPosition")}


def part_of(topic: str, table: Table, role: Role) -> Part | None:
    package, _, kind = table.kind.rpartition("/")
    if not package.startswith("px4_msgs") or kind not in _KINDS.get(role, ()):
        return None
    (part,) = roles_of([(role, topic, _IMU if role == "imu" else _FIX)], {topic: table.columns})[role]
    return part if role == "imu" or {"lat", "lon"} <= part.columns.keys() else None


def recognizes(path: Path) -> bool:
    return first_bytes(path, 7) == MAGIC or (path.is_file() and path.suffix == ".ulg")


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    core = import_library("pyulog.core", "logs")
    # pyulog prints
    with errors_as_damage(path), _Log(io.FileIO(path)) as file, redirect_stdout(io.StringIO()):
        log = core.ULog(file, message_name_filter_list=list(_TOPICS))
    if log.file_corruption or file.stopped < path.stat().st_size:
        raise InputError(f"{path}: is cut short or broken before byte {file.stopped}; copy the log again")
    frames = {
        f"{data.name}{data.multi_id or ''}": pl.DataFrame({k: v for k, v in data.data.items() if v.ndim == 1})
        for data in log.data_list
    }
    if not frames:
        raise InputError(
            f"{path}: contains none of {', '.join(_TOPICS)}; enable these topics (SDLOG_PROFILE), and record again"
        )
    guess = _guess(frames)
    return log_of_frames(path, frames, "uORB topic", lambda _: guess)


class _Log(io.BufferedReader):
    """A file that records where pyulog stopped reading, and prevents pyulog's search after a damaged message.

    pyulog stops without an error at a message that is too short. After a message of unknown kind and impossible
    size, its byte-by-byte search takes hours or does not end.
    """

    stopped = 0
    _last = 0

    def read(self, size: int | None = -1, /) -> bytes:
        content = super().read(size)
        self._last = len(content) if len(content) == size else -4  # too short: refuse to seek back
        return content

    def seek(self, offset: int, whence: int = 0, /) -> int:
        # pyulog seeks back over a valid message at the end of the definitions, and over a message of unknown kind
        if whence == io.SEEK_CUR and -offset not in (self._last, self._last + 3):
            raise EOFError(f"at byte {self.tell()}")
        return super().seek(offset, whence)

    def close(self) -> None:
        if not self.closed:
            self.stopped = self.tell()
        super().close()


def _guess(frames: dict[str, pl.DataFrame]) -> Guess:
    parts: list[tuple[Role, str, dict[str, str | tuple[str, ...]]]] = [("imu", "sensor_combined", {**_IMU})]
    origin = None
    notes = [AXES_NOTE]
    if fixes := next((t for t in _TOPICS[1:3] if t in frames), None):
        parts.append(("gps", fixes, _FIX))
        notes.append(
            f"{fixes}: the horizontal accuracy / sqrt(2) is used as the standard deviation east and north"
        )
    reference = ("ref_lat", "ref_lon", "ref_alt")
    if _TRUTH in frames and {*reference} <= {*frames[_TRUTH].columns} and len(frames[_TRUTH]):
        parts.append(("truth", _TRUTH, {**_TRUE}))
        lat, lon, alt = (float(frames[_TRUTH][name][-1]) for name in reference)
        origin = lat, lon, alt
    return Guess(roles_of(parts, {name: f.columns for name, f in frames.items()}), tuple(notes), origin)
