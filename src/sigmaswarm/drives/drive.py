"""The Drive: one recorded or simulated journey, as read-only arrays."""

import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar, cast

import numpy as np

from sigmaswarm import notebook
from sigmaswarm.arrays import Array
from sigmaswarm.drives.checks import check_tables
from sigmaswarm.drives.frames import tables_from_frames
from sigmaswarm.drives.mounting import KEY, Angles
from sigmaswarm.drives.tables import RECORDS, Gps, Imu, Odometer, Table, Truth

T = TypeVar("T")


def as_list(given: Iterable[T] | T) -> list[T]:
    return list(cast("Iterable[T]", given)) if isinstance(given, Iterable) else [given]


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive: the measurements and, if known, the truth.

    Attributes
    ----------
    name : str
    imu : Imu
    gps : Gps
    truth : Truth or None
    frame : {"enu", "wgs84"}
        Frame of the recorded fixes; ``gps.x`` and ``gps.y`` are always in meters.
    origin : (latitude deg, longitude deg, altitude m) or None
        Origin of the local frame; always known if ``frame`` is "wgs84".
    metadata : mapping
        All other keys of drive.toml, unchanged.
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
        """Make a drive from data frames of pandas or polars, or from mappings of column names to arrays.

        Times are seconds or dates, in a column ``t`` or ``time`` or in a pandas index. Dates become seconds since the
        first IMU sample, whose Unix time is ``metadata["time_origin_s"]``.

        Parameters
        ----------
        imu : frame with columns t, ax, ay, gz and optionally az, gx, gy
            Units: s, m/s2 and rad/s. Body frame: x forward, y left, z up.
        gps : frame with columns t and x, y (m) or lat, lon (deg)
            Optionally alt, std_x, std_y (m), speed (m/s), course, heading, std_heading (rad).
        truth : frame with columns t, x, y (m), vx, vy (m/s), theta (rad), optional
        odometer : frame with columns t, speed (m/s), optional
        name : str
        origin : (latitude deg, longitude deg, altitude m), optional
            Position of x = y = 0; if there are lat and lon, the default is the first fix.
        columns : mapping, optional
            Maps names of your columns to the names above: ``{"acc_x": "ax"}``.

        Raises
        ------
        DriveError
            If a column is missing, not numeric, not finite or out of range, or if times do not increase. The message
            states table, column and row (from 0).

        Warns
        -----
        SigmaswarmWarning
            For gaps, for unknown columns (which are ignored), and for values that suggest other units or axes.

        Examples
        --------
        >>> import numpy as np, polars as pl, sigmaswarm
        >>> t = np.arange(0, 60, 0.01)
        >>> imu = pl.DataFrame({"t": t, "ax": 0 * t, "ay": 0 * t, "gz": 0 * t})
        >>> gps = {"t": t[::20], "x": 10 * t[::20], "y": 0 * t[::20]}
        >>> sigmaswarm.Drive.from_frames(imu, gps).duration
        59.99
        """
        given = {"imu": imu, "gps": gps, "truth": truth, "odometer": odometer}
        given = {key: frame for key, frame in given.items() if frame is not None}
        tables, about, warned = tables_from_frames(given, columns or {}, origin)
        drive = cls(name, **tables, **about)
        warned += check_tables(
            drive.imu, drive.gps, drive.truth, lambda m: f"{name}: {m.replace('.csv', '')}"
        )
        for warning in warned:
            warnings.warn(warning, stacklevel=2)
        return drive

    from_arrays = from_frames

    @property
    def tables(self) -> dict[str, Table]:
        """The tables of this drive, by their names in `RECORDS`."""
        return {name: table for name in RECORDS if (table := getattr(self, name)) is not None}

    @property
    def nominal_interval(self) -> float:
        """Median time between IMU samples, s; the process noise is the variance added per such interval."""
        return self.imu.interval

    @property
    def lever_arm(self) -> Array:
        """Vector from IMU to antenna, m forward and left, shape (2,).

        The value is ``gps_lever_arm_m`` of drive.toml, otherwise 0.
        """
        return np.array(self.metadata.get("gps_lever_arm_m", (0.0, 0.0))[:2], dtype=np.float64)

    @property
    def antenna_height(self) -> float:
        """Height of the antenna above the IMU, m: third element of ``gps_lever_arm_m``, otherwise 0."""
        arm = self.metadata.get("gps_lever_arm_m", ())
        return float(arm[2]) if len(arm) > 2 else 0.0

    @property
    def heading(self) -> float | None:
        """Heading at the first IMU sample, rad: ``heading_deg`` of drive.toml, otherwise None."""
        stated = self.metadata.get("heading_deg")
        return None if stated is None else float(np.radians(float(stated)))

    @property
    def mounting(self) -> Angles | None:
        """Roll, pitch and yaw (deg) of the rotation that was applied to the raw IMU samples.

        The value is ``imu_mounting_deg`` of drive.toml, otherwise None.
        """
        stated = self.metadata.get(KEY)
        return None if stated is None else (float(stated[0]), float(stated[1]), float(stated[2]))

    @property
    def duration(self) -> float:
        """Time from the first to the last IMU sample, s."""
        return float(self.imu.time[-1] - self.imu.time[0])

    def _repr_html_(self) -> str:
        tables: dict[str, Table | None] = {"IMU": self.imu, "fixes": self.gps, "truth": self.truth}
        rows: list[tuple[object, ...]] = []
        for name, table in tables.items():
            if table:
                interval = table.interval
                rate = 1 / interval if interval > 0 else float("nan")
                rows.append((name, len(table), rate, float(table.time[-1] - table.time[0])))
        paths = {"fixes": (self.gps.x, self.gps.y)}
        if self.truth:
            paths["truth"] = (self.truth.x, self.truth.y)
        heads = ("", "rows", "rate, Hz", "length, s")
        return notebook.table(self.name, heads, rows) + notebook.track(self.name, paths)
