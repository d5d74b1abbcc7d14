"""Import of a log: open the log, guess or read a recipe, gather the columns, assemble the drive."""

import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from sigmaswarm.drives.description import require_name
from sigmaswarm.drives.drive import Drive, Imu
from sigmaswarm.errors import InputError
from sigmaswarm.importing.assemble import assemble, assemble_imu
from sigmaswarm.importing.clocks import rate_by_duration, wrong_tick
from sigmaswarm.importing.completion import (
    assumed_mounting,
    completed,
    guessed_counter,
    notes_of,
    with_tables,
)
from sigmaswarm.importing.expressions import ROW
from sigmaswarm.importing.faults import faults_left, missing_sensor, with_rate_of_rows
from sigmaswarm.importing.gather import Gathered, durations, gather_all, joined_faults
from sigmaswarm.importing.imu_units import (
    impossible_rates,
    require_gravity_in_force,
    unit_of_rates,
    wrong_scale,
)
from sigmaswarm.importing.magnetometer import with_magnetometer
from sigmaswarm.importing.mounting import AUTO, find_mount
from sigmaswarm.importing.opening import Plan, Request, opened
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.row_times import gaps_by_clock, gaps_by_distance
from sigmaswarm.importing.source import ROLES, ImportProgress, Role
from sigmaswarm.wording import printable

SHOW_HINT = " (--show lists the columns, and proposes a mapping if their names or values suggest one)"


@dataclass(frozen=True)
class ImportResult:
    drive: Drive
    recipe: Recipe
    notes: tuple[str, ...]
    assumed: tuple[str, ...] = ()  # notes on an assumed mounting


def import_drive(
    request: Request, name: str, progress: ImportProgress = lambda done: None, *, raw: bool = False
) -> ImportResult:
    """Make a drive from a log.

    ``progress`` receives the completed fraction, 0 to 1. ``raw`` permits IMU values in raw counts. Raises `InputError`
    for a damaged or incomplete log, or a column that cannot be computed.
    """
    require_name(name, "the drive")
    plan, gathered, notes = _read(request, ROLES, progress)
    progress(1.0)
    with _errors_of(request):
        drive, recipe = _drive(name, plan, gathered, notes, raw=raw)
    source = os.fsencode(request.log).decode("utf-8", "replace")  # a name may not be valid UTF-8
    stated = {key: value for guess in plan.guesses.values() for key, value in guess.metadata.items()}
    drive = replace(drive, metadata={**stated, **drive.metadata, "source": source})
    return ImportResult(drive, recipe, tuple(dict.fromkeys(notes)), assumed_mounting(plan))


def import_imu(request: Request) -> tuple[Imu, tuple[str, ...]]:
    """Read the IMU of a log, with or without fixes. Return the IMU and the assumptions of the import."""
    plan, gathered, notes = _read(request, ("imu",), lambda done: None)
    with _errors_of(request):
        imu = assemble_imu(gathered["imu"], plan.recipe, notes.append, request.part)
    return imu, tuple(dict.fromkeys(notes))


@contextmanager
def _errors_of(request: Request) -> Generator[None]:
    """Add the name of the log to errors."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{request.log}: {error}") from None


def _read(
    request: Request, roles: Sequence[Role], progress: ImportProgress
) -> tuple[Plan, Gathered, list[str]]:
    """Return the plan (with its logs closed and removed), the columns of the roles, and notes."""
    with opened(request) as plan:
        plan = completed(plan)
        plan = plan.with_roles({role: parts for role, parts in plan.recipe.roles.items() if role in roles})
        if faults := faults_left(plan):
            raise InputError(joined_faults(faults))
        if fault := missing_sensor(plan, roles):
            raise InputError(f"{fault}{SHOW_HINT}")
        whole, faults = with_tables(plan)
        if faults:
            raise InputError(joined_faults(with_rate_of_rows(faults, plan)))
        gathered = gather_all(whole, progress)
        notes = [*notes_of(plan), *gaps_by_clock(gathered), *_unused_truth(plan, roles)]
        return replace(plan, logs={}), gathered, notes


def _unused_truth(plan: Plan, roles: Sequence[Role]) -> list[str]:
    if "truth" not in roles or "truth" in plan.recipe.roles:
        return []
    used = {part.table for parts in plan.recipe.roles.values() for part in parts}
    what = "is not used as truth, since no columns are recognized as positions; specify them with --map"
    named = (table for table in plan.log("imu").tables if "truth" in table.lower())
    return [f"{printable(table)} {what}" for table in named if table not in used]


def _drive(name: str, plan: Plan, gathered: Gathered, notes: list[str], *, raw: bool) -> tuple[Drive, Recipe]:
    """Assemble and check the drive. Return it with the recipe and an estimated mounting, and extend ``notes``."""
    recipe, recording = plan.recipe, plan.request.part
    plain = replace(recipe, mount="") if recipe.mount == AUTO else recipe
    field = gathered.pop("mag", ())
    time, counter = plan.imu_time, guessed_counter(plan)
    other_rate = rate_by_duration(counter, time, durations(gathered) if counter.alone else {})
    try:
        drive = assemble(name, gathered, plain, notes.append, recording)
    except InputError as error:
        remedy = other_rate.remedy if "overlap" in str(error) else ""
        raise InputError("; ".join(filter(None, (str(error), remedy)))) from None
    if any(ROW in part.expressions["t"].columns for part in gathered.get("gps", ())):
        notes += filter(None, [gaps_by_distance(drive)])
    if fault := wrong_tick(drive, counter, time, other_rate):
        raise InputError(fault)
    notes += _notes_on_units(drive, plan, raw=raw)
    if recipe.mount == AUTO:
        drive, mount, note = find_mount(drive)
        recipe = replace(recipe, mount=mount)
        notes.append(note)
    if field:
        drive = with_magnetometer(drive, field, recipe, notes.append, recording)
    elif recipe.declination_deg is not None:
        raise InputError("--declination needs a magnetometer; choose its topic or table with --mag-topic")
    return drive, recipe


def _notes_on_units(drive: Drive, plan: Plan, *, raw: bool) -> list[str]:
    """Refuse an IMU in wrong units. Return a note if the unit of its rates is assumed."""
    require_gravity_in_force(drive.imu)
    roles, mapped = plan.recipe.roles, [entry.partition("=")[0].strip() for entry in plan.request.maps]
    unitless = {n: t for n, t in plan.guess("imu").unitless.items() if not {n, f"imu.{n}"} & {*mapped}}
    impossible = {} if raw else impossible_rates(drive.imu, roles["imu"])
    unit = unit_of_rates(drive, roles, unitless | impossible)
    scales = [] if raw else wrong_scale(drive.imu, roles["imu"], {} if unit.fault else impossible)
    if faults := list(filter(None, (*scales, unit.fault))):
        raise InputError("; and ".join(faults))
    return [unit.note] if unit.note else []
