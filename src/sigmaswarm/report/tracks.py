"""Tracks and errors over time of every method on a drive, thinned, as one file that pages are made of.

`tracks.npz` holds, for drive number ``i`` in ``names`` and each of its series, one array a column, called
``i/series/column``. Same result, same bytes: nothing in it tells when it was written.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Array, Drive, Truth
from sigmaswarm.errors import InputError
from sigmaswarm.files import whole_file
from sigmaswarm.filters.dead_reckoning import run_imu_only
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, datasheet
from sigmaswarm.filters.run import Estimate, run_filter, run_innovations
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.score import truth_at

Columns = Mapping[str, NDArray[np.floating[Any]]]
NIS = ".nis"
"""Ends the name of the series that holds a filter's NIS."""
MOST_POINTS = 1500
"""Of a series; more than a screen has columns."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """What every method said on one drive.

    Attributes
    ----------
    name : str
        Of the drive.
    series : mapping of str to mapping of str to ndarray, shape (n,)
        ``truth``, ``raw_gps``, ``imu_only`` and the filters have time (s), x, y (m); methods also position_error (m),
        filters and ``imu_only`` heading_error (deg), filters position_3sigma (m) and heading_3sigma (deg). ``F.nis``
        has the time and NIS of the fixes that the filter ``F`` took in. Errors are NaN where truth is not known.
    """

    name: str
    series: Mapping[str, Columns]


def compared(drive: Drive, tuned: FilterParameters) -> dict[str, FilterParameters]:
    """The manual filters and the tuned one; the tuned one last, to be drawn on top."""
    return {"datasheet": datasheet(drive), "defaults": DEFAULTS, "tuned": tuned}


def estimates(drive: Drive, tuned: FilterParameters, initial: InitialState) -> Mapping[str, Estimate]:
    """What the filters of `compared` say, from the same start."""
    return {name: run_filter(drive, p, initial=initial) for name, p in compared(drive, tuned).items()}


def errors_of(estimate: Estimate, truth: Truth) -> tuple[Array, Array]:
    """Distance from the truth (m) and heading error (deg) at the estimate's times; NaN where truth is not known."""
    x, y = truth_at(truth, estimate.time)
    theta = np.interp(estimate.time, truth.time, np.unwrap(truth.theta), left=np.nan, right=np.nan)
    distance = np.hypot(estimate.mean[:, 0] - x, estimate.mean[:, 1] - y)
    return distance, np.degrees(wrap_angle(estimate.mean[:, THETA] - theta))


def three_sigma(estimate: Estimate) -> tuple[Array, Array]:
    """What a filter thinks of its own errors: 3-sigma radius of the position (m) and of the heading (deg)."""
    std = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
    return 3 * np.hypot(std[:, 0], std[:, 1]), 3 * np.degrees(std[:, THETA])


def tracks_of(
    drive: Drive, filters: Mapping[str, FilterParameters], name: str, most_points: int = MOST_POINTS
) -> Tracks:
    """Run filters, by the names of their series, over a drive, and keep what a page shows of it."""
    initial = initial_state(drive)
    gps, truth = drive.gps, drive.truth
    series: dict[str, dict[str, Array]] = {}
    if truth is not None:
        series["truth"] = {"time": truth.time, "x": truth.x, "y": truth.y}
    for method, parameters in filters.items():
        estimate = run_filter(drive, parameters, initial=initial)
        series[method] = _columns(estimate, truth)
        if estimate.failure is None:
            innovations = run_innovations(drive, parameters, initial=initial)
            series[method + NIS] = {"time": innovations.time, "nis": innovations.nis}
    series["imu_only"] = _columns(run_imu_only(drive, initial=initial), truth)
    series["raw_gps"] = {"time": gps.time, "x": gps.x, "y": gps.y}
    if truth is not None:
        x, y = truth_at(truth, gps.time)
        series["raw_gps"]["position_error"] = np.hypot(gps.x - x, gps.y - y)
    return Tracks(name, {s: _thinned(columns, most_points) for s, columns in series.items()})


def _columns(estimate: Estimate, truth: Truth | None) -> dict[str, Array]:
    columns = {"time": estimate.time, "x": estimate.mean[:, 0], "y": estimate.mean[:, 1]}
    if truth is not None:
        columns["position_error"], columns["heading_error"] = errors_of(estimate, truth)
    if len(estimate.covariance):
        columns["position_3sigma"], columns["heading_3sigma"] = three_sigma(estimate)
    return columns


def _thinned(columns: Mapping[str, Array], most_points: int) -> Columns:
    """At most so many rows, float32 but for the time; no peak of the error, or of the NIS, gets lost."""
    n = len(columns["time"])
    kept = np.arange(n)
    if n > most_points:
        matters = columns.get("position_error", columns.get("nis", np.arange(n, dtype=float)))
        matters = np.nan_to_num(matters, nan=0.0)
        parts = np.array_split(kept[1:-1], most_points // 2 - 1)
        ends = [part[[matters[part].argmin(), matters[part].argmax()]] for part in parts]
        kept = np.unique([0, n - 1, *np.concatenate(ends)])
    return {name: v[kept] if name == "time" else v[kept].astype(np.float32) for name, v in columns.items()}


def save_tracks(tracks: Sequence[Tracks], path: Path) -> Path:
    """Write tracks.npz."""
    arrays = {
        f"{i}/{series}/{column}": values
        for i, one in enumerate(tracks)
        for series, columns in one.series.items()
        for column, values in columns.items()
    }
    with whole_file(path) as file:
        np.savez_compressed(file, allow_pickle=False, names=np.array([t.name for t in tracks]), **arrays)
    return path


def load_tracks(path: Path) -> list[Tracks]:
    """Read what `save_tracks` wrote.

    Raises
    ------
    InputError
        If the file can't be read.
    """
    try:
        # opened here, since np.load leaves a damaged file open
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            names = [str(name) for name in file["names"]]
            series: list[dict[str, dict[str, Array]]] = [{} for _ in names]
            for key in file.files:
                if key != "names":
                    number, of, column = key.split("/")
                    series[int(number)].setdefault(of, {})[column] = np.asarray(file[key], np.float64)
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise InputError(f"{path}: not readable; repeat the command that made the folder") from None
    return [Tracks(name, s) for name, s in zip(names, series, strict=True)]
