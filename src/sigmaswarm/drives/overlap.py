"""Find the part of a drive that other drives contain, even if they are renamed, cut or repaired copies.

Landmarks are sampled positions and yaw rates of a drive, with their times. Copies of a drive have equal landmarks.
Other drives rarely do, because of the sensors' noise. Each pair of equal landmarks votes for an offset between the
clocks of two drives (as in Wang, "An Industrial-Strength Audio Search Algorithm", ISMIR 2003). A copy keeps the yaw
rates if fixes are left out, shifted or replaced, and the fixes if the IMU is rotated or interpolated.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.errors import InputError
from sigmaswarm.files import atomic_file, read_arrays
from sigmaswarm.geodesy import enu_to_geodetic

Integers = NDArray[np.int64]

TRAINING_DATA_FILE = "seen.npz"  # landmarks of the training drives of a tuning
MICRO = 1_000_000
# us, largest difference between the times of a landmark in two drives, without the clock offset
TIME_TOLERANCE = 1000
POSITION_TOLERANCE = 3.0  # cm or 1e-7 deg (1.1 cm to the north), largest difference of one fix in two files
RATE_TOLERANCE = 2e-4  # largest difference of ln|gz| of equal yaw rates with 8 decimals, in rad/s or deg/s
MIN_SPEED = 1.5  # m/s, smallest speed between a landmark and a neighboring fix
LOG_RATIO = math.log(180 / math.pi)  # ln of the ratio of rad/s to deg/s; landmarks are ln|gz| modulo this
# A yaw rate is a landmark if ln|gz| modulo `LOG_RATIO` is below this width. This is true of a tenth of all samples, for
# example of those of 1 to 1.5 deg/s.
LANDMARK_WIDTH = 0.4
MAX_LANDMARKS = 20_000  # largest number of yaw-rate landmarks; the width of long drives is smaller
MAX_OCCURRENCES = 100  # in a drive; more frequent yaw rates, for example of a coarse gyro, are ignored
MIN_MATCHES = 8  # smallest number of different values of landmarks that must agree
MIN_MATCH_SHARE = 0.5  # smallest fraction of the landmarks in the common time that must agree


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Sampled positions and yaw rates of a drive. A file of landmarks has a thousandth of the drive's size.

    ``sha256`` is the `fingerprint` of the drive. ``span`` contains start and end of the IMU samples, s. ``fixes`` (n,
    3) contains time (us), then latitude and longitude (1e-7 deg) if ``geographic``, otherwise y and x (cm). ``rates``
    (k, 2) contains time (s) and ln|gz| modulo ``LOG_RATIO``, below ``width``. The second value is the same in rad/s and
    deg/s and for both signs.
    """

    name: str
    sha256: str
    span: tuple[float, float]
    geographic: bool
    fixes: Integers
    rates: Array
    width: float = LANDMARK_WIDTH


@dataclass(frozen=True)
class Overlap:
    """Duration (s) of the part of a drive that other drives contain, and the names of these drives."""

    seconds: float = 0.0
    of: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return self.seconds > 0


@np.errstate(all="ignore")  # impossible positions and rates match nothing
def landmarks(drive: Drive) -> Landmarks:
    gps, imu = drive.gps, drive.imu
    dt = np.maximum(np.diff(gps.time), 1e-3)
    speed = np.hypot(np.diff(gps.x), np.diff(gps.y)) / dt
    moving = np.maximum(np.append(speed, 0.0), np.append(0.0, speed)) > MIN_SPEED
    geographic = drive.origin is not None
    if gps.lat is not None and gps.lon is not None:
        geographic, position = True, 1e7 * np.column_stack([gps.lat, gps.lon])
    elif drive.origin is not None:
        position = 1e7 * enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), drive.origin)[:, :2]
    else:
        position = 100 * np.column_stack([gps.y, gps.x])
    fixes = np.column_stack([MICRO * gps.time, position])[moving]
    fixes = np.rint(np.clip(np.nan_to_num(fixes), -9e18, 9e18)).astype(np.int64)
    turning = imu.gz != 0
    digits = np.mod(np.log(np.abs(imu.gz[turning])), LOG_RATIO)
    times, width = imu.time[turning], LANDMARK_WIDTH
    while np.count_nonzero(digits < width) > MAX_LANDMARKS:
        width /= 2
    rates = np.column_stack([times, digits])[digits < width]
    span = float(imu.time[0]), float(imu.time[-1])
    return Landmarks(drive.name, fingerprint(drive), span, geographic, fixes, rates, width)


def whole_drive(name: str, sha256: str, duration: float) -> Landmarks:
    return Landmarks(name, sha256, (0.0, duration), False, np.zeros((0, 3), np.int64), np.zeros((0, 2)))


def overlap_of(drive: Landmarks, others: Iterable[Landmarks]) -> Overlap:
    """Return the duration (s) of the parts that other drives contain, and the names of these drives."""
    overlaps = [(other.name, part) for other in others if (part := _common(drive, other)) is not None]
    covered, until = 0.0, -math.inf
    for start, end in sorted(part for _, part in overlaps):
        covered += max(end - max(start, until), 0.0)
        until = max(until, end)
    return Overlap(round(covered, 3), tuple(dict.fromkeys(name for name, _ in overlaps)))


def known_overlap(drive: Landmarks, others: Sequence[Landmarks]) -> Overlap | None:
    """Return the result of `overlap_of`, or None if the overlap is unknown.

    The overlap is unknown if none is found, but another drive has too few landmarks to recognize its parts.
    """
    overlap = overlap_of(drive, others)
    recognizes_parts = all(max(len(other.fixes), len(other.rates)) >= MIN_MATCHES for other in others)
    return overlap if overlap or recognizes_parts else None


def _common(one: Landmarks, other: Landmarks) -> tuple[float, float] | None:
    """Return the start and end of the part of ``one`` that is also in ``other``, s on the clock of ``one``, or None."""
    if one.sha256 == other.sha256:
        return one.span
    for offset in (_by_fixes(one, other), _by_rates(one, other)):
        if offset is not None:
            start, end = max(one.span[0], other.span[0] + offset), min(one.span[1], other.span[1] + offset)
            if end > start:
                return start, end
    return None


def _by_fixes(one: Landmarks, other: Landmarks) -> float | None:
    if one.geographic != other.geographic:
        return None
    return _offset(one.fixes.astype(np.float64), other.fixes.astype(np.float64), POSITION_TOLERANCE)


def _by_rates(one: Landmarks, other: Landmarks) -> float | None:
    width = min(one.width, other.width)

    def rates(marks: Landmarks) -> Array:
        time, value = marks.rates[marks.rates[:, 1] < width].T
        _, level, count = np.unique(np.rint(value / RATE_TOLERANCE), return_inverse=True, return_counts=True)
        return np.column_stack([MICRO * time, value])[count[level] <= MAX_OCCURRENCES]

    return _offset(rates(one), rates(other), RATE_TOLERANCE)


def _offset(a: Array, b: Array, tolerance: float) -> float | None:
    """Return the offset (s) between the clocks of two drives for which most landmarks agree; None if too few agree.

    ``a`` and ``b`` are landmarks, in rows of time (us) and values. Some landmarks agree by chance. Therefore, in the
    common time, at least half of the landmarks of the drive with fewer landmarks must agree. The other drive may have
    more, since a copy may be decimated. A stationary car repeats one value, so several values must agree.
    """
    if min(len(a), len(b)) < MIN_MATCHES:
        return None
    i, j = _equal(a[:, 1:], b[:, 1:], tolerance)
    if len(i) < MIN_MATCHES:
        return None
    offsets = a[i, 0] - b[j, 0]
    order = np.argsort(offsets, kind="stable")
    ends = np.searchsorted(offsets[order], offsets[order] + 2 * TIME_TOLERANCE, side="right")
    votes = ends - np.arange(len(order))
    best = int(np.argmax(votes))
    chosen = order[best : best + votes[best]]
    offset = float(np.median(offsets[chosen]))
    times = a[:, 0], b[:, 0] + offset
    start, end = max(t.min() for t in times) - TIME_TOLERANCE, min(t.max() for t in times) + TIME_TOLERANCE
    there = [np.count_nonzero((t >= start) & (t <= end)) for t in times]
    agreeing = min(len(np.unique(i[chosen])), len(np.unique(j[chosen])))
    values = len(np.unique(np.rint(a[i[chosen], 1] / tolerance)))
    few = agreeing < MIN_MATCH_SHARE * min(there) or values < MIN_MATCHES
    return None if few else offset / MICRO


def _equal(a: Array, b: Array, tolerance: float) -> tuple[Integers, Integers]:
    """Return the pairs (i, j) of rows of a and b that differ by at most the tolerance in each column."""
    pairs = KDTree(a).sparse_distance_matrix(KDTree(b), tolerance, np.inf, output_type="ndarray")
    order = np.lexsort([pairs["j"], pairs["i"]])
    return pairs["i"][order], pairs["j"][order]


def save_landmarks(
    seen: Iterable[Landmarks], path: Path, names: Sequence[tuple[str, str]] | None = None
) -> None:
    """Save landmarks of drives. With ``names`` (name, fingerprint), read ``seen`` drive by drive, to save memory."""
    if names is None:
        seen = list(seen)
        names = [(marks.name, marks.sha256) for marks in seen]
    # `np.savez_compressed` writes the same format, but needs all arrays at once
    with atomic_file(path) as file, ZipFile(file, "w", ZIP_DEFLATED) as archive:

        def put(name: str, array: NDArray[np.generic]) -> None:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)

        put("names", np.array(names, dtype=np.str_).reshape(-1, 2))
        for k, marks in enumerate(seen):
            put(f"{k}-about", np.array([*marks.span, marks.geographic, marks.width]))
            put(f"{k}-fixes", marks.fixes)
            put(f"{k}-rates", marks.rates)


@dataclass(frozen=True)
class SavedLandmarks(Sequence[Landmarks]):
    """Landmarks in a file, each of which is read when it is used."""

    path: Path
    names: tuple[tuple[str, str], ...]

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, k: Any) -> Any:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        with np.load(self.path, allow_pickle=False) as file:
            return _loaded(self.names[k], k % len(self), file)


def load_landmarks(path: Path) -> list[Landmarks] | None:
    """Load a file of `save_landmarks`. Return None if the file is missing, as after tuning with early versions."""
    if not path.exists():
        return None
    try:
        file = read_arrays(path)
        return [_loaded(names, k, file) for k, names in enumerate(file["names"].tolist())]
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise InputError(f"{path}: is not readable; delete it, or repeat `sigmaswarm tune`") from None


def _loaded(names: Sequence[str], k: int, file: Any) -> Landmarks:
    start, end, geographic, width = file[f"{k}-about"].tolist()
    fixes, rates = file[f"{k}-fixes"].reshape(-1, 3), file[f"{k}-rates"].reshape(-1, 2)
    return Landmarks(names[0], names[1], (start, end), bool(geographic), fixes, rates, width)
