"""The identity of a drive, whatever it is called and wherever it lies."""

import hashlib
from typing import Any

from pydantic import BaseModel, Field

from sigmaswarm.drives.drive import Drive

START_RULE = (
    "the first fix with 20 m of forward driving in the 4 to 6 s before it (12 km/h or faster), which tell the "
    "heading"
)
"""What people are told of `DriveRecord.scored_from_s`, in all messages and pages: the rule of `alignment`."""


class DriveRecord(BaseModel):
    """A drive that a result comes from, as its file names it."""

    name: str
    duration_s: float | None = None
    imu_samples: int | None = None
    fixes: int | None = None
    has_truth: bool | None = None
    sha256: str = ""
    truth_share: float | None = None
    """Of an evaluated drive: the share of the time from there on in which truth is known."""
    scored_from_s: float | None = None
    """Of an evaluated drive: so many s into it filters start, and scores with them."""
    seen_s: float | None = None
    """Of an evaluated drive: so many seconds of it are in drives that the filter was tuned on."""
    seen_in: list[str] = Field(default_factory=list)
    """Those drives."""


def described(drive: Drive) -> dict[str, Any]:
    """The identity of a drive: its name, size, and a fingerprint of its numbers."""
    return {
        "name": drive.name,
        "duration_s": round(drive.duration, 3),
        "imu_samples": len(drive.imu),
        "fixes": len(drive.gps),
        "has_truth": drive.truth is not None,
        "sha256": fingerprint(drive),
    }


def fingerprint(drive: Drive) -> str:
    """A hash of all numbers of a drive, whatever it is called."""
    digest = hashlib.sha256()
    if drive.lever_arm.any():
        digest.update(b"lever arm" + drive.lever_arm.tobytes())
    if drive.antenna_height:
        digest.update(b"antenna height" + repr(drive.antenna_height).encode())
    for table in (drive.imu, drive.gps, drive.truth):
        for name, column in sorted(vars(table).items()) if table is not None else ():
            if column is not None:
                digest.update(name.encode())
                digest.update(column)
    if drive.odometer is not None:  # behind the others: a drive without one keeps its fingerprint
        digest.update(b"odometer")
        digest.update(drive.odometer.time.tobytes())
        digest.update(drive.odometer.speed.tobytes())
    return digest.hexdigest()
