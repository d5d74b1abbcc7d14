"""Split a drive in time; parts with different mountings of the IMU are later repaired separately."""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.drives.alignment import StartFailure, find_start
from sigmaswarm.drives.checks import shortage_of
from sigmaswarm.drives.description import CUT, REPAIR_ALONE
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.split import clip, require_fraction
from sigmaswarm.errors import InputError, SigmaswarmWarning


def split_time(
    drive: Drive, train_fraction: float = 0.7, *, at: float | tuple[float, float] | None = None
) -> tuple[Drive, Drive]:
    """Split one long drive in time: ``<name>-train`` is the first part, ``<name>-test`` the remaining part.

    Parameters
    ----------
    drive : Drive
        The drive, which is not changed. Rows before and after the IMU's samples are in neither part.
    train_fraction : float
        Fraction of the drive's duration in the first part, between 0 and 1.
    at : float or (float, float), optional
        Time of the split, s on the drive's clock, for example at a pause of the logger. If two times are given, the
        part between them is omitted, and the other parts are ``<name>-before`` and ``<name>-after``.

    Warns
    -----
    SigmaswarmWarning
        If no filter can start on a part.

    Returns
    -------
    (Drive, Drive)
        The two parts. ``cut_from`` in their metadata contains the name and fingerprint of the original drive, and start
        and end of the part on its clock, s. If the doctor proposes to split a drive, the parts have different faults
        and are repaired separately.
    """
    require_fraction(train_fraction)
    if at is None:
        at = float(drive.imu.time[0] + train_fraction * drive.duration)
    times = np.ravel(np.asarray(at, np.float64))
    if len(times) not in (1, 2):
        raise InputError(
            f"at has {len(times)} times; pass one time, or two times to omit the part between them"
        )
    end, start = float(times[0]), float(times[-1])
    if start < end:
        raise InputError(
            f"at = {end:.12g}, {start:.12g} s: the first time is after the second; swap the times"
        )
    names = ("before", "after") if len(times) == 2 else ("train", "test")
    inside = clip(drive, float(drive.imu.time[0]), float(np.nextafter(drive.imu.time[-1], np.inf)))
    parts = (
        clip(inside, end=end, name=f"{drive.name}-{names[0]}"),
        clip(inside, start=start, name=f"{drive.name}-{names[1]}"),
    )
    sha256 = fingerprint(drive)
    found = diagnose(drive).findings if not shortage_of(drive.imu, drive.gps) else ()
    alone = {REPAIR_ALONE: True} if any(f.cut is not None for f in found if f.severity == "serious") else {}
    _warn_of_parts(parts, rest=len(times) == 2 or bool(alone))
    cuts = [
        {"drive": drive.name, "start_s": float(t[0]), "end_s": float(t[-1]), "sha256": sha256, **alone}
        for t in (part.imu.time for part in parts)
    ]
    first, last = (replace(p, metadata={**p.metadata, CUT: c}) for p, c in zip(parts, cuts, strict=True))
    return first, last


def _warn_of_parts(parts: Sequence[Drive], *, rest: bool) -> None:
    """Warn about parts on which no filter can start. With ``rest``, warn only if no filter can start on either part."""
    starts = [find_start(part) for part in parts]
    failed = [isinstance(start, StartFailure) for start in starts]
    for part, start in zip(parts, starts, strict=True):
        if isinstance(start, StartFailure) and (all(failed) or not rest):
            message = f"{part.name} can't be used as a drive: {start.what}; split at another time, or {start.remedy}"
            warnings.warn(message, SigmaswarmWarning, stacklevel=3)


split = split_time  # name of `split_time` in the short API
