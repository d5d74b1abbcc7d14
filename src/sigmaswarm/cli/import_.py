"""`sigmaswarm import`."""

import re
import shlex
import sys
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from sigmaswarm.cli.common import parse_numbers, print_json, require_free
from sigmaswarm.cli.findings import affects_axes, mirror_maps, next_steps, print_diagnosis
from sigmaswarm.cli.options import FIELDS, MORE, Hyphened, Json, Overwrite, Verbose
from sigmaswarm.cli.output import Output
from sigmaswarm.cli.terminal import progress_bar
from sigmaswarm.errors import DriveWarning, InputError
from sigmaswarm.files import free_path
from sigmaswarm.wording import count_of, printable

if TYPE_CHECKING:
    from sigmaswarm.doctor.findings import Diagnosis, Finding
    from sigmaswarm.drives.drive import Drive
    from sigmaswarm.importing.convert import ImportResult
    from sigmaswarm.importing.inspection import Inspection, TablePreview
    from sigmaswarm.importing.opening import Request
    from sigmaswarm.importing.recipe import Recipe

AXES_NOTE = (
    "the IMU's axes are assumed to be x forward, y left, z up; "
    "if this is wrong, add --mount auto, or the mounting, for example --mount 90"
)
NOT_READY_NOTE = "The log cannot be imported yet: follow the notes above, and repeat --show"
DIRECTIONS = {"course-convention": ("course", "vx", "vy"), "heading-convention": ("heading",)}
"""Columns of the fixes that the findings with these codes are about."""
MAX_UNUSED_COLUMNS = 100  # unused columns that are named per table


@dataclass(frozen=True)
class ImportOptions:
    """Options of `sigmaswarm import`.

    Attributes
    ----------
    out
        Folder of the new drive.
    show
        Show tables or topics, rates, value ranges and the planned import, but write no drive.
    format
        Format: ros, mcap, kitti, nclt, comma2k19, rtklib, ubx, nmea, px4, ardupilot, matlab, sensor-logger, phyphox,
        gnss-logger, json, csv.
    gps
        Log of the fixes, if SOURCE does not contain them.
    truth
        Log of the truth or of a reference receiver's fixes, if SOURCE does not contain them.
    odometer
        Log of the wheel speed, if SOURCE does not contain it.
    map
        Columns of the drive as column=expression: "ax=-acc_y*9.80665", "gps.t=stamp"; "az=" omits a column.
    time
        Expression for the times, s, in the tables of SOURCE, such as "stamp*1e-9" or "utc(date)".
    recipe
        Use the recipe in a file that --save-recipe wrote.
    save_recipe
        File to which the recipe of this import is saved.
    imu_topic
        Topic or table of the IMU.
    gps_topic
        Topic or table of the fixes.
    velocity_topic
        Topic or table of the receiver's velocity, m/s east and north.
    truth_topic
        Topic or table of the truth.
    odometer_topic
        Topic or table of the wheel speed, m/s forward.
    mag_topic
        Topic or table of a magnetometer with the IMU's axes; adds headings to the fixes. Names for --map: mag.mx,
        mag.my.
    declination
        Magnetic declination, deg, east positive. By default, the sum of declination and sensor rotation is estimated
        from the course.
    receive_times
        Use the receive times of messages instead of the stamps in their headers.
    part
        Number of the recording to read, counted from 1. A table contains several recordings if its clock restarts.
    msg
        Message definitions that the bag does not contain: a .msg file, or the folder of a ROS package.
    mount
        Orientation of the IMU: auto, degrees about z (90), roll,pitch,yaw (0,10,90), or axes (x=-y,y=x).
    gps_offset
        Seconds to add to the times of the fixes.
    truth_offset
        Seconds to add to the times of the truth.
    odometer_offset
        Seconds to add to the times of the odometer.
    origin
        Origin of the local frame: lat,lon,alt in deg and m; the first fix by default.
    lever_arm
        Vector from the IMU to the antenna: forward,left,up in m.
    heading_from_north
        Heading at the first IMU sample, deg clockwise from north. Needed if the vehicle is too slow for an estimate.
    gps_from_truth
        Simulate fixes from the truth: rate in Hz and standard deviation per axis in m, for example 5,1.
    max_rows
        Maximum number of rows of a table; 10 million by default (28 hours at 100 Hz).
    max_columns
        Maximum number of columns of all tables together; 100,000 by default.
    max_unpacked_mb
        Maximum size in MB after unpacking, for a bag's chunk, MATLAB variable, JSON file or zip; 500 by default.
    name
        Name of the drive; by default the name of the folder.
    """

    out: Path | None = None
    show: bool = False
    format: str | None = None
    gps: Path | None = None
    truth: Path | None = None
    odometer: Annotated[Path | None, MORE] = None
    map: list[str] | None = None
    time: str | None = None
    recipe: Path | None = None
    save_recipe: Annotated[Path | None, MORE] = None
    imu_topic: Annotated[str | None, Parameter(alias="--imu-table")] = None
    gps_topic: Annotated[str | None, Parameter(alias="--gps-table")] = None
    velocity_topic: Annotated[str | None, MORE, Parameter(alias="--velocity-table")] = None
    truth_topic: Annotated[str | None, MORE, Parameter(alias="--truth-table")] = None
    odometer_topic: Annotated[str | None, MORE, Parameter(alias="--odometer-table")] = None
    mag_topic: Annotated[str | None, MORE, Parameter(alias="--mag-table")] = None
    declination: Annotated[float | None, MORE, Parameter(allow_leading_hyphen=True)] = None
    receive_times: Annotated[bool, MORE] = False
    part: int | None = None
    msg: Annotated[list[Path] | None, MORE] = None
    mount: Hyphened = None
    gps_offset: Annotated[float | None, MORE] = None
    truth_offset: Annotated[float | None, MORE] = None
    odometer_offset: Annotated[float | None, MORE] = None
    origin: Annotated[Hyphened, MORE] = None
    lever_arm: Annotated[Hyphened, MORE] = None
    heading_from_north: Annotated[float | None, MORE, Parameter(allow_leading_hyphen=True)] = None
    gps_from_truth: Annotated[Hyphened, MORE] = None
    max_rows: Annotated[int | None, MORE] = None
    max_columns: Annotated[int | None, MORE] = None
    max_unpacked_mb: Annotated[int | None, MORE] = None
    name: Annotated[str | None, MORE] = None
    overwrite: Overwrite = False
    verbose: Annotated[Verbose, MORE] = False
    json: Annotated[Json, MORE] = False


def import_(
    source: Annotated[
        Path,
        Parameter(name="SOURCE", help="The log with the IMU and perhaps other sensors: a file or a folder."),
    ],
    /,
    *,
    options: Annotated[ImportOptions, FIELDS] = ImportOptions(),
) -> None:
    """Import a log as a drive.

    The log can be a ROS bag, an MCAP, CSV or Parquet file, a published data set, or a log of a receiver, a flight
    controller or a phone. The command detects the format of the log. Begin with --show, which writes no drive.

    For example:

        sigmaswarm import monday.mcap --show
        sigmaswarm import monday.mcap --out drives/monday --imu-topic /imu/data --mount 90
        sigmaswarm import imu.csv --out drives/monday --gps track.ubx --truth rtk.pos
        sigmaswarm import log.csv --out drives/monday --time "stamp*1e-3" --map "ax=-acc_y*9.80665" "gz=radians(gyro_z)"
    """
    request, heading = _request(source, options), options.heading_from_north
    if heading is not None and not abs(heading) <= 360:
        raise InputError(f"--heading-from-north {heading:g} is out of range; specify -360 to 360 degrees")
    if options.show:
        _show(request, options)
    elif options.out is None:
        raise InputError("--out is missing: specify a folder for the drive, or look at the log with --show")
    else:
        _import(request, options.out, options)


def _request(source: Path, options: ImportOptions) -> "Request":
    from sigmaswarm.importing.opening import request_of
    from sigmaswarm.importing.source import ROLES, Limits, TableChoice

    topics = {name: getattr(options, f"{name}_topic", None) for name in (*ROLES, "velocity")}
    limits = {name: getattr(options, f"max_{name}") for name in ("rows", "columns", "unpacked_mb")}
    for name, value in limits.items():
        if value is not None and value < 1:
            raise InputError(f"--max-{name.replace('_', '-')} {value}: must be above 0")
    same = ("format", "gps", "truth", "odometer", "recipe", "time", "part", "mount")
    settings = {
        **{name: getattr(options, name) for name in same},
        **{f"{name}_offset_s": getattr(options, f"{name}_offset") for name in ("gps", "truth", "odometer")},
        "maps": options.map,
        "definitions": options.msg,
        "choice": TableChoice({k: v for k, v in topics.items() if v}, options.receive_times),
        "limits": Limits(**{name: value for name, value in limits.items() if value is not None}),
        "declination_deg": options.declination,
        "origin": parse_numbers(options.origin, 3, "--origin", "50.1,8.7,120"),
        "gps_lever_arm_m": parse_numbers(options.lever_arm, 3, "--lever-arm", "1.2,0,0.5"),
        "gps_from_truth": parse_numbers(options.gps_from_truth, 2, "--gps-from-truth", "5,1"),
    }
    return request_of(source, {key: value for key, value in settings.items() if value is not None})


def _import(request: "Request", out: Path, options: ImportOptions) -> None:
    _check_folders(request, out, options)  # before the imports, which take seconds
    from sigmaswarm.doctor.diagnose import diagnose
    from sigmaswarm.drives.writer import write_drive
    from sigmaswarm.importing.convert import import_drive

    with progress_bar("importing") as show, warnings.catch_warnings():
        warnings.simplefilter("ignore", DriveWarning)  # the diagnosis contains the same checks in more detail
        imported = import_drive(request, options.name or out.resolve().name, lambda share: show(share, 1.0))
    if (heading := options.heading_from_north) is not None:
        stated = {**imported.drive.metadata, "heading_deg": (90.0 - heading) % 360.0}
        imported = replace(imported, drive=replace(imported.drive, metadata=stated))
    write_drive(imported.drive, out, overwrite=options.overwrite)
    if options.save_recipe:
        imported.recipe.save(options.save_recipe)
    diagnosis = _with_columns(diagnose(imported.drive), imported)
    if options.json:
        print_json(_summary(imported, out) | {"doctor": diagnosis.to_dict()})
        return
    output = Output(verbose=options.verbose)
    output.show(_written(imported.drive, out, diagnosis))
    # the remedy of a finding about the axes replaces the note on the assumed axes
    axes = imported.assumed or (() if imported.recipe.mount else (AXES_NOTE,))
    output.show(*_notes([*imported.notes, *(() if affects_axes(diagnosis) else axes)]))
    if options.verbose:  # --show prints them too
        output.show(*_columns_read(imported.recipe))
    print_diagnosis(output, diagnosis, out)
    again = _with_corrected_fixes(diagnosis)
    steps = [f"next: {again}"] if again else next_steps(diagnosis, out, imported.drive)
    output.next(*steps, place=f"sigmaswarm doctor {shlex.quote(str(out))} --verbose")


def _check_folders(request: "Request", out: Path, options: ImportOptions) -> None:
    """Raise `InputError` if the drive or the recipe can't be written."""
    from sigmaswarm.drives.writer import require_replaceable

    read = [
        place.resolve() for place in (request.source, request.gps, request.truth, request.odometer) if place
    ]
    if any(out.resolve() in (place, place.parent) for place in read) and out.exists():
        raise InputError(f"{out}: contains a log that this command reads; choose another folder")
    recipe = options.save_recipe
    also = f" (which also replaces {recipe})" if recipe and recipe.is_file() else ""
    remedy = f"add --overwrite{also}, or choose another folder, for example --out {shlex.quote(str(free_path(out)))}"
    require_replaceable(out.resolve(), options.overwrite, remedy)
    require_free(options.save_recipe, overwrite=options.overwrite)


def _with_corrected_fixes(diagnosis: "Diagnosis") -> str:
    """Return the user's command with a --map that corrects mirrored fixes.

    Return "" if the fixes are not mirrored, or if the command already contains --map.
    """
    maps = mirror_maps(diagnosis)
    if not maps or "--map" in sys.argv:
        return ""
    typed = [word for word in sys.argv[1:] if word != "--overwrite"]
    return printable(shlex.join(["sigmaswarm", *typed, "--map", *maps, "--overwrite"]), 4000)


def _with_columns(diagnosis: "Diagnosis", imported: "ImportResult") -> "Diagnosis":
    """Replace placeholders such as COLUMN_OF_LAT in remedies by expressions of the recipe."""
    parts = [part for role in ("imu", "gps") for part in imported.recipe.roles.get(role, ())]
    texts = {name: text for part in parts for name, text in part.columns.items()}

    def named(finding: "Finding") -> str:
        omitted = [f'"gps.{name}="' for name in DIRECTIONS.get(finding.code, ()) if name in texts]
        option = f"omit it: import with --map {' '.join(omitted)}"
        text = finding.remedy.replace("omit the column", option) if omitted else finding.remedy
        return re.sub(r"COLUMN_OF_([A-Z]+)", lambda m: texts.get(m[1].lower(), m[0]), text)

    return replace(diagnosis, findings=tuple(replace(f, remedy=named(f)) for f in diagnosis.findings))


def _summary(imported: "ImportResult", out: Path) -> dict[str, Any]:
    drive = imported.drive
    return {
        "drive": str(out),
        "duration_s": drive.duration,
        "imu_samples": len(drive.imu),
        "fixes": len(drive.gps),
        "truth_samples": len(drive.truth or ()),
        "odometer_samples": len(drive.odometer or ()),
        "recipe": imported.recipe.to_toml(),
        "notes": [*imported.notes, *imported.assumed],
    }


def _written(drive: "Drive", out: Path, diagnosis: "Diagnosis") -> str:
    from sigmaswarm.drives.checks import outside_of

    truth = f", {len(drive.truth)} rows of truth" if drive.truth else ", no truth"
    wheels = f", {len(drive.odometer)} odometer samples" if drive.odometer else ""
    outside = outside_of(drive.imu.time, drive.gps.time).sum()
    warned = any(f.code == "gps-outside" and f.severity == "warning" for f in diagnosis.findings)
    unused = f" ({outside} outside of the IMU's time span are not used)" if outside and not warned else ""
    samples = f"{len(drive.imu)} IMU samples ({1 / drive.nominal_interval:.3g} Hz)"
    return f"wrote {out}: {drive.duration:.1f} s, {samples}, {len(drive.gps)} fixes{unused}{wheels}{truth}"


def _columns_read(recipe: "Recipe") -> Iterator[str]:
    yield from (f"read {printable(read, 1000)}" for read in recipe.map_arguments())


def _notes(notes: Iterable[str]) -> Iterator[str]:
    yield from (f"note: {printable(note, 1000)}" for note in notes)


def _show(request: "Request", options: ImportOptions) -> None:
    from sigmaswarm.importing.inspection import inspect_request

    with progress_bar("checking") as show:
        inspection = inspect_request(request, lambda share: show(share, 1.0))
    if options.save_recipe:
        require_free(options.save_recipe, overwrite=options.overwrite)
        inspection.recipe.save(options.save_recipe)
    if options.json:
        content = {"recipe": inspection.recipe.to_toml(), "notes": inspection.notes}
        content |= {"proposal": inspection.proposal, "evidence": inspection.evidence}
        print_json({"tables": [asdict(t) for t in inspection.tables], **content})
    else:
        _print_inspection(inspection, options)


def _print_inspection(inspection: "Inspection", options: ImportOptions) -> None:
    output, unread = Output(verbose=options.verbose), inspection.unread
    all_columns = (
        options.verbose or inspection.proposal or not inspection.works
    )  # the user looks for a column
    output.show("Lowest, median and highest value of each column in the first rows:")
    for preview in inspection.tables:
        rows = f", {preview.rows} rows" if preview.rows is not None else ""
        rate = f", {preview.rate:.4g} Hz" if preview.rate else ""
        output.show(f"{printable(preview.table)}: {printable(preview.kind)}{rows}{rate}")
        hidden = () if all_columns else unread.get(preview.table, ())
        output.show(
            *_columns(replace(preview, ranges=tuple(r for r in preview.ranges if r.column not in hidden)))
        )
    output.show(
        "", *([*_columns_read(inspection.recipe)] or ["no column was recognized; map the columns with --map"])
    )
    for table, columns in unread.items():
        more = f" and {len(columns) - MAX_UNUSED_COLUMNS} more" if len(columns) > MAX_UNUSED_COLUMNS else ""
        names = ", ".join(map(printable, columns[:MAX_UNUSED_COLUMNS]))
        output.show(f"not used from {printable(table)}: {names}{more}")
    output.show(*_notes(inspection.notes))
    if inspection.proposal:
        lacking = "" if inspection.works else " (some columns are still missing, see below)"
        of_rows = re.search(r"\b(imu|gps)\.t=", inspection.proposal)
        output.show(
            f"\nTo read more columns, add these options to the command{lacking}:",
            printable(inspection.proposal, 4000),
            f"({printable(inspection.evidence, 1000)})",
            *(["(imu.t and gps.t are the times of IMU samples and fixes)"] if of_rows else []),
        )
    recipe = "\n".join(printable(line, 1000) for line in inspection.recipe.to_toml().split("\n"))
    output.details("the recipe", "\nThe recipe, which --save-recipe saves:", recipe)
    output.details("the ranges of unused columns", *() if all_columns else unread)
    output.show("")
    output.next(f"next: {_command(inspection, options)}" if inspection.works else NOT_READY_NOTE)


def _command(inspection: "Inspection", options: ImportOptions) -> str:
    typed = [word for word in sys.argv[1:] if word != "--show"]
    out = [] if options.out else ["--out", str(free_path("drive"))]
    # A proposal's expressions for the IMU's columns already give values in the drive's axes.
    corrected = inspection.proposal and re.search(r"\b[ag][xyz]=", inspection.proposal)
    out += ["--mount", inspection.mount] if inspection.mount and not corrected else []
    command = printable(shlex.join(["sigmaswarm", *typed, *out]), 4000)
    return f"{command} {printable(inspection.proposal, 4000)}".rstrip()


def _columns(preview: "TablePreview") -> Iterator[str]:
    """Yield a line for each column that is not always 0: lowest, median and highest value, or an example."""
    varying = [r for r in preview.ranges if r.low or r.high or r.low is None]
    width = max((len(printable(r.column)) for r in varying), default=0)
    for r in varying:
        ends = f"{_short(r.low):>20} {_short(r.middle):>20} {_short(r.high):>20}" if r.example else "empty"
        yield f"  {printable(r.column):{width}} {printable(r.example) if r.low is None and r.example else ends}"
    if others := len(preview.ranges) - len(varying):
        yield f"  and {count_of(others, 'column')} with only the value 0"


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.12g}" if abs(value) >= 1e6 else f"{value:.8g}"
