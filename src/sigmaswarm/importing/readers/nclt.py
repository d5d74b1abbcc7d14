"""NCLT: the files ms25.csv, gps.csv and groundtruth_*.csv of a session.

N. Carlevaris-Bianco, A. K. Ushani, R. M. Eustice, "University of Michigan North Campus long-term vision and lidar
dataset", IJRR 2016, describe the files. Times are UTC in us. The body axes are x forward, y right, z down; the truth is
x north, y east of a fixed origin. Latitude and longitude are in rad.
"""

from contextlib import ExitStack
from pathlib import Path

import polars as pl

from sigmaswarm.drives.table_files import one_file
from sigmaswarm.errors import InputError
from sigmaswarm.importing.readers.columns import log_of_files
from sigmaswarm.importing.readers.scanning import collect
from sigmaswarm.importing.source import Guess, Limits, Log, Part, Role

ORIGIN = (42.293227, -83.709657, 270.0)  # deg, deg, m, of the truth's frame
_T = {"t": "utime*1e-6"}
# File of each role, its columns, and the expressions of the columns of a drive
FILES: dict[Role, tuple[str, str, dict[str, str]]] = {
    "imu": (
        "ms25.csv",
        "utime mag_x mag_y mag_z accel_x accel_y accel_z rot_r rot_p rot_h",
        {
            **(_T | {"ax": "accel_x", "ay": "-accel_y", "az": "-accel_z"}),
            **{"gx": "rot_r", "gy": "-rot_p", "gz": "-rot_h"},
        },
    ),
    "gps": (
        "gps.csv",
        "utime mode num_satellites lat lon alt track speed",
        _T | {"lat": "degrees(lat)", "lon": "degrees(lon)", "alt": "alt", "keep": "mode >= 2"},
    ),
    "truth": (
        "groundtruth*.csv",
        "utime x y z roll pitch heading",
        _T | {"x": "y", "y": "x", "theta": "pi/2 - heading"},
    ),
}
_NOTE = (
    "the axes of the MS25 are converted from forward, right, down to forward, left, up; course and speed of gps.csv "
    "are not used"
)


def recognizes(path: Path) -> bool:
    return (path / "ms25.csv").is_file()


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    scans: dict[str, pl.LazyFrame] = {}
    roles: dict[Role, tuple[Part, ...]] = {}
    for role, (pattern, columns, expressions) in FILES.items():
        for file in sorted(path.glob(pattern))[:1]:
            kinds = {name: pl.Int64 if name == "utime" else pl.Float64 for name in columns.split()}
            rows = pl.scan_csv(**one_file(file), has_header=False, schema=kinds, null_values=["nan", "NaN"])
            if not len(collect(rows.head(10), file, file.name)):
                raise InputError(f"{file} is empty; unpack the session again")
            scans[file.name], roles[role] = rows, (Part(file.name, expressions),)
    guess = Guess(roles, (_NOTE,), ORIGIN, {"dataset": "NCLT", "licence": "ODbL"})
    return log_of_files(path, scans, "NCLT", guess)
