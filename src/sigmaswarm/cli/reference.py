"""`sigmaswarm reference`."""

import shlex
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sigmaswarm.cli.options import Json

_Values = Annotated[str | None, Parameter(allow_leading_hyphen=True)]


def reference(
    drive: Annotated[Path, Parameter(name="DRIVE")],
    /,
    *,
    fixes: Path,
    out: Path,
    lever_arm: _Values = None,
    offset: float = 0.0,
    accuracy: float = 0.1,
    fix_std: float | None = None,
    seed: int = 0,
    overwrite: bool = False,
    json: Json = False,
) -> None:
    """Compute truth from a good receiver (RTK) on the same vehicle.

    Its fixes are smoothed with the drive's IMU. The new drive gets a truth.csv at the IMU's times, with standard
    deviations, and with gaps at float solutions and at outages too long for the IMU to bridge.

    Examples:

        sigmaswarm reference drives/monday --fixes rtk.pos --out drives/monday-rtk --lever-arm 0.9,-0.4,1.2
        sigmaswarm tune drives/monday-rtk --out tuned
        sigmaswarm reference drives/monday --fixes drives/rtk --out drives/monday-rtk --accuracy 0.3 --offset -18

    Parameters
    ----------
    drive
        The drive folder, with the IMU and the cheap receiver's fixes.
    fixes
        The good receiver's log (RTKLIB, NMEA, UBX, CSV, ...), or a drive folder; fixed solutions are used.
    out
        Folder of the new drive.
    lever_arm
        From the IMU to the good receiver's antenna, m forward,left,up; none by default.
    offset
        Added to the good receiver's times, s.
    accuracy
        Largest standard deviation per axis of a row of truth, m; others are left out.
    fix_std
        Smallest standard deviation per axis of a fix, m; also that of fixes without one.
    seed
        Seed of the tuning for the good receiver and of the hidden fixes.
    overwrite
        Replace an existing drive.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import numbers_of, print_json, read_known, stdout
    from sigmaswarm.cli.progress import tuning_progress
    from sigmaswarm.drives.writer import require_replaceable, write_drive

    arm = None if lever_arm is None else numbers_of(lever_arm, 3, "--lever-arm", "0.9,-0.4,1.2")
    require_replaceable(out.resolve(), overwrite, "add --overwrite, or name another folder")
    read = read_known(drive)
    with tuning_progress("tuning for the good receiver") as progress:
        made = sigmaswarm.reference(
            read,
            fixes,
            lever_arm=None if arm is None else (arm[0], arm[1], arm[2]),
            offset=offset,
            accuracy=accuracy,
            fix_std=fix_std,
            seed=seed,
            progress=progress,
        )
    write_drive(made, out, overwrite=overwrite)
    about = made.metadata["reference"]
    if json:
        print_json({"drive": str(out), "truth_samples": len(made.truth or ()), **about})
        return
    console = stdout()
    for note in about["notes"]:
        console.print(f"note: {note}", markup=False)
    console.print(
        f"took {about['fixes_taken']} of {about['fixes_given']} fixes; the truth is known to {accuracy:g} m over "
        f"{about['share']:.0%} of the drive"
    )
    if about["stretched"] > 1:
        console.print(
            f"hidden fixes lay farther off than the smoother said: its standard deviations were multiplied by "
            f"{about['stretched']:.2g}"
        )
    console.print(f"wrote {out}")
    console.print(f"next: sigmaswarm tune {shlex.quote(str(out))} --out tuned")
