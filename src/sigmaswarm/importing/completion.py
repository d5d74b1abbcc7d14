"""Complete the recipe of an import from the guesses about its logs, and find the table and the time of each part."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from shlex import quote

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.clocks import Counter, describe_rate, time_of_ticks
from sigmaswarm.importing.expressions import ROW, compile_expression, is_valid_expression
from sigmaswarm.importing.opening import Plan
from sigmaswarm.importing.recipe import COLUMNS, with_maps
from sigmaswarm.importing.source import FILES, ROLES, SAMPLE_ROWS, Log, Part, Role, TickRate, texts_of
from sigmaswarm.importing.time_units import wrong_unit
from sigmaswarm.importing.times import of_one_table, rising_time, time_of
from sigmaswarm.wording import list_names, printable, quoted

# The truth may be the fixes of an accurate receiver, and fixes may be in a log that a reader takes for truth
_SAME_SENSOR: dict[Role, Role] = {"truth": "gps", "gps": "truth"}
IF_RATE_IS_KNOWN = "if the rate is known"  # begins a remedy
Beginnings = Mapping[Path, Mapping[str, pl.DataFrame]]  # first rows of the tables of each log


def completed(plan: Plan) -> Plan:
    """Return the plan with the parts of the request.

    A role that is not in the request has the guessed parts, changed by the mappings.
    """
    request, own = plan.request, plan.request.recipe
    roles: dict[Role, tuple[Part, ...]] = {}
    for role in ROLES:
        guessed = plan.guess(role).roles
        parts = guessed.get(role, ())
        if not parts and role in _SAME_SENSOR and getattr(request, role):
            for part in guessed.get(_SAME_SENSOR[role], ()):
                columns = {name: text for name, text in part.columns.items() if name in COLUMNS[role]}
                parts = (*parts, Part(part.table, columns))
        roles[role] = own.roles.get(role, parts)
    mine: list[Role] = [role for role in ROLES if request.time and request.home(role) == request.source]
    times = dict.fromkeys(mine, request.time or "")
    roles = with_maps({role: parts for role, parts in roles.items() if parts}, request.maps, times)
    roles = _with_tick_rates(plan, roles)
    if own.gps_from_truth:
        roles.pop("gps", None)
    origins = [own.origin, *(guess.origin for guess in plan.guesses.values())]
    recipe = replace(own, roles=roles, origin=next((o for o in origins if o is not None), None))
    if (placed := plan.guess("imu").placed) is not None:
        lever = recipe.gps_lever_arm_m or (None if request.gps else placed.lever_arm)
        recipe = replace(recipe, mount=recipe.mount or placed.mount, gps_lever_arm_m=lever)
    return replace(plan, recipe=recipe)


def _with_tick_rates(plan: Plan, roles: Mapping[Role, tuple[Part, ...]]) -> dict[Role, tuple[Part, ...]]:
    """Use the counter rates that a known clock shows, also for other tables with the IMU's counter."""
    rates, counter = _tick_rates(plan), plan.guess("imu").ticks.get("imu", "")
    changed = dict(roles)
    for role, parts in roles.items():
        own = plan.guess(role).ticks.get(role, "")
        shared = counter in rates and parts[0].table == rates[counter].table
        text = own if own in rates else counter if shared else ""
        if text and not plan.is_stated(role, "t"):
            time = {"t": time_of_ticks(text, rates[text].rate)}
            changed[role] = tuple(replace(part, columns={**part.columns, **time}) for part in parts)
    return changed


def _tick_rates(plan: Plan) -> dict[str, TickRate]:
    return {text: rate for guess in plan.guesses.values() for text, rate in guess.rates.items()}


def guessed_counter(plan: Plan) -> Counter:
    own, other = (plan.guess(role).ticks.get(role, "") for role in ("imu", "gps"))
    stated, also = (plan.is_stated(role, "t") for role in ("imu", "gps"))
    if not own or own in _tick_rates(plan) or stated or (own == other and also):
        return Counter()
    return Counter(own, own == other)


def notes_of(plan: Plan) -> list[str]:
    """Return the notes on guessed columns that are read as guessed, and the readers' remarks."""
    used = {role: texts_of(parts) for role, parts in plan.recipe.roles.items()}
    guesses = plan.guesses.values()

    def read(role: Role, column: str, text: str) -> bool:
        return used.get(role, {}).get(column, "") == text and not plan.is_stated(role, column)

    notes = [note for guess in guesses for note in guess.notes_on(read)]
    rates = {time_of_ticks(text, rate.rate): (text, rate) for text, rate in _tick_rates(plan).items()}
    times = dict.fromkeys(parts[0].columns.get("t", "") for parts in plan.recipe.roles.values())
    notes += [describe_rate(*rates[time]) for time in times if time in rates]
    recipe = plan.recipe
    placed = (guess.placed for guess in guesses if guess.placed)
    notes += [note for one in placed for note in one.notes(recipe.mount, recipe.gps_lever_arm_m)]
    return notes + [remark for log in plan.logs.values() for remark in log.remarks]


def assumed_mounting(plan: Plan) -> tuple[str, ...]:
    """Return the readers' sentences on an assumed mounting; empty if the recipe contains a mounting."""
    found = () if plan.recipe.mount else plan.guesses.values()
    return tuple(dict.fromkeys(filter(None, [*(guess.flat for guess in found), points_down(plan)])))


def points_down(plan: Plan) -> str:
    """Return the sentence on a z axis that points down; "" with a mounting, or if the user has mapped az."""
    az = texts_of(plan.parts("imu")).get("az")
    found = () if plan.recipe.mount else plan.guesses.values()
    kept = (guess.downward for guess in found if texts_of(guess.roles.get("imu", ())).get("az") == az)
    return next(filter(None, kept), "")


def with_tables(plan: Plan, first: Beginnings | None = None) -> tuple[Plan, list[str]]:
    """Complete all parts with `complete_parts`. Return the plan with these parts, and the first fault of each table."""
    roles: dict[Role, tuple[Part, ...]] = {}
    faults: dict[tuple[Path, str], str] = {}
    for path, log in plan.logs.items():
        rows = None if first is None else first[path]
        for role in ROLES:
            for part in plan.parts(role) if plan.request.home(role) == path else ():
                try:
                    roles[role] = (*roles.get(role, ()), *complete_parts(part, log, role, rows))
                except InputError as error:
                    faults.setdefault((path, part.table), str(error))
    return plan.with_roles(roles), [*faults.values()]


def complete_parts(
    part: Part, log: Log, role: Role, first: Mapping[str, pl.DataFrame] | None = None
) -> list[Part]:
    """Complete a part. A part without a table becomes one part for each table that contains its columns.

    ``first`` contains the first rows of the tables, if they have been read.
    """
    return [_complete(fitted, log, role, first) for fitted in _in_tables(part, log, role)]


def _complete(part: Part, log: Log, role: Role, first: Mapping[str, pl.DataFrame] | None) -> Part:
    """Add the likely time to a part without a time, and check the part's expressions."""
    rows = (log.first_rows(part.table) if first is None else first[part.table]).head(SAMPLE_ROWS)
    where = f"{log.path}, {printable(part.table)}"
    if len(rows):
        if "t" not in part.columns and (time := time_of(rows)) is not None:
            part = replace(part, columns={"t": time, **part.columns})
        elif unit := wrong_unit(part.columns.get("t", ""), rows, role):
            raise InputError(f"{log.path}: {unit if len(log.tables) == 1 else of_one_table(unit, role)}")
    if "t" not in part.columns and (len(rows) or first is None):
        place = log.path if log.path.name == part.table else where
        time = "--time {}" if role == "imu" and len(log.tables) == 1 else f'--map "{role}.t={{}}"'
        column, rate = rising_time(rows, role) if len(rows) else "", 100 if role == "imu" else 1
        remedy = f"specify it with {time.format(column)}, or, " * bool(column)
        raise InputError(
            f"{place}: no column is recognized as the time of the {role}; {remedy}{IF_RATE_IS_KNOWN}, compute it "
            f"from the row number, for example {time.format(f'{ROW}/{rate}')} for {rate} Hz (replace {rate} by the "
            "rate of this log)"
        )
    for text in part.columns.values():
        try:
            compile_expression(text, (*log.tables[part.table].columns, ROW))
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
    return part


def _in_tables(part: Part, log: Log, role: Role) -> list[Part]:
    """Find the tables of a part.

    If a log has only one table, this table fits any part that names no table, or that names another file.
    """
    if part.table in log.tables:
        return [part]
    if len(log.tables) == 1:
        ((name, table),) = log.tables.items()
        if not part.table or table.kind == FILES:
            return [replace(part, table=name)]
    if part.table:
        there = list_names(log.tables)
        raise InputError(f"{log.path}: has no table {quoted(part.table)} for the {role}; choose from {there}")
    homes = {
        name: [n for n, table in log.tables.items() if is_valid_expression(text, table.columns)]
        for name, text in part.columns.items()
    }
    fitting = [n for n in log.tables if all(n in tables for tables in homes.values())]
    apart = {tables[0]: None for name, tables in homes.items() if name != "t" and len(tables) == 1}
    if not fitting and all(len(tables) == 1 for name, tables in homes.items() if name != "t"):
        return [
            Part(table, {name: text for name, text in part.columns.items() if table in homes[name]})
            for table in apart
        ]
    chosen = quote(fitting[0]) if len(fitting) == 1 else "TABLE"
    raise InputError(
        f"{log.path}: has several tables ({list_names(log.tables)}); choose one for {', '.join(part.columns)} with "
        f"--{role}-table {chosen}, or write a recipe with table = ..."
    )
