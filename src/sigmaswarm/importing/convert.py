"""Import of a log: open the log, guess or read a recipe, gather the columns, assemble the drive."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import quote
from typing import Any

import polars as pl

from sigmaswarm.drives.description import require_name
from sigmaswarm.drives.drive import Drive, Imu
from sigmaswarm.errors import InputError
from sigmaswarm.importing.assemble import REQUIRED, assemble, assemble_imu
from sigmaswarm.importing.formats import unsupported_format
from sigmaswarm.importing.gather import IF_RATE_IS_KNOWN, ROW, PartColumns, complete_parts, gather
from sigmaswarm.importing.gravity import impossible_rates, require_gravity_in_force, wrong_scale
from sigmaswarm.importing.guess import FORCES, PLACES, RATES
from sigmaswarm.importing.long_tables import describe_kinds
from sigmaswarm.importing.magnetometer import with_magnetometer
from sigmaswarm.importing.mounting import AUTO, find_mount
from sigmaswarm.importing.names import read_names
from sigmaswarm.importing.opening import Guesses, Request, opened
from sigmaswarm.importing.rates import unit_of_rates
from sigmaswarm.importing.recipe import COLUMNS, Recipe, mapped_columns, with_maps
from sigmaswarm.importing.row_times import gaps_by_clock, gaps_by_distance
from sigmaswarm.importing.source import (
    ROLES,
    ImportProgress,
    Log,
    Part,
    Role,
    TickRate,
)
from sigmaswarm.importing.tick_evidence import rate_by_duration, rate_by_motion, shown_rate, wrong_tick
from sigmaswarm.importing.ticks import Counter, describe_rate, time_of_ticks
from sigmaswarm.importing.time_units import UNKNOWN_TICK
from sigmaswarm.importing.times import of_one_table
from sigmaswarm.importing.unnamed import header_by_values
from sigmaswarm.wording import list_names, printable


@dataclass(frozen=True)
class ImportResult:
    drive: Drive
    recipe: Recipe
    notes: tuple[str, ...]
    assumed: tuple[str, ...] = ()  # notes on an assumed mounting


SHOW_HINT = " (--show lists the columns, and proposes a mapping if their names or values suggest one)"
# Columns of the IMU, with the meaning of the required ones
IMU = dict.fromkeys(("az", "gx", "gy"), "") | {
    "ax": "ax (the forward acceleration)",
    "ay": "ay (the acceleration to the left)",
    "gz": "gz (the yaw rate)",
}
# Suffixes of receiver logs in a folder of tables; such a log is read only with --gps
RECEIVER_LOGS = (".llh", ".pos", ".nmea", ".ubx")
MAX_FAULTS = 3  # largest number of faults in one message
# Trial rates, Hz, of a counter of unknown rate. The first rate with which the import succeeds is then corrected by
# comparing the motion of IMU and fixes.
TRIAL_RATES = (1e4, 1e5, 1e6, 1e7, 1e8, 1e3)
TRIAL_ROWS = 25.0  # Hz, trial rate of the rows of a table without a time


def import_drive(
    request: Request, name: str, progress: ImportProgress = lambda done: None, *, raw: bool = False
) -> ImportResult:
    """Make a drive from a log.

    ``progress`` receives the completed fraction, 0 to 1; ``raw`` permits IMU values in raw counts. Raise `InputError`
    for a damaged or incomplete log, or a column that cannot be computed.
    """
    require_name(name, "the drive")
    recipe, gathered, notes, assumed, metadata, unitless, counter = _read(request, ROLES, progress)
    progress(1.0)
    try:
        plain = replace(recipe, mount="") if recipe.mount == AUTO else recipe
        field = gathered.pop("mag", ())
        other_rate = rate_by_duration(counter, gathered, recipe)
        try:
            drive = assemble(name, gathered, plain, notes.append, request.part)
        except InputError as error:
            remedy = other_rate.remedy if "overlap" in str(error) else ""
            raise InputError("; ".join(filter(None, (str(error), remedy)))) from None
        if any(ROW in part.expressions["t"].columns for part in gathered.get("gps", ())):
            notes += filter(None, [gaps_by_distance(drive)])
        parts = recipe.roles["imu"]
        if fault := wrong_tick(drive, counter, recipe, other_rate):
            raise InputError(fault)
        require_gravity_in_force(drive.imu)
        impossible = {} if raw else impossible_rates(drive.imu, parts)
        unit = unit_of_rates(drive, recipe.roles, unitless | impossible)
        scales = [] if raw else wrong_scale(drive.imu, parts, {} if unit.fault else impossible)
        if faults := list(filter(None, (*scales, unit.fault))):
            raise InputError("; and ".join(faults))
        notes += [unit.note] if unit.note else []
        if recipe.mount == AUTO:
            drive, mount, note = find_mount(drive)
            recipe = replace(recipe, mount=mount)
            notes.append(note)
        if field:
            drive = with_magnetometer(drive, field, recipe, notes.append, request.part)
        elif recipe.declination_deg is not None:
            raise InputError("--declination needs a magnetometer; choose its topic or table with --mag-topic")
    except InputError as error:
        raise InputError(f"{request.log}: {error}") from None
    source = os.fsencode(request.log).decode("utf-8", "replace")  # a name may not be valid UTF-8
    drive = replace(drive, metadata={**metadata, **drive.metadata, "source": source})
    return ImportResult(drive, recipe, tuple(dict.fromkeys(notes)), assumed)


def import_imu(request: Request) -> tuple[Imu, tuple[str, ...]]:
    """Read the IMU of a log, with or without fixes; return the IMU and the assumptions of the import."""
    recipe, gathered, notes, *_ = _read(request, ("imu",), lambda done: None)
    try:
        imu = assemble_imu(gathered["imu"], recipe, notes.append, request.part)
    except InputError as error:
        raise InputError(f"{request.log}: {error}") from None
    return imu, tuple(dict.fromkeys(notes))


def _read(
    request: Request, roles: Sequence[Role], progress: ImportProgress
) -> tuple[
    Recipe, dict[Role, list[PartColumns]], list[str], tuple[str, ...], dict[str, Any], dict[str, str], Counter
]:
    """Return recipe, columns, notes, assumptions on the mounting, metadata of the logs, and columns without a unit.

    The last element is the result of `guessed_counter`.
    """
    with opened(request) as (logs, guesses):
        recipe = complete_recipe(request, guesses)
        wanted = {role: parts for role, parts in recipe.roles.items() if role in roles}
        recipe = replace(recipe, roles=wanted)
        unitless = guesses[request.source].unitless
        if faults := faults_left(request, recipe, logs, guesses):
            raise InputError("; and ".join(faults[:MAX_FAULTS]))
        if fault := missing_sensor(recipe, request, logs, guesses, roles):
            raise InputError(f"{fault}{SHOW_HINT}")
        gathered = _gather_all(request, logs, recipe, progress)
        metadata = {key: value for guess in guesses.values() for key, value in guess.metadata.items()}
        notes, assumed = notes_of(request, logs, guesses, recipe), assumed_mounting(guesses, recipe)
        notes += gaps_by_clock(gathered)
        if "truth" in roles and "truth" not in recipe.roles:
            named = [t for t in logs[request.source].tables if "truth" in t.lower()]
            used = {part.table for parts in recipe.roles.values() for part in parts}
            what = "is not used as truth, since no columns are recognized as positions; name them with --map"
            notes += [f"{printable(table)} {what}" for table in named if table not in used]
        mapped = {entry.partition("=")[0].strip().removeprefix("imu.") for entry in request.maps}
        guessed = {name: text for name, text in unitless.items() if name not in mapped}
        return recipe, gathered, notes, assumed, metadata, guessed, guessed_counter(request, guesses)


def complete_recipe(request: Request, guesses: Guesses) -> Recipe:
    roles: dict[Role, tuple[Part, ...]] = {}
    for role in ROLES:
        guessed = guesses[request.home(role)].roles
        parts = guessed.get(role, ())
        if not parts and role == "truth" and request.truth:
            # the truth may be the fixes of an accurate receiver; their standard deviations are left out
            for part in guessed.get("gps", ()):
                columns = {k: v for k, v in part.columns.items() if k in COLUMNS["truth"]}
                parts = (*parts, Part(part.table, columns))
        if not parts and role == "gps" and request.gps:
            for part in guessed.get("truth", ()):
                columns = {k: v for k, v in part.columns.items() if k in COLUMNS["gps"]}
                parts = (*parts, Part(part.table, columns))
        roles[role] = request.recipe.roles.get(role, parts)
    mine: list[Role] = [role for role in ROLES if request.time and request.home(role) == request.source]
    times = dict.fromkeys(mine, request.time or "")
    roles = with_maps({role: parts for role, parts in roles.items() if parts}, request.maps, times)
    roles = _with_tick_rates(request, roles, guesses)
    if request.recipe.gps_from_truth:
        roles.pop("gps", None)
    origins = [request.recipe.origin, *(g.origin for g in guesses.values())]
    recipe = replace(request.recipe, roles=roles, origin=next((o for o in origins if o is not None), None))
    if (placed := guesses[request.source].placed) is None:
        return recipe
    lever = recipe.gps_lever_arm_m or (None if request.gps else placed.lever_arm)
    return replace(recipe, mount=recipe.mount or placed.mount, gps_lever_arm_m=lever)


def _stated(request: Request, role: Role, column: str) -> bool:
    """Return True if the user specified a column."""
    mapped = mapped_columns(request.maps)
    timed = column == "t" and request.time is not None and request.home(role) == request.source
    return (role, column) in mapped or timed or role in request.recipe.roles


def _with_tick_rates(
    request: Request, roles: Mapping[Role, tuple[Part, ...]], guesses: Guesses
) -> dict[Role, tuple[Part, ...]]:
    """Use the counter rates that a known clock shows, also for other tables with the IMU's counter."""
    rates = _tick_rates(guesses)
    counter = guesses[request.source].ticks.get("imu", "")
    changed = dict(roles)
    for role, parts in roles.items():
        own = guesses[request.home(role)].ticks.get(role, "")
        shared = counter in rates and parts[0].table == rates[counter].table
        text = own if own in rates else counter if shared else ""
        if text and not _stated(request, role, "t"):
            time = {"t": time_of_ticks(text, rates[text].rate)}
            changed[role] = tuple(replace(part, columns={**part.columns, **time}) for part in parts)
    return changed


def _tick_rates(guesses: Guesses) -> dict[str, TickRate]:
    return {text: rate for guess in guesses.values() for text, rate in guess.rates.items()}


def guessed_counter(request: Request, guesses: Guesses) -> Counter:
    both: tuple[Role, ...] = ("imu", "gps")
    own, other = (guesses[request.home(role)].ticks.get(role, "") for role in both)
    stated = [_stated(request, role, "t") for role in both]
    if not own or own in _tick_rates(guesses) or stated[0] or (own == other and stated[1]):
        return Counter()
    return Counter(own, own == other)


def faults_left(request: Request, recipe: Recipe, logs: Mapping[Path, Log], guesses: Guesses) -> list[str]:
    """Return the faults of guessed columns, except for columns that the user has mapped or omitted.

    If the unit of angular rates is unknown, the remedy in the message names the unit that agrees with the course of the
    fixes.
    """
    stated = {entry.partition("=")[0].strip() for entry in request.maps}
    left: list[str] = []
    for path, guess in guesses.items():
        for fault in guess.faults:
            parts = recipe.roles.get(fault.role, ())
            used = request.home(fault.role) == path and fault.role not in request.recipe.roles
            mapped = {fault.column, f"{fault.role}.{fault.column}"} & stated
            if used and parts and not mapped and not any(fault.column in part.columns for part in parts):
                where = path if path.name == fault.table else path / fault.table
                several = len(logs[path].tables) > 1
                sentence = of_one_table(fault.sentence, fault.role) if several else fault.sentence
                left.append(f"{where}, {sentence}")
    left = _with_rate_of_ticks(list(dict.fromkeys(left)), request, logs, recipe, guesses)
    return _with_unit_of_rates(left, request, logs, recipe, guesses[request.source].unitless)


def _with_rate_of_ticks(
    faults: list[str], request: Request, logs: Mapping[Path, Log], recipe: Recipe, guesses: Guesses
) -> list[str]:
    """In faults of a counter of unknown unit, replace the remedy by the rate that motion or duration indicates.

    The unit of a counter that IMU and fixes share is also unknown if the guesses for both differ.
    """
    counter = guessed_counter(request, guesses)
    unknown = [fault for fault in faults if UNKNOWN_TICK in fault]
    times = {part.columns.get("t") for role in ("imu", "gps") for part in recipe.roles.get(role, ())[:1]}
    differ = counter.shared and len(times) > 1
    if not counter.text or "gps" not in recipe.roles or not (unknown or differ):
        return faults
    remedy = _trial(counter, request, logs, recipe)
    if remedy and not unknown:
        return [*faults, f"{counter.text}: the unit of the times is unknown; {remedy}"]
    shown = {fault: f"{fault.partition('; specify')[0]}; {remedy}" for fault in unknown if remedy}
    return [shown.get(fault, fault) for fault in faults]


def _trial(
    counter: Counter,
    request: Request,
    logs: Mapping[Path, Log],
    recipe: Recipe,
    rates: Sequence[float] = TRIAL_RATES,
) -> str:
    """Import with the first trial rate that works; return the remedy computed from the resulting drive, or ""."""
    for trial in rates:
        maps = [f"{r}.t={time_of_ticks(counter.text, trial)}" for r in ("imu", "gps")[: 1 + counter.shared]]
        plain = replace(recipe, roles=with_maps(recipe.roles, maps, {}), mount="")
        try:
            gathered = _gather_all(request, logs, plain, lambda done: None)
            gathered.pop("mag", None)
            if not counter.shared:
                return rate_by_duration(counter, gathered, plain).remedy
            drive = assemble("log", gathered, plain, lambda note: None, request.part)
        except InputError:
            continue
        factor = rate_by_motion(drive)
        return "" if factor is None else shown_rate(counter.text, trial / factor)
    return ""


def _with_unit_of_rates(
    faults: list[str], request: Request, logs: Mapping[Path, Log], recipe: Recipe, unitless: Mapping[str, str]
) -> list[str]:
    """For angular rates without a unit, let the remedy state the unit that agrees with the course of the fixes."""
    if "gps" not in recipe.roles or not any('"imu.g' in fault for fault in faults):
        return faults
    known = {name for part in recipe.roles["imu"] for name in part.columns}
    maps = [f"imu.{name}={text}" for name, text in unitless.items() if name not in known]
    plain = replace(recipe, roles=with_maps(recipe.roles, maps, {}), mount="")
    try:
        gathered = _gather_all(request, logs, plain, lambda done: None)
        gathered.pop("mag", None)
        drive = assemble("log", gathered, plain, lambda note: None, request.part)
        message = unit_of_rates(drive, plain.roles, unitless).fault
    except InputError:  # other faults prevent the comparison
        return faults
    rates = [fault for fault in faults if '"imu.g' in fault] if message else []
    shown = {fault: f"{fault.partition('; specify')[0]}; {message}" for fault in rates[:1]}
    return [shown.get(fault, fault) for fault in faults if fault not in rates[1:]]


def notes_of(request: Request, logs: Mapping[Path, Log], guesses: Guesses, recipe: Recipe) -> list[str]:
    made, found = recipe.mount, guesses.values()
    notes: list[str] = []
    used = {(r, n): text for r, parts in recipe.roles.items() for p in parts for n, text in p.columns.items()}

    def read(role: Role, column: str, text: str) -> bool:
        return used.get((role, column), "") == text and not _stated(request, role, column)

    for guess in guesses.values():
        notes += guess.notes_on(read)
    rates = {time_of_ticks(text, rate.rate): (text, rate) for text, rate in _tick_rates(guesses).items()}
    times = {parts[0].columns.get("t", ""): None for parts in recipe.roles.values()}
    notes += [describe_rate(*rates[time]) for time in times if time in rates]
    notes += [n for guess in found if guess.placed for n in guess.placed.notes(made, recipe.gps_lever_arm_m)]
    return notes + [remark for log in logs.values() for remark in log.remarks]


def assumed_mounting(guesses: Guesses, recipe: Recipe) -> tuple[str, ...]:
    """Return the readers' sentences on an assumed mounting; empty if the recipe contains a mounting."""
    found = () if recipe.mount else guesses.values()
    return tuple(dict.fromkeys(note for guess in found for note in (guess.flat, guess.downward) if note))


def missing_sensor(
    recipe: Recipe, request: Request, logs: Mapping[Path, Log], guesses: Guesses, roles: Sequence[Role]
) -> str:
    """Describe a missing sensor, with the remedy; return "" if IMU and fixes have tables."""
    wanted: tuple[tuple[Role, str, str], ...] = (
        ("imu", "IMU samples", "name a log with IMU samples as SOURCE"),
        ("gps", "position fixes", "add a log with fixes: --gps LOG"),
    )
    for role, what, remedy in wanted:
        if role not in roles or recipe.roles.get(role) or (role == "gps" and recipe.gps_from_truth):
            continue
        path = request.home(role)
        there, siblings = list_names(logs[path].tables), _siblings(path, role)
        if siblings:
            remedy = f"name the folder {quote(str(path.parent))} as SOURCE, which also contains {list_names(siblings)}"
        if example := _headers(logs[path]) or (role == "imu" and describe_kinds(logs[path])):
            remedy = f"{example}; or {remedy}"
        texts = (*logs[path].remarks, *guesses[path].notes)
        reasons = "has no header", "can't be decoded", "is empty", "cells contain"
        if why := [s for s in texts if any(reason in s for reason in reasons)]:
            there = there or "the part that can be decoded"
            return f"{path}: no {what} found in {there}; {why[0]}; or {remedy}"
        columns = [name.meaning for table in logs[path].tables.values() for name in read_names(table.columns)]
        lacking = [IMU[n] for n in REQUIRED["imu"] if n not in columns]
        if role == "imu" and lacking and {*columns} & {*IMU}:
            there = f"the IMU has no column for {list_names(lacking)}"
            return f"{path}: {there}; {remedy}, or name the columns with --map"
        there += _lacking_table(logs[path]) if role == "imu" else ""
        around = sorted(path.iterdir()) if role == "gps" and path.is_dir() else ()
        if receiver_log := next((f for f in around if f.suffix.lower() in RECEIVER_LOGS), None):
            remedy = f"add the log with the fixes: --gps {quote(str(receiver_log))}"
        more = next(
            (
                f"; {f.name} is not read, since it is {kind}"
                for f in around
                if (kind := unsupported_format(f))
            ),
            "",
        )
        return (
            f"{path}: no {what} found in {there or 'the log'}{more}; {remedy}, or name the columns with --map"
        )
    return ""


def _siblings(path: Path, role: Role) -> list[str]:
    """List the other CSV files in the folder of a CSV file, if their names contain the name of a sensor."""
    if not path.is_file() or path.suffix.lower() != ".csv":
        return []
    names = sorted(
        f.name for f in path.parent.iterdir() if f.suffix.lower() == ".csv" and f.name != path.name
    )
    sensors = (FORCES, RATES, PLACES) if role == "imu" else (PLACES,)
    return [name for name in names if any(sensor.search(name) for sensor in sensors)]


def _lacking_table(log: Log) -> str:
    """Name the missing sensor if the log has a table of either the accelerometer or the gyroscope, but not of both."""
    names = [
        name for name, table in log.tables.items() if {"x", "y", "z"} <= {c.lower() for c in table.columns}
    ]
    forces, rates = (any(sensor.search(name) for name in names) for sensor in (FORCES, RATES))
    lacking = "an accelerometer" if rates else "a gyroscope"
    return f", since there is no table of {lacking}" if forces != rates else ""


def _headers(log: Log) -> str:
    """Return a command that copies the tables of a folder and adds missing headers; "" if no IMU would result."""
    if not log.path.is_dir():
        return ""
    first = (
        next(iter(log.batches({name: t.columns})), ("", pl.DataFrame(), 0.0))
        for name, t in log.tables.items()
    )
    headers = {name: header for name, rows, _ in first if (header := header_by_values(rows))}
    headers = {name: header for name, header in headers.items() if log.tables[name].columns[0] == "c1"}
    if not {"ax", "gz"} <= {*",".join(headers.values()).split(",")}:
        return ""
    new = {name: quote(f"named/{name}") for name in log.tables}
    folders = dict.fromkeys(quote(str(Path("named", name).parent)) for name in log.tables)
    lines = [f"(echo {quote(text)}; cat {quote(name)}) > {new[name]}" for name, text in headers.items()]
    left = [name for name, table in log.tables.items() if name not in headers and table.columns[0] == "c1"]
    lines += [f"cp {quote(name)} {new[name]}" for name in log.tables if name not in (*headers, *left)]
    command = " && ".join([f"cd {quote(str(log.path))}", f"mkdir -p {' '.join(folders)}", *lines])
    there = quote(str(log.path / "named"))
    more = f"; copy {list_names(left)} to {there} with a header, such as t,lat,lon, since the values suggest none"
    return (
        f"write headers as the values suggest: ({command}){more * bool(left)}, and import the folder {there}"
    )


def complete_all(
    request: Request,
    logs: Mapping[Path, Log],
    recipe: Recipe,
    first: Mapping[Path, Mapping[str, pl.DataFrame]] | None = None,
) -> tuple[dict[Path, list[tuple[Role, Part]]], list[str]]:
    """Complete the parts of each log with `complete_parts`; return the parts and the first fault of each table.

    ``first``: first rows of the tables of each log, if they have been read.
    """
    completed = {path: list[tuple[Role, Part]]() for path in logs}
    faults: dict[tuple[Path, str], str] = {}
    for path, log in logs.items():
        rows = None if first is None else first[path]
        for role, part in _parts(request, recipe, path):
            try:
                for whole in complete_parts(part, log, role, rows):
                    completed[path].append((role, whole))
            except InputError as error:
                faults.setdefault((path, part.table), str(error))
    return completed, _with_rate_of_rows([*faults.values()], request, logs, recipe)


def _with_rate_of_rows(
    faults: list[str], request: Request, logs: Mapping[Path, Log], recipe: Recipe
) -> list[str]:
    """For IMU and fixes in one table without a time, let the remedy state the rate of rows that the motion shows."""
    parts = [recipe.roles.get(role, (Part("", {}),))[0] for role in ("imu", "gps")]
    timeless = [fault for fault in faults if f"; {IF_RATE_IS_KNOWN}" in fault]
    shared = parts[0].table == parts[1].table and request.home("imu") == request.home("gps")
    if not timeless or not shared or any("t" in part.columns or not part.columns for part in parts):
        return faults
    remedy = _trial(Counter(ROW, True), request, logs, recipe, (TRIAL_ROWS,))
    shown = {
        fault: f"{fault.partition(f'; {IF_RATE_IS_KNOWN}')[0]}; {remedy}" for fault in timeless if remedy
    }
    return [shown.get(fault, fault) for fault in faults]


def _parts(request: Request, recipe: Recipe, path: Path) -> list[tuple[Role, Part]]:
    """Return the parts that are read from the log ``path``, with their roles."""
    return [
        (role, part) for role in ROLES if request.home(role) == path for part in recipe.roles.get(role, ())
    ]


def _gather_all(
    request: Request, logs: Mapping[Path, Log], recipe: Recipe, progress: ImportProgress
) -> dict[Role, list[PartColumns]]:
    gathered: dict[Role, list[PartColumns]] = {}
    completed, faults = complete_all(request, logs, recipe)
    if faults:
        raise InputError("; and ".join(faults[:MAX_FAULTS]))
    sizes = {path: _size(path) for path in logs}
    total, before = sum(sizes.values()), 0
    for path, log in logs.items():
        mine = completed[path]
        share = _share(progress, before / total, sizes[path] / total)
        read = gather(log, [part for _, part in mine], share, request.limits)
        for (role, _), columns in zip(mine, read, strict=True):
            gathered.setdefault(role, []).append(columns)
        before += sizes[path]
    return gathered


def _share(progress: ImportProgress, begin: float, part: float) -> Callable[[float], None]:
    return lambda done: progress(begin + part * done)


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]
    return max(sum(f.stat().st_size for f in files), 1)
