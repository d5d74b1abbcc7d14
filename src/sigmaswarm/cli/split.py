"""`sigmaswarm split`."""

import shlex
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import sigmaswarm
from sigmaswarm.cli.common import print_json, read_silently, require_writable
from sigmaswarm.cli.findings import has_unrepairable, repair_and_split, too_short_for_outages
from sigmaswarm.cli.options import Json, Overwrite
from sigmaswarm.cli.terminal import print_lines
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
            f"--at has {len(at)} times; specify one time, or two times to omit the part between them"
        )
    from sigmaswarm.drives.split import is_repaired_alone

    whole = read_silently(drive)
    parts = _parts(whole, 0.7 if train_fraction is None else train_fraction, at)
    require_writable([out / part.name for part in parts], [drive], overwrite=overwrite)
    diagnosis, own = sigmaswarm.diagnose(whole), all(map(is_repaired_alone, parts))
    for part in parts:
        sigmaswarm.write_drive(part, out / part.name, overwrite=overwrite)
    if json:
        print_json({"drives": [str(out / part.name) for part in parts]})
        return
    print_lines(*(f"wrote {out / part.name} ({part.duration:.0f} s)" for part in parts))
    repairs = [] if own else [*repair_and_split(diagnosis, drive, _options(train_fraction, at))]
    print_lines(*(repairs or _next_steps(parts, out, own=own)))


def _parts(
    whole: "sigmaswarm.Drive", train_fraction: float, at: list[float] | None
) -> "Sequence[sigmaswarm.Drive]":
    """Split a drive; with two times, return only the longer part if the other is too short for a drive."""
    times = None if not at else at[0] if len(at) == 1 else (at[0], at[1])
    try:
        parts = sigmaswarm.split_time(whole, train_fraction, at=times)
        _require_enough(whole, parts)
        return parts
    except sigmaswarm.InputError:
        long = _longest_part(whole, at) if at and len(at) == 2 and at[0] <= at[1] else None
        if long is None:
            raise
        return [long]


def _longest_part(whole: "sigmaswarm.Drive", at: list[float]) -> "sigmaswarm.Drive | None":
    """Return the longer of the two parts before the first time and after the second time.

    Return None if this part is too short for a drive.
    """
    late = float(whole.imu.time[-1]) - at[1] > at[0] - float(whole.imu.time[0])
    with warnings.catch_warnings(), suppress(sigmaswarm.InputError):
        warnings.simplefilter("ignore")  # about the other part
        part = sigmaswarm.split_time(whole, at=at[late])[late]
        _require_enough(whole, [part])
        return replace(part, name=f"{whole.name}-{('before', 'after')[late]}")
    return None


def _options(train_fraction: float | None, at: list[float] | None) -> list[str]:
    """Return the options with which the repaired drive is split in the same way."""
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


def _free(out: Path) -> str:
    return shlex.quote(str(free_path(out)))


def _is_longer(part: "sigmaswarm.Drive", other: "sigmaswarm.Drive") -> bool:
    return part.duration >= other.duration


def _next_steps(parts: "Sequence[sigmaswarm.Drive]", out: Path, *, own: bool) -> list[str]:
    from sigmaswarm.drives.alignment import StartFailure, find_start
    from sigmaswarm.drives.split import part_of

    if len(parts) == 1:
        return [f"next: sigmaswarm split {shlex.quote(str(out / parts[0].name))} --out {_free(out)}"]
    short, named = [too_short_for_outages(part) for part in parts], bool(part_of(parts[0]))
    # tune on the part that is long enough
    chosen = parts[::-1] if (short[0] and not short[1]) or not (named or _is_longer(*parts)) else parts
    train, test = (shlex.quote(str(out / part.name)) for part in chosen)
    tuned = free_path("tuned")
    diagnoses = [sigmaswarm.diagnose(part) for part in parts]
    serious = any(diagnosis.serious for diagnosis in diagnoses)
    failed = [isinstance(find_start(part), StartFailure) for part in chosen]
    if not named and not failed[0] and (failed[1] or too_short_for_outages(chosen[1])):
        again = f"sigmaswarm split {train} --out {_free(out)}"
        why = "the other part can't be evaluated: it is too short, or no filter can start on it"
        return [f"next: {again}    ({why})"]
    if any(failed) or any(map(has_unrepairable, diagnoses)) or (serious and not own):
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
