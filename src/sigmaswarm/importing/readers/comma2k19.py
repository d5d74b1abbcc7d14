"""comma2k19: the folder of a segment, with processed_log and global_pose.

H. Schafer et al., "A Commute in Data: The comma2k19 Dataset", 2018, and the README of the data set define the files.
NumPy arrays contain times (s since the boot of the device) and values. The axes of the IMU are forward, right and down.
The poses of the camera are in ECEF, with quaternions (Hamilton, w first) that rotate the axes of the device to ECEF.
"""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import polars as pl
import pymap3d

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.importing.source import Guess, Limits, Log, Role, errors_as_damage, log_of_frames, roles_of

_AXES = ("forward", "right", "down")
# For each table: the folders that may contain it, of which the first is read, and the names of its columns
_SENSORS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "accelerometer": (("IMU/accelerometer", "IMU/acceleration"), _AXES),
    "gyro": (("IMU/gyro", "IMU/gyro_uncalibrated"), _AXES),
    "gnss": (
        ("GNSS/live_gnss_ublox", "GNSS/live_gnss_qcom"),
        ("latitude", "longitude", "speed", "utc", "altitude", "bearing"),
    ),
    "speed": (("CAN/speed",), ("speed",)),
}
_FIX = {
    **{"t": "t", "lat": "latitude", "lon": "longitude", "alt": "altitude"},
    **{"speed": "speed", "course": "radians(90 - bearing)"},
}
PARTS: tuple[tuple[Role, str, dict[str, str]], ...] = (
    ("imu", "accelerometer", {"t": "t", "ax": "forward", "ay": "-right", "az": "-down"}),
    ("imu", "gyro", {"t": "t", "gx": "forward", "gy": "-right", "gz": "-down"}),
    ("gps", "gnss", _FIX),
    ("truth", "pose", {name: name for name in ("t", "lat", "lon", "alt", "vx", "vy", "theta")}),
    ("odometer", "speed", {"t": "t", "speed": "speed"}),
)
_NOTE = (
    "the IMU's axes are converted from forward, right, down to forward, left, up; the truth is the position of "
    "the camera"
)


def recognizes(path: Path) -> bool:
    return (path / "processed_log" / "IMU").is_dir()


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    frames: dict[str, pl.DataFrame] = {}
    for name, (folders, columns) in _SENSORS.items():
        for folder in [f for f in (path / "processed_log" / f for f in folders) if f.is_dir()][:1]:
            time = _load(folder / "t", 1)
            values = _load(folder / "value", len(columns), len(time))
            frames[name] = pl.DataFrame({"t": time[:, 0], **dict(zip(columns, values.T, strict=True))})
    for folder in [f for f in (path / "global_pose", path / "global_pos") if f.is_dir()][:1]:
        frames["pose"] = _pose(folder)
    parts = [p for p in PARTS if p[0] != "imu" or {"accelerometer", "gyro"} <= frames.keys()]
    roles = roles_of(parts, {name: frame.columns for name, frame in frames.items()})
    guess = Guess(roles, (_NOTE,), metadata={"licence": "MIT", "dataset": "comma2k19"})
    return log_of_frames(path, frames, "", lambda _: guess)


def _load(path: Path, width: int, rows: int | None = None) -> Array:
    """Load numbers as an array (rows, width); without ``rows``, load an array with one axis."""
    with errors_as_damage(path, "can't be read as a NumPy array", "unpack the segment again"):
        # memory-mapped, so that NumPy refuses a shape larger than the file before it allocates memory
        array = np.load(path, allow_pickle=False, mmap_mode="r")
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub":
            raise ValueError("not an array of numbers")
        array = np.array(array, dtype=np.float64)
    shape = (array.size,) if rows is None else (rows, width)
    if array.shape != shape and not (width == 1 and array.shape == shape[:1]):
        raise InputError(f"{path}: has shape {array.shape}, not {shape}; unpack the segment again")
    return array.reshape(len(array), width)


@np.errstate(all="ignore")
def _pose(folder: Path) -> pl.DataFrame:
    """Return the position in degrees, the velocity and the heading of the camera.

    An invalid position affects only its own row.
    """
    time = _load(folder / "frame_times", 1)
    if not len(time):
        raise InputError(f"{folder / 'frame_times'}: is empty; unpack the segment again")
    widths = {"positions": 3, "velocities": 3, "orientations": 4}
    ecef, velocity, quaternion = (_load(folder / f"frame_{n}", k, len(time)) for n, k in widths.items())
    lat, lon, alt = pymap3d.ecef2geodetic(*ecef.T)
    w, x, y, z = quaternion.T
    # the first column of the rotation is the direction of the device's forward axis
    forward = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    east, north, _ = pymap3d.ecef2enuv(*forward, lat0=lat, lon0=lon)
    vx, vy, _ = pymap3d.ecef2enuv(*velocity.T, lat0=lat, lon0=lon)
    columns = {"t": time[:, 0], "lat": lat, "lon": lon, "alt": alt, "vx": vx, "vy": vy}
    return pl.DataFrame({**columns, "theta": np.arctan2(north, east)})
