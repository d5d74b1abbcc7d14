"""`sigmaswarm reference`."""

from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

from cyclopts import Parameter

import sigmaswarm
from sigmaswarm.cli.common import parse_numbers, print_result, read_silently
from sigmaswarm.cli.options import FIELDS, Hyphened, Json, Overwrite
from sigmaswarm.cli.terminal import tuning_progress
from sigmaswarm.files import free_path


@dataclass(frozen=True, kw_only=True)
class ReferenceOptions:
    """Options of `sigmaswarm reference`.

    Attributes
    ----------
    fixes
        Log of the reference receiver (RTKLIB, NMEA, UBX, CSV, ...), or a drive folder. RTK float solutions are left
        out.
    out
        Folder of the new drive.
    lever_arm
        Vector from the IMU to the reference receiver's antenna: forward,left,up in m; by default 0,0,0.
    offset
        Seconds to add to the reference receiver's times.
    accuracy
        Largest standard deviation per axis, m. Fixes and truth with a larger standard deviation are left out.
    fix_std
        Minimum standard deviation of the reference receiver's fixes, m per axis; also used for fixes without a standard
        deviation.
    seed
        Seed of the smoother's tuning, and of the choice of fixes that are hidden to test the smoother.
    """

    fixes: Path
    out: Path
    lever_arm: Hyphened = None
    offset: float = 0.0
    accuracy: float = 0.1
    fix_std: float | None = None
    seed: int = 0
    overwrite: Overwrite = False
    json: Json = False


def reference(
    drive: Annotated[
        Path, Parameter(name="DRIVE", help="The drive folder, with the IMU and the cheap receiver's fixes.")
    ],
    /,
    *,
    options: Annotated[ReferenceOptions, FIELDS],
) -> None:
    """Compute truth from a reference receiver (RTK) on the same vehicle.

    A smoother fuses the reference receiver's fixes with the drive's IMU. The new drive has a truth.csv at the IMU's
    times, with standard deviations. The truth has gaps where its standard deviation exceeds --accuracy, for example in
    long outages of the reference receiver.

    For example:

        sigmaswarm reference drives/monday --fixes rtk.pos --out drives/monday-rtk --lever-arm 0.9,-0.4,1.2
        sigmaswarm tune drives/monday-rtk --out tuned
        sigmaswarm reference drives/monday --fixes drives/rtk --out drives/monday-rtk --accuracy 0.3 --offset -18
    """
    from sigmaswarm.drives.writer import require_replaceable, write_drive

    out = options.out
    given = {name: getattr(options, name) for name in ("offset", "accuracy", "fix_std", "seed")}
    arm: Any = parse_numbers(options.lever_arm, 3, "--lever-arm", "0.9,-0.4,1.2")
    require_replaceable(
        out.resolve(),
        options.overwrite,
        f"add --overwrite, or choose another --out, for example {quote(str(free_path(out)))}",
    )
    read = read_silently(drive)
    with tuning_progress("tuning the smoother") as progress:
        made = sigmaswarm.reference(read, options.fixes, lever_arm=arm, progress=progress, **given)
    write_drive(made, out, overwrite=options.overwrite)
    about = made.metadata["reference"]
    lines = [f"note: {note}" for note in about["notes"]]
    lines.append(
        f"used {about['fixes_taken']} of {about['fixes_given']} fixes; the truth covers {about['share']:.0%} of the "
        f"drive, with a standard deviation of at most {options.accuracy:g} m per axis"
    )
    if about["stretched"] > 1:
        lines.append(
            "the errors at hidden fixes exceeded the smoother's standard deviations, which were therefore multiplied "
            f"by {about['stretched']:.2g}"
        )
    lines += [f"wrote {out}", f"next: sigmaswarm tune {quote(str(out))} --out {free_path('tuned')}"]
    print_result(options.json, {"drive": str(out), "truth_samples": len(made.truth or ()), **about}, *lines)
