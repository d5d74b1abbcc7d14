"""Estimates as files: one writer per format, which the file's ending names."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import polars as pl

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.errors import InputError
from sigmaswarm.exports.body import quaternions, rotations
from sigmaswarm.exports.maps import MAPS
from sigmaswarm.exports.ros import ros2
from sigmaswarm.files import whole_file
from sigmaswarm.filters.run import Estimate, Innovations
from sigmaswarm.geodesy import Origin, enu_to_geodetic


def write_estimate(
    estimate: Estimate,
    path: str | Path,
    *,
    origin: Origin | None = None,
    time_origin: float = 0.0,
    innovations: Innovations | None = None,
    merge: str | Path | None = None,
    name: str | None = None,
) -> None:
    """Write an estimate in the form that the file's ending names.

    ``.csv``: t, x, y, vx, vy, theta and std_x ... std_theta (s, m, m/s, rad); planar8's biases likewise, and
    tilted12's roll and pitch.
    ``.mat``: for MATLAB: t, the states by name, and covariance (n, states, states).
    ``.tum``: one line ``t x y z qx qy qz qw`` per estimate, z = 0 and the attitude as a quaternion.
    ``.kitti``: one line of 12 numbers per estimate, the pose's 3 x 4 matrix row by row; it has no times.
    ``.ros2``: a ROS 2 bag, which is a folder, with the estimate as nav_msgs/Odometry and, with an origin, as
    sensor_msgs/NavSatFix, its standard deviations, innovations and NIS, and a layout for Foxglove.
    ``.geojson``, ``.gpx``, ``.kml``: the track in degrees.

    Parameters
    ----------
    estimate : Estimate
    path : str or Path
    origin : (latitude deg, longitude deg, altitude m), optional
        Where x = y = 0 is on the earth; the last three formats need it.
    time_origin : float
        s at which the estimate's times are 0 on the clock of its log, see `time_origin_of`; for bags and maps, whose
        times are on that clock.
    innovations : Innovations, optional
        .ros2: those of the filter.
    merge : str or Path, optional
        .ros2: a ROS 2 bag whose messages are copied unchanged into the new one.
    name : str, optional
        Name of the track in a map, such as the drive's; by default the file's.

    Raises
    ------
    InputError
        If the ending is another, the folder does not exist, a needed origin is not given, or ``merge`` can't be used.
    """
    span = (float(estimate.time[0]), float(estimate.time[-1]))
    options: dict[str, Any] = {"innovations": innovations, "merge": merge, "name": name}
    write_pieces([estimate], span, path, origin=origin, time_origin=time_origin, **options)


def write_pieces(
    pieces: Iterable[Estimate],
    span: tuple[float, float],
    path: str | Path,
    *,
    origin: Origin | None = None,
    time_origin: float = 0.0,
    innovations: Innovations | None = None,
    merge: str | Path | None = None,
    name: str | None = None,
) -> None:
    """Write an estimate that comes in pieces over ``span`` (s); the bytes do not depend on the pieces.

    .csv, .tum, .kitti and .ros2 hold one piece at a time, maps all times and places, .mat everything. If a piece can't
    be computed, nothing is written. Otherwise as `write_estimate`.
    """
    path = Path(path)
    check_target(path, origin, merge)
    if path.suffix in MAPS and origin is not None:  # which has been checked
        rows = [np.column_stack([piece.time, piece.mean[:, :2]]) for piece in pieces]
        time, east, north = np.concatenate(rows).T
        MAPS[path.suffix](time + time_origin, _degrees(east, north, origin), path, name or path.stem)
    elif path.suffix == BAG:
        options: dict[str, Any] = {"time_origin": time_origin, "origin": origin, "innovations": innovations}
        ros2(pieces, span, path, merge=Path(merge) if merge else None, **options)
    else:
        with whole_file(path) as file:
            _WRITERS[path.suffix](pieces, file)


def _degrees(east: Array, north: Array, origin: Origin) -> Array:
    return enu_to_geodetic(np.column_stack([east, north, np.zeros(len(east))]), origin)[:, :2]


def write_fixes(
    drive: Drive,
    until: float,
    path: str | Path,
    *,
    origin: Origin | None = None,
    time_origin: float = 0.0,
) -> int:
    """Write the fixes before ``until`` (s), all that is known before a filter starts; return their number.

    ``.csv``: t, x, y (s, m). ``.geojson``, ``.gpx``, ``.kml``: a track of its own, named as fixes of the drive.

    Raises
    ------
    InputError
        As `write_estimate`; other formats hold poses, which fixes are not.
    """
    path = Path(path)
    check_fixes_target(path, origin)
    gps = drive.gps.select(drive.gps.time < until)
    if path.suffix in MAPS and origin is not None:
        name = f"{drive.name}: fixes before the filter's start"
        MAPS[path.suffix](gps.time + time_origin, _degrees(gps.x, gps.y, origin), path, name)
    else:
        with whole_file(path) as file:
            pl.DataFrame({"t": gps.time, "x": gps.x, "y": gps.y}).write_csv(file)
    return len(gps)


def check_fixes_target(path: Path, origin: Origin | None = None) -> None:
    """Raise `InputError` where `write_fixes` could not write, before any work is done."""
    if path.suffix not in (endings := (".csv", *MAPS)):
        raise InputError(f"{path}: fixes are not poses; end the name in {', '.join(endings)}")
    check_target(path, origin)


def time_origin_of(drive: Drive) -> float:
    """Return the time on the log's clock, s, at which a drive's times are 0, as its import set it; else 0."""
    stated = drive.metadata.get("time_origin_s", 0.0)
    usable = isinstance(stated, int | float) and abs(stated) < _LATEST_ORIGIN  # not NaN
    return float(stated) if usable else 0.0


def check_target(path: Path, origin: Origin | None = None, merge: str | Path | None = None) -> None:
    """Raise `InputError` where `write_estimate` could not write, before any work is done."""
    endings = [*_WRITERS, BAG, *MAPS]
    if path.suffix not in endings:
        raise InputError(
            f"{path}: unknown format; end the name in {', '.join(endings[:-1])} or {endings[-1]}"
        )
    if merge and path.suffix != BAG:
        raise InputError(f"{path}: --merge copies the messages of a bag into a bag; end the name in {BAG}")
    if path.suffix == BAG and path.exists():
        raise InputError(f"{path}: exists already; delete it, or choose another name")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; make it first")
    if path.suffix in MAPS and origin is None:
        raise InputError(
            f"{path}: a map needs degrees, and the drive has no origin on the earth; give "
            "--origin LAT,LON, or origin in its drive.toml, or write .csv, .mat, .tum, .kitti or .ros2"
        )


def true_trajectory(drive: Drive) -> Estimate:
    """A drive's truth in the form of an estimate.

    Raises
    ------
    InputError
        If the drive has no truth.
    """
    truth = drive.truth
    if truth is None:
        raise InputError(f"{drive.name}: has no truth.csv; leave --truth out")
    mean = np.column_stack([truth.x, truth.y, truth.vx, truth.vy, truth.theta])
    return Estimate(truth.time, mean, np.empty(0), InitialState(mean[0], np.eye(5), float(truth.time[0])))


def _csv(pieces: Iterable[Estimate], file: BinaryIO) -> None:
    for number, estimate in enumerate(pieces):
        pl.DataFrame(estimate.columns(std=True)).write_csv(file, include_header=number == 0)


def _mat(pieces: Iterable[Estimate], file: BinaryIO) -> None:
    """Write a MATLAB file; its format has an array's size before its numbers, so all pieces stay in memory."""
    from scipy.io import savemat

    parts = [estimate.columns() | {"covariance": estimate.covariance} for estimate in pieces]
    savemat(
        file, {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, oned_as="column"
    )


def _tum(pieces: Iterable[Estimate], file: BinaryIO) -> None:
    for estimate in pieces:
        level = np.zeros(len(estimate.time))
        rows = np.column_stack([estimate.time, estimate.mean[:, :2], level, quaternions(estimate.mean)])
        np.savetxt(file, rows, fmt=["%.9f", *["%.6f"] * 3, *["%.9f"] * 4])


def _kitti(pieces: Iterable[Estimate], file: BinaryIO) -> None:
    for estimate in pieces:
        place = np.zeros((len(estimate.time), 3, 1))
        place[:, :2, 0] = estimate.mean[:, :2]
        pose = np.concatenate([rotations(estimate.mean), place], axis=2)
        np.savetxt(file, pose.reshape(-1, 12), fmt="%.9f")


_LATEST_ORIGIN = 1e12
"""s: largest time origin of a log."""
BAG = ".ros2"
"""A folder, written by `ros2`, which needs more than an estimate."""
_WRITERS: dict[str, Callable[[Iterable[Estimate], BinaryIO], None]] = {
    ".csv": _csv,
    ".mat": _mat,
    ".tum": _tum,
    ".kitti": _kitti,
}
