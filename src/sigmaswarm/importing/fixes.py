"""Read the fixes of a second receiver, and convert them to the clock and the local frame of a drive."""

from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.drives.reader import has_table, read_with_warnings
from sigmaswarm.errors import InputError
from sigmaswarm.importing.assemble import placed_fixes
from sigmaswarm.importing.completion import complete_parts, completed
from sigmaswarm.importing.dates import MIN_DATE, SECOND, Nanoseconds
from sigmaswarm.importing.gather import gather
from sigmaswarm.importing.joining import join
from sigmaswarm.importing.opening import Request, opened
from sigmaswarm.importing.positions import Say, Values
from sigmaswarm.wording import list_names

CLOCK = "time_origin_s"  # key of drive.toml: Unix time at t = 0, s


@dataclass(frozen=True, eq=False)
class ReceiverLog:
    """Fixes of a receiver, in the clock and the local frame of a drive."""

    gps: Gps
    sure: NDArray[
        np.bool_
    ]  # (n,), True for fixes with integer ambiguities; all True if the log has no such status
    notes: tuple[str, ...] = ()  # assumptions, one sentence each


def read_fixes(path: Path, drive: Drive, offset: float = 0.0) -> ReceiverLog:
    """Read the fixes of a log in any format of `sigmaswarm import`, or of a drive's folder.

    Clock (``time_origin_s``) and frame (``origin``) are those of ``drive``. ``offset``, s, is added to the times.
    """
    if has_table(path, "gps"):
        return _of_drive(read_with_warnings(path)[0], drive, offset)  # the import has printed the warnings
    notes: list[str] = []
    time, values, sure = _gathered(path, notes.append)
    counted = bool(time[len(time) // 2] >= MIN_DATE)
    zero = int(drive.metadata.get(CLOCK, 0)) if counted else 0
    gps = _placed(values, (time - zero * SECOND) / SECOND + offset, drive, path, notes.append)
    return ReceiverLog(gps, sure, tuple(dict.fromkeys(notes)))


def _gathered(path: Path, say: Say) -> tuple[Nanoseconds, Values, NDArray[np.bool_]]:
    """Read the fixes of a receiver's log.

    Return times (n,), ns, columns (n,) by name, and a mask (n,). The mask marks fixes whose ambiguities are fixed to
    integers.
    """
    request = Request(source=path)
    with opened(request) as plan:
        log, guess = plan.log("gps"), plan.guess("gps")
        parts = completed(plan).parts("gps") or guess.roles.get("truth", ())
        if not parts:
            there = list_names(log.tables)
            raise InputError(
                f"{path}: no position fixes found in {there}; specify the receiver's own log, or import its fixes as a "
                f"drive (sigmaswarm import IMU_LOG --gps {quote(str(path))} --map ... --out ...) and specify this drive"
            )
        parts = [whole for part in parts for whole in complete_parts(part, log, "gps")]
        fixed = [replace(parts[0], columns={**parts[0].columns, "keep": guess.fixed})] if guess.fixed else []
        read = gather(log, [*parts, *fixed], lambda done: None, request.limits)
        for note in (*guess.notes, *log.remarks):
            say(note)
    samples = join(read[: len(parts)], "gps", (), say)
    time = samples.time
    sure = np.isin(time, read[-1].finish()[0]) if fixed else np.ones(len(time), dtype=np.bool_)
    return time, samples.values, sure


def _of_drive(other: Drive, drive: Drive, offset: float) -> ReceiverLog:
    clocks = [d.metadata.get(CLOCK) for d in (other, drive)]
    apart = clocks[0] - clocks[1] if clocks[0] is not None and clocks[1] is not None else 0.0
    gps = replace(other.gps, time=other.gps.time + apart + offset)
    if other.origin != drive.origin:
        replaced = {"time", "x", "y"} if gps.lat is not None else {"time"}
        values = {k: v for k, v in vars(gps).items() if k not in replaced and v is not None}
        gps = _placed(values, gps.time, drive, Path(other.name), lambda _: None)
    return ReceiverLog(gps, np.ones(len(gps), dtype=np.bool_))


def _placed(values: Values, time: Array, drive: Drive, path: Path, say: Say) -> Gps:
    if "lat" in values and drive.origin is None:
        raise InputError(
            f"{path}: positions are in degrees, but the drive {drive.name} has no origin; write "
            "origin = [lat, lon, alt] at the top of its drive.toml"
        )
    return Gps(time, **placed_fixes(values, drive.origin, say)[0])
