"""Split drives into training and test drives, cut parts of drives, and find the drive of a part."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sigmaswarm.drives.description import CUT, REPAIR_ALONE, cut_of, read_description
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.reader import Location, has_table, read_with_warnings
from sigmaswarm.drives.urls import is_url
from sigmaswarm.errors import DriveError, InputError

T = TypeVar("T")

MAX_FOLDERS = 1000  # maximum number of folders in which a whole drive is searched


def split_drives(
    drives: Sequence[T], train_fraction: float = 0.7, *, rng: np.random.Generator
) -> tuple[list[T], list[T]]:
    """Draw whole drives for training; the others are for testing. Both sets keep the given order.

    Parameters
    ----------
    drives : sequence of Drive, or of objects that represent drives, such as paths
        At least two drives.
    train_fraction : float
        Fraction of the drives for training, in (0, 1).
    rng : numpy.random.Generator
    """
    require_fraction(train_fraction)
    if len(drives) < 2:
        raise InputError(
            f"a split needs at least 2 drives, not {len(drives)}; pass more drives, or split one drive in time"
        )
    count = min(max(round(train_fraction * len(drives)), 1), len(drives) - 1)
    chosen = set(rng.permutation(len(drives))[:count].tolist())
    train = [drive for i, drive in enumerate(drives) if i in chosen]
    return train, [drive for i, drive in enumerate(drives) if i not in chosen]


def part_of(drive: Drive) -> str:
    """Return "train" or "test" for a part that `split_time` cut and named, otherwise "".

    The result is also "" for parts that are repaired alone, since the other part may not suit a tuning.
    """
    ends = [name for name in ("train", "test") if drive.name.endswith(f"-{name}")]
    return ends[0] if ends and CUT in drive.metadata and not is_repaired_alone(drive) else ""


def name_of_other(part: str) -> str:
    """Return the name of the other part of a split drive."""
    whole, _, end = part.rpartition("-")
    other = {"train": "test", "test": "train", "before": "after", "after": "before"}.get(end, "")
    return f"{whole}-{other}"


def name_of_whole(drive: Drive) -> str:
    """Return the name of the whole drive of this part; "" for a whole drive, or for a part that is repaired alone."""
    cut = cut_of(drive.metadata)
    name = cut.get("drive")
    return name if isinstance(name, str) and not is_repaired_alone(drive) else ""


def is_repaired_alone(part: Drive) -> bool:
    """Return True for a part that is repaired alone, since its faults differ from those of the rest of the drive."""
    return bool(cut_of(part.metadata).get(REPAIR_ALONE))


def find_whole(part: Location) -> tuple[Drive, Path] | None:
    """Return the drive from which a part was split, and the folder of this drive.

    Return None if the drive is not found near the part's folder (see `_near`).

    The part's drive.toml states the fingerprint of this drive.
    """
    if is_url(part):
        return None
    cut = cut_of(description_of(Path(part)))
    name, sha256 = cut.get("drive"), cut.get("sha256")
    for folder in _near(Path(part)):
        if folder.name == name or description_of(folder).get("name") == name:
            try:
                drive, _ = read_with_warnings(folder)
            except DriveError:
                continue
            if fingerprint(drive) == sha256:
                return drive, folder
    return None


def _near(part: Path) -> Iterator[Path]:
    """Yield drive folders up to two levels below the parent and the grandparent folder of a part."""
    bases = dict.fromkeys((part.parent, part.parent.parent))
    folders = (folder for base in bases for pattern in ("*", "*/*") for folder in sorted(base.glob(pattern)))
    for folder, _ in zip(folders, range(MAX_FOLDERS), strict=False):
        if folder != part and (folder / "drive.toml").is_file() and has_table(folder, "imu"):
            yield folder


def description_of(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's drive.toml, or {} if the file is missing or damaged."""
    try:
        return read_description(folder / "drive.toml")
    except DriveError:
        return {}


def clip(drive: Drive, start: float = -np.inf, end: float = np.inf, name: str | None = None) -> Drive:
    """Return the part of a drive with start <= t < end (s). Raises DriveError if it has fewer than two IMU samples."""
    inside = {k: v.select((v.time >= start) & (v.time < end)) for k, v in drive.tables.items()}
    if len(inside["imu"]) < 2:
        span = f"t = {drive.imu.time[0]:.12g} to {drive.imu.time[-1]:.12g} s"
        raise DriveError(
            f"{drive.name}: {start:.12g} <= t < {end:.12g} contains fewer than two IMU samples; choose times "
            f"within {span}"
        )
    begins = inside["imu"].time[0] == drive.imu.time[0]  # a stated heading refers to the first sample
    changes: dict[str, Any] = {k: v if len(v) or k == "gps" else None for k, v in inside.items()}
    return replace(
        drive,
        name=drive.name if name is None else name,
        metadata={k: v for k, v in drive.metadata.items() if begins or k != "heading_deg"},
        **changes,
    )


def require_fraction(train_fraction: float) -> None:
    if not 0 < train_fraction < 1:
        raise InputError(
            f"train_fraction = {train_fraction:g} leaves one part empty; choose a fraction between 0 and 1"
        )
