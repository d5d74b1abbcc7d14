"""The recipe: columns and settings with which a log becomes a drive, also as a TOML file."""

import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self, cast

import tomli_w

from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import read_toml_text
from sigmaswarm.files import make_folder, write_atomically
from sigmaswarm.importing.source import ROLES, Part, Role
from sigmaswarm.wording import printable, printable_value, quoted

# Columns of each role: those of a drive (docs/drives.md), and ``vx, vy`` of fixes (m/s east, north); ``forward, left``
# (m/s in the body frame), ``speed, course`` and ``lat, lon, alt`` of the truth; ``keep``, true for the rows to read.
# ``+ax`` of a second table is added to ``ax``.
COLUMNS: dict[Role, tuple[str, ...]] = {
    "imu": ("t", "ax", "ay", "az", "gx", "gy", "gz", "keep"),
    "gps": (
        *("t", "lat", "lon", "alt", "x", "y", "std_x", "std_y"),
        *("speed", "course", "heading", "std_heading", "vx", "vy", "keep"),
    ),
    "truth": (
        *("t", "x", "y", "lat", "lon", "alt", "vx", "vy"),
        *("speed", "course", "forward", "left", "theta", "keep"),
    ),
    "odometer": ("t", "speed", "keep"),
    "mag": ("t", "mx", "my", "mz", "keep"),
}

# Types of the settings, or lengths of lists of numbers
_SETTINGS: dict[str, type | int] = {
    "mount": str,
    **dict.fromkeys(("gps_offset_s", "truth_offset_s", "odometer_offset_s", "declination_deg"), float),
    **{"origin": 3, "gps_lever_arm_m": 3, "gps_from_truth": 2},
}


@dataclass(frozen=True)
class Recipe:
    """Expressions of a drive's columns over the columns of a log, and settings of the import."""

    roles: Mapping[Role, tuple[Part, ...]] = field(default_factory=dict[Role, tuple[Part, ...]])
    mount: str = ""  # mounting of the IMU in the vehicle: see `parse_mount`
    gps_offset_s: float = 0.0  # added to the times of the fixes
    truth_offset_s: float = 0.0  # added to the times of the truth
    odometer_offset_s: float = 0.0  # added to the times of the odometer
    # deg from true to magnetic north, east positive; None: the course of the fixes replaces it
    declination_deg: float | None = None
    origin: tuple[float, float, float] | None = None  # deg, deg, m, of the local frame
    gps_lever_arm_m: tuple[float, float, float] | None = None  # forward, left, up from IMU to antenna
    # Rate, Hz, and standard deviation of the white noise, m per axis, of fixes made from the truth
    gps_from_truth: tuple[float, float] | None = None

    @classmethod
    def load(cls, path: Path) -> Self:
        try:
            text = read_toml_text(path)
        except OSError as error:
            raise InputError(f"{path}: can't be read ({error.strerror}); specify a recipe file") from None
        except UnicodeDecodeError as error:
            raise InputError(
                f"{path} is not valid TOML: {printable(error, 160)}; write it as UTF-8"
            ) from None
        try:
            content = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # also numbers of 5000 digits, and lists 3000 deep
            raise InputError(
                f"{path} is not valid TOML: {printable(error, 160)}; correct that line"
            ) from None
        known = (*ROLES, *_SETTINGS)
        if unknown := sorted(set(content) - set(known)):
            raise InputError(f"{path}: {quoted(unknown[0])} is unknown; the keys are {', '.join(known)}")
        settings = {key: _setting(content[key], key, path) for key in _SETTINGS if key in content}
        there: list[Role] = [role for role in ROLES if role in content]
        return cls(roles={role: tuple(_parts(content[role], role, path)) for role in there}, **settings)

    def to_toml(self) -> str:
        content: dict[str, Any] = {k: v for k in _SETTINGS if (v := getattr(self, k)) != getattr(Recipe, k)}
        for role, parts in self.roles.items():
            content[role] = [{"table": part.table, **part.columns} for part in parts]
        return tomli_w.dumps(content)

    def imu_axes(self) -> dict[str, str]:
        """Return the expression of each axis of the IMU, with its table if there are several."""
        axes: dict[str, str] = {}
        parts = self.roles.get("imu", ())
        for part in parts:
            table = os.fsencode(part.table).decode("utf-8", "replace")  # a name may not be valid UTF-8
            for name, text in part.columns.items():
                axis, text = name.removeprefix("+"), f"{text} of {table}" if len(parts) > 1 else text
                axes[axis] = f"{axes[axis]} + {text}" if axis != name and axis in axes else text
        return {axis: text for axis, text in axes.items() if axis not in ("t", "keep")}

    def map_arguments(self) -> Iterator[str]:
        """Describe the recipe as arguments of ``--map``, one line per table."""
        for role, parts in self.roles.items():
            for part in parts:
                of = f" from {part.table}" if part.table else ""
                yield f"{role}{of}: {', '.join(f'{k}={v}' for k, v in part.columns.items())}"

    def save(self, path: Path) -> None:
        make_folder(path.parent, "specify another file")
        write_atomically(path, "# How `sigmaswarm import` makes a drive from a log.\n" + self.to_toml())


def _setting(value: Any, key: str, path: Path) -> Any:
    kind = _SETTINGS[key]
    if kind is str and isinstance(value, str):
        return value
    values = cast("list[Any]", value if isinstance(kind, int) and isinstance(value, list) else [value])
    wanted = kind if isinstance(kind, int) else 1
    sound = len(values) == wanted and all(type(v) in (int, float) and abs(v) < 1e300 for v in values)
    if kind is not str and sound:
        return tuple(map(float, values)) if isinstance(kind, int) else float(values[0])
    what = f"{kind} numbers" if isinstance(kind, int) else "text" if kind is str else "a number"
    raise InputError(f"{path}: {key} = {printable_value(value)} is not valid; write {what}")


def _parts(content: Any, role: Role, path: Path) -> Iterator[Part]:
    for entry in cast("list[Any]", content if isinstance(content, list) else [content]):
        if not isinstance(entry, dict):
            raise InputError(
                f"{path}: {role} = {printable_value(entry)} is not valid; write [[{role}]] and its columns below"
            )
        cells = cast("dict[str, Any]", entry)
        columns = {str(k): v if isinstance(v, str) else printable_value(v) for k, v in cells.items()}
        table = columns.pop("table", "")
        if unknown := sorted(c for c in columns if c.removeprefix("+") not in COLUMNS[role]):
            raise InputError(
                f"{path}: {quoted(unknown[0])} under [[{role}]] is unknown; use {', '.join(COLUMNS[role])}"
            )
        yield Part(table, columns)


def with_maps(
    roles: Mapping[Role, tuple[Part, ...]], maps: Sequence[str], times: Mapping[Role, str]
) -> dict[Role, tuple[Part, ...]]:
    """Replace expressions by those of the user: ``ax=-acc_y*9.80665`` or ``gps.t=stamp``; "az=" omits a column.

    ``times`` contains expressions of the times by role, which are used unless the user maps the times of this role.
    """
    mapped: dict[Role, list[Part]] = {role: list(parts) for role, parts in roles.items()}
    timed: set[Role] = set()
    for role, column, expression in map(_entry, maps):
        parts = mapped.setdefault(role, [])
        parts += [] if parts else [Part("", {})]
        place = next((i for i, part in enumerate(parts) if column in part.columns), 0)
        columns = {**parts[place].columns, column: expression}
        if column == "t":
            timed.add(role)
        elif not expression:
            del columns[column]
        parts[place] = replace(parts[place], columns=columns)
    for role, time in times.items():
        if role in mapped and role not in timed:
            mapped[role] = [replace(part, columns={**part.columns, "t": time}) for part in mapped[role]]
    return {role: tuple(parts) for role, parts in mapped.items()}


def mapped_roles(maps: Sequence[str]) -> frozenset[str]:
    """Return the roles with mapped columns other than the time."""
    return frozenset(role for role, column in mapped_columns(maps) if column != "t")


def mapped_columns(maps: Sequence[str]) -> frozenset[tuple[Role, str]]:
    """Return the roles and columns of mappings; skip invalid entries, which `with_maps` rejects."""
    columns: set[tuple[Role, str]] = set()
    for text in maps:
        with suppress(InputError):
            columns.add(_entry(text)[:2])
    return frozenset(columns)


def _entry(text: str) -> tuple[Role, str, str]:
    target, equals, expression = text.partition("=")
    prefix, dot, column = target.strip().rpartition(".")
    if not equals:
        raise InputError(f'--map {text!r} is not a mapping; write for example --map "ax=-acc_y*9.80665"')
    if dot and prefix not in ROLES:
        raise InputError(
            f"--map {text!r}: {prefix!r} is not one of {', '.join(ROLES)}; write for example gps.t=stamp"
        )
    roles: list[Role] = [role for role in ROLES if prefix in ("", role)]
    for role in roles:  # without a role, x and y belong to the fixes, t and keep to the IMU
        if column in COLUMNS[role]:
            return role, column, expression.strip()
    there = dict.fromkeys(c for role in roles for c in COLUMNS[role])
    raise InputError(f"--map {text!r}: a drive has no column {column!r}; choose from {', '.join(there)}")
