"""comma2k19: a segment's folder, with processed_log and global_pose.

H. Schafer et al., "A Commute in Data: The comma2k19 Dataset", 2018, and the data set's README: NumPy arrays of times
(s since the device's start) and values; IMU forward, right, down; poses of the camera in ECEF, quaternions Hamilton,
w first, that turn the device's axes to ECEF.
"""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import polars as pl
import pymap3d

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.source import Frames, Guess, Part, Role, Source
from sigmaswarm.wording import shown

_SENSORS = {
    "accelerometer": ("IMU/accelerometer", "IMU/acceleration"),
    "gyro": ("IMU/gyro", "IMU/gyro_uncalibrated"),
    "gnss": ("GNSS/live_gnss_ublox", "GNSS/live_gnss_qcom"),
    "speed": ("CAN/speed",),
}
_COLUMNS = {
    "accelerometer": ("forward", "right", "down"),
    "gyro": ("forward", "right", "down"),
    "gnss": ("latitude", "longitude", "speed", "utc", "altitude", "bearing"),
    "speed": ("speed",),
}
_FIX = {
    **{"t": "t", "lat": "latitude", "lon": "longitude", "alt": "altitude"},
    **{"speed": "speed", "course": "radians(90 - bearing)"},
}
_TRUTH = {name: name for name in ("t", "lat", "lon", "alt", "vx", "vy", "theta")}


def recognizes(path: Path) -> bool:
    """Return True if it is a segment's folder."""
    return (path / "processed_log" / "IMU").is_dir()


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Read a segment: a minute, a few MB."""
    frames: dict[str, pl.DataFrame] = {}
    for name, folders in _SENSORS.items():
        folder = next((f for f in (path / "processed_log" / f for f in folders) if f.is_dir()), None)
        if folder is not None:
            frames[name] = _table(folder, _COLUMNS[name])
    pose = next((f for f in (path / "global_pose", path / "global_pos") if f.is_dir()), None)
    if pose is not None:
        frames["pose"] = _pose(pose)
    roles: dict[Role, tuple[Part, ...]] = {}
    if {"accelerometer", "gyro"} <= frames.keys():
        acceleration = {"t": "t", "ax": "forward", "ay": "-right", "az": "-down"}
        rates = {"t": "t", "gx": "forward", "gy": "-right", "gz": "-down"}
        roles["imu"] = (Part("accelerometer", acceleration), Part("gyro", rates))
    if "gnss" in frames:
        roles["gps"] = (Part("gnss", _FIX),)
    if "pose" in frames:
        roles["truth"] = (Part("pose", _TRUTH),)
    if "speed" in frames:
        roles["odometer"] = (Part("speed", {"t": "t", "speed": "speed"}),)
    notes = ("the IMU's axes turned from forward, right, down; the truth is the camera's",)
    yield Frames(path, frames, Guess(roles, notes, metadata={"licence": "MIT", "dataset": "comma2k19"}))


def _load(path: Path) -> Array:
    try:
        # mapped, a header that says more than the file holds is refused before memory is asked for
        array = np.load(path, allow_pickle=False, mmap_mode="r")
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub":
            raise ValueError("no array of numbers")
        return np.array(array, dtype=np.float64)
    except Exception as error:  # a damaged header is evaluated as Python, and raises whatever that does
        said = shown(" ".join(str(error).split()), 120)
        raise InputError(
            f"{path}: can't be read as a NumPy array ({said}); unpack the segment again"
        ) from None


def _table(folder: Path, columns: tuple[str, ...]) -> pl.DataFrame:
    """Times and values of a sensor."""
    time, values = _load(folder / "t"), _load(folder / "value")
    _require_shape(time, (time.size,), folder / "t")
    if len(columns) == 1 and values.ndim == 1:
        values = values[:, np.newaxis]
    _require_shape(values, (len(time), len(columns)), folder / "value")
    return pl.DataFrame({"t": time, **dict(zip(columns, values.T, strict=True))})


def _require_shape(array: Array, shape: tuple[int, ...], path: Path) -> None:
    if array.shape != shape:
        raise InputError(f"{path}: has shape {array.shape}, not {shape}; unpack the segment again")


@np.errstate(all="ignore")
def _pose(folder: Path) -> pl.DataFrame:
    """The camera's place in degrees, and its velocity and heading about the first place."""
    time, ecef = _load(folder / "frame_times"), _load(folder / "frame_positions")
    velocity, quaternion = _load(folder / "frame_velocities"), _load(folder / "frame_orientations")
    _require_shape(time, (max(time.size, 1),), folder / "frame_times")
    for array, width, name in (
        (ecef, 3, "positions"),
        (velocity, 3, "velocities"),
        (quaternion, 4, "orientations"),
    ):
        _require_shape(array, (len(time), width), folder / f"frame_{name}")
    lat, lon, alt = pymap3d.ecef2geodetic(*ecef.T)
    first = lat[0], lon[0]
    w, x, y, z = quaternion.T
    # the first column of the rotation: where the device's forward axis points
    forward = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    east, north, _ = pymap3d.ecef2enuv(*forward, *first)
    vx, vy, _ = pymap3d.ecef2enuv(velocity[:, 0], velocity[:, 1], velocity[:, 2], *first)
    columns = {"t": time, "lat": lat, "lon": lon, "alt": alt, "vx": vx, "vy": vy}
    return pl.DataFrame({**columns, "theta": np.arctan2(north, east)})
