"""Guess the roles of a log's tables from the names, units and sampled values of their columns."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from shlex import quote

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.clocks import on_common_clock, rates_by_clock
from sigmaswarm.importing.coordinates import degree_parts, degrees_as_meters, from_ecef, geographic_position
from sigmaswarm.importing.kept_rows import kept_rows
from sigmaswarm.importing.names import Name, read_name, read_names, split_words
from sigmaswarm.importing.quantities import heading, quantity, with_gravity
from sigmaswarm.importing.source import Fault, Guess, Part, Role
from sigmaswarm.importing.table_columns import (
    Columns,
    Conversion,
    column_numbers,
    median_of,
    quoted_column,
    refused,
)
from sigmaswarm.importing.times import time_of_rows
from sigmaswarm.wording import list_names

Z_DOWN = "x=x,y=-y"  # mounting of an IMU with x forward, y right and z down
# Number and length of the blocks of rows from which units are guessed. The blocks are spread over the table, since a
# log may begin without fixes and at standstill. Rows of a block are consecutive, so most time steps are those of the
# log. A block contains fixes even if only 1 of 200 rows has one.
BLOCKS, BLOCK = 16, 500
_RECEIVER = re.compile(r"gps|gnss", re.IGNORECASE)
# Columns of fixes for which a name with gps or gnss takes precedence: lat may be an estimate, speed that of the wheels
_OF_RECEIVER = ("lat", "lon", "alt", "speed", "course", "bearing")
_WHEELS = re.compile(r"odo|wheel|(?:^|[^a-z])can(?:[^a-z]|$)", re.IGNORECASE)
TRUTH = re.compile(r"truth|ground|reference|(?:^|[^a-z])(?:gt|ref)(?:[^a-z]|$)", re.IGNORECASE)
# Words that mark a column as truth; the rest of the name is interpreted. The suffix _ref is not among them, since x_ref
# may be a setpoint; so may ref_x (`_MAYBE_TRUTH`).
_OF_TRUTH = re.compile(
    r"^(?:(?:ground_?)?truth|true|gt|ref(?:erence)?)[\W_]|[\W_](?:(?:ground_?)?truth|true|gt)$",
    re.IGNORECASE,
)
_MAYBE_TRUTH = re.compile(r"ref", re.IGNORECASE)
# Names of axes in a table named after a sensor
_AXIS = r"(?:value_|axis_)?([xyz])(?:_value|_axis)?"
FORCES = re.compile(r"acc", re.IGNORECASE)
RATES = re.compile(r"gyr|ang(?:ular)?_?(?:vel|rate)|rotation_?rate|rotationrate", re.IGNORECASE)
PLACES = re.compile(r"gps|gnss|fix|location|position", re.IGNORECASE)
# Names of tables whose x, y, z are neither a position nor axes of the IMU
_NO_PLACES = re.compile(
    r"mag|orient|attitude|gravity|quat|rotation|linear|baro|light|imu|velocity|twist|(?:^|[^a-z])vel",
    re.IGNORECASE,
)
# Names of tables whose positions are estimates, not measurements
_ESTIMATE = re.compile(
    r"filter|estimat|kalman|(?:^|[^a-z])[eu]?kf|fused|fusion|smooth|predict", re.IGNORECASE
)
# Names of tables whose positions are accurate, and presumably a reference for those of other tables
_REFERENCE = re.compile(
    r"mocap|vicon|opti_?track|leica|total_?station|survey|(?:^|[^a-z])(?:rtk|ppk)(?:[^a-z]|$)", re.IGNORECASE
)
# largest ratio of the 90% to the 10% quantile of the magnitude of x, y, z of a magnetometer
MAX_SIZE_RATIO = 1.3
# Largest ratio of the median of the magnetometer's z to the magnitude. In positions, x and y may be far smaller than z.
MAX_VERTICAL_SHARE = 0.99
# Patterns of a magnetometer's axis names in lower case, the most common first
_MAGNETIC_AXES = (
    r"(?:.*[\W_])?mag(?:netic[\W_]?field|[a-z]*)\d*[\W_]*([xyz])(?:[\W_].*)?",
    r"[mb][\W_]?([xyz])",
    r"([xyz])",
)
_WANTED: dict[Role, tuple[str, ...]] = {
    "imu": ("ax", "ay", "az", "gx", "gy", "gz"),
    "gps": (
        *("lat", "lon", "alt", "x", "y", "std_x", "std_y"),
        *("speed", "course", "bearing", "std_heading", "vx", "vy"),
    ),
    "truth": ("lat", "lon", "alt", "x", "y", "vx", "vy", "theta", "bearing"),
    "odometer": ("wheel_speed", "speed"),
}
_HINTS: dict[str, str] = {
    "imu": "imu",
    "gps": "gps|gnss|fix|location|position",
    "truth": "truth",
    "odometer": "odo|wheel",
}


def guess_roles(samples: Mapping[str, pl.DataFrame], chosen: Mapping[str, str]) -> Guess:
    """Find the tables of each role by their columns, and choose among several tables by their names.

    ``samples`` contains rows of each table, and ``chosen`` the table that the user chose for each role.
    """
    found = {table: _find_columns(frame, table) for table, frame in samples.items()}
    truths, notes = _truths_of_columns(samples, found)
    roles: dict[Role, tuple[Part, ...]] = {}
    faults: list[Fault] = []
    about: dict[str, list[tuple[Role, str]]] = {}
    ticks: dict[Role, str] = {}
    for role, tables in _candidates(found, truths, chosen.get("truth")).items():
        if role in chosen and chosen[role] not in samples:
            raise InputError(f"there is no table {chosen[role]!r}; choose from {list_names(samples)}")
        if not tables and role not in chosen:
            continue
        best = chosen.get(role) or _best_table(role, tables, found)
        used = {best, *chosen.values(), *(part.table for parts in roles.values() for part in parts)}
        located = [t for t, c in found.items() if c.located and not _has_constant_size(c)]
        ask = role == "gps" and role not in chosen
        others = [t for t in (located if role == "gps" else tables) if t not in used]
        notes += _other_tables(role, best, others, samples, ask=ask)
        rates = [t for t, c in found.items() if "gz" in c and not c.has("ax", "ay")][:1]
        for table in [best, *rates] if role == "imu" and "gz" not in found[best] else [best]:
            expressions: dict[str, str] = {}
            # In a table with an IMU, the rate of the IMU determines the unit of the times, also for other roles.
            shared = "imu" in roles and table == roles["imu"][0].table
            columns = truths.get(table, found[table]) if role == "truth" else found[table]
            for what, found_as in _expressions(columns, role, "imu" if shared else role):
                notes += [found_as.note] if found_as.note else []
                about.setdefault(found_as.note, []).append((role, what))
                if found_as.ticks:
                    ticks.setdefault(role, found_as.ticks)
                fault = found_as.fault.replace('"imu.t=', f'"{role}.t=')
                faults += [Fault(role, what, table, fault)] if fault else []
                expressions |= {what: found_as.expression} if found_as.expression else {}
            roles[role] = (*roles.get(role, ()), Part(table, expressions))
    own, (roles, shared_clock) = roles, on_common_clock(roles, samples)
    notes += shared_clock
    ticks = {role: text for role, text in ticks.items() if roles[role] == own[role]}
    downward = _downward(found[roles["imu"][0].table]) if "imu" in roles else ""
    tables = [found[part.table] for part in roles.get("imu", ())]
    unitless = {
        w: c.text(w) for c in reversed(tables) for w in _WANTED["imu"] if w in c and not c.has_unit(w)
    }
    notes = [*dict.fromkeys(notes)]
    return Guess(
        roles,
        tuple(notes),
        downward=downward,
        faults=tuple(faults),
        unitless=unitless,
        ticks=ticks,
        rates=rates_by_clock(samples) if ticks else {},
        about=about,
    )


def _other_tables(
    role: Role, best: str, others: Sequence[str], samples: Mapping[str, pl.DataFrame], *, ask: bool
) -> list[str]:
    """Return a note on unused tables with equal columns or, if ``ask``, with positions, and the options that read them.

    Positions from wheels or estimates are not proposed as fixes.
    """
    alike = [table for table in others if samples[table].columns == samples[best].columns]
    measured = [table for table in others if not (_WHEELS.search(table) or _ESTIMATE.search(table))]
    if not (others := alike or (measured if ask else [])):
        return []
    other = quote(next(filter(_REFERENCE.search, others), others[0]))
    have = f"{list_names(others)} also {'has' if len(others) == 1 else 'have'}"
    have += f" {'the same columns' if alike else 'positions'}, but only {best} is used for the {role}"
    if alike:
        return [f"{have}; import each table as a separate drive, for example with --{role}-table {other}"]
    how = f"--truth-table {other} reads a reference, and " if _REFERENCE.search(other) else ""
    return [f"{have}; {how}--{role}-table {other} reads other fixes"]


def _best_table(role: Role, tables: Sequence[str], found: Mapping[str, Columns]) -> str:
    """Return the first table with a matching name or, if there is none, the first table.

    Tables that may contain estimates come last. For fixes, positions from wheels come after all measured positions, and
    a reference comes after other measurements. Tables whose x, y, z have a constant magnitude come later, since they
    may be those of a magnetometer.
    """
    return max(
        tables,
        key=lambda t: (
            not _ESTIMATE.search(t),
            role != "gps" or not _WHEELS.search(t),
            bool(re.search(_HINTS[role], t, re.IGNORECASE)),
            role != "gps" or not _has_constant_size(found[t]),
            role != "gps" or not _REFERENCE.search(t),
            role == "gps" and "ax" not in found[t],
        ),
    )


def _has_constant_size(columns: Columns) -> bool:
    """Return True if x, y, z change but their magnitude does not, as for a magnetometer that turns."""
    if not columns.has("x", "y", "z") or from_ecef(columns):
        return False
    low, high = (float(columns.norms(["x", "y", "z"]).quantile(q) or 0.0) for q in (0.1, 0.9))
    return high < MAX_SIZE_RATIO * low and median_of(columns.numbers("z").abs()) < MAX_VERTICAL_SHARE * high


def spread_rows(rows: pl.LazyFrame) -> pl.DataFrame:
    """Read blocks of rows that are spread over a table, or all rows of a short table."""
    count = int(rows.select(pl.len()).collect().item())
    if count <= BLOCKS * BLOCK:
        return rows.collect()
    number = "\0"  # no column has this name
    chosen = rows.with_row_index(number).filter(pl.col(number) % (count // BLOCKS) < BLOCK)
    return chosen.drop(number).collect(engine="streaming")


def _find_columns(frame: pl.DataFrame, table: str) -> Columns:
    """Assign to each quantity the first column with its name; in a table named after a sensor, x, y, z are axes."""
    columns = Columns(frame)
    for name in read_names(frame.columns):
        if TRUTH.search(table) and name.meaning is None:
            name = replace(read_name(_OF_TRUTH.sub("", name.column)), column=name.column)
        if (what := name.meaning) is None or what == "t":
            continue
        first = columns.names.get(what)
        of_receiver = (
            what in _OF_RECEIVER and _names_receiver(name) and not (first and _names_receiver(first))
        )
        # a direction may be N or NE
        if (first is None or of_receiver) and (what != "bearing" or len(column_numbers(frame[name.column]))):
            columns.names[what] = name
        elif what == "bearing" and first and first.is_one("cog|track") and name.is_one("heading"):
            columns.names |= {"course": first, "bearing": name}
    for what, (column, text) in degree_parts(frame).items():
        if text:
            columns.names[what], columns.degrees[what] = Name(column, what), text
        else:
            columns.names[what] = next(n for n in read_names(frame.columns) if n.column == column)
    called = f"{table} {'_'.join(split_words(table))}"  # the name, and its words in English
    letter = "a" if FORCES.search(called) else "g" if RATES.search(called) else ""
    if letter and not columns.has("lat", "lon"):
        for name in read_names(frame.columns):
            if axis := re.fullmatch(_AXIS, name.meaning if name.meaning in {*"xyz"} else name.plain):
                columns.names.setdefault(f"{letter}{axis[1]}", name)
    turned = "q" in columns and columns.names["q"].plain == "w"  # x, y, z are those of a quaternion
    posed = "x" in columns and columns.names["x"].plain.startswith("pose_")  # a pose is usually an estimate
    turned |= posed and not _RECEIVER.search(table)
    dropped = {"x", "y"} if _NO_PLACES.search(table) or turned or letter else set[str]()
    if "ax" in columns and columns.names["ax"].plain == "linear_x":  # velocities also have this name
        size = median_of(columns.norms(["ax", "ay", "az"])) if columns.has("ax", "ay", "az") else 0.0
        dropped |= set() if 8.0 < size < 12.0 or 0.85 < size < 1.15 else {"ax", "ay", "az"}
    columns.names = {what: name for what, name in columns.names.items() if what not in dropped}
    return columns


def _names_receiver(name: Name) -> bool:
    return _RECEIVER.search(name.column) is not None


def _truths_of_columns(
    samples: Mapping[str, pl.DataFrame], found: Mapping[str, Columns]
) -> tuple[dict[str, Columns], list[str]]:
    """Find columns with truth in each table by names such as truth_x and gt_lat. Return the columns, and notes.

    The truth of a moving vehicle changes; the position of a reference station does not.
    """
    truths: dict[str, Columns] = {}
    notes: list[str] = []
    for table, frame in samples.items():
        columns = Columns(frame)
        for column in frame.columns if not TRUTH.search(table) else ():
            name = replace(read_name(bare := _OF_TRUTH.sub("", column)), column=column)
            if bare == column or (what := name.meaning) not in _WANTED["truth"] or read_name(column).meaning:
                continue
            if column_numbers(frame[column]).n_unique() > 1:
                columns.names.setdefault(what, name)
        if not columns.located or _in_wrong_unit(columns):
            continue
        pair = ("lat", "lon") if columns.has("lat", "lon") else ("x", "y")
        both = " and ".join(columns.names[what].column for what in pair)
        if any(_MAYBE_TRUTH.match(columns.names[what].column) for what in pair):
            maps = " ".join(quote(f"truth.{what}={columns.text(what)}") for what in pair)
            notes.append(
                f"{both} are not used, since they may be setpoints; if they are the truth, write --map {maps}"
            )
        elif _repeats_fixes(columns, found[table], pair):
            notes.append(f"{both} are not used as truth, since they repeat the positions of the fixes")
        else:
            truths[table] = columns
    return truths, notes


def _repeats_fixes(truth: Columns, fixes: Columns, pair: Sequence[str]) -> bool:
    if not fixes.has(*pair):
        return False
    names = [[columns.names[what].column for what in pair] for columns in (truth, fixes)]
    placed = truth.frame.select(
        pl.col(*names[0], *names[1]).cast(pl.Float64, strict=False).fill_nan(None)
    ).drop_nulls()
    return len(placed) > 0 and placed.select(names[0]).equals(
        placed.select(names[1]).rename(dict(zip(names[1], names[0], strict=True)))
    )


def _in_wrong_unit(truth: Columns) -> bool:
    return not truth.has("lat", "lon") and bool(degrees_as_meters(truth, "truth"))


def _candidates(
    found: Mapping[str, Columns], truths: Collection[str], chosen_truth: str | None
) -> dict[Role, list[str]]:
    """List the tables that fit each role.

    If a table has latitude and longitude, tables with only x, y are not fixes. ``truths`` are tables in which the names
    of some columns mark truth. ``chosen_truth`` is the table that the user chose for the truth.
    """
    forces = {t for t, c in found.items() if c.has("ax", "ay")}
    rates = {t for t, c in found.items() if "gz" in c}
    degrees = {t for t, c in found.items() if c.has("lat", "lon")}
    located = {t for t, c in found.items() if c.located}
    truth = {t for t in found if t not in truths and (t == chosen_truth or TRUTH.search(t))}
    loose = {t for t in forces if rates and not re.search("lin|gravi", t, re.IGNORECASE)}
    counted = {
        t
        for t, c in found.items()
        if "wheel_speed" in c or ("speed" in c and _WHEELS.search(t) and t not in located)
    }
    chosen: dict[Role, set[str]] = {
        "imu": forces & rates or loose,
        "truth": truth & located | {*truths},
        # a pose in meters is that of another system, or an estimate
        "gps": degrees - truth or {t for t in located - truth if "q" not in found[t]},
        "odometer": counted,
    }
    return {role: [t for t in found if t in tables] for role, tables in chosen.items()}


def _expressions(columns: Columns, role: Role, rows_of: Role) -> Iterator[tuple[str, Conversion]]:
    """Yield the columns of a role as expressions.

    The unit of times is chosen by the usual rate of the role ``rows_of``.
    """
    filled: dict[str, Role] = {"gz": "imu", "ax": "imu", "x": "gps", "lat": "gps"}
    keys: dict[Role, str] = {of: columns.names[what].column for what, of in filled.items() if what in columns}
    if (time := time_of_rows(columns.frame, role, keys, rows_of)) is not None:
        yield "t", time
    located = columns.has("lat", "lon")
    if located and role in ("gps", "truth"):
        yield from geographic_position(columns, role).items()
    elif role in ("gps", "truth") and (found := from_ecef(columns)):
        yield from found.items()
        located = True
    elif role in ("gps", "truth") and columns.has("x", "y") and (fault := degrees_as_meters(columns, role)):
        yield "lat", refused(fault)
        located = True
    if (kept := kept_rows(columns, role)) is not None:
        yield "keep", kept
    skipped = {"lat", "lon"} | ({"x", "y"} if located else set())
    # "heading" is the course of a receiver with one antenna, unless the table also has a course or a std_heading
    heads = role == "gps" and "bearing" in columns and columns.names["bearing"].is_one("heading")
    heads = heads and ("course" in columns or "std_heading" in columns)
    course = "theta" if role == "truth" else "course"
    skipped |= {"bearing"} if course in columns and not heads else set()
    skipped |= set() if heads else {"std_heading"}
    skipped |= {"speed"} if role == "odometer" and "wheel_speed" in columns else set()
    gravity = with_gravity(columns) if role == "imu" else {}
    for what in _WANTED[role]:
        if what not in columns or what in skipped:
            continue
        if what in ("course", "bearing", "theta"):
            yield ("heading" if what == "bearing" and heads else course), heading(columns, what, role)
        elif what == "std_heading" and columns.names[what].unit is None:
            degrees = "radians" in heading(columns, "bearing", role).expression
            yield what, Conversion(f"radians({columns.text(what)})" if degrees else columns.text(what))
        else:
            found = quantity(columns, what, role)
            yield what.removeprefix("wheel_"), replace(found, **gravity.get(what, {}))
    if role == "gps" and not columns.has("std_x", "std_y"):
        yield from _std_of_messages(columns.frame.columns)


def _std_of_messages(names: Sequence[str]) -> Iterator[tuple[str, Conversion]]:
    """Yield the standard deviations of NavSatFix messages in a table. `join` leaves out values of 0."""
    for what, element in (("std_x", 0), ("std_y", 4)):
        found = [n for n in names if re.search(rf"position_covariance\W?_?{element}\W?$", n, re.IGNORECASE)]
        if len(found) == 1:
            yield what, Conversion(f"sqrt({quoted_column(found[0])})")


def _downward(imu: Columns) -> str:
    gravity = median_of(imu.norms(["ax", "ay", "az"])) if imu.has("ax", "ay", "az") else 0.0
    if "az" not in imu or median_of(column_numbers(imu.frame[imu.names["az"].column])) >= -0.5 * gravity:
        return ""  # the sign of an acceleration without gravity has no meaning
    return points_down(imu.names["az"].column)


def points_down(column: str) -> str:
    return (
        f"{column} is negative, so the z axis points down. If x points forward and y to the right, add --mount "
        f"{Z_DOWN}, and check the result with `sigmaswarm doctor`"
    )


def magnetometer_part(table: str, columns: Sequence[str]) -> Part:
    """Find the axes in a table of a magnetometer by their names. The part is empty if there are none."""
    for pattern in _MAGNETIC_AXES:
        found = {m[1]: column for column in reversed(columns) if (m := re.fullmatch(pattern, column.lower()))}
        if {"x", "y"} <= found.keys():
            return Part(table, {f"m{axis}": quoted_column(found[axis]) for axis in "xyz" if axis in found})
    return Part(table, {})
