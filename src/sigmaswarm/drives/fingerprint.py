"""Identify a drive by its data, independently of its name and folder."""

import hashlib
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat

from sigmaswarm.drives.alignment import is_slow
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.mounting import AXES_KEY, KEY, axes_of

# Rule by which `alignment` finds the start of a filter, for messages and pages
START_RULE = (
    "the first fix with a heading, or the first fix after 20 m of forward driving in 4 to 6 s (slow vehicle: after "
    "10 m in at most 90 s)"
)

# Numbers of drive.toml that change a tuning or an evaluation but are not part of the fingerprint
STATED = (
    "gps_std_m",
    "accel_noise_density",
    "gyro_noise_density",
    "accel_bias_walk",
    "gyro_bias_walk",
    "imu_stated_noise",
)


class DriveRecord(BaseModel):
    """Description of a drive in the file of a result."""

    name: str
    duration_s: float | None = None
    imu_samples: int | None = None
    fixes: int | None = None
    has_truth: bool | None = None
    imu_mounting_deg: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    imu_axes: dict[str, str] = Field(default_factory=dict)
    stated: dict[str, float | list[float]] = Field(default_factory=dict)  # the numbers `STATED` of drive.toml
    slow: bool = False  # True if the vehicle rarely travels far enough for the usual alignment
    sha256: str = ""
    receiver_std_m: float | None = None  # standard deviation of the fixes per axis, see `receiver_std`
    shown_std_m: float | None = None  # the same, from the truth or from the scatter of the fixes
    # Of an evaluated drive: fraction of the scored time with known truth; start of filters and scores, s after the
    # first sample; duration of the part that training drives contain, s
    truth_share: float | None = None
    scored_from_s: float | None = None
    seen_s: float | None = None
    seen_in: list[str] = Field(default_factory=list)  # training drives with parts of an evaluated drive


def drive_record(drive: Drive) -> dict[str, Any]:
    return {
        "name": drive.name,
        "duration_s": round(drive.duration, 3),
        "imu_samples": len(drive.imu),
        "fixes": len(drive.gps),
        "has_truth": drive.truth is not None,
        **({KEY: [*drive.mounting]} if drive.mounting else {}),
        **({AXES_KEY: axes} if (axes := axes_of(drive.metadata)) else {}),
        "stated": {
            key: np.asarray(drive.metadata[key], float).tolist() for key in STATED if key in drive.metadata
        },
        **({"slow": True} if is_slow(drive) else {}),
        "sha256": fingerprint(drive),
    }


def rounded(std: float) -> float:
    """Round a standard deviation to three digits, for a `DriveRecord`."""
    return float(f"{std:.3g}")


def fingerprint(drive: Drive) -> str:
    digest = hashlib.sha256()
    if drive.lever_arm.any():
        digest.update(b"lever arm" + drive.lever_arm.tobytes())
    if drive.antenna_height:
        digest.update(b"antenna height" + repr(drive.antenna_height).encode())
    if drive.heading is not None:
        digest.update(b"heading" + repr(drive.heading).encode())
    for kind, table in drive.tables.items():
        columns = {name: column for name, column in vars(table).items() if column is not None}
        if kind in ("imu", "gps", "truth"):
            for name, column in sorted(columns.items()):
                digest.update(name.encode())
                digest.update(np.ascontiguousarray(column).data)
        else:  # tables added in later versions; drives without them have the same fingerprint as before
            digest.update(kind.encode() + b"".join(column.tobytes() for column in columns.values()))
    return digest.hexdigest()
