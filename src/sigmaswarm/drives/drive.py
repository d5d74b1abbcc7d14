"""The Drive: one recorded or simulated journey, as frozen arrays."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from sigmaswarm import notebook
from sigmaswarm.errors import DriveError

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
T = TypeVar("T")


def listed(given: Iterable[T] | T) -> list[T]:
    """Return one or many as a list."""
    return list(cast("Iterable[T]", given)) if isinstance(given, Iterable) else [given]


class _Table:
    """Columns of equal length, made read-only float64 when the record is built."""

    time: Array

    def __post_init__(self) -> None:
        length = np.size(self.time)
        for f in fields(self):  # pyright: ignore[reportArgumentType]
            values = getattr(self, f.name)
            if values is None:
                continue
            column = np.array(values, dtype=np.float64)
            if column.shape != (length,):
                name = type(self).__name__
                raise DriveError(
                    f"{name}.{f.name} has shape {column.shape}, but {name}.time has {length} values"
                )
            column.setflags(write=False)
            object.__setattr__(self, f.name, column)

    def __len__(self) -> int:
        return len(self.time)

    def select(self, rows: NDArray[np.bool_] | slice) -> Self:
        """Return the table with some of its rows (a mask or a slice)."""
        columns = {f.name: getattr(self, f.name) for f in fields(self)}  # pyright: ignore[reportArgumentType]
        return type(self)(**{k: None if v is None else v[rows] for k, v in columns.items()})

    def to_pandas(self) -> "pd.DataFrame":
        """Return the existing columns, in the order and units of the attributes; needs pandas.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        columns = {f.name: getattr(self, f.name) for f in fields(self)}  # pyright: ignore[reportArgumentType]
        return notebook.to_pandas({name: column for name, column in columns.items() if column is not None})


@dataclass(frozen=True, eq=False)
class Imu(_Table):
    """Inertial samples, each column of shape (n,), in the body frame (x forward, y left, z up).

    Attributes
    ----------
    time : s, strictly increasing
    ax, ay, az : specific force, m/s2 (az is about +9.8 at rest)
    gx, gy, gz : angular rate, rad/s
    """

    time: Array
    ax: Array
    ay: Array
    gz: Array
    az: Array | None = None
    gx: Array | None = None
    gy: Array | None = None


@dataclass(frozen=True, eq=False)
class Gps(_Table):
    """Position fixes, each column of shape (n,).

    Attributes
    ----------
    time : s, increasing; strictly so in files. Two receivers may give fixes of one time, used in order
    x, y : m east and north of the drive's origin
    lat, lon, alt : deg, deg, m: the recorded fixes, if the log has them in WGS-84
    std_x, std_y : m, the receiver's stated standard deviation
    speed, course : m/s; rad, counter-clockwise from east
    """

    time: Array
    x: Array
    y: Array
    lat: Array | None = None
    lon: Array | None = None
    alt: Array | None = None
    std_x: Array | None = None
    std_y: Array | None = None
    speed: Array | None = None
    course: Array | None = None


@dataclass(frozen=True, eq=False)
class Odometer(_Table):
    """The speed of the wheels, each column of shape (n,).

    Attributes
    ----------
    time : s, strictly increasing
    speed : m/s, forward positive, at the rear axle; with scale error, quantization and slip
    """

    time: Array
    speed: Array


@dataclass(frozen=True, eq=False)
class Truth(_Table):
    """The vehicle's true motion at the IMU's place, each column of shape (n,). A filter never sees it.

    Attributes
    ----------
    time : s, strictly increasing
    x, y : m east and north of the drive's origin
    vx, vy : m/s east and north
    theta : rad, heading counter-clockwise from east; may be unwrapped
    std_x, std_y : m, standard deviation of the truth, if known: both or none
    std_theta : rad, that of its heading
    """

    time: Array
    x: Array
    y: Array
    vx: Array
    vy: Array
    theta: Array
    std_x: Array | None = None
    std_y: Array | None = None
    std_theta: Array | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.std_x is None) != (self.std_y is None) or (
            self.std_x is None and self.std_theta is not None
        ):
            raise DriveError(
                "Truth states std_x and std_y both, and with them std_theta, or none; add what lacks"
            )


@dataclass(frozen=True, eq=False)
class Drive:
    """One journey: the measurements and, where known, the truth.

    Attributes
    ----------
    name : str
    imu : Imu
    gps : Gps
    truth : Truth or None
    frame : {"enu", "wgs84"}
        In which form the fixes were recorded; ``gps.x`` and ``gps.y`` are always metres.
    origin : (latitude deg, longitude deg, altitude m) or None
        Where the local frame touches the earth. Always known when ``frame`` is "wgs84".
    metadata : mapping
        Every other key of drive.toml, kept as it was.
    odometer : Odometer or None
    """

    name: str
    imu: Imu
    gps: Gps
    truth: Truth | None = None
    frame: Literal["enu", "wgs84"] = "enu"
    origin: tuple[float, float, float] | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict[str, Any])
    odometer: Odometer | None = None

    @classmethod
    def from_frames(
        cls,
        imu: Any,
        gps: Any,
        truth: Any = None,
        odometer: Any = None,
        *,
        name: str = "drive",
        origin: tuple[float, float, float] | None = None,
        columns: Mapping[str, str] | None = None,
    ) -> "Drive":
        """Make a drive of data frames: those of pandas or polars, or mappings of column names to arrays.

        Parameters
        ----------
        imu : frame with columns t, ax, ay, gz and perhaps az, gx, gy
            s; m/s2; rad/s, in the body frame: x forward, y left, z up.
        gps : frame with columns t and x, y (m) or lat, lon (deg), perhaps alt, std_x, std_y (m), speed, course
        truth : frame with columns t, x, y (m), vx, vy (m/s), theta (rad), optional
        odometer : frame with columns t, speed (m/s), optional
        name : str
        origin : (latitude deg, longitude deg, altitude m), optional
            Where x = y = 0; by default the first fix that has lat and lon.
        columns : mapping, optional
            Your names to the names above: ``{"acc_x": "ax"}``.

        Returns
        -------
        Drive
            Times may be seconds or dates, in a column ``t`` or ``time`` or as a pandas index. Dates become seconds
            since the first IMU sample, whose Unix time is ``metadata["time_origin_s"]``.

        Raises
        ------
        DriveError
            A column is missing, not numeric, not finite or out of range, or times do not increase; one line gives
            table, column and row (from 0).

        Warns
        -----
        SigmaswarmWarning
            Unknown columns (ignored).
        DriveWarning
            Gaps, and values that look like other units or axes.

        Examples
        --------
        >>> import numpy as np, polars as pl, sigmaswarm
        >>> t = np.arange(0, 60, 0.01)
        >>> imu = pl.DataFrame({"t": t, "ax": 0 * t, "ay": 0 * t, "gz": 0 * t})
        >>> gps = {"t": t[::20], "x": 10 * t[::20], "y": 0 * t[::20]}
        >>> sigmaswarm.Drive.from_frames(imu, gps).duration
        59.99
        """
        from sigmaswarm.drives.frames import drive_from_tables  # it imports this file

        return drive_from_tables(imu, gps, truth, odometer, name=name, origin=origin, columns=columns)

    from_arrays = from_frames

    @property
    def nominal_interval(self) -> float:
        """The median time between IMU samples, s: the step that process noise refers to."""
        return float(np.median(np.diff(self.imu.time)))

    @property
    def lever_arm(self) -> Array:
        """From the IMU to the antenna, m forward and left, shape (2,): ``gps_lever_arm_m`` of drive.toml, or none."""
        return np.array(self.metadata.get("gps_lever_arm_m", (0.0, 0.0))[:2], dtype=np.float64)

    @property
    def antenna_height(self) -> float:
        """From the IMU up to the antenna, m: the third number of ``gps_lever_arm_m``, or none."""
        arm = self.metadata.get("gps_lever_arm_m", ())
        return float(arm[2]) if len(arm) > 2 else 0.0

    @property
    def heading(self) -> float | None:
        """Heading at the first IMU sample, rad, as ``heading_deg`` of drive.toml states it; None if it does not."""
        stated = self.metadata.get("heading_deg")
        return None if stated is None else float(np.radians(float(stated)))

    @property
    def duration(self) -> float:
        """Time from the first to the last IMU sample, s."""
        return float(self.imu.time[-1] - self.imu.time[0])

    def _repr_html_(self) -> str:
        """Return HTML for a notebook: the recorded data, and a map of fixes and truth."""
        tables: dict[str, _Table | None] = {"IMU": self.imu, "fixes": self.gps, "truth": self.truth}
        rows = [
            (name, len(each), _rate(each.time), _span(each.time)) for name, each in tables.items() if each
        ]
        paths = {"fixes": (self.gps.x, self.gps.y)}
        if self.truth:
            paths["truth"] = (self.truth.x, self.truth.y)
        heads = ("", "rows", "rate, Hz", "length, s")
        return notebook.table(self.name, heads, rows) + notebook.track(self.name, paths)


def _rate(time: Array) -> float:
    """Of the median interval, Hz; NaN where there is none."""
    interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return 1 / interval if interval > 0 else float("nan")


def _span(time: Array) -> float:
    return float(time[-1] - time[0]) if len(time) else 0.0
