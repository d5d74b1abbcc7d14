"""Describe faults of a plan, with a remedy: columns without a known unit, and missing sensors."""

import collections
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shlex import quote

import polars as pl

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.assemble import REQUIRED, assemble
from sigmaswarm.importing.clocks import Counter, rate_by_duration, rate_by_motion, shown_rate, time_of_ticks
from sigmaswarm.importing.completion import IF_RATE_IS_KNOWN, guessed_counter, with_tables
from sigmaswarm.importing.expressions import ROW
from sigmaswarm.importing.formats import unsupported_format
from sigmaswarm.importing.gather import Gathered, durations, gather_all, joined_faults
from sigmaswarm.importing.guess import FORCES, PLACES, RATES
from sigmaswarm.importing.imu_units import unit_of_rates
from sigmaswarm.importing.names import is_time, read_name, read_names, split_words
from sigmaswarm.importing.opening import Plan
from sigmaswarm.importing.recipe import with_maps
from sigmaswarm.importing.source import Log, Part, Role, first_bytes, texts_of
from sigmaswarm.importing.table_columns import column_numbers
from sigmaswarm.importing.time_units import UNKNOWN_TICK
from sigmaswarm.importing.times import of_one_table
from sigmaswarm.importing.unnamed import header_by_values
from sigmaswarm.importing.word_meanings import FORCE, is_of_earth
from sigmaswarm.wording import list_names, printable

# Trial rates, Hz, of a counter of unknown rate. The first rate with which the import succeeds is then corrected by
# comparing the motion of IMU and fixes.
TRIAL_RATES = (1e4, 1e5, 1e6, 1e7, 1e8, 1e3)
TRIAL_ROWS = 25.0  # Hz, trial rate of the rows of a table without a time
# Columns of the IMU, with the meaning of the required ones
IMU = dict.fromkeys(("az", "gx", "gy"), "") | {
    "ax": "ax (the forward acceleration)",
    "ay": "ay (the acceleration to the left)",
    "gz": "gz (the yaw rate)",
}
# Suffixes of receiver logs in a folder of tables; such a log is read only with --gps
RECEIVER_LOGS = (".llh", ".pos", ".nmea", ".ubx")
_SENSORS: tuple[tuple[Role, str, str], ...] = (
    ("imu", "IMU samples", "specify a log with IMU samples as SOURCE"),
    ("gps", "position fixes", "add a log with fixes: --gps LOG"),
)
MAX_KINDS = 20
# Sentences of a board's own; others are those of NMEA 0183, or of the makers of receivers
_OWN = r"\$(?!PASHR|PUBX|PQTM|PMTK|PTNL|PSTM|PGRM|PSAT|PAIR)(?:P[A-Z]{2,}|[A-Z]*(?:IMU|ACC|GYR)[A-Z]*)"
MIN_NUMBERS = 6  # smallest count of numbers in a row of an IMU


def faults_left(plan: Plan) -> list[str]:
    """Return the faults of guessed columns, except for columns that the user has mapped or omitted."""
    request = plan.request
    stated = {entry.partition("=")[0].strip() for entry in request.maps}
    left: list[str] = []
    for path, guess in plan.guesses.items():
        for fault in guess.faults:
            parts = plan.parts(fault.role)
            used = request.home(fault.role) == path and fault.role not in request.recipe.roles
            mapped = {fault.column, f"{fault.role}.{fault.column}"} & stated
            if used and parts and not mapped and not any(fault.column in part.columns for part in parts):
                where = path if path.name == fault.table else path / fault.table
                several = len(plan.logs[path].tables) > 1
                sentence = of_one_table(fault.sentence, fault.role) if several else fault.sentence
                left.append(f"{where}, {sentence}")
    return _with_unit_of_rates(_with_rate_of_ticks(list(dict.fromkeys(left)), plan), plan)


def _with_rate_of_ticks(faults: list[str], plan: Plan) -> list[str]:
    """In faults of a counter of unknown unit, replace the remedy by the rate that the motion or duration shows.

    If IMU and fixes share a counter, its unit is also unknown if the guesses for the two differ.
    """
    counter = guessed_counter(plan)
    unknown = [fault for fault in faults if UNKNOWN_TICK in fault]
    times = {part.columns.get("t") for role in ("imu", "gps") for part in plan.parts(role)[:1]}
    differ = counter.shared and len(times) > 1
    if not counter.text or "gps" not in plan.recipe.roles or not (unknown or differ):
        return faults
    remedy = _rate_by_trial(counter, plan)
    if remedy and not unknown:
        return [*faults, f"{counter.text}: the unit of the times is unknown; {remedy}"]
    return [_with_remedy(fault, remedy) if remedy and fault in unknown else fault for fault in faults]


def with_rate_of_rows(faults: list[str], plan: Plan) -> list[str]:
    """If IMU and fixes are in one table without a time, add the rate of rows that agrees with the motion to the remedy.

    ``faults`` are those of `with_tables`.
    """
    imu, gps = ((*plan.parts("imu"), Part("", {}))[0], (*plan.parts("gps"), Part("", {}))[0])
    timeless = [fault for fault in faults if f"; {IF_RATE_IS_KNOWN}" in fault]
    shared = imu.table == gps.table and plan.log("imu") is plan.log("gps")
    if not timeless or not shared or any("t" in part.columns or not part.columns for part in (imu, gps)):
        return faults
    if not (remedy := _rate_by_trial(Counter(ROW, True), plan, (TRIAL_ROWS,))):
        return faults
    shown = {fault: f"{fault.partition(f'; {IF_RATE_IS_KNOWN}')[0]}; {remedy}" for fault in timeless}
    return [shown.get(fault, fault) for fault in faults]


def _rate_by_trial(counter: Counter, plan: Plan, rates: Sequence[float] = TRIAL_RATES) -> str:
    """Import with the first trial rate that works. Return the remedy computed from the resulting drive, or ""."""
    for trial in rates:
        roles: Sequence[Role] = ("imu", "gps")[: 1 + counter.shared]
        changed = _with_maps(plan, {f"{role}.t": time_of_ticks(counter.text, trial) for role in roles})
        try:
            gathered = _gathered(changed)
            if not counter.shared:
                return rate_by_duration(counter, changed.imu_time, durations(gathered)).remedy
            factor = rate_by_motion(_drive(changed, gathered))
        except InputError:
            continue
        return "" if factor is None else shown_rate(counter.text, trial / factor)
    return ""


def _with_unit_of_rates(faults: list[str], plan: Plan) -> list[str]:
    """For angular rates without a unit, add the unit that agrees with the course of the fixes to the remedy."""
    rates = [fault for fault in faults if '"imu.g' in fault]
    if "gps" not in plan.recipe.roles or not rates:
        return faults
    unitless, known = plan.guess("imu").unitless, texts_of(plan.parts("imu"))
    changed = _with_maps(plan, {f"imu.{n}": text for n, text in unitless.items() if n not in known})
    try:
        drive = _drive(changed, _gathered(changed))
        message = unit_of_rates(drive, changed.recipe.roles, unitless).fault
    except InputError:  # other faults prevent the comparison
        return faults
    if not message:
        return faults
    shown = {rates[0]: _with_remedy(rates[0], message)}
    return [shown.get(fault, fault) for fault in faults if fault not in rates[1:]]


def _with_remedy(fault: str, remedy: str) -> str:
    return f"{fault.partition('; specify')[0]}; {remedy}"


def _with_maps(plan: Plan, texts: Mapping[str, str]) -> Plan:
    """Return the plan with other expressions, and without a mounting."""
    roles = with_maps(plan.recipe.roles, [f"{name}={text}" for name, text in texts.items()], {})
    return replace(plan, recipe=replace(plan.recipe, roles=roles, mount=""))


def _gathered(plan: Plan) -> Gathered:
    whole, faults = with_tables(plan)
    if faults:
        raise InputError(joined_faults(faults))
    return {role: parts for role, parts in gather_all(whole).items() if role != "mag"}


def _drive(plan: Plan, gathered: Gathered) -> Drive:
    return assemble("log", gathered, plan.recipe, lambda note: None, plan.request.part)


def missing_sensor(plan: Plan, roles: Sequence[Role]) -> str:
    """Describe a missing sensor, with the remedy. Return "" if IMU and fixes have tables."""
    for role, what, remedy in _SENSORS:
        made = role == "gps" and plan.recipe.gps_from_truth
        if role in roles and not plan.parts(role) and not made:
            return _without(role, what, remedy, plan)
    return ""


def _without(role: Role, what: str, remedy: str, plan: Plan) -> str:
    log = plan.log(role)
    path, there = log.path, list_names(log.tables)
    if siblings := _siblings(path, role):
        remedy = f"specify the folder {quote(str(path.parent))} as SOURCE, which also contains {list_names(siblings)}"
    if example := _headers(log) or (role == "imu" and describe_kinds(log)):
        remedy = f"{example}; or {remedy}"
    reasons = "has no header", "can't be decoded", "is empty", "cells contain"
    texts = (*log.remarks, *plan.guess(role).notes)
    if why := next((text for text in texts if any(reason in text for reason in reasons)), ""):
        return f"{path}: no {what} found in {there or 'the part that can be decoded'}; {why}; or {remedy}"
    remedy = f"{remedy}, or specify the columns with --map"
    if role == "imu":
        columns = {name.meaning for table in log.tables.values() for name in read_names(table.columns)}
        lacking = [IMU[n] for n in REQUIRED["imu"] if n not in columns]
        names = [c for table in log.tables.values() for c in table.columns]
        if lacking and any(is_of_earth(name) and FORCE & {*split_words(name)} for name in names):
            why = (
                "accelerations in the axes of the earth can't be used; log those of the sensor, such as Acc_X"
            )
            remedy = f"{why}; or {remedy}"
        if lacking and columns & {*IMU}:
            return f"{path}: the IMU has no column for {list_names(lacking)}; {remedy}"
        return f"{path}: no {what} found in {there + _lacking_table(log) or 'the log'}; {remedy}"
    around = sorted(path.iterdir()) if path.is_dir() else []
    kinds = ((file.name, unsupported_format(file)) for file in around)
    more = next((f"; {name} is not read, since it is {kind}" for name, kind in kinds if kind), "")
    if receiver_log := next((f for f in around if f.suffix.lower() in RECEIVER_LOGS), None):
        remedy = (
            f"add the log with the fixes: --gps {quote(str(receiver_log))}, or specify the columns with --map"
        )
    return f"{path}: no {what} found in {there or 'the log'}{more}; {remedy}"


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
    """Name the missing sensor if the log has a table of the accelerometer or of the gyroscope, but not of both."""
    names = [
        name for name, table in log.tables.items() if {"x", "y", "z"} <= {c.lower() for c in table.columns}
    ]
    forces, rates = (any(sensor.search(name) for name in names) for sensor in (FORCES, RATES))
    lacking = "an accelerometer" if rates else "a gyroscope"
    return f", since there is no table of {lacking}" if forces != rates else ""


def _headers(log: Log) -> str:
    """Return a command that copies the tables of a folder and adds missing headers; "" if this would give no IMU."""
    if not log.path.is_dir():
        return ""
    headers = {name: header for name in log.tables if (header := header_by_values(log.first_rows(name)))}
    headers = {name: header for name, header in headers.items() if log.tables[name].columns[0] == "c1"}
    if not {"ax", "gz"} <= {*",".join(headers.values()).split(",")}:
        return ""
    new = {name: quote(f"named/{name}") for name in log.tables}
    folders = dict.fromkeys(quote(str(Path("named", name).parent)) for name in log.tables)
    lines = [f"(echo {quote(text)}; cat {quote(name)}) > {new[name]}" for name, text in headers.items()]
    left = [name for name, table in log.tables.items() if name not in headers and table.columns[0] == "c1"]
    placed = any("lat" in header.split(",") for header in headers.values())
    lines += [f"cp {quote(name)} {new[name]}" for name in log.tables if name not in (*headers, *left)]
    command = " && ".join([f"cd {quote(str(log.path))}", f"mkdir -p {' '.join(folders)}", *lines])
    there = quote(str(log.path / "named"))
    more = f"; copy {list_names(left)} to {there} with a header, such as t,lat,lon, since the values suggest none"
    more = more if left and not placed else ""
    return f"add the headers that the values suggest: ({command}){more}, and import the folder {there}"


def describe_kinds(log: Log) -> str:
    """Describe a long table (one value or sensor per row), and a command that converts it; "" for other tables."""
    if found := _between_sentences(log.path):
        return found
    for table in log.tables:
        frame = log.first_rows(table)
        kinds = [name for name in frame.columns if _is_kind(frame[name])]
        kinds.sort(key=lambda name: frame[name].n_unique())
        times = [name.column for name in read_names(frame.columns) if is_time(name.plain)]
        numbers = [name for name in frame.columns if name not in times and len(column_numbers(frame[name]))]
        changing = [name for name in numbers if frame[name].n_unique() > MAX_KINDS]
        file = log.path.name if log.path.is_file() else table
        if not (kinds and times and changing):
            continue
        if not all(map(_is_harmless, (file, *kinds, times[0], changing[0]))):
            continue
        read = f"import os,polars as pl;f=pl.read_csv({file!r},comment_prefix='#',glob=False)"
        if len(changing) == 1:
            write = f"f.with_columns(k=pl.concat_str({kinds},separator='_')).pivot('k',index={times[0]!r},"
            write += (
                f"values={changing[0]!r},aggregate_function='first').sort({times[0]!r}).write_csv('new.csv')"
            )
            command, then = f"{read};{write}", "import new.csv"
        else:
            name = f"'kinds/' + p.item(0, {kinds[0]!r}) + '.csv'"
            parts = f"[p.write_csv({name}) for p in f.partition_by({kinds[0]!r})]"
            command, then = f"{read};os.makedirs('kinds',exist_ok=True);{parts}", "import the folder kinds"
            placed = (
                n
                for n, t in log.tables.items()
                if {"lat", "lon"} <= {read_name(c).meaning for c in t.columns}
            )
            then += next((f" with --gps {quote(other)}" for other in placed if other != table), "")
        there = ", ".join(map(str, frame[kinds[0]].drop_nulls().unique(maintain_order=True)[:4]))
        return f'{table} has rows of several kinds ({there}); run: python -c "{command}", and {then}'
    return ""


def _is_harmless(name: str) -> bool:
    """Return True if a shell takes a name in double quotes literally."""
    return re.fullmatch(r"[^\\\"'`$!\n\r]*", name) is not None


def _is_kind(values: pl.Series) -> bool:
    if values.dtype != pl.String:
        return False
    known = values.drop_nulls().unique()
    return 1 < len(known) <= MAX_KINDS < len(values) and bool(known.str.contains(r"^[A-Za-z]\w*$").all())


def _between_sentences(path: Path) -> str:
    """Describe rows of numbers, or of a board's format, between NMEA sentences, and a command that separates them."""
    lines = first_bytes(path, 65536).decode("utf-8", "replace").split("\n")[:-1] if path.is_file() else []
    rows = [line for line in lines if len(re.findall(r"\d+\.?\d*", line)) >= MIN_NUMBERS]
    sentences = [found[1] for line in lines if (found := re.match(r"\$([A-Z]{4,6}),", line))]
    kinds = collections.Counter(line.partition(",")[0] for line in rows if "$" in line)
    own, count = next(((k, n) for k, n in kinds.most_common(1) if re.fullmatch(_OWN, k)), ("", 0))
    rows = [line for line in rows if line.startswith(f"{own},") or (not own and "$" not in line)]
    if not sentences or max(count, len(rows)) < 0.2 * len(lines):
        return ""
    name = quote(path.name)
    what = f"the sentences {own}" if own else "the lines between the NMEA sentences"
    command = rf"sed -nE 's/^[$]{own[1:]},([^*]*).*$/\1/p' {name}" if own else f"grep -av '[$]' {name}"
    return (
        f"{what} may be IMU samples ({printable(rows[0], 60)}); write them to a file "
        f"with: {command} > imu.csv, and import imu.csv with --gps {name}"
    )
