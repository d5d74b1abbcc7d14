"""`sigmaswarm split`."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import sigmaswarm
from sigmaswarm.cli.common import print_json, print_lines, read_silently, require_writable
from sigmaswarm.cli.findings import has_unrepairable, repair_and_split, too_short_for_outages
from sigmaswarm.cli.options import Json, Overwrite
from sigmaswarm.files import free_path
from sigmaswarm.wording import count_of


def split(
    drive: Annotated[Path, Parameter(name="DRIVE")],
    /,
    *,
    out: Path,
    train_fraction: float | None = None,
    at: Annotated[list[float] | None, Parameter(consume_multiple=True)] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Split a drive in time into a part to tune on and a part to test on.

    Example:

        sigmaswarm split drives/monday --out parts
        sigmaswarm tune parts/monday-train --out tuned
        sigmaswarm evaluate tuned parts/monday-test --out evaluation

    Parameters
    ----------
    drive
        A drive folder.
    out
        Folder for the two drive folders.
    train_fraction
        Fraction of the drive's duration in the first part; 0.7 by default.
    at
        Time of the split on the drive's clock, s. If two times are given, data between them are left out.
    """
    if at is not None and train_fraction is not None:
        raise sigmaswarm.InputError("specify --at or --train-fraction, not both")
    if at is not None and len(at) > 2:
        raise sigmaswarm.InputError(
            f"--at has {len(at)} times; specify one time, or two times to leave out the part between them"
        )
    from sigmaswarm.drives.split import is_repaired_alone

    times = None if not at else at[0] if len(at) == 1 else (at[0], at[1])
    whole = read_silently(drive)
    parts = sigmaswarm.split_time(whole, 0.7 if train_fraction is None else train_fraction, at=times)
    _require_enough(whole, parts)
    diagnosis, own = sigmaswarm.diagnose(whole), all(map(is_repaired_alone, parts))
    require_writable([out / part.name for part in parts], [drive], overwrite=overwrite)
    for part in parts:
        sigmaswarm.write_drive(part, out / part.name, overwrite=overwrite)
    if json:
        print_json({"drives": [str(out / part.name) for part in parts]})
        return
    print_lines(*(f"wrote {out / part.name} ({part.duration:.0f} s)" for part in parts))
    repairs = [] if own else [*repair_and_split(diagnosis, drive, _options(train_fraction, at))]
    print_lines(*(repairs or _next_steps(parts, out, own=own)))


def _options(train_fraction: float | None, at: list[float] | None) -> list[str]:
    """Return the options of this command, for the command that splits the repaired drive."""
    if at:
        return ["--at", *(f"{time:.12g}" for time in at)]
    return [] if train_fraction is None else ["--train-fraction", f"{train_fraction:g}"]


def _require_enough(whole: "sigmaswarm.Drive", parts: "Sequence[sigmaswarm.Drive]") -> None:
    from sigmaswarm.drives.checks import MIN_SAMPLES, MIN_SHARED_FIXES, shortage_of

    imu, gps = whole.imu.time, whole.gps.time
    gps = gps[(gps >= imu[0]) & (gps <= imu[-1])]
    for part in parts:
        if len(part.gps) and not shortage_of(part.imu, part.gps):
            continue
        low = max(imu[MIN_SAMPLES - 1], gps[MIN_SHARED_FIXES - 1]) + 0.01
        high = min(imu[-MIN_SAMPLES], gps[-MIN_SHARED_FIXES]) - 0.01
        remedy = (
            f"split at a time from {low:.2f} to {high:.2f} s (--at)"
            if low < high
            else "record a longer drive"
        )
        fixes = count_of(len(part.gps), "fix")
        raise sigmaswarm.InputError(
            f"{part.name}: a part of {part.duration:.1f} s with {fixes} is too short for a drive; {remedy}"
        )


def _next_steps(parts: "Sequence[sigmaswarm.Drive]", out: Path, *, own: bool) -> list[str]:
    from sigmaswarm.drives.alignment import StartFailure, find_start

    short = [too_short_for_outages(part) for part in parts]
    chosen = parts[::-1] if short[0] and not short[1] else parts  # tune on the part that is long enough
    train, test = (shlex.quote(str(out / part.name)) for part in chosen)
    tuned = free_path("tuned")
    diagnoses = [sigmaswarm.diagnose(part) for part in parts]
    serious = any(diagnosis.serious for diagnosis in diagnoses)
    unusable = any(isinstance(find_start(part), StartFailure) for part in parts)
    if unusable or any(map(has_unrepairable, diagnoses)) or (serious and not own):
        return [f"next: sigmaswarm doctor {train} {test}"]
    if all(short):
        return [f"next: use a longer drive, or split at another time; {short[0]}"]
    why = [f"note: {short[0]}"] if short[0] else []
    if serious:
        repaired = shlex.quote(str(Path("mended") / chosen[0].name))
        return [
            *why,
            f"next: sigmaswarm doctor {train} {test} --fix mended",
            f"then: sigmaswarm tune {repaired} --out {tuned}",
        ]
    last = f"sigmaswarm evaluate {tuned} {test} --out {free_path('evaluation')}"
    return [
        *why,
        f"next: sigmaswarm tune {train} --out {tuned}",
        f"then: {'evaluate the tuning on another drive' if why else last}",
    ]
