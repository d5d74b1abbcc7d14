"""The tables of a drive: frozen records of columns, with the time of each row."""

from dataclasses import MISSING, dataclass, fields
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from sigmaswarm import notebook
from sigmaswarm.arrays import Array
from sigmaswarm.errors import DriveError

if TYPE_CHECKING:
    import pandas as pd

Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of equal length, converted to read-only float64."""

    time: Array

    def __post_init__(self) -> None:
        length = np.size(self.time)
        for name, values in list(vars(self).items()):
            if values is None:
                continue
            column = np.array(values, dtype=np.float64)
            if column.shape != (length,):
                kind = type(self).__name__
                raise DriveError(
                    f"{kind}.{name} has shape {column.shape}, but {kind}.time has {length} values"
                )
            column.setflags(write=False)
            object.__setattr__(self, name, column)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def interval(self) -> float:
        """Median time from one row to the next, s; NaN for a single row."""
        return float(np.median(np.diff(self.time))) if len(self) > 1 else np.nan

    def select(self, rows: NDArray[np.bool_] | slice) -> Self:
        chosen: dict[str, Any] = {name: v if v is None else v[rows] for name, v in vars(self).items()}
        return type(self)(**chosen)

    def to_pandas(self) -> "pd.DataFrame":
        """Return the existing columns as a data frame, in the units of the attributes.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        return notebook.to_pandas({name: v for name, v in vars(self).items() if v is not None})


IMU_AXES = ("ax", "ay", "az", "gx", "gy", "gz")


@dataclass(frozen=True, eq=False)
class Imu(Table):
    """Inertial samples, each column of shape (n,), in the body frame (x forward, y left, z up).

    Attributes
    ----------
    time : s, strictly increasing
    ax, ay, az : specific force, m/s2 (az is about +9.8 at rest)
    gx, gy, gz : angular rate, rad/s
    """

    ax: Array
    ay: Array
    gz: Array
    az: Array | None = None
    gx: Array | None = None
    gy: Array | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the existing axes, in the order of `IMU_AXES`."""
        return tuple(axis for axis in IMU_AXES if getattr(self, axis) is not None)


NO_HEADING = np.pi  # rad; a fix whose heading has this or a larger stated standard deviation has no heading


@dataclass(frozen=True, eq=False)
class Gps(Table):
    """Position fixes, each column of shape (n,).

    Attributes
    ----------
    time : s, strictly increasing in files; in memory, fixes of two receivers may have equal times
    x, y : m east and north of the drive's origin
    lat, lon, alt : deg, deg, m: the recorded fixes, if they are in WGS-84
    std_x, std_y : m, the receiver's stated standard deviation
    speed, course : m/s; rad, counter-clockwise from east
    heading : rad, counter-clockwise from east, from two antennas or a compass; filters can then start at rest
    std_heading : rad, stated standard deviation of the heading; `NO_HEADING` or more if the fix has no heading
    """

    x: Array
    y: Array
    lat: Array | None = None
    lon: Array | None = None
    alt: Array | None = None
    std_x: Array | None = None
    std_y: Array | None = None
    speed: Array | None = None
    course: Array | None = None
    heading: Array | None = None
    std_heading: Array | None = None

    @property
    def position(self) -> NDArray[np.complex128]:
        """East + i north, m."""
        return self.x + 1j * self.y

    @property
    def std(self) -> Array | None:
        """Stated standard deviations, shape (2, n), m east and north; None if not stated."""
        return _pair(self.std_x, self.std_y)

    @property
    def velocity(self) -> Array | None:
        """Velocity over ground, shape (2, n), m/s east and north; None if speed or course is missing."""
        if self.speed is None or self.course is None:
            return None
        return self.speed * np.array([np.cos(self.course), np.sin(self.course)])


def _pair(x: Array | None, y: Array | None) -> Array | None:
    return None if x is None or y is None else np.array([x, y])


def headings_of(gps: Gps) -> tuple[Array, Array]:
    """Return the heading (rad) and stated variance (rad2; infinite without a heading) of each fix."""
    if gps.heading is None:
        return np.zeros(len(gps.time)), np.full(len(gps.time), np.inf)
    std = np.zeros(len(gps.time)) if gps.std_heading is None else gps.std_heading
    return gps.heading, np.where(np.isfinite(gps.heading) & (std < NO_HEADING), std**2, np.inf)


@dataclass(frozen=True, eq=False)
class Odometer(Table):
    """The speed of the wheels, each column of shape (n,).

    Attributes
    ----------
    time : s, strictly increasing
    speed : m/s, forward positive, at the rear axle; with scale error, quantization and slip
    """

    speed: Array


@dataclass(frozen=True, eq=False)
class Truth(Table):
    """The vehicle's true motion at the IMU, each column of shape (n,). Filters never use the truth.

    Attributes
    ----------
    time : s, strictly increasing
    x, y : m east and north of the drive's origin
    vx, vy : m/s east and north
    theta : rad, heading counter-clockwise from east; may be unwrapped
    std_x, std_y : m, standard deviation of the truth, if known
    std_theta : rad, standard deviation of the true heading
    """

    x: Array
    y: Array
    vx: Array
    vy: Array
    theta: Array
    std_x: Array | None = None
    std_y: Array | None = None
    std_theta: Array | None = None

    @property
    def std(self) -> Array | None:
        """Standard deviations of the position, shape (2, n), m; None if unknown."""
        return _pair(self.std_x, self.std_y)

    def __post_init__(self) -> None:
        super().__post_init__()
        none = self.std_x is None
        if none != (self.std_y is None) or (none and self.std_theta is not None):
            raise DriveError(
                "Truth accepts std_x and std_y only together, and std_theta only with these two; add the missing arrays"
            )


RECORDS: dict[str, type[Table]] = {"imu": Imu, "gps": Gps, "truth": Truth, "odometer": Odometer}


def _columns(table: type[Table]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    required = {("t" if f.name == "time" else f.name): f.default is MISSING for f in fields(table)}
    return tuple(c for c, r in required.items() if r), tuple(c for c, r in required.items() if not r)


COLUMNS = {name: _columns(table) for name, table in RECORDS.items()}
COLUMNS["enu"] = COLUMNS["gps"]
COLUMNS["wgs84"] = ("t", "lat", "lon"), tuple(c for c in COLUMNS["gps"][1] if c not in ("lat", "lon"))
"""Required and optional columns of each table; those of the table gps depend on the frame."""
