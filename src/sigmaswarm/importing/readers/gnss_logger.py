"""Android's GnssLogger: one text with lines of several kinds, each kind's columns in a comment at the top.

LOGGING.md of the app's public descriptions: Fix (degrees, m/s, AccuracyMeters a circle with 68%, bearing from north),
Accel or UncalAccel with gravity (m/s2), Gyro or UncalGyro (rad/s). ``elapsedRealtimeNanos`` is one clock for all; older
logs have it not in Fix, then the milliseconds of UTC serve.
"""

from collections.abc import Collection, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.phones import FLAT, RADIUS_68
from sigmaswarm.importing.source import (
    CHUNK,
    Batch,
    Choice,
    Guess,
    Part,
    Role,
    Source,
    Table,
    first_bytes,
    require_distinct,
)

_KINDS = ("Fix", "Accel", "UncalAccel", "Gyro", "UncalGyro")


def recognizes(path: Path) -> bool:
    """Return True if its comments name the kinds of lines."""
    head = first_bytes(path, 16384)
    return (
        b"# Fix,Provider" in head or b"# Raw,utcTimeMillis" in head or b"# Raw,ElapsedRealtimeMillis" in head
    )


@dataclass(frozen=True)
class _Lines:
    """An open text: each kind of line is a table."""

    path: Path
    tables: Mapping[str, Table]
    remarks: tuple[str, ...] = ()
    interleaved: ClassVar[bool] = True

    def batches(self, wanted: Mapping[str, Collection[str]]) -> Iterator[Batch]:
        """Some thousand lines of a kind at a time."""
        size, read = self.path.stat().st_size, 0
        rows: dict[str, list[list[str]]] = {table: [] for table in wanted}
        with self.path.open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, 1):
                read += len(line)
                kind, _, rest = line.partition(",")
                if kind not in rows:
                    continue
                cells = rest.strip().split(",")
                if len(cells) < len(self.tables[kind].columns):
                    raise InputError(
                        f"{self.path}, row {number}: {line.strip()[:40]!r} is cut short; delete the row"
                    )
                rows[kind].append(cells[: len(self.tables[kind].columns)])
                if sum(map(len, rows.values())) >= CHUNK:
                    for full in wanted:
                        if rows[full]:
                            yield self._batch(full, rows, wanted, min(read / size, 1.0))
        for kind in wanted:
            if rows[kind]:
                yield self._batch(kind, rows, wanted, 1.0)

    def _batch(
        self, kind: str, rows: dict[str, list[list[str]]], wanted: Mapping[str, Collection[str]], done: float
    ) -> Batch:
        taken, rows[kind] = rows[kind], []
        frame = pl.DataFrame(taken, schema=dict.fromkeys(self.tables[kind].columns, pl.String), orient="row")
        return Batch(kind, frame.select(list(wanted[kind])), done)

    def guess(self, choice: Choice) -> Guess:
        """As the app's documents say."""
        roles: dict[Role, tuple[Part, ...]] = {}
        acceleration = next((k for k in ("Accel", "UncalAccel") if k in self.tables), None)
        gyro = next((k for k in ("Gyro", "UncalGyro") if k in self.tables), None)
        clock = "elapsedRealtimeNanos"
        shared = all(clock in table.columns for table in self.tables.values())
        notes = [FLAT] + (
            [] if shared else ["Fix has no elapsedRealtimeNanos: times are the milliseconds of UTC"]
        )
        if acceleration and gyro:
            t = f"{clock}*1e-9" if shared else "utcTimeMillis*1e-3"
            x, y, z = (f"{acceleration}{axis}Mps2" for axis in "XYZ")
            p, q, r = (f"{gyro}{axis}RadPerSec" for axis in "XYZ")
            roles["imu"] = (
                Part(acceleration, {"t": t, "ax": y, "ay": f"-{x}", "az": z}),
                Part(gyro, {"t": t, "gx": q, "gy": f"-{p}", "gz": r}),
            )
        if "Fix" in self.tables:
            roles["gps"] = (Part("Fix", _fix(self.tables["Fix"].columns, shared)),)
        return Guess(roles, tuple(notes))


def _fix(columns: Collection[str], shared: bool) -> dict[str, str]:
    """The receiver's own fixes, not those that Android fuses or takes from the network."""
    utc = next((c for c in ("UnixTimeMillis", "(UTC)TimeInMs") if c in columns), "UnixTimeMillis")
    named = {"alt": "AltitudeMeters", "speed": "SpeedMps"}
    found = {"t": "elapsedRealtimeNanos*1e-9" if shared else f"`{utc}`*1e-3"}
    found |= {"lat": "LatitudeDegrees", "lon": "LongitudeDegrees"}
    found |= {target: column for target, column in named.items() if column in columns}
    if "BearingDegrees" in columns:
        found["course"] = "radians(90 - BearingDegrees)"
    if "AccuracyMeters" in columns:
        found["std_x"] = found["std_y"] = f"AccuracyMeters/{RADIUS_68}"
    return {**found, "keep": "Provider == 'GPS' or Provider == 'gps'"}


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Read the comments, and lines when they are wanted."""
    tables: dict[str, Table] = {}
    present = _kinds_present(path)
    with path.open(encoding="utf-8", errors="replace") as file:
        for line in file:
            if not line.startswith("#"):
                break
            kind, *columns = line.lstrip("# ").strip().split(",")
            if kind in present:
                require_distinct(columns, path)
                tables[kind] = Table(tuple(columns), "lines")
    if not tables:
        raise InputError(f"{path}: holds no lines of {', '.join(_KINDS)}; log fixes and sensors")
    yield _Lines(path, tables)


def _kinds_present(path: Path) -> set[str]:
    """The kinds of lines of which there is at least one: comments name also what was not logged."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return {kind for line in file if (kind := line.partition(",")[0]) in _KINDS}
