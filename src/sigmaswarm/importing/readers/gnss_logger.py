"""Android's GnssLogger: one text file with several kinds of lines. Comments at the top list the columns of each kind.

LOGGING.md of the app describes the kinds: Fix (degrees, m/s, bearing from north; AccuracyMeters is the radius of a 68%
circle), Accel or UncalAccel with gravity (m/s2), Gyro or UncalGyro (rad/s). All kinds have the clock
``elapsedRealtimeNanos``, except for Fix in older logs; then all times are UTC in milliseconds.
"""

from contextlib import ExitStack
from pathlib import Path

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.positions import FLAT_NOTE, RADIUS_68
from sigmaswarm.importing.readers.columns import log_of_files
from sigmaswarm.importing.readers.scanning import collect, text_lines
from sigmaswarm.importing.source import (
    Guess,
    Limits,
    Log,
    Role,
    Wanted,
    first_bytes,
    require_distinct,
    roles_of,
)

_KINDS = ("Fix", "Accel", "UncalAccel", "Gyro", "UncalGyro")
_MARKS = (b"# Fix,Provider", b"# Raw,utcTimeMillis", b"# Raw,ElapsedRealtimeMillis")
_CLOCK = "elapsedRealtimeNanos"
_FIX: dict[str, str | tuple[str, ...]] = {
    "lat": "LatitudeDegrees",
    "lon": "LongitudeDegrees",
    "alt": ("AltitudeMeters",),
    "speed": ("SpeedMps",),
    "course": ("radians(90 - BearingDegrees)",),
    "std_x": (f"AccuracyMeters/{RADIUS_68}",),
    "std_y": (f"AccuracyMeters/{RADIUS_68}",),
    "keep": "Provider == 'GPS' or Provider == 'gps'",  # excludes fused fixes and network fixes
}


def recognizes(path: Path) -> bool:
    head = first_bytes(path, 16384)
    return any(mark in head for mark in _MARKS)


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    columns: dict[str, list[str]] = {}
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            if not line.startswith("#"):
                break
            kind, *names = line.lstrip("# ").strip().split(",")
            if kind in _KINDS:
                columns[kind] = names
    kind = pl.col("line").str.extract(rf"^({'|'.join(_KINDS)}),").alias("kind")
    lines = (
        text_lines(path, 0).with_row_index("row", 1).with_columns(kind).filter(pl.col("kind").is_not_null())
    )
    present = set(collect(lines.select(pl.col("kind").unique()), path, path.name)["kind"])
    columns = {kind: names for kind, names in columns.items() if kind in present}
    for names in columns.values():
        require_distinct(names, path)
    _require_one_clock(columns, path)
    if not columns:
        raise InputError(f"{path}: contains no lines of {', '.join(_KINDS)}; record fixes and sensors")
    cells = pl.col("line").str.count_matches(",", literal=True)
    widths = pl.col("kind").replace_strict({k: len(n) for k, n in columns.items()}, default=0)
    for row, line, _ in collect(lines.filter(cells < widths).head(1), path, path.name).iter_rows():
        raise InputError(f"{path}, row {row}: {line.strip()[:40]!r} is cut short; delete the row")
    scans = {kind: _cells(lines.filter(pl.col("kind") == kind), names) for kind, names in columns.items()}
    return log_of_files(path, scans, "lines", _guess(columns))


def _cells(lines: pl.LazyFrame, names: list[str]) -> pl.LazyFrame:
    cells = pl.col("line").str.strip_chars().str.splitn(",", len(names) + 2)
    whole = cells.struct.rename_fields(["kind ", *names, "surplus "])
    return lines.select(whole.alias("cells")).unnest("cells").select(names)


def _require_one_clock(columns: Wanted, path: Path) -> None:
    """Refuse a sensor without the common clock if another sensor has it, since a header comment is then damaged."""
    clock = {kind: _CLOCK in names for kind, names in columns.items() if kind != "Fix"}
    if any(clock.values()) and not all(clock.values()):
        kind = next(kind for kind, found in clock.items() if not found)
        raise InputError(
            f"{path}: the header comment of {kind} lacks the column {_CLOCK}, which other header comments contain; "
            "correct this line of the log"
        )


def _guess(columns: Wanted) -> Guess:
    shared = all(_CLOCK in names for names in columns.values())
    t = f"{_CLOCK}*1e-9" if shared else "utcTimeMillis*1e-3"
    fix = {"t": t if shared else ("`UnixTimeMillis`*1e-3", "`(UTC)TimeInMs`*1e-3"), **_FIX}
    parts: list[tuple[Role, str, dict[str, str | tuple[str, ...]]]] = [("gps", "Fix", fix)]
    acceleration, gyro = ([k for k in kinds if k in columns] for kinds in (_KINDS[1:3], _KINDS[3:]))
    if acceleration and gyro:
        x, y, z = (f"{acceleration[0]}{axis}Mps2" for axis in "XYZ")
        p, q, r = (f"{gyro[0]}{axis}RadPerSec" for axis in "XYZ")
        parts.append(("imu", acceleration[0], {"t": t, "ax": y, "ay": f"-{x}", "az": z}))
        parts.append(("imu", gyro[0], {"t": t, "gx": q, "gy": f"-{p}", "gz": r}))
    lacking = [kind for kind, names in columns.items() if _CLOCK not in names]
    note = f"{', '.join(lacking)}: the column {_CLOCK} is missing, so all times are UTC in milliseconds"
    notes = (note,) if lacking else ()
    return Guess(roles_of(parts, columns), notes, flat=FLAT_NOTE)
