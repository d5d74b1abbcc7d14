"""Import of a log: open it, guess or read a recipe, gather, assemble, write."""

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from shlex import quote
from typing import Any

from sigmaswarm.drives.description import require_name
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.assemble import assemble
from sigmaswarm.importing.expressions import compile_expression
from sigmaswarm.importing.formats import open_log
from sigmaswarm.importing.gather import Columns, check_part, gather
from sigmaswarm.importing.guess import SAMPLE, time_of
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.mounting import AUTO, find_mount
from sigmaswarm.importing.recipe import COLUMNS, Recipe, mapped_roles, with_maps
from sigmaswarm.importing.source import FILES, ROLES, Choice, Guess, Part, Progress, Role, Source
from sigmaswarm.importing.times import wrong_unit
from sigmaswarm.wording import names_shown


@dataclass(frozen=True)
class Request:
    """The logs to import and the options of the user.

    Attributes
    ----------
    source : the log; it must hold the IMU
    gps, truth, odometer : further logs, for fixes, truth and the wheels' speed
    form : the source's format, if given
    recipe : settings, and parts that take the place of the guess
    maps : ``column=expression``
    time : expression of the time, in every table of the source
    choice : tables and times
    limits : how much is read
    part : which recording, from 1, where a clock starts anew within a table
    definitions : files or folders of ROS messages' definitions, .msg, for bags without them
    """

    source: Path
    gps: Path | None = None
    truth: Path | None = None
    odometer: Path | None = None
    form: str | None = None
    recipe: Recipe = field(default_factory=Recipe)
    maps: Sequence[str] = ()
    time: str | None = None
    choice: Choice = field(default_factory=Choice)
    limits: Limits = field(default_factory=Limits)
    part: int | None = None
    definitions: Sequence[Path] = ()


@dataclass(frozen=True)
class Imported:
    """A drive, its recipe, and the assumptions of the import."""

    drive: Drive
    recipe: Recipe
    notes: tuple[str, ...]


def import_drive(request: Request, name: str, progress: Progress = lambda done: None) -> Imported:
    """Make a drive of a log.

    Parameters
    ----------
    request : Request
    name : str
        Of the drive.
    progress : callable
        Called with the share that is done, 0 to 1.

    Raises
    ------
    InputError
        A log is damaged or incomplete, or a column cannot be computed; the message has the remedy.
    """
    require_name(name, "the drive")
    notes: list[str] = []
    with ExitStack() as stack:
        sources = open_logs(request, stack)
        guesses = {path: guess_of(source, request) for path, source in sources.items()}
        recipe = complete_recipe(request, guesses)
        for fault in faults_left(request, recipe, guesses):
            raise InputError(fault)
        _require_sensors(recipe, request, sources, guesses)
        for guess in guesses.values():
            notes += guess.said(mounted=bool(recipe.mount))
        gathered = _gather_all(request, sources, recipe, progress)
        for source in sources.values():
            notes += source.remarks
        metadata: dict[str, Any] = {}
        for guess in guesses.values():
            metadata |= guess.metadata
    progress(1.0)
    try:
        plain = replace(recipe, mount="") if recipe.mount == AUTO else recipe
        drive = assemble(name, gathered, plain, notes.append, request.part)
        if recipe.mount == AUTO:
            drive, mount, note = find_mount(drive)
            recipe = replace(recipe, mount=mount)
            notes.append(note)
    except InputError as error:
        raise InputError(f"{request.source.name}: {error}") from None
    source = os.fsencode(request.source.name).decode("utf-8", "replace")  # a name may be no UTF-8
    drive = replace(drive, metadata={**metadata, **drive.metadata, "source": source})
    return Imported(drive, recipe, tuple(dict.fromkeys(notes)))


def faults_left(request: Request, recipe: Recipe, guesses: Mapping[Path, Guess]) -> list[str]:
    """Return the reasons not to read columns as guessed, unless the user mapped or omitted them."""
    said = {entry.partition("=")[0].strip() for entry in request.maps}
    left: list[str] = []
    for path, guess in guesses.items():
        for fault in guess.faults:
            parts = recipe.roles.get(fault.role, ())
            used = home_of(fault.role, request) == path and fault.role not in request.recipe.roles
            mapped = {fault.column, f"{fault.role}.{fault.column}"} & said
            if used and parts and not mapped and not any(fault.column in part.columns for part in parts):
                where = path if path.name == fault.table else path / fault.table
                left.append(f"{where}, {fault.sentence}")
    return list(dict.fromkeys(left))


def _require_sensors(
    recipe: Recipe, request: Request, sources: Mapping[Path, Source], guesses: Mapping[Path, Guess]
) -> None:
    """Refuse logs in which no IMU or no fixes were found, before they are read."""
    wanted: tuple[tuple[Role, str, str], ...] = (
        ("imu", "IMU samples", "name the log that holds them as SOURCE"),
        ("gps", "position fixes", "name a log that holds them with --gps"),
    )
    for role, what, remedy in wanted:
        if not recipe.roles.get(role) and not (role == "gps" and recipe.gps_from_truth):
            path = home_of(role, request)
            there = names_shown(sources[path].tables)
            said = (*sources[path].remarks, *guesses[path].notes)
            if why := [s for s in said if "has no header" in s or "can't be decoded" in s]:
                there = there or "what can be decoded"
                raise InputError(f"{path}: no {what} found in {there}; {why[0]}; or {remedy}")
            raise InputError(
                f"{path}: no {what} found in {there}; {remedy}, or say what is what with --map (--show proposes it)"
            )


def home_of(role: Role, request: Request) -> Path:
    """The log that gives a role."""
    named: Mapping[Role, Path | None] = {
        "imu": None,
        "gps": request.gps,
        "truth": request.truth,
        "odometer": request.odometer,
    }
    return named[role] or request.source


def open_logs(request: Request, stack: ExitStack) -> dict[Path, Source]:
    """Open every log that the request names; the stack closes them."""
    paths = dict.fromkeys(home_of(role, request) for role in ROLES)
    return {
        path: stack.enter_context(
            open_log(
                path,
                request.form if path == request.source else None,
                request.limits,
                request.definitions,
            )
        )
        for path in paths
    }


def guess_of(source: Source, request: Request) -> Guess:
    """The reader's guess; a log that is named for a role and has one table holds it, whatever its name."""
    choice = replace(request.choice, mapped=mapped_roles(request.maps))
    for role, path in (("truth", request.truth), ("odometer", request.odometer)):
        if source.path == path and len(source.tables) == 1:
            choice = replace(choice, tables={**choice.tables, role: next(iter(source.tables))})
    return source.guess(choice)


def complete_recipe(request: Request, guesses: Mapping[Path, Guess]) -> Recipe:
    """The recipe with the parts that the user left to the guess, from the logs that were named for them."""
    roles: dict[Role, tuple[Part, ...]] = {}
    for role in ROLES:
        guessed = guesses[home_of(role, request)].roles
        parts = guessed.get(role, ())
        if not parts and role == "truth" and request.truth:
            parts = _as_truth(guessed.get("gps", ()))
        if not parts and role == "gps" and request.gps:
            parts = guessed.get("truth", ())
        parts = request.recipe.roles.get(role, parts)
        if parts:
            roles[role] = parts
    times: dict[Role, str] = {}
    for role in ROLES:
        if request.time and home_of(role, request) == request.source:
            times[role] = request.time
    whole = with_maps(Guess(roles), request.maps, times)
    if request.recipe.gps_from_truth:
        whole = replace(whole, roles={role: parts for role, parts in whole.roles.items() if role != "gps"})
    origins = [g.origin for g in guesses.values() if g.origin is not None]
    origin = request.recipe.origin or (origins[0] if origins else None)
    return replace(request.recipe, roles=whole.roles, origin=origin)


def _as_truth(parts: Sequence[Part]) -> tuple[Part, ...]:
    """A good receiver's fixes serve as truth: without their deviations."""
    return tuple(
        replace(p, columns={k: v for k, v in p.columns.items() if k in COLUMNS["truth"]}) for p in parts
    )


def _gather_all(
    request: Request, sources: Mapping[Path, Source], recipe: Recipe, progress: Progress
) -> dict[Role, list[Columns]]:
    """Each log is read once, for all the roles that it gives."""
    gathered: dict[Role, list[Columns]] = {}
    size = {path: _size(path) for path in sources}
    total, before = sum(size.values()), 0
    for path, source in sources.items():
        mine: list[tuple[Role, Part]] = []
        for role in ROLES:
            if home_of(role, request) == path:
                for part in recipe.roles.get(role, ()):
                    mine.append((role, _with_time(with_only_table(part, source, role), source, role)))
        for role, part in mine:
            check_part(part, source, role)
        share = _share(progress, before / total, size[path] / total)
        for (role, _), columns in zip(
            mine, gather(source, [p for _, p in mine], share, request.limits), strict=True
        ):
            gathered.setdefault(role, []).append(columns)
        before += size[path]
    return gathered


def with_only_table(part: Part, source: Source, role: Role) -> Part:
    """A part that names no table takes the only one; and so does one that names a file, of another day's log."""
    only = next(iter(source.tables.values())) if len(source.tables) == 1 else None
    if part.table in source.tables or (part.table and (only is None or only.kind != FILES)):
        return part
    if only is None:
        fitting = [name for name, table in source.tables.items() if _holds(table.columns, part)]
        chosen = quote(fitting[0]) if len(fitting) == 1 else "TABLE"
        raise InputError(
            f"{source.path}: none of its tables {names_shown(source.tables)} was chosen for {', '.join(part.columns)}; "
            f"add --{role}-topic {chosen}, or write a recipe with table = ..."
        )
    return replace(part, table=next(iter(source.tables)))


def _holds(columns: Collection[str], part: Part) -> bool:
    """Return True if a table has all columns that a part's expressions name."""
    try:
        for text in part.columns.values():
            compile_expression(text, columns)
    except InputError:
        return False
    return True


def _with_time(part: Part, source: Source, role: Role) -> Part:
    """A part that names no time takes the column that looks like it; a time in another unit is refused."""
    if part.table not in source.tables:
        return part  # which is told with the part's other mistakes
    names = source.tables[part.table].columns
    rows = next((batch.rows for batch in source.batches({part.table: names}) if len(batch.rows)), None)
    if rows is None:
        return part
    rows = rows.head(SAMPLE)
    if "t" not in part.columns and (time := time_of(rows)) is not None:
        return replace(part, columns={"t": time, **part.columns})
    if unit := wrong_unit(part.columns.get("t", ""), rows, role):
        raise InputError(f"{source.path}: {unit}")
    return part


def _share(progress: Progress, begin: float, part: float) -> Callable[[float], None]:
    return lambda done: progress(begin + part * done)


def _size(path: Path) -> int:
    files = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]
    return max(sum(f.stat().st_size for f in files), 1)
