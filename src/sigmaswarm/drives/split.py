"""Splitting into training and test drives, by drive or by time within a drive."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from sigmaswarm.drives.alignment import StartFailure, find_start
from sigmaswarm.drives.description import CUT, REPAIR_ALONE, cut_of
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.errors import DriveError, InputError, SigmaswarmWarning

T = TypeVar("T")


def split_drives(
    drives: Sequence[T], train_fraction: float = 0.7, *, rng: np.random.Generator
) -> tuple[list[T], list[T]]:
    """Draw whole drives for training; the others are for testing. Both parts keep the given order.

    Parameters
    ----------
    drives : sequence of Drive, or of objects that represent drives, such as paths
        At least two drives.
    train_fraction : float
        Share of the drives for training, in (0, 1).
    rng : numpy.random.Generator
    """
    _require_fraction(train_fraction)
    if len(drives) < 2:
        raise InputError(
            f"{len(drives)} drive can't be split; pass at least 2 drives, or split one drive in time"
        )
    count = min(max(round(train_fraction * len(drives)), 1), len(drives) - 1)
    chosen = set(rng.permutation(len(drives))[:count].tolist())
    train = [drive for i, drive in enumerate(drives) if i in chosen]
    return train, [drive for i, drive in enumerate(drives) if i not in chosen]


def split_time(
    drive: Drive, train_fraction: float = 0.7, *, at: float | tuple[float, float] | None = None
) -> tuple[Drive, Drive]:
    """Split one long drive in time: ``<name>-train`` is its first part, ``<name>-test`` the rest.

    Parameters
    ----------
    drive : Drive
        The drive, which is not changed.
    train_fraction : float
        Share of the drive's duration, in (0, 1).
    at : float or (float, float), optional
        Time of the split, s on the drive's clock, for example at a pause of the logger. Two times leave out the part
        between them; the parts are then ``<name>-before`` and ``<name>-after``.

    Warns
    -----
    SigmaswarmWarning
        If no filter can start on a part.

    Returns
    -------
    (Drive, Drive)
        ``cut_from`` in their metadata contains the original drive (name, fingerprint) and the part (s on its clock).
    """
    _require_fraction(train_fraction)
    if at is None:
        at = float(drive.imu.time[0] + train_fraction * drive.duration)
    times = np.ravel(np.asarray(at, np.float64))
    if len(times) not in (1, 2):
        raise InputError(
            f"at has {len(times)} times; pass one time, or two times to leave out the part between them"
        )
    end, start = float(times[0]), float(times[-1])
    if start < end:
        raise InputError(f"at = {end:g}, {start:g} s: the first time is after the second; exchange them")
    names = ("before", "after") if len(times) == 2 else ("train", "test")
    parts = (
        clip(drive, end=end, name=f"{drive.name}-{names[0]}"),
        clip(drive, start=start, name=f"{drive.name}-{names[1]}"),
    )
    sha256 = fingerprint(drive)
    for part in parts:
        if isinstance(found := find_start(part), StartFailure):
            message = f"{part.name} can't be used as a drive: {found.what}; split at another time, or {found.remedy}"
            warnings.warn(message, SigmaswarmWarning, stacklevel=2)
    first, last = (
        {"drive": drive.name, "start_s": float(t[0]), "end_s": float(t[-1]), "sha256": sha256}
        for t in (part.imu.time for part in parts)
    )
    return (
        replace(parts[0], metadata={**parts[0].metadata, CUT: first}),
        replace(parts[1], metadata={**parts[1].metadata, CUT: last}),
    )


def part_of(drive: Drive) -> str:
    """Return "train" or "test" for a part of `split_time` with a default name, else ""."""
    ends = [name for name in ("train", "test") if drive.name.endswith(f"-{name}")]
    return ends[0] if ends and CUT in drive.metadata else ""


def name_of_whole(drive: Drive) -> str:
    """Return the name of the drive from which a part was split and with which it is repaired; "" if there is none."""
    cut = cut_of(drive.metadata)
    name = cut.get("drive")
    return name if isinstance(name, str) and not cut.get(REPAIR_ALONE) else ""


split = split_time  # name of `split_time` in the short API


def clip(drive: Drive, start: float = -np.inf, end: float = np.inf, name: str | None = None) -> Drive:
    """Return the part of a drive with start <= t < end, s; raise DriveError if it has fewer than two IMU samples."""

    inside = {k: v.select((v.time >= start) & (v.time < end)) for k, v in drive.tables.items()}
    if len(inside["imu"]) < 2:
        span = f"t = {drive.imu.time[0]:g} to {drive.imu.time[-1]:g} s"
        raise DriveError(
            f"{drive.name}: {start:g} <= t < {end:g} leaves no drive; choose times within {span}"
        )
    begins = inside["imu"].time[0] == drive.imu.time[0]  # a stated heading refers to the first sample
    changes: dict[str, Any] = {k: v if len(v) or k == "gps" else None for k, v in inside.items()}
    return replace(
        drive,
        name=drive.name if name is None else name,
        metadata={k: v for k, v in drive.metadata.items() if begins or k != "heading_deg"},
        **changes,
    )


def _require_fraction(train_fraction: float) -> None:
    if not 0 < train_fraction < 1:
        raise InputError(
            f"train_fraction = {train_fraction:g} leaves one part empty; choose it between 0 and 1"
        )
