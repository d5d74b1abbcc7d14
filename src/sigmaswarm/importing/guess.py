"""Guess the roles of a log's tables by the names, units and first values of their columns."""

import re
from collections.abc import Iterator, Mapping, Sequence

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.quantities import Columns, heading, place, quantity
from sigmaswarm.importing.source import Fault, Guess, Part, Role
from sigmaswarm.importing.times import Found, find_time, numbers_of
from sigmaswarm.wording import names_shown

SAMPLE = 2000
"""Rows by which units are guessed."""
_WHEELS = re.compile(r"odo|wheel|(?:^|[^a-z])can(?:[^a-z]|$)", re.IGNORECASE)
_TRUTH = re.compile(r"truth|ground|reference|(?:^|[^a-z])(?:gt|ref)(?:[^a-z]|$)", re.IGNORECASE)
_FORCES = re.compile(r"acc", re.IGNORECASE)
_RATES = re.compile(r"gyr|ang(?:ular)?_?(?:vel|rate)|rotation_?rate|rotationrate", re.IGNORECASE)
_NO_PLACES = re.compile(
    r"mag|orient|attitude|gravity|quat|rotation|linear|baro|light|imu|velocity|twist|(?:^|[^a-z])vel",
    re.IGNORECASE,
)
"""Tables whose x, y, z are neither a place nor the IMU's."""
_WANTED: dict[Role, tuple[str, ...]] = {
    "imu": ("ax", "ay", "az", "gx", "gy", "gz"),
    "gps": ("lat", "lon", "alt", "x", "y", "std_x", "std_y", "speed", "course", "bearing", "vx", "vy"),
    "truth": ("lat", "lon", "alt", "x", "y", "vx", "vy", "theta", "bearing"),
    "odometer": ("wheel_speed", "speed"),
}
_HINTS: dict[Role, str] = {
    "imu": "imu",
    "gps": "gps|gnss|fix|location|position",
    "truth": "truth",
    "odometer": "odo|wheel",
}


def guess_roles(samples: Mapping[str, pl.DataFrame], chosen: Mapping[str, str] | None = None) -> Guess:
    """Find the tables of IMU, fixes and truth, by their columns, and among several by their names.

    Parameters
    ----------
    samples : the first rows of each table
    chosen : the table of a role, if the user chose it
    """
    chosen = chosen or {}
    found = {table: find_columns(frame, table) for table, frame in samples.items()}
    roles: dict[Role, tuple[Part, ...]] = {}
    notes: list[str] = []
    faults: list[Fault] = []
    for role, tables in _candidates(found).items():
        if role in chosen and chosen[role] not in samples:
            raise InputError(f"there is no table {chosen[role]!r}; there are {names_shown(samples)}")
        if not tables and role not in chosen:
            continue
        best = chosen[role] if role in chosen else _best(tables, _HINTS[role])
        notes.extend(_alike(role, best, [t for t in tables if t not in chosen.values()], samples))
        parts = [best, *_rates_beside(best, found)] if role == "imu" else [best]
        made = [_part(found[table], table, role) for table in parts]
        roles[role] = tuple(part for part, _, _ in made)
        notes += [note for _, said, _ in made for note in said]
        faults += [fault for _, _, wrong in made for fault in wrong]
    downward = _downward(found[roles["imu"][0].table]) if "imu" in roles else ""
    return Guess(roles, tuple(dict.fromkeys(notes)), downward=downward, faults=tuple(faults))


def find_columns(frame: pl.DataFrame, table: str = "") -> Columns:
    """Assign columns to quantities; of several candidates the first. x, y, z of an IMU's table are the IMU's."""
    names = [read_name(column) for column in frame.columns]
    columns = Columns(frame)
    for name in names:
        if (what := name.meaning) is not None and what != "t":
            columns.names.setdefault(what, name)
    letter = "a" if _FORCES.search(table) else "g" if _RATES.search(table) else ""
    if letter and not columns.has("lat", "lon"):
        for axis in "xyz":
            if axis in columns:
                columns.names.setdefault(f"{letter}{axis}", columns.names.pop(axis))
    if "ax" in columns and columns.names["ax"].plain == "linear_x" and not _holds_gravity(columns):
        columns.names = {what: name for what, name in columns.names.items() if what not in ("ax", "ay", "az")}
    if _NO_PLACES.search(table) or "q" in columns or letter:
        columns.names = {what: name for what, name in columns.names.items() if what not in ("x", "y")}
    return columns


def _holds_gravity(columns: Columns) -> bool:
    """Whether ax, ay, az are specific forces, in m/s2 or g, and no velocities, which have these names as well."""
    size = columns.norm(["ax", "ay", "az"]) if columns.has("ax", "ay", "az") else 0.0
    return 8.0 < size < 12.0 or 0.85 < size < 1.15


def _candidates(found: Mapping[str, Columns]) -> dict[Role, list[str]]:
    """The tables that could give each role; where one has latitude and longitude, x and y are no fixes."""
    whole = [t for t, c in found.items() if c.has("ax", "ay", "gz")]
    forces = [
        t for t, c in found.items() if c.has("ax", "ay") and not re.search("lin|gravity", t, re.IGNORECASE)
    ]
    rates = [t for t, c in found.items() if c.has("gz")]
    placed = [t for t, c in found.items() if c.has("lat", "lon") and not _TRUTH.search(t)]
    metres = [t for t, c in found.items() if c.has("x", "y") and not _TRUTH.search(t)]
    return {
        "imu": whole or (forces if rates else []),
        "truth": [
            t for t, c in found.items() if _TRUTH.search(t) and (c.has("lat", "lon") or c.has("x", "y"))
        ],
        "gps": placed or metres,
        "odometer": [t for t, c in found.items() if _counted(t, c)],
    }


def _counted(table: str, columns: Columns) -> bool:
    """Whether a table has the wheels' speed: by the column's name, or by the table's where it has no position."""
    located = columns.has("lat", "lon") or columns.has("x", "y")
    return "wheel_speed" in columns or ("speed" in columns and bool(_WHEELS.search(table)) and not located)


def _rates_beside(table: str, found: Mapping[str, Columns]) -> list[str]:
    """The table of angular rates for one that has accelerations alone."""
    if "gz" in found[table]:
        return []
    return [t for t, c in found.items() if "gz" in c and not c.has("ax", "ay")][:1]


def _part(columns: Columns, table: str, role: Role) -> tuple[Part, list[str], list[Fault]]:
    """A table's part in a role, the assumptions, and reasons not to use a column."""
    expressions: dict[str, str] = {}
    notes: list[str] = []
    faults: list[Fault] = []
    for what, found in _expressions(columns, role):
        if found.note:
            notes.append(found.note)
        if found.fault:
            faults.append(Fault(role, what, table, found.fault))
        if found.expression:
            expressions[what] = found.expression
    return Part(table, expressions), notes, faults


def _expressions(columns: Columns, role: Role) -> Iterator[tuple[str, Found]]:
    """The drive's columns of a role, as expressions in a drive's units."""
    time = find_time(columns.frame, role)
    if time is not None:
        yield "t", time
    located = columns.has("lat", "lon")
    if located and role in ("gps", "truth"):
        yield from place(columns, role).items()
    for what in _WANTED[role]:
        if what not in columns or what in ("lat", "lon") or (what in ("x", "y") and located):
            continue
        if what == "wheel_speed" or (what == "speed" and role == "odometer" and "wheel_speed" not in columns):
            yield "speed", quantity(columns, what, role)
        elif what == "bearing" and (
            (role == "truth" and "theta" in columns) or (role == "gps" and "course" in columns)
        ):
            continue
        elif what in ("course", "bearing", "theta"):
            yield ("theta" if role == "truth" else "course"), heading(columns, what, role)
        elif what != "speed" or role in ("gps",):
            yield what, quantity(columns, what, role)


def _downward(imu: Columns) -> str:
    """A sentence where the vertical axis of an IMU points down."""
    middle = numbers_of(imu.frame[imu.names["az"].column]).median() if "az" in imu else 0.0
    if float(middle or 0.0) >= 0:  # pyright: ignore[reportArgumentType]
        return ""
    return (
        f"{imu.names['az'].column} is negative, so that axis points down; where the others point forward "
        "and to the right, say --mount x=x,y=-y; `sigmaswarm doctor` tells whether it was right"
    )


def _alike(
    role: Role, taken: str, tables: Sequence[str], samples: Mapping[str, pl.DataFrame]
) -> Iterator[str]:
    """Tables of the same columns as the one that is taken: another part of the log, or another log."""
    alike = [t for t in tables if t != taken and samples[t].columns == samples[taken].columns]
    if alike:
        yield (
            f"{names_shown(alike)} {'has' if len(alike) == 1 else 'have'} the columns of {taken}, and only {taken} is "
            f"taken for the {role}; choose with --{role}-table, and import each log into a drive of its own"
        )


def _best(tables: Sequence[str], hint: str) -> str:
    """The first table whose name fits, or else the first."""
    return max(tables, key=lambda table: bool(re.search(hint, table, re.IGNORECASE)))
