"""Assign the columns of a log to quantities, as options of `import_log` and of the command line."""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.inspection import Inspection
from sigmaswarm.importing.recipe import COLUMNS
from sigmaswarm.importing.source import ROLES
from sigmaswarm.importing.table_columns import quoted_column
from sigmaswarm.importing.units import factor_of

# Expressions that convert a column to the unit of a drive, by quantity and unit of the column
UNITS: dict[str, dict[str, str]] = {
    "time": {"s": "{}", "ms": "{}*1e-3", "µs": "{}*1e-6", "ns": "{}*1e-9", "date, UTC": "utc({})"},
    "acceleration": {"m/s²": "{}", "g": "{}*9.80665", "mg": "{}*0.00980665", "-m/s²": "-{}", "-g": "-{}*9.80665"},
    "rate": {"rad/s": "{}", "deg/s": "radians({})", "-rad/s": "-{}", "-deg/s": "-radians({})"},
    "degrees": {"deg": "{}", "rad": "degrees({})", "1e-7 deg": "{}*1e-7", "ddmm.mm": "ddmm({})"},
    "length": {"m": "{}", "mm": "{}*1e-3", "cm": "{}*1e-2", "ft": "{}*0.3048", "km": "{}*1e3"},
    "speed": {"m/s": "{}", "km/h": "{}/3.6", "mm/s": "{}*1e-3", "cm/s": "{}*1e-2", "mph": "{}*0.44704",
              "knots": f"{{}}*{factor_of('knots')!r}"},
    "angle": {"rad from east": "{}", "deg from north": "radians(90-{})", "deg from east": "radians({})",
              "rad from north": "pi/2-{}"},
    "deviation": {"rad": "{}", "deg": "radians({})"},
    "condition": {"as it is": "{}"},
    "field": {"as it is": "{}", "reversed": "-{}"},
}  # fmt: skip
KINDS = {
    **dict.fromkeys(("ax", "ay", "az"), "acceleration"),
    **dict.fromkeys(("gx", "gy", "gz"), "rate"),
    **dict.fromkeys(("alt", "x", "y", "std_x", "std_y"), "length"),
    **dict.fromkeys(("speed", "vx", "vy", "forward", "left"), "speed"),
    **dict.fromkeys(("lat", "lon"), "degrees"),
    **dict.fromkeys(("course", "theta", "heading"), "angle"),
    **dict.fromkeys(("mx", "my", "mz"), "field"),
    **{"t": "time", "keep": "condition", "std_heading": "deviation"},
}
LABELS = {"t": "time", "ax": "ax forward", "ay": "ay left", "az": "az up", "gx": "gx roll rate", "gy": "gy pitch rate",
        "gz": "gz yaw rate", "lat": "latitude", "lon": "longitude", "alt": "altitude", "x": "x east", "y": "y north",
        "std_x": "standard deviation east", "std_y": "standard deviation north", "vx": "velocity east",
        "vy": "velocity north", "theta": "heading", "keep": "condition of rows to read"}  # fmt: skip
NAMES = {"imu": "IMU", "gps": "fixes", "truth": "truth", "odometer": "wheels", "mag": "magnetometer"}
UNUSED = ""
TARGETS: dict[str, str] = {UNUSED: "not used"} | {
    f"{role}.{name}": f"{NAMES[role]}: {LABELS.get(name, name)}" for role in ROLES for name in COLUMNS[role]
}
CUSTOM = "expression"
GIVEN = ("gps", "truth", "tables", "maps")

FLAGS = {
    "mount": "--mount",
    "gps_offset_s": "--gps-offset",
    "gps_lever_arm_m": "--lever-arm",
    "part": "--part",
}
Uses = dict[tuple[str, str], list[tuple[str, str]]]  # by table and column: targets and their expressions


def uses_of(inspection: Inspection) -> Uses:
    uses: Uses = {}
    names = {preview.table: [r.column for r in preview.ranges] for preview in inspection.tables}
    for role, parts in inspection.recipe.roles.items():
        for part in parts:
            table = part.table or next(iter(names), "")
            for target, expression in part.columns.items():
                for column in names.get(table, ()):
                    if mentions(expression, column):
                        found = uses.setdefault((table, column), [])
                        found.append((f"{role}.{target.removeprefix('+')}", expression))
    return uses


def mentions(text: str, column: str) -> bool:
    return re.search(rf"(?<![\w.]){re.escape(column)}(?![\w.])", text) is not None


def units_of(target: str) -> dict[str, str]:
    return UNITS[KINDS.get(target.partition(".")[2], "length")]


def unit_in(target: str, column: str, expression: str) -> str:
    """Return the unit from which an expression converts, or `CUSTOM` if the unit is not in `units_of`."""
    plain = expression.replace(" ", "")
    for unit, text in units_of(target).items():
        if plain in (text.format(quoted_column(column)).replace(" ", ""), text.format(column)):
            return unit
    return CUSTOM


def expression_of(target: str, column: str, unit: str = "") -> str:
    """Return the expression that converts a column from a unit, by default the first of `units_of`."""
    units = units_of(target)
    return (units[unit] if unit else next(iter(units.values()))).format(quoted_column(column))


def assign(choices: dict[str, Any], inspection: Inspection, table: str, column: str, target: str) -> None:
    """Assign a column to a target, and remove it from its previous targets other than times.

    The expression is the one that a note proposes for this column; without such a note, the target's first unit is
    assumed.
    """
    maps: dict[str, str] = choices.setdefault("maps", {})
    for old, _ in uses_of(inspection).get((table, column), []):
        if old != target and not old.endswith(".t"):
            maps[old] = ""
    if not target:
        return
    role = target.partition(".")[0]
    noted = (
        text for note in inspection.notes for text in re.findall(rf'"{re.escape(target)}=([^"]*)"', note)
    )
    maps[target] = next((text for text in noted if mentions(text, column)), expression_of(target, column))
    tables = {part.table for name, parts in inspection.recipe.roles.items() if name == role for part in parts}
    if len(inspection.tables) > 1 and table not in tables:
        choices.setdefault("tables", {})[role] = table


def settings_of(choices: Mapping[str, Any]) -> dict[str, Any]:
    settings = {key: choices[key] for key in (*GIVEN, *FLAGS) if choices.get(key)}
    if arm := settings.get("gps_lever_arm_m"):
        try:
            forward, left, up = (float(v) for v in arm.split(","))
        except ValueError:
            raise InputError(
                f"{arm!r} is not a lever arm; write forward,left,up in m, for example 1.2,0,0.5"
            ) from None
        settings["gps_lever_arm_m"] = forward, left, up
    return settings


def command_of(log: Path, out: Path, choices: Mapping[str, Any]) -> str:
    words = ["sigmaswarm", "import", str(log), "--out", str(out)]
    for key in ("gps", "truth"):
        words += [f"--{key}", choices[key]] if choices.get(key) else []
    for role, table in choices.get("tables", {}).items():
        words += [f"--{role}-table", table]
    if maps := choices.get("maps"):
        words += ["--map", *(f"{target}={text}" for target, text in maps.items())]
    words += [f"{flag}={choices[key]}" for key, flag in FLAGS.items() if choices.get(key)]
    return shlex.join(words)
