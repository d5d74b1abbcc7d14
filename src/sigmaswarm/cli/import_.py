"""`sigmaswarm import`."""

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from sigmaswarm.cli.options import MORE, Json
from sigmaswarm.wording import shown

if TYPE_CHECKING:
    from sigmaswarm.importing.convert import Imported
    from sigmaswarm.importing.limits import Limits
    from sigmaswarm.importing.look import Look
    from sigmaswarm.importing.recipe import Recipe

MOST_UNREAD = 100
"""Names of unused columns shown per table."""

_Values = Annotated[str | None, Parameter(allow_leading_hyphen=True)]


def import_(
    source: Annotated[Path, Parameter(name="SOURCE")],
    /,
    *,
    out: Path | None = None,
    show: bool = False,
    format: str | None = None,
    gps: Path | None = None,
    truth: Path | None = None,
    odometer: Annotated[Path | None, MORE] = None,
    map: list[str] | None = None,
    time: str | None = None,
    recipe: Path | None = None,
    save_recipe: Annotated[Path | None, MORE] = None,
    imu_topic: Annotated[str | None, Parameter(name=("--imu-topic", "--imu-table"))] = None,
    gps_topic: Annotated[str | None, Parameter(name=("--gps-topic", "--gps-table"))] = None,
    velocity_topic: Annotated[
        str | None, MORE, Parameter(name=("--velocity-topic", "--velocity-table"))
    ] = None,
    truth_topic: Annotated[str | None, MORE, Parameter(name=("--truth-topic", "--truth-table"))] = None,
    odometer_topic: Annotated[
        str | None, MORE, Parameter(name=("--odometer-topic", "--odometer-table"))
    ] = None,
    receive_times: Annotated[bool, MORE] = False,
    part: int | None = None,
    msg: Annotated[list[Path] | None, MORE] = None,
    mount: _Values = None,
    gps_offset: Annotated[float | None, MORE] = None,
    truth_offset: Annotated[float | None, MORE] = None,
    odometer_offset: Annotated[float | None, MORE] = None,
    origin: Annotated[_Values, MORE] = None,
    lever_arm: Annotated[_Values, MORE] = None,
    heading_from_north: Annotated[float | None, MORE, Parameter(allow_leading_hyphen=True)] = None,
    gps_from_truth: Annotated[_Values, MORE] = None,
    max_rows: Annotated[int | None, MORE] = None,
    max_columns: Annotated[int | None, MORE] = None,
    max_unpacked_mb: Annotated[int | None, MORE] = None,
    name: Annotated[str | None, MORE] = None,
    overwrite: Annotated[bool, MORE] = False,
    json: Annotated[Json, MORE] = False,
) -> None:
    """Import a log as a drive.

    ROS bags, MCAP, CSV, Parquet, data sets, receivers, flight logs and phones; the format is detected. Begin with
    --show, which writes nothing.

    Examples:

        sigmaswarm import monday.mcap --show
        sigmaswarm import monday.mcap --out drives/monday --imu-topic /imu/data --mount 90
        sigmaswarm import imu.csv --out drives/monday --gps track.ubx --truth rtk.pos
        sigmaswarm import log.csv --out drives/monday --time "stamp*1e-3" --map "ax=-acc_y*9.80665" "gz=radians(gyro_z)"

    Parameters
    ----------
    source
        The log, a file or a folder, with the IMU and often everything else.
    out
        Folder of the new drive.
    show
        Show tables or topics, rates, ranges and the planned import; write nothing.
    format
        Format: ros, mcap, kitti, nclt, comma2k19, rtklib, ubx, nmea, px4, ardupilot, matlab, sensor-logger, phyphox,
        gnss-logger, csv.
    gps
        Separate log of the fixes.
    truth
        Separate log of the truth, or of a good receiver's fixes.
    odometer
        Separate log of the wheel speed.
    map
        column=expression for a drive's columns, as "ax=-acc_y*9.80665", "gps.t=stamp"; "az=" leaves a column out.
    time
        Expression of the time in SOURCE's tables, s, as "stamp*1e-9" or "utc(date)".
    recipe
        A saved recipe.
    save_recipe
        File in which the recipe is saved.
    imu_topic
        Topic or table of the IMU.
    gps_topic
        Topic or table of the fixes.
    velocity_topic
        Topic of the receiver's velocity, m/s east and north.
    truth_topic
        Topic or table of the truth.
    odometer_topic
        Topic or table of the wheel speed, m/s forward.
    receive_times
        Use the times at which messages were received, not their headers' stamps.
    part
        Recording to read, from 1, if a clock restarts within a table.
    msg
        Definitions of ROS messages, .msg files or a package's folder, for bags without them.
    mount
        Orientation of the IMU: auto, degrees about z (90), roll,pitch,yaw (0,10,90), or axes (x=-y,y=x).
    gps_offset
        Added to the fixes' times, s.
    truth_offset
        Added to the truth's times, s.
    odometer_offset
        Added to the odometer's times, s.
    origin
        lat,lon,alt of the local frame; the first fix by default.
    lever_arm
        From the IMU to the antenna, m forward,left,up.
    heading_from_north
        Heading at the first IMU sample, degrees clockwise from north; written as heading_deg. For slow vehicles.
    gps_from_truth
        rate,noise: make fixes from the truth, Hz and m of white noise, as 5,1.
    max_rows
        Largest number of rows of a table; 10 million by default, 28 hours at 100 Hz.
    max_columns
        Largest number of columns of all tables; 100 000 by default.
    max_unpacked_mb
        Largest unpacked size of a chunk or of a zip's files, MB; 1000 by default.
    name
        The drive's name; the folder's by default.
    overwrite
        Replace an existing drive.
    """
    from sigmaswarm.cli.common import numbers_of
    from sigmaswarm.errors import InputError
    from sigmaswarm.importing.convert import Request
    from sigmaswarm.importing.recipe import Recipe
    from sigmaswarm.importing.source import Choice

    topics = {
        "imu": imu_topic,
        "gps": gps_topic,
        "velocity": velocity_topic,
        "truth": truth_topic,
        "odometer": odometer_topic,
    }
    settings: dict[str, Any] = {
        "mount": mount,
        "gps_offset_s": gps_offset,
        "truth_offset_s": truth_offset,
        "odometer_offset_s": odometer_offset,
        "origin": None if origin is None else numbers_of(origin, 3, "--origin", "50.1,8.7,120"),
        "gps_lever_arm_m": None
        if lever_arm is None
        else numbers_of(lever_arm, 3, "--lever-arm", "1.2,0,0.5"),
        "gps_from_truth": None
        if gps_from_truth is None
        else numbers_of(gps_from_truth, 2, "--gps-from-truth", "5,1"),
    }
    request = Request(
        source=source,
        gps=gps,
        truth=truth,
        odometer=odometer,
        form=format,
        recipe=_with(Recipe.load(recipe) if recipe else Recipe(), settings),
        maps=map or (),
        time=time,
        choice=Choice({k: v for k, v in topics.items() if v}, receive_times),
        limits=_limits(rows=max_rows, columns=max_columns, unpacked_mb=max_unpacked_mb),
        part=part,
        definitions=msg or (),
    )
    if heading_from_north is not None and not abs(heading_from_north) <= 360:
        raise InputError(f"--heading-from-north {heading_from_north:g} is no angle; give degrees, 0 to 360")
    if show:
        _show(request, save_recipe, json)
        return
    if out is None:
        raise InputError("--out is missing: name the drive's folder to be made, or use --show to look first")
    stated = {} if heading_from_north is None else {"heading_deg": (90.0 - heading_from_north) % 360.0}
    _import(request, (out, name or out.resolve().name), stated, save_recipe, overwrite=overwrite, json=json)


def _limits(**given: int | None) -> "Limits":
    from sigmaswarm.errors import InputError
    from sigmaswarm.importing.limits import Limits

    for name, value in given.items():
        if value is not None and value < 1:
            raise InputError(f"--max-{name.replace('_', '-')} {value} can't be; give a number above 0")
    return Limits(**{name: value for name, value in given.items() if value is not None})


def _with(recipe: "Recipe", settings: dict[str, Any]) -> "Recipe":
    from dataclasses import replace

    return replace(recipe, **{key: value for key, value in settings.items() if value is not None})


def _import(
    request: Any,
    target: tuple[Path, str],
    stated: dict[str, float],
    save_recipe: Path | None,
    *,
    overwrite: bool,
    json: bool,
) -> None:
    """Import and write; print the assumptions."""
    from dataclasses import replace

    from sigmaswarm.cli.common import print_json, stdout
    from sigmaswarm.cli.findings import mending, print_diagnosis
    from sigmaswarm.cli.progress import percent_bar
    from sigmaswarm.doctor.diagnose import diagnose
    from sigmaswarm.drives.writer import require_replaceable, write_drive
    from sigmaswarm.importing.convert import import_drive

    out, name = target
    require_replaceable(out.resolve(), overwrite, "add --overwrite, or name another folder")
    with percent_bar("importing") as progress:
        imported = import_drive(request, name, progress)
    drive = replace(imported.drive, metadata={**imported.drive.metadata, **stated})
    imported = replace(imported, drive=drive)
    write_drive(drive, out, overwrite=overwrite)
    if save_recipe:
        imported.recipe.save(save_recipe)
    diagnosis = diagnose(imported.drive)
    if json:
        print_json(_summary(imported, out) | {"doctor": diagnosis.to_dict()})
    else:
        _tell(imported, out)
        print_diagnosis(diagnosis)
        ready = out
        if diagnosis.serious:
            command, mended = mending(diagnosis, out)
            ready = mended or out
            go_on = (
                f"go on with {mended}, not with {out}" if mended else "what it can't mend, mend in the log"
            )
            stdout().print(f"next: {command}    (then {go_on})")
        else:
            stdout().print(f"next: sigmaswarm plot {shlex.quote(str(out))}")
        stdout().print(f"then: sigmaswarm tune {shlex.quote(str(ready))} --out tuned")
        stdout().print("      (or keep this drive back, to evaluate on it what was tuned on others)")


def _summary(imported: "Imported", out: Path) -> dict[str, Any]:
    drive = imported.drive
    return {
        "drive": str(out),
        "duration_s": drive.duration,
        "imu_samples": len(drive.imu),
        "fixes": len(drive.gps),
        "truth_samples": len(drive.truth) if drive.truth else 0,
        "odometer_samples": len(drive.odometer) if drive.odometer else 0,
        "recipe": imported.recipe.to_toml(),
        "notes": list(imported.notes),
    }


def _tell(imported: "Imported", out: Path) -> None:
    from sigmaswarm.cli.common import stdout

    drive, console = imported.drive, stdout()
    truth = f", {len(drive.truth)} rows of truth" if drive.truth else ", no truth"
    wheels = f", {len(drive.odometer)} of the odometer" if drive.odometer else ""
    for read in imported.recipe.said():
        console.print(f"read: {shown(read, 1000)}")
    for note in imported.notes:
        console.print(f"note: {shown(note, 1000)}")
    if not imported.recipe.mount:
        console.print("note: the IMU's axes taken as x forward, y left, z up; say otherwise with --mount")
    rate = 1 / drive.nominal_interval
    console.print(
        f"wrote {out}: {drive.duration:.1f} s, {len(drive.imu)} IMU samples ({rate:.3g} Hz), "
        f"{len(drive.gps)} fixes{wheels}{truth}",
    )


def _show(request: Any, save_recipe: Path | None, json: bool) -> None:
    from sigmaswarm.cli.common import print_json
    from sigmaswarm.importing.look import look

    seen = look(request)
    if save_recipe:
        seen.recipe.save(save_recipe)
    if json:
        from dataclasses import asdict

        told = {"recipe": seen.recipe.to_toml(), "notes": seen.notes}
        asked = {"proposal": seen.proposal, "evidence": seen.evidence}
        print_json({"tables": [asdict(t) for t in seen.tables], **told, **asked})
    else:
        _print_look(seen)


def _print_look(seen: "Look") -> None:
    from sigmaswarm.cli.common import stdout

    console = stdout()
    for glance in seen.tables:
        rows = f", {glance.rows} rows" if glance.rows is not None else ""
        rate = f", {glance.rate:.4g} Hz" if glance.rate else ""
        title = f"{shown(glance.table)}: {shown(glance.kind)}{rows}{rate}"
        console.print(title, style="bold")
        told = [r for r in glance.ranges if r.low or r.high or r.low is None]
        width = max((len(shown(r.column)) for r in told), default=0)
        for r in told:
            cells = (
                f"{_short(r.low):>20} {_short(r.middle):>20} {_short(r.high):>20}" if r.example else "empty"
            )
            console.print(
                f"  {shown(r.column):{width}} {shown(r.example) if r.low is None and r.example else cells}",
                markup=False,
            )
        if left := len(glance.ranges) - len(told):
            console.print(f"  and {left} columns that are 0")
    console.print("(each column's lowest value, median and highest, over the first rows)")
    console.print(
        "\nWhat import would do by itself (save it with --save-recipe, change it with --map):", style="bold"
    )
    recipe = "\n".join(shown(line, 1000) for line in seen.recipe.to_toml().split("\n"))
    console.print(recipe or "nothing was recognized; say what is what with --map")
    for note in seen.notes:
        console.print(f"note: {shown(note, 1000)}")
    if seen.proposal:
        console.print("\nTo read the rest, add to the command:", style="bold")
        console.print(shown(seen.proposal, 4000), markup=False)
        times = (
            "; imu.t and gps.t are the times of their rows"
            if re.search(r"\b(imu|gps)\.t=", seen.proposal)
            else ""
        )
        console.print(f"({shown(seen.evidence, 1000)}{times}; nothing of it is done unless you ask for it)")
    if seen.unread:
        console.print("\nWhat neither reads:", style="bold")
        for table, columns in seen.unread.items():
            more = f" and {len(columns) - MOST_UNREAD} more" if len(columns) > MOST_UNREAD else ""
            console.print(
                f"{shown(table)}: {', '.join(map(shown, columns[:MOST_UNREAD]))}{more}", markup=False
            )


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.12g}" if abs(value) >= 1e6 else f"{value:.8g}"
