"""Write estimates to files. The file extension selects the format."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.exports.attitude import quaternions, rotations
from sigmaswarm.exports.foxglove import LAYOUT_FILE
from sigmaswarm.exports.maps import MAPS
from sigmaswarm.exports.ros import ros2
from sigmaswarm.files import atomic_file
from sigmaswarm.filters.run import Estimate, Innovations
from sigmaswarm.geodesy import Origin, enu_to_geodetic


def write_estimate(estimate: Estimate, path: str | Path, **options: Any) -> None:
    """Write an estimate to a file, with options as in `write_pieces`."""
    span = (float(estimate.time[0]), float(estimate.time[-1]))
    write_pieces([estimate], span, path, **options)


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
    replace: bool = False,
) -> None:
    """Write an estimate, given in pieces, to a file; the extension selects the format.

    ``.csv``: t, x, y, vx, vy, theta and std_x ... std_theta (s, m, m/s, rad); also the other states of the model and
    their standard deviations. ``.mat``, for MATLAB: t, the states by name, and covariance (n, states, states).
    ``.tum``: one line ``t x y z qx qy qz qw`` per estimate, z = 0 and the attitude as a quaternion. ``.kitti``: one
    line of 12 numbers per estimate, the 3 x 4 matrix of the pose row by row, without time. ``.ros2``: a ROS 2 bag (a
    folder) with the estimate as nav_msgs/Odometry and, with an origin, as sensor_msgs/NavSatFix; also standard
    deviations, innovations, NIS, and a layout for Foxglove. ``.geojson``, ``.gpx``, ``.kml``: the track in degrees.

    The file does not depend on the division into pieces. Maps and .mat need all pieces in memory; the other formats
    need one piece. After an error, no file remains.

    Parameters
    ----------
    pieces : iterable of Estimate
    span : (float, float)
        Times of the first and the last estimate, s.
    path : str or Path
    origin : (latitude deg, longitude deg, altitude m), optional
        Position of x = y = 0; required for maps.
    time_origin : float
        Time on the clock of the log at which the times of the estimate are 0, s (`time_origin_of`); for bags and maps.
    innovations : Innovations, optional
        .ros2: innovations of the filter.
    merge : str or Path, optional
        .ros2: copy the messages of this ROS 2 bag unchanged into the new bag.
    name : str, optional
        Name of the track in a map; by default the name of the file.
    replace : bool
        .ros2: replace a bag that this function wrote.

    Raises
    ------
    InputError
        If the extension is unknown, if the folder does not exist, if a map has no origin, or if ``merge`` is unusable.
    """
    path = Path(path)
    check_target(path, origin, merge, replace=replace)
    if path.suffix in MAPS and origin is not None:
        rows = [np.column_stack([piece.time, piece.mean[:, :2]]) for piece in pieces]
        time, east, north = np.concatenate(rows).T
        MAPS[path.suffix](time + time_origin, _degrees(east, north, origin), path, name or path.stem)
    elif path.suffix == BAG:
        options: dict[str, Any] = {"time_origin": time_origin, "origin": origin, "innovations": innovations}
        ros2(pieces, span, path, merge=Path(merge) if merge else None, replace=replace, **options)
    else:
        with atomic_file(path) as file:
            _WRITERS[path.suffix](pieces, file)


def _degrees(east: Array, north: Array, origin: Origin) -> Array:
    return enu_to_geodetic(np.column_stack([east, north, np.zeros(len(east))]), origin)[:, :2]


def write_fixes(
    drive: Drive, until: float, path: str | Path, *, origin: Origin | None = None, time_origin: float = 0.0
) -> int:
    """Write the fixes before ``until`` (s), for example before the start of a filter.

    Return the number of written fixes.

    Formats: ``.csv`` (t in s, x and y in m), ``.geojson``, ``.gpx`` and ``.kml``. Other formats raise `InputError`.
    """
    path = Path(path)
    check_fixes_target(path, origin)
    gps = drive.gps.select(drive.gps.time < until)
    if path.suffix in MAPS and origin is not None:
        name = f"{drive.name}: fixes before the filter's start"
        MAPS[path.suffix](gps.time + time_origin, _degrees(gps.x, gps.y, origin), path, name)
    else:
        with atomic_file(path) as file:
            pl.DataFrame({"t": gps.time, "x": gps.x, "y": gps.y}).write_csv(file)
    return len(gps)


def check_fixes_target(path: Path, origin: Origin | None = None) -> None:
    if path.suffix not in (endings := (".csv", *MAPS)):
        raise InputError(
            f"{path}: fixes can't be written in this format; end the name in {', '.join(endings)}"
        )
    check_target(path, origin)


def time_origin_of(drive: Drive) -> float:
    """Return the time on the log's clock (s) at which the times of a drive are 0; 0 if the import did not store it."""
    stated = drive.metadata.get("time_origin_s", 0.0)
    usable = isinstance(stated, int | float) and abs(stated) < _LATEST_ORIGIN  # not NaN
    return float(stated) if usable else 0.0


def check_target(
    path: Path, origin: Origin | None = None, merge: str | Path | None = None, *, replace: bool = False
) -> None:
    """Raise `InputError` if an estimate can't be written.

    If ``replace`` is True, a bag that this module wrote may be replaced.
    """
    endings = [*_WRITERS, BAG, *MAPS]
    if path.suffix not in endings:
        raise InputError(
            f"{path}: unknown format; end the name in {', '.join(endings[:-1])} or {endings[-1]}"
        )
    if merge and path.suffix != BAG:
        raise InputError(f"{path}: --merge writes a ROS 2 bag; end the name of the output in {BAG}")
    if path.suffix == BAG and path.exists() and not (replace and (path / LAYOUT_FILE).is_file()):
        raise InputError(f"{path}: already exists; delete it, or choose another name")
    if path.suffix != BAG and path.is_dir():
        raise InputError(f"{path}: is a folder; specify a file")
    if not path.parent.is_dir():
        raise InputError(f"{path.parent}: no such folder; create it first")
    if path.suffix in MAPS and origin is None:
        raise InputError(
            f"{path}: a map needs degrees, but the drive has no origin; specify --origin LAT,LON, or origin in "
            "its drive.toml, or write .csv, .mat, .tum, .kitti or .ros2"
        )


def true_trajectory(drive: Drive) -> Estimate:
    """Return the truth of a drive as an estimate. Raises `InputError` if there is no truth."""
    truth = drive.truth
    if truth is None:
        raise InputError(f"{drive.name}: has no truth.csv; omit --truth")
    mean = np.column_stack([truth.x, truth.y, truth.vx, truth.vy, truth.theta])
    return Estimate(truth.time, mean, np.empty(0), InitialState(mean[0], np.eye(5), float(truth.time[0])))


def _csv(pieces: Iterable[Estimate], file: BinaryIO) -> None:
    for number, estimate in enumerate(pieces):
        pl.DataFrame(estimate.columns(std=True)).write_csv(file, include_header=number == 0)


def _mat(pieces: Iterable[Estimate], file: BinaryIO) -> None:
    """Write a MATLAB file. Its arrays begin with their size, so all pieces must be in memory."""
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


_LATEST_ORIGIN = 1e12  # s
BAG = ".ros2"
_WRITERS: dict[str, Callable[[Iterable[Estimate], BinaryIO], None]] = {
    ".csv": _csv,
    ".mat": _mat,
    ".tum": _tum,
    ".kitti": _kitti,
}
