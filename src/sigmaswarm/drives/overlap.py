"""Whether a drive holds what another one holds, found by content: whatever it is called, however it was cut or mended.

Two kinds of landmarks are the same in every copy of a drive, and in no other drive: where the car was, to the last
digit of the receiver's noise, at what intervals; and the yaw rates' digits, with the gyro's noise in them. As in audio
fingerprinting (Wang, "An Industrial-Strength Audio Search Algorithm", ISMIR 2003) equal landmarks vote for the offset
between the two clocks, and those of one drive agree. A copy keeps one kind or the other: fixes left out, moved in time
or made anew leave the gyro's, an IMU turned or interpolated leaves the fixes. Decimation thins both.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.errors import InputError
from sigmaswarm.files import read_arrays, whole_file
from sigmaswarm.geodesy import enu_to_geodetic

Whole = NDArray[np.int64]

SEEN_FILE = "seen.npz"
"""In a tuning's folder: the landmarks of the drives that it was tuned on."""
MICRO = 1_000_000
SAME_TIME = 1000
"""us: how far the times of one landmark may be apart, but for the clocks' offset."""
SAME_PLACE = 3
"""cm, or 1e-7 deg (1.1 cm to the north): how far the places of one fix may be apart, written in two ways."""
SAME_RATE = 2e-4
"""Of ln: how far yaw rates of one sample may be apart, written in two units with 8 decimals."""
MOVING = 1.5
"""m/s between fixes: slower ones, of a car that stands, tell nothing."""
UNITS = math.log(180 / math.pi)
"""ln of deg/s in rad/s: what a yaw rate's logarithm is told without."""
WIDTH = 0.4
"""Of the range `UNITS`: a tenth of all samples, about those of 1 to 1.5 deg/s, are landmarks."""
MOST = 20_000
"""Yaw rates that are kept of a drive: of long ones a smaller part."""
FEWEST = 8
"""Landmarks of different value that have to agree."""
MOST_PAIRS = 2_000_000
"""Equal yaw rates of two drives: where there are more, as of coarse gyros in long drives, the common ones go."""
COMMON = MOST_PAIRS // MOST
"""Times that a yaw rate may occur in a drive then."""
SHARE = 0.5
"""Of the landmarks in the common time that have to agree."""


@dataclass(frozen=True, eq=False)
class Landmarks:
    """What a drive is recognized by, in a thousandth of its size.

    Attributes
    ----------
    name : str
        The drive's.
    sha256 : str
        Its `fingerprint`, by which a whole drive is known that has no landmarks.
    span : (float, float)
        s, of its IMU.
    geographic : bool
        Whether places are degrees; else m in a frame that nothing ties to the earth.
    fixes : ndarray of int, shape (n, 3)
        Time (us), and place: latitude and longitude (1e-7 deg), or y and x (cm).
    rates : ndarray, shape (k, 2)
        Time (s), and the yaw rate as ln|gz| modulo ``UNITS``: the same in rad/s and deg/s, with either sign.
    width : float
        The samples with less than that are landmarks.
    """

    name: str
    sha256: str
    span: tuple[float, float]
    geographic: bool
    fixes: Whole
    rates: Array
    width: float = WIDTH

    @property
    def tell_parts(self) -> bool:
        """Whether a part of the drive would be recognized, not only the whole by its fingerprint."""
        return max(len(self.fixes), len(self.rates)) >= FEWEST


@dataclass(frozen=True)
class Overlap:
    """The part of a drive that others hold, too.

    Attributes
    ----------
    seconds : float
    of : tuple of str
        The others' names.
    """

    seconds: float = 0.0
    of: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return self.seconds > 0


@np.errstate(all="ignore")  # places and rates that can't be are nobody's landmarks
def landmarks(drive: Drive) -> Landmarks:
    """What a drive is recognized by."""
    gps, imu = drive.gps, drive.imu
    dt = np.maximum(np.diff(gps.time), 1e-3)
    speed = np.hypot(np.diff(gps.x), np.diff(gps.y)) / dt
    moving = np.maximum(np.append(speed, 0.0), np.append(0.0, speed)) > MOVING
    geographic = drive.origin is not None
    if gps.lat is not None and gps.lon is not None:
        geographic, place = True, 1e7 * np.column_stack([gps.lat, gps.lon])
    elif drive.origin is not None:
        place = 1e7 * enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), drive.origin)[:, :2]
    else:
        place = 100 * np.column_stack([gps.y, gps.x])
    fixes = _whole(np.column_stack([MICRO * gps.time, place])[moving])
    turning = imu.gz != 0
    digits = np.mod(np.log(np.abs(imu.gz[turning])), UNITS)
    times, width = imu.time[turning], WIDTH
    while np.count_nonzero(digits < width) > MOST:
        width /= 2
    rates = np.column_stack([times, digits])[digits < width]
    span = float(imu.time[0]), float(imu.time[-1])
    return Landmarks(drive.name, fingerprint(drive), span, geographic, fixes, rates, width)


def _whole(values: Array) -> Whole:
    """Rounded; what no car reaches ends where integers do."""
    return np.rint(np.clip(np.nan_to_num(values), -9e18, 9e18)).astype(np.int64)


def whole_drive(name: str, sha256: str, duration: float) -> Landmarks:
    """What a drive is recognized by of which only the fingerprint is kept: the same whole drive."""
    return Landmarks(name, sha256, (0.0, duration), False, np.zeros((0, 3), np.int64), np.zeros((0, 2)))


def overlap_of(drive: Landmarks, others: Iterable[Landmarks]) -> Overlap:
    """How much of a drive others hold, too, s, and which of them."""
    found = {
        (i, other.name): part for i, other in enumerate(others) if (part := _common(drive, other)) is not None
    }
    covered, until = 0.0, -math.inf
    for start, end in sorted(found.values()):
        covered += max(end - max(start, until), 0.0)
        until = max(until, end)
    return Overlap(round(covered, 3), tuple(dict.fromkeys(name for _, name in found)))


def known_overlap(drive: Landmarks, others: Sequence[Landmarks]) -> Overlap | None:
    """What `overlap_of` finds; None where it finds nothing, but would not recognize a part of some of the others."""
    found = overlap_of(drive, others)
    return found if found or all(other.tell_parts for other in others) else None


def _common(one: Landmarks, other: Landmarks) -> tuple[float, float] | None:
    """From when to when, s on its clock, a drive is the other; None where it is not."""
    if one.sha256 == other.sha256:
        return one.span
    for offset in (_by_fixes(one, other), _by_rates(one, other)):
        if offset is not None:
            start, end = max(one.span[0], other.span[0] + offset), min(one.span[1], other.span[1] + offset)
            if end > start:
                return start, end
    return None


def _by_fixes(one: Landmarks, other: Landmarks) -> float | None:
    """By how many s one's clock is ahead of the other's, if their fixes are the same."""
    if one.geographic != other.geographic or min(len(one.fixes), len(other.fixes)) < FEWEST:
        return None
    i, j = _near(one.fixes[:, 1:], other.fixes[:, 1:])
    return _agreed(one.fixes[:, 0], other.fixes[:, 0], i, j, one.fixes[:, 1])


def _near(a: Whole, b: Whole) -> tuple[Whole, Whole]:
    """The pairs (i, j) of places in a and b that are no more than SAME_PLACE apart in each direction.

    By cells of that size: what is near lies in the same one or beside it. (To import SciPy's tree takes 0.2 s.)
    """
    a, b = (np.clip(places, -(2**60), 2**60) for places in (a, b))  # of what is no place, no overflow

    def numbers(cells: Whole) -> Whole:
        return cells[:, 0] * 1_000_003 + cells[:, 1]  # others may share one: all are looked at

    cells, of_b = a // (SAME_PLACE + 1), numbers(b // (SAME_PLACE + 1))
    order = np.argsort(of_b, kind="stable")
    pairs: list[Whole] = []
    for beside in np.ndindex(3, 3):
        at = numbers(cells + np.array(beside) - 1)
        first, last = (np.searchsorted(of_b[order], at, side) for side in ("left", "right"))
        i, places = _ranges(first, last - first)
        j = order[places]
        pairs.append(np.stack([i, j])[:, (np.abs(a[i] - b[j]) <= SAME_PLACE).all(axis=1)])
    i, j = np.unique(np.concatenate(pairs, axis=1), axis=1)
    return i, j


def _ranges(first: Whole, count: Whole) -> tuple[Whole, Whole]:
    """For each k, count[k] pairs (k, first[k]), (k, first[k] + 1) and so on."""
    k = np.repeat(np.arange(len(first)), count)
    return k, np.repeat(first - np.append(0, np.cumsum(count)[:-1]), count) + np.arange(count.sum())


def _by_rates(one: Landmarks, other: Landmarks) -> float | None:
    """The same of their yaw rates."""
    width = min(one.width, other.width)
    a, b = (marks.rates[marks.rates[:, 1] < width] for marks in (one, other))
    if min(len(a), len(b)) < FEWEST:
        return None
    b = b[np.argsort(b[:, 1])]
    first, count = _alike(a, b)
    if count.sum() > MOST_PAIRS:
        a, b = a[_alike(a, a[np.argsort(a[:, 1])])[1] <= COMMON], b[_alike(b, b)[1] <= COMMON]
        if min(len(a), len(b)) < FEWEST:
            return None
        first, count = _alike(a, b)
    i, j = _ranges(first, count)
    return _agreed(_whole(MICRO * a[:, 0]), _whole(MICRO * b[:, 0]), i, j, _whole(a[:, 1] / SAME_RATE))


def _alike(a: Array, b: Array) -> tuple[Whole, Whole]:
    """Of each yaw rate in a: where in b, which is in their order, those begin that are the same, and how many."""
    first = np.searchsorted(b[:, 1], a[:, 1] - SAME_RATE)
    return first, np.searchsorted(b[:, 1], a[:, 1] + SAME_RATE) - first


def _agreed(a: Whole, b: Whole, i: Whole, j: Whole, values: Whole) -> float | None:
    """The offset, s, that most pairs (i, j) of equal landmarks at a and b (us) vote for, if enough of them do.

    By chance some always agree: so it has to be half of those that either has in the common time, of whichever has
    fewer, since one may be decimated; and of different ``values``, since a car that stands repeats one.
    """
    if len(i) < FEWEST:
        return None
    offsets = a[i] - b[j]
    order = np.argsort(offsets, kind="stable")
    offsets = offsets[order]
    votes = np.searchsorted(offsets, offsets + 2 * SAME_TIME, side="right") - np.arange(len(offsets))
    best = int(np.argmax(votes))
    chosen = order[best : best + votes[best]]
    offset = int(np.median(offsets[best : best + votes[best]]))
    start, end = max(a.min(), b.min() + offset), min(a.max(), b.max() + offset)
    there = [np.count_nonzero((t >= start - SAME_TIME) & (t <= end + SAME_TIME)) for t in (a, b + offset)]
    agreeing = min(len(np.unique(i[chosen])), len(np.unique(j[chosen])))
    if agreeing < SHARE * min(there) or len(np.unique(values[i[chosen]])) < FEWEST:
        return None
    return offset / MICRO


def save_landmarks(
    seen: Sequence[Landmarks], path: Path, names: Sequence[tuple[str, str]] | None = None
) -> None:
    """Keep the landmarks of drives as one file; with names and fingerprints known they are looked at one by one."""
    if names is None:
        names = [(marks.name, marks.sha256) for marks in seen]
    with (
        whole_file(path) as file,
        ZipFile(file, "w", ZIP_DEFLATED) as archive,
    ):  # as `np.savez_compressed` writes it

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
    """Landmarks that stay in the file that `save_landmarks` wrote, until one is looked at."""

    path: Path
    names: tuple[tuple[str, str], ...]

    def __len__(self) -> int:
        return len(self.names)

    @overload
    def __getitem__(self, k: int) -> Landmarks: ...
    @overload
    def __getitem__(self, k: slice) -> list[Landmarks]: ...
    def __getitem__(self, k: int | slice) -> Landmarks | list[Landmarks]:
        if isinstance(k, slice):
            return [self[i] for i in range(*k.indices(len(self)))]
        name, sha256 = self.names[k]
        k %= len(self)
        with np.load(self.path, allow_pickle=False) as file:
            return _loaded(name, sha256, file[f"{k}-about"], file[f"{k}-fixes"], file[f"{k}-rates"])


def load_landmarks(path: Path) -> list[Landmarks] | None:
    """Read what `save_landmarks` wrote; None where there is nothing, as in tunings of earlier versions.

    Raises
    ------
    InputError
        If the file is there but can't be read.
    """
    if not path.exists():
        return None
    try:
        file = read_arrays(path)
        return [
            _loaded(str(name), str(sha256), file[f"{k}-about"], file[f"{k}-fixes"], file[f"{k}-rates"])
            for k, (name, sha256) in enumerate(file["names"])
        ]
    except Exception:  # a damaged archive raises BadZipFile, EOFError, zlib.error, ValueError, KeyError ...
        raise InputError(f"{path}: not readable; delete it, or repeat `sigmaswarm tune`") from None


def _loaded(name: str, sha256: str, about: Array, fixes: Whole, rates: Array) -> Landmarks:
    start, end, geographic, width = about.tolist()
    places, rates = fixes.reshape(-1, 3), rates.reshape(-1, 2)
    return Landmarks(name, sha256, (start, end), bool(geographic), places, rates, width)
