"""`sigmaswarm export`."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

import sigmaswarm
from sigmaswarm.cli.common import (
    print_json,
    print_lines,
    read_drives,
    read_silently,
    require_free,
    require_result_folder,
    require_tuning,
)
from sigmaswarm.cli.options import FIELDS, Json, Overwrite
from sigmaswarm.cli.remarks import warn_of_unusable
from sigmaswarm.exports.names import AnyTarget, Target, next_command, target_named

if TYPE_CHECKING:
    from sigmaswarm.exports.check import ExportCheck
    from sigmaswarm.tuning.record import TuningRecord


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Options of `sigmaswarm export`.

    Attributes
    ----------
    to
        c99: a C library. filterpy: a Python script (planar models). robot_localization: YAML (exact only for the
        model robot-localization).
    out
        Folder of the export. --overwrite replaces an earlier export, removes the programs built from it, and keeps
        other files.
    replay
        c99: also write this drive as replay.csv, the input of the program replay.c.
    check
        c99: compare the C library with `sigmaswarm run` on these drives. For robot-localization, write the filter's
        errors into README.md.
    against
        With --check and the model robot-localization, another tuning: the errors of its filter are added to README.md.
    lanes
        c99: number of filters in the exported bank, 1 to 16. This bank does not search for better parameters.
    seed
        c99: seed for drawing the parameters of the filters in the bank.
    """

    to: AnyTarget
    out: Path
    replay: Path | None = None
    check: list[Path] | None = None
    against: Path | None = None
    lanes: int = 1
    seed: int = 0
    overwrite: Overwrite = False
    json: Json = False


def export(
    tuning: Annotated[Path, Parameter(name="TUNING", help="A tuning.toml, or the folder that contains it.")],
    /,
    *,
    options: Annotated[ExportOptions, FIELDS],
) -> None:
    """Export a tuned filter as C, as a Python script or for robot_localization.

    To write the estimates of a filter, use `sigmaswarm run`.

    For example:

        sigmaswarm export tuned --to c99 --out filter-c --replay drives/friday --check drives
        sigmaswarm export tuned-planar8 --to filterpy --out filter-py
        sigmaswarm export tuned --to robot_localization --out filter-ros
        sigmaswarm export tuned --to robot_localization --out ekf --check drives/friday --against tuned-tilted12
    """
    to, out = target_named(options.to), options.out
    # before the imports, which take seconds; the user's own files are checked when the names of the exported files are
    # known
    require_result_folder(out, [], f"export to {to}", alone=False, overwrite=options.overwrite)
    from sigmaswarm.exports.check import check_export
    from sigmaswarm.exports.targets import export_texts, write_texts
    from sigmaswarm.filters.models import MODELS
    from sigmaswarm.scoring.evaluation import evaluate
    from sigmaswarm.scoring.view import accuracy_section
    from sigmaswarm.tuning.record import TunedFilter

    following = f"sigmaswarm export tuned --to {options.to} --out {quote(str(out))}"
    require_tuning(tuning, f"tune first: sigmaswarm tune {quote(str(tuning))} --out tuned, then {following}")
    tuned = TunedFilter.read(tuning)
    record, parameters = tuned.record, tuned.parameters
    ros = to != "c99" and MODELS[parameters.model].measures_imu
    _check_options(options, ros=ros)
    drive = read_silently(options.replay) if options.replay else None
    drives = read_drives(options.check or [])
    bank: dict[str, Any] = {"lanes": options.lanes, "seed": options.seed}
    texts = export_texts(parameters, to, replay=drive, **bank, **record.for_export)
    require_free(*(out / name for name in texts), overwrite=options.overwrite)
    if drives and ros:
        evaluation = evaluate(drives, parameters, against=options.against, seen=tuned.seen)
        texts["README.md"] += accuracy_section(evaluation.view)
    written = write_texts(texts, out, to)
    checked: list[ExportCheck] = []
    if drives and not ros:
        checked = check_export(out, parameters, drives, as_recorded=record.as_recorded, **bank)
    if options.json:
        comparison = {"checked": [asdict(check) for check in checked]} if checked else {}
        print_json({"written": [str(path) for path in written], **comparison})
    else:
        names = ", ".join(str(path.relative_to(out)) for path in written)
        print_lines(f"wrote {out}: {names}", *(_describe(check, options.lanes) for check in checked))
        print_lines(*_notes(to, record, replay=drive is not None))
    if not warn_of_unusable(tuning, record) and not options.json:
        print_lines(f"next: {next_command(to, out, texts) or _with_replay(tuning, options)}")


def _check_options(options: ExportOptions, *, ros: bool) -> None:
    """Raise `InputError` for options that the target does not have.

    ``ros`` is True if a filter with the model robot-localization is exported as YAML.
    """
    if options.check and options.to != "c99" and not ros:
        raise sigmaswarm.InputError(
            "--check needs --to c99 or a tuning of the model robot-localization; omit --check"
        )
    if options.against and not (options.check and ros):
        raise sigmaswarm.InputError(
            "--against needs --check and a tuning of the model robot-localization; omit --against"
        )


def _notes(target: Target, record: "TuningRecord", *, replay: bool) -> Iterator[str]:
    if record.mounting and target == "c99":
        angles = ", ".join(f"{angle:.4g}" for angle in record.mounting)
        axes = "with the axes in README.md" if record.imu_axes else "in SI units"
        yield (
            f"note: the IMU is rotated relative to the vehicle (roll, pitch, yaw: {angles} deg). In your program, pass "
            f"each sample {axes} to ins_gps_turn_imu() first"
            f"{'; the samples in replay.csv are rotated already' if replay else ''}"
        )
    if target != "filterpy" and record.mountings_differ:
        yield (
            "note: the training drives have different mountings, so the export contains no rotation; rotate raw "
            "samples to x forward, y left, z up for the filter, or tune on drives with one mounting"
        )

    if target == "c99" and record.data and all(drive.slow for drive in record.data):
        yield (
            "note: in the training drives, the vehicle rarely travels 20 m within 6 s (12 km/h), which the alignment "
            "in C requires. Compute the initial state in your program, and pass it to ins_gps_init() (README.md)"
        )


def _with_replay(tuning: Path, options: ExportOptions) -> str:
    """Return the command that repeats the export with an input for the program replay.c."""
    drive = quote(str(options.check[0])) if options.check else "DRIVE"
    lanes = f" --lanes {options.lanes} --seed {options.seed}" if options.lanes > 1 else ""
    command = f"sigmaswarm export {quote(str(tuning))} --to c99 --out {quote(str(options.out))}{lanes}"
    return f"{command} --replay {drive} --overwrite    (adds an input for the program replay.c)"


def _describe(check: "ExportCheck", lanes: int) -> str:
    library = "sigmaswarm run" if lanes == 1 else "a LiveFilterBank without searches"
    line = (
        f"{check.drive}: every state in C is within {check.double.state:.1e} of {library} "
        "(relative for values above 1)"
    )
    single = check.single
    if single is None:
        return f"{line}; in single precision the filter fails"
    return (
        f"{line}; in single precision the position differs by at most {1e3 * single.position:.2g} mm and the heading "
        f"by {math.degrees(single.heading):.1g} degrees"
    )
