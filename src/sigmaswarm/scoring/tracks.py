"""Record thinned tracks and errors of every method on a drive; write tracks.npz.

tracks.npz contains one array ``i/series/column`` for each column of each series of drive ``i`` in ``names``.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gaps import is_known
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError
from sigmaswarm.files import atomic_file, read_arrays
from sigmaswarm.filters.bank.offsets import START
from sigmaswarm.filters.bank.run import BankRun
from sigmaswarm.filters.filter_run import EstimateChunk, FilterRun
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.run import Estimate, whole_pass
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.scoring.consistency import Consistency, RadiusRecord, consistency_of, stated_radius
from sigmaswarm.scoring.drifts import Run
from sigmaswarm.scoring.methods import BASELINE
from sigmaswarm.scoring.score import PieceErrors, Score, distance_from, score_raw_gps

Columns = Mapping[str, NDArray[np.floating[Any]]]


class ThinnedSeries:
    """A limited number of rows of a series, including the peaks of the position error or of the NIS.

    The first and the last row are kept. The rows in between are divided into equal parts. In each part, the rows with
    the smallest and the largest error or NIS are kept. For a series with neither, the first and the last row of each
    part are kept.
    """

    def __init__(self, n: int, most: int) -> None:
        self._ends: NDArray[np.intp] | None = None
        if n > most:
            parts, inner = most // 2 - 1, n - 2
            sizes = inner // parts + (np.arange(parts) < inner % parts)
            self._ends = np.concatenate([[1], 1 + np.cumsum(sizes), [n]])
        self._first = 0  # index in the series of the first waiting row
        self._waiting: dict[str, NDArray[np.floating[Any]]] = {}
        self._kept: list[Columns] = []

    def add(self, columns: Columns) -> None:
        if self._ends is None:
            self._kept.append({name: np.array(values) for name, values in columns.items()})
            return
        if self._waiting:
            columns = {name: np.concatenate([self._waiting[name], v]) for name, v in columns.items()}
        ends = self._ends[self._ends > self._first] - self._first
        whole = ends[ends <= len(columns["time"])]
        if len(whole):
            rows = _extremes(columns, whole)
            self._kept.append({name: values[rows] for name, values in columns.items()})
            columns = {name: values[whole[-1] :] for name, values in columns.items()}
            self._first += int(whole[-1])
        self._waiting = {name: np.array(values) for name, values in columns.items()}

    @property
    def columns(self) -> Columns:
        """Rows that were kept; complete after the last piece."""
        if not self._kept:
            return {"time": np.empty(0)}
        return {name: np.concatenate([part[name] for part in self._kept]) for name in self._kept[0]}


def _extremes(columns: Columns, ends: NDArray[np.intp]) -> NDArray[np.intp]:
    order = np.arange(len(columns["time"]), dtype=np.float64)
    key = np.nan_to_num(columns.get("position_error", columns.get("nis", order)), nan=0.0)
    parts = [(first, key[first:end]) for first, end in pairwise([0, *ends.tolist()])]
    rows = [first + int(at) for first, part in parts for at in (part.argmin(), part.argmax())]
    return np.unique(rows)


class CloseUp:
    """All rows of a series that lie in a region, with a gap wherever the series leaves the region.

    ``center`` is the middle of the region, m, shape (2,). ``side`` is the side of the plotted square, m.
    The region is twice as wide, since a plot with equal scales may show more than this square.
    """

    def __init__(self, center: NDArray[np.float64], side: float) -> None:
        self._center, self._reach = center, side
        self._kept: list[NDArray[np.float64]] = []
        self._was_near = True

    def add(self, columns: Columns) -> None:
        if "x" not in columns:
            return
        points = np.column_stack([columns["x"], columns["y"]]).astype(np.float64)
        near = np.all(np.abs(points - self._center) <= self._reach, axis=1)
        leaves = ~near & np.append(self._was_near, near[:-1])
        points[~near] = np.nan
        self._kept.append(points[near | leaves])
        self._was_near = bool(near[-1])

    @property
    def columns(self) -> Columns:
        points = np.concatenate(self._kept) if self._kept else np.empty((0, 2))
        return {"x": points[:, 0], "y": points[:, 1]}


TRACKS_FILE = "tracks.npz"
NIS = ".nis"
SHARES, MOVED = ".shares", ".moved"  # series of a filter bank: weights, distance from the tuned parameters
MAX_POINTS = 1500  # largest number of points of a series in a file; most charts have fewer pixel columns
MAX_PLOT_POINTS = 20_000  # largest number of points of a series in a static plot
NOTHING_STATED: tuple[Array, Array, Array | None] = np.empty(0), np.empty(0), None
CLOSE_UP_SIZE = 50.0  # m, side of the close-up of a track


@dataclass(frozen=True, eq=False)
class Tracks:
    """Estimates and errors of all methods on one drive.

    Series have the columns time (s), x and y (m). All series except ``truth`` also have position_error (m). Filters and
    ``imu_only`` have heading_error (deg), and filters have position_3sigma (m) and heading_3sigma (deg). The series
    ``F.nis`` has the time and NIS of the fixes that filter ``F`` used. Without truth there are no error columns; in
    gaps of truth the errors are NaN.
    """

    name: str
    series: Mapping[str, Columns]


@dataclass(frozen=True, eq=False)
class Picture:
    """Data of a static plot of the tracks on a drive.

    ``close`` contains all x and y of each series in a region around the sharpest turn, and NaN where the series leaves
    this region. ``start`` and ``turn``, shape (2,), are the positions of the filters' start and of the turn, m east and
    north. ``frame``, shape (2, 2), has the smallest and the largest x and y of the fixes.
    """

    whole: Tracks
    close: Mapping[str, Columns]
    start: Array
    turn: Array
    frame: Array


def compared(
    drive: Drive, tuned: FilterParameters, shown_std: float | None = None
) -> dict[str, FilterParameters]:
    return {BASELINE: baseline(drive, tuned, shown_std), "tuned": tuned}


class Tracker:
    """Recorder of thinned tracks of methods that run over a drive; complete estimates are not stored.

    ``own_sigma`` is the RMS of each filter's position standard deviation, m. ``stated`` contains times of truth (s),
    and the tuned filter's position variances per axis (m2) and errors (m) at these times; without truth, it contains
    times and variances of all estimates. If ``picture`` is True, the data of a static plot are also recorded.
    """

    def __init__(self, ready: PreparedDrive, most_points: int = MAX_POINTS, *, picture: bool = False) -> None:
        self._ready, self._most, self._picture = ready, most_points, picture
        self._turn = sharpest_turn(ready) if picture else np.zeros(2)
        self._thin: dict[str, Columns] = {}
        self._fine: dict[str, Columns] = {}
        self._close: dict[str, Columns] = {}
        self.scores: dict[str, Score] = {}
        self.own_sigma: dict[str, float] = {}
        self.stated = NOTHING_STATED
        truth = ready.drive.truth
        if truth is not None:
            self._theta = np.unwrap(truth.theta)
            self._keep("truth", [{"time": truth.time, "x": truth.x, "y": truth.y}], len(truth))

    def record(
        self, series: str, drive_pass: FilterPass, parameters: FilterParameters, *, recover: bool = False
    ) -> FilterRun:
        recording = FilterRun(drive_pass, parameters, recover=recover)
        self._follow(series, recording, drive_pass.initial)
        if recording.failure is None:
            nu = recording.innovations
            self._keep(series + NIS, [{"time": nu.time, "nis": nu.nis}], len(nu.time))
        return recording

    def follow(self, series: str, run: Run) -> None:
        self._follow(series, run, run.initial)
        self.scores[series] = replace(self.scores[series], failed=run.failure is not None)
        if isinstance(run, BankRun):
            log = run.log
            moved = {name: log.moved[:, i] for i, name in enumerate(log.names) if name != START}
            self._keep(series + SHARES, [{"time": log.time, **log.shares}], len(log.time))
            self._keep(series + MOVED, [{"time": log.time, **moved}], len(log.time))

    def _follow(self, series: str, run: Iterable[EstimateChunk], initial: InitialState) -> None:
        truth, imu_time = self._ready.drive.truth, self._ready.drive.imu.time
        errors = None if truth is None else PieceErrors(truth, initial)
        variance, count = 0.0, 0
        variances: list[Array] = []

        def pieces() -> Iterator[Columns]:
            nonlocal variance, count
            for piece in run:
                mean_variance = None
                if len(piece.covariance):
                    both = piece.covariance[:, [0, 1], [0, 1]]
                    variance += float(both.sum())
                    count += len(piece.time)
                    mean_variance = both.mean(axis=1) if series == "tuned" else None
                if errors:
                    errors.add(piece.time, piece.mean, mean_variance)
                elif mean_variance is not None:
                    variances.append(np.vstack([piece.time, mean_variance]))
                yield self._columns(piece)

        self._keep(series, pieces(), int((imu_time > self._ready.initial.time).sum()))
        self.own_sigma[series] = float(np.sqrt(variance / count)) if count else np.nan
        self.scores[series] = errors.score if errors else Score()
        if series == "tuned":
            self.stated = errors.errors if errors else (*np.hstack(variances), None)

    def keep_estimate(self, series: str, estimate: Estimate) -> None:
        self._keep(series, [self._columns(estimate)], len(estimate.time))

    def _columns(self, estimate: Estimate | EstimateChunk) -> Columns:
        time, mean, truth = estimate.time, estimate.mean, self._ready.drive.truth
        columns = {"time": time, "x": mean[:, 0], "y": mean[:, 1]}
        if truth is not None:
            columns["position_error"] = distance_from(truth, time, mean[:, 0], mean[:, 1])
            true = np.where(is_known(truth, time), np.interp(time, truth.time, self._theta), np.nan)
            columns["heading_error"] = np.degrees(wrap_angle(mean[:, THETA] - true))
        if len(estimate.covariance):
            std = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
            columns["position_3sigma"] = 3 * np.hypot(std[:, 0], std[:, 1])
            columns["heading_3sigma"] = 3 * np.degrees(std[:, THETA])
        return columns

    def _keep(self, series: str, pieces: Iterable[Columns], n: int) -> None:
        thin, fine = ThinnedSeries(n, self._most), ThinnedSeries(n, MAX_PLOT_POINTS)
        close = CloseUp(self._turn, CLOSE_UP_SIZE)
        for columns in pieces:
            thin.add(columns)
            if self._picture:
                fine.add(columns)
                close.add(columns)
        self._thin[series] = {k: v if k == "time" else v.astype(np.float32) for k, v in thin.columns.items()}
        if self._picture:
            self._fine[series], self._close[series] = fine.columns, close.columns

    def tracks(self, name: str) -> Tracks:
        self._keep_fixes()
        return Tracks(name, self._thin)

    def picture(self, name: str) -> Picture:
        self._keep_fixes()
        gps = self._ready.drive.gps
        frame = np.array([[gps.x.min(), gps.y.min()], [gps.x.max(), gps.y.max()]])
        start = self._ready.initial.mean[:2]
        return Picture(Tracks(name, self._fine), self._close, start, self._turn, frame)

    def _keep_fixes(self) -> None:
        if "raw_gps" in self._thin:
            return
        for kept in (self._thin, self._fine, self._close):  # IMU only is drawn after the filters
            if "imu_only" in kept:
                kept["imu_only"] = kept.pop("imu_only")
        gps, truth = self._ready.drive.gps, self._ready.drive.truth
        columns = {"time": gps.time, "x": gps.x, "y": gps.y}
        if truth is not None:
            columns["position_error"] = distance_from(truth, gps.time, gps.x, gps.y)
        self._keep("raw_gps", [columns], len(gps))


@dataclass(frozen=True, eq=False)
class FirstTrack:
    """Result of a tuned filter on a training drive.

    ``position_rmse`` contains values for the tuned filter, the baseline and the raw fixes, m; NaN if there is no truth.
    """

    picture: Picture
    position_rmse: Mapping[str, float]
    consistency: Consistency | None
    radius: RadiusRecord | None = None


def first_track(
    drive: Drive, parameters: FilterParameters, *, as_recorded: bool, shown_std: float | None = None
) -> FirstTrack:
    ready = PreparedDrive(drive, as_recorded=as_recorded)
    tracker = Tracker(ready, picture=True)
    filters = compared(drive, parameters, shown_std)
    recorded = {series: tracker.record(series, whole_pass(ready), p) for series, p in filters.items()}
    rmse = {series: score.position_rmse for series, score in tracker.scores.items()}
    rmse["raw_gps"] = score_raw_gps(drive, ready.initial).position_rmse
    consistency = radius = None
    if recorded["tuned"].failure is None:
        consistency = consistency_of(recorded["tuned"].innovations, own_sigma=tracker.own_sigma["tuned"])
        radius = stated_radius(drive, parameters, tracker.stated)
    return FirstTrack(tracker.picture(drive.name), rmse, consistency, radius)


def sharpest_turn(ready: PreparedDrive) -> Array:
    """Return the position of the largest turn within 4 s, m east and north, as the median of the five nearest fixes."""
    imu, gps = ready.drive.imu, ready.drive.gps
    turned = np.concatenate([[0.0], np.cumsum(imu.gz[1:] * np.diff(imu.time))])
    t = imu.time[imu.time > ready.initial.time]
    inside = t[(t > t[0] + 2) & (t < t[-1] - 2)]
    at = t[len(t) // 2]
    if len(inside):
        change = np.abs(np.interp(inside + 2, imu.time, turned) - np.interp(inside - 2, imu.time, turned))
        at = inside[int(np.argmax(change))]
    around = np.argsort(np.abs(gps.time - at))[:5]
    return np.array([np.median(gps.x[around]), np.median(gps.y[around])])


def save_tracks(tracks: Sequence[Tracks], path: Path) -> Path:
    arrays = {
        f"{i}/{series}/{column}": values
        for i, one in enumerate(tracks)
        for series, columns in one.series.items()
        for column, values in columns.items()
    }
    with atomic_file(path) as file:
        np.savez_compressed(file, allow_pickle=False, names=np.array([t.name for t in tracks]), **arrays)
    return path


def load_tracks(path: Path) -> list[Tracks]:
    try:
        arrays = read_arrays(path)
        names = [str(name) for name in arrays.pop("names")]
        series: list[dict[str, dict[str, Array]]] = [{} for _ in names]
        for key, values in arrays.items():
            number, of, column = key.split("/")
            series[int(number)].setdefault(of, {})[column] = np.asarray(values, np.float64)
        tracks = [Tracks(name, s) for name, s in zip(names, series, strict=True)]
        for of, columns in (item for one in tracks for item in one.series.items()):
            # NAME.nis, NAME.shares and NAME.moved have no positions
            needed = {"time", *(() if "." in of else ("x", "y")), *(["nis"] if of.endswith(NIS) else [])}
            shapes = {values.shape for values in columns.values()}
            if len(shapes) != 1 or len(shapes.pop()) != 1 or not needed <= columns.keys():
                raise ValueError(of)
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise InputError(f"{path}: not readable; repeat the command that made the folder") from None
    return tracks
