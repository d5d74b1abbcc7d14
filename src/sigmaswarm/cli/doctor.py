"""`sigmaswarm doctor`."""

import shlex
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

import sigmaswarm
from sigmaswarm.cli.common import print_json, read_drives, require_writable
from sigmaswarm.cli.findings import has_repairable, next_steps, print_diagnosis, repair_whole
from sigmaswarm.cli.options import FIELDS, Json, Overwrite, Verbose
from sigmaswarm.cli.output import Output
from sigmaswarm.errors import AlignmentError, DriveWarning, InputError, SigmaswarmWarning

if TYPE_CHECKING:
    from sigmaswarm import Drive
    from sigmaswarm.doctor.findings import Diagnosis
    from sigmaswarm.tuning.lever_arm import LeverArmEstimate


@dataclass(frozen=True)
class DoctorOptions:
    """Options of `sigmaswarm doctor`.

    Attributes
    ----------
    fix
        Folder for a repaired copy of each drive. The drives themselves are not changed.
    lever_arm_within
        Estimate one lever arm from all drives. --fix writes its components whose 95% error is at most this value, m.
    """

    fix: Path | None = None
    lever_arm_within: float | None = None
    overwrite: Overwrite = False
    verbose: Verbose = False
    json: Json = False


def doctor(
    drives: Annotated[
        list[Path], Parameter(name="DRIVE", help="Drive folders, or folders of drive folders.")
    ],
    /,
    *,
    options: Annotated[DoctorOptions, FIELDS] = DoctorOptions(),
) -> None:
    """Check drives for gaps and for wrong signs, units, axes, clocks and noise.

    The doctor compares the IMU with the motion of the fixes. If there is truth, it also checks the truth's clock, and
    the errors and the delay of the fixes. The exit code is 0 if no drive has a serious fault, 1 if a drive has a
    serious fault, and 2 if a drive can't be read. With --fix, exit codes 0 and 1 refer to the repaired copies.

    For example:

        sigmaswarm doctor drives/friday
        sigmaswarm doctor drives
        sigmaswarm doctor drives/friday --fix mended
        sigmaswarm doctor drives/friday --lever-arm-within 0.15 --fix mended
        sigmaswarm doctor drives/friday --json
    """
    from sigmaswarm.drives.reader import drive_folders

    read, fix = _read(drives), options.fix
    if fix is not None:
        _check_names(read)
        require_writable([fix / drive.name for drive in read], drives, overwrite=options.overwrite)
        _refuse_parts(read, drives)
    within = options.lever_arm_within
    arm = None if within is None else _lever_arm(read, within, repaired=fix is not None)
    result: list[dict[str, Any]] = []
    output, serious, following = Output(verbose=options.verbose, silent=options.json), False, list[str]()
    alone = drive_folders(drives[0])[0] if len(read) == 1 else None
    for drive in read:
        diagnosis = sigmaswarm.diagnose(drive)
        content = diagnosis.to_dict()
        print_diagnosis(output, diagnosis, alone)
        if fix is not None:
            diagnosis, content["copy"] = _repair(drive, diagnosis, fix / drive.name, arm, options, output)
        result.append(content)
        serious |= diagnosis.serious
        folder = fix / drive.name if fix else alone
        if alone and folder and (folder / "drive.toml").exists():
            following = [*next_steps(diagnosis, folder, drive)]
    if arm:
        output.show(f"lever arm: {arm}")
    places = [*drives, *([fix / drive.name for drive in read] if fix else [])]
    output.next(*following, place=f"sigmaswarm doctor {shlex.join(map(str, places))} --verbose")
    if options.json:
        print_json({"drives": result, "serious": serious, **({"lever_arm": arm.to_dict()} if arm else {})})
    if serious:
        raise SystemExit(1)


def _repair(
    drive: "Drive",
    diagnosis: "Diagnosis",
    folder: Path,
    arm: "LeverArmEstimate | None",
    options: DoctorOptions,
    output: Output,
) -> "tuple[Diagnosis, dict[str, Any]]":
    """Write a repaired copy of a drive.

    Return the diagnosis of the copy, and the value of "copy" in the JSON output.
    """
    copy = sigmaswarm.repair(drive, diagnosis)
    copy = arm.applied(copy) if arm else copy
    sigmaswarm.write_drive(copy, folder, overwrite=options.overwrite)
    codes = dict.fromkeys(f.code for f in diagnosis.findings if f.repair)
    repaired = [code for code in codes if code not in copy.metadata.get("withheld", ())]
    repaired += ["lever-arm"] if arm and any(arm.observable) else []
    remaining = sigmaswarm.diagnose(copy)
    if repaired:
        output.show(f"wrote {folder}, a repaired copy ({', '.join(repaired)})")
        print_diagnosis(output, remaining, folder, printed=diagnosis)
    else:
        worse = "with the repairs, a filter predicts the fixes less accurately"
        why = worse if codes else "there is no fault that the doctor can repair"
        output.show(f"wrote {folder}, an unchanged copy, since {why}")
    return remaining, {"path": str(folder), "mended": repaired, **remaining.to_dict()}


def _read(paths: list[Path]) -> "list[Drive]":
    """Read drives without warnings, since the diagnosis reports the same faults in more detail."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DriveWarning)
        return read_drives(paths)


def _lever_arm(drives: "list[Drive]", within: float, *, repaired: bool) -> "LeverArmEstimate | None":
    """Estimate one lever arm for all drives; warn and return None if no filter can start."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the repairs warn again when the copies are made
            if repaired:
                drives = [sigmaswarm.repair(drive, sigmaswarm.diagnose(drive)) for drive in drives]
            return sigmaswarm.estimate_lever_arm(drives, within=within)
    except AlignmentError as error:
        warnings.warn(f"no lever arm is estimated: {error}", SigmaswarmWarning, stacklevel=3)
        return None


def _refuse_parts(drives: "list[Drive]", given: list[Path]) -> None:
    """Raise `InputError` for a part of a split drive, since a repair of one part could leave the parts inconsistent."""
    from sigmaswarm.drives.reader import all_drive_locations

    for drive, folder in zip(drives, all_drive_locations(given), strict=True):
        diagnosis = sigmaswarm.diagnose(drive)
        if diagnosis.whole and has_repairable(diagnosis):
            steps, whole = repair_whole(diagnosis, folder)
            commands = [step.partition("    ")[0].partition(": ")[2] for step in steps]
            remedy = ", then ".join(commands) or f"{whole} needs no repair; use this part as it is"
            raise InputError(
                f"{folder}: is a part of the drive {diagnosis.whole}, and would differ from the other part if it were "
                f"repaired alone; {remedy}"
            )


def _check_names(drives: "list[Drive]") -> None:
    names = [drive.name for drive in drives]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"{names.count(name)} drives are named {name!r}; run doctor for each, with different --fix folders"
            )
