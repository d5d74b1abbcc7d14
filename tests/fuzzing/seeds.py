"""A small sound log for every reader, and the options of its import."""

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import polars as pl

from importing import test_datasets as sets
from importing import test_phones as phones
from importing.bags import ROS1, messages, write_mcap, write_ros
from importing.logs import EPOCH, ORIGIN, a_drive
from importing.test_matlab_and_ardupilot import dataflash, write_mat
from importing.test_px4 import write_ulog
from importing.test_receivers import GPS, nmea, ubx
from sigmaswarm import read_drive, write_drive
from sigmaswarm.drives.drive import Drive
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.recipe import Recipe
from support import make_drive

SHORT = a_drive(4.0)


@dataclass(frozen=True)
class Seed:
    """A reader's sound log.

    Attributes
    ----------
    write : writes it below a folder and returns its path
    kind : how its files are broken and compared: text, npy, ubx, nmea, ulog, mcap, zip, bytes
    form : the format's name; empty for a drive
    beside : whether it goes beside an IMU's table: it has fixes alone
    """

    write: Callable[[Path], Path]
    kind: str
    form: str
    beside: bool = False

    def read(self, path: Path, imu: Path) -> Drive:
        """Make a drive of it."""
        if not self.form:
            return read_drive(path)
        return import_drive(self._request(path, imu), "fuzzed").drive

    def look(self, path: Path, imu: Path) -> None:
        """Look at it."""
        if self.form:
            inspect_request(self._request(path, imu))

    def _request(self, path: Path, imu: Path) -> Request:
        made = (5.0, 0.0) if self.form == "kitti" else None
        recipe = Recipe(origin=ORIGIN, gps_from_truth=made)  # a fixed origin: x and y stay comparable
        if self.beside:
            return Request(imu, gps=path, recipe=recipe)
        return Request(path, form=self.form, recipe=recipe)


def _bytes(name: str, content: Callable[[], bytes]) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content())
        return folder / name

    return write


def _table(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        imu, gps = SHORT.imu, SHORT.gps
        place = {n: np.interp(imu.time, gps.time, getattr(gps, n)) for n in ("lat", "lon")}
        force = {"acc_x": imu.ax / 9.8, "acc_y": imu.ay, "acc_z": imu.az, "gyro_z_dps": np.degrees(imu.gz)}
        time = {"time_ms": np.round((imu.time + EPOCH) * 1e3)}
        frame = pl.DataFrame({**time, **force, **place, "note": ["ok"] * len(imu)})
        path = folder / f"log.{suffix}"
        frame.write_csv(path) if suffix == "csv" else frame.write_parquet(path)
        return path

    return write


def _mcap(encoding: str, compression: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        import mcap.writer

        plain, kind = mcap.writer.Writer, mcap.writer.CompressionType[compression]

        def small(file: Any) -> Any:
            return plain(file, compression=kind, chunk_size=4096)

        with patch.object(mcap.writer, "Writer", small):
            return write_mcap(folder / "log.mcap", messages(SHORT), encoding)

    return write


def _zipped(write: Callable[[Path], Path]) -> Callable[[Path], Path]:
    def zipped(folder: Path) -> Path:
        export = write(folder / "export")
        log = phones.zipped(export).rename(folder / "log.zip")
        shutil.rmtree(export)
        return log

    return zipped


def _phone(system: str) -> Callable[[Path], Path]:
    return lambda folder: phones.sensor_logger(folder, system)


def _in(name: str, write: Callable[[Path], Path]) -> Callable[[Path], Path]:
    return lambda folder: write(folder / name)


def _kitti(folder: Path) -> Path:
    return sets.write_kitti(folder, make_drive(duration=12.0, imu_rate=10.0, gps_rate=2.0))


def write_json(path: Path) -> Path:
    """A sample on each line, with the fix in the first line after it."""
    imu, gps = SHORT.imu, SHORT.gps
    last = np.searchsorted(gps.time, imu.time, side="right") - 1
    with path.open("w") as file:
        for i, time in enumerate(imu.time.tolist()):
            acc = {"x": imu.ax[i], "y": imu.ay[i], "z": imu.az[i]}
            row = {"t": time, "acc": acc, "gyro": [imu.gx[i], imu.gy[i], imu.gz[i]]}
            k = last[i]
            if k >= 0 and (i == 0 or k > last[i - 1]):
                row["gps"] = {"lat": gps.lat[k], "lon": gps.lon[k]}
            file.write(json.dumps(row) + "\n")
    return path


SEEDS: dict[str, Seed] = {
    "drive": Seed(lambda f: write_drive(SHORT, f / "d"), "text", ""),
    "drive-enu": Seed(lambda f: write_drive(make_drive(duration=4.0), f / "d"), "text", ""),
    "csv": Seed(_table("csv"), "text", "csv"),
    "csv-folder": Seed(lambda f: write_drive(SHORT, f / "d"), "text", "csv"),
    "parquet": Seed(_table("parquet"), "bytes", "csv"),
    "kitti": Seed(_kitti, "text", "kitti"),
    "nclt": Seed(sets.write_nclt, "text", "nclt"),
    "comma2k19": Seed(sets.write_comma, "npy", "comma2k19"),
    "rtklib": Seed(_in("rtk.pos", sets.write_pos), "text", "rtklib", True),
    "rtklib-week": Seed(_in("rtk.pos", lambda p: sets.write_pos(p, "week")), "text", "rtklib", True),
    "ubx": Seed(_bytes("log.ubx", lambda: b"".join(map(ubx, range(len(GPS))))), "ubx", "ubx", True),
    "nmea": Seed(
        _bytes("log.nmea", lambda: b"".join(s for i in range(len(GPS)) for s in nmea(i))),
        "nmea",
        "nmea",
        True,
    ),
    "px4": Seed(_in("f.ulg", write_ulog), "ulog", "px4"),
    "px4-old": Seed(_in("f.ulg", lambda p: write_ulog(p, True)), "ulog", "px4"),
    "ardupilot": Seed(_bytes("log.bin", dataflash), "bytes", "ardupilot"),
    "matlab": Seed(_in("log.mat", write_mat), "bytes", "matlab"),
    "sensor-logger-ios": Seed(_in("export", _phone("ios")), "text", "sensor-logger"),
    "sensor-logger-android": Seed(_in("export", _phone("android")), "text", "sensor-logger"),
    "sensor-logger-zip": Seed(_zipped(_phone("ios")), "zip", "sensor-logger"),
    "phyphox": Seed(_in("export", phones.phyphox), "text", "phyphox"),
    "phyphox-zip": Seed(_zipped(phones.phyphox), "zip", "phyphox"),
    "gnss-logger": Seed(_in("log.txt", phones.gnss_logger), "text", "gnss-logger"),
    "json-lines": Seed(_in("log.jsonl", write_json), "text", "json"),
    "ros1": Seed(_in("log.bag", lambda p: write_ros(p, messages(SHORT, ROS1), "ros1")), "bytes", "ros"),
    "ros2-sqlite3": Seed(_in("bag", lambda p: write_ros(p, messages(SHORT))), "bytes", "ros"),
    "ros2-mcap": Seed(_in("bag", lambda p: write_ros(p, messages(SHORT), "mcap")), "bytes", "ros"),
    "mcap-cdr": Seed(_mcap("cdr", "ZSTD"), "mcap", "mcap"),
    "mcap-cdr-plain": Seed(_mcap("cdr", "NONE"), "mcap", "mcap"),
    "mcap-json": Seed(_mcap("json", "LZ4"), "mcap", "mcap"),
    "mcap-json-plain": Seed(_mcap("json", "NONE"), "mcap", "mcap"),
}
