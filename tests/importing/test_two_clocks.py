"""A table with a device's stamp and a time of receipt: the stamp is used only where this is certain."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from importing.logs import EPOCH, a_drive, imported

DRIVE = a_drive(12.0)
RNG = np.random.default_rng(8)
IMU, GPS = DRIVE.imu.time, DRIVE.gps.time
LATE = IMU + 0.05 + RNG.uniform(0, 0.009, len(IMU))
"""Times of receipt, s after the first sample."""


def write(folder: Path, times: dict[str, Any], fixes: dict[str, Any]) -> None:
    axes = {n: getattr(DRIVE.imu, n) for n in ("ax", "ay", "az", "gx", "gy", "gz")}
    pl.DataFrame({**times, **axes}).write_csv(folder / "imu.csv")
    pl.DataFrame({**fixes, "lat": DRIVE.gps.lat, "lon": DRIVE.gps.lon}).write_csv(folder / "gps.csv")


def begins(time: np.ndarray, factor: float = 1.0) -> np.ndarray:
    return np.round((EPOCH + time) * factor, 6)


@pytest.mark.parametrize(
    "receipt", ["recv_time", "log_time", "system_timestamp", "arrival_stamp", "received"]
)
@pytest.mark.parametrize("own", ["sensor_time", "device_timestamp", "hardware_stamp", "utc_time"])
def test_the_stamp_of_the_device_goes_before_the_time_of_receipt(tmp_path: Path, own: str, receipt: str):
    write(
        tmp_path, {receipt: begins(LATE), own: begins(IMU)}, {receipt: begins(GPS + 0.05), own: begins(GPS)}
    )
    got = imported(tmp_path)
    np.testing.assert_allclose(got.drive.imu.time - got.drive.gps.time[0], IMU - GPS[0], atol=2e-6)
    assert f"the time is {own}, of the device; {receipt} is the time of receipt" in got.notes


def test_units_in_the_names_are_read(tmp_path: Path):
    times = [
        {"arrival_time_ms": begins(t + 0.1, 1e3), "hardware_timestamp_us": begins(t, 1e6)} for t in (IMU, GPS)
    ]
    write(tmp_path, *times)
    got = imported(tmp_path)
    np.testing.assert_allclose(got.drive.imu.time - got.drive.gps.time[0], IMU - GPS[0], atol=2e-6)
    assert any("hardware_timestamp_us, of the device" in note for note in got.notes)


SEEN = {"recv_time": begins(LATE)}
OTHER: dict[str, Callable[[], dict[str, Any]]] = {
    "time since the device began": lambda: {**SEEN, "device_time": 1e3 * IMU + 777},
    "a stamp of whole seconds": lambda: {**SEEN, "utc_time": np.floor(begins(IMU))},
    "an unset stamp": lambda: {**SEEN, "sensor_time": 0 * IMU},
    "a stamp in some rows": lambda: {
        **SEEN, "sensor_time": [t if i % 3 else None for i, t in enumerate(begins(IMU).tolist())]
    },
    "a stamp of last year": lambda: {**SEEN, "sensor_time": begins(IMU - 3e7)},
    "a time that is no stamp": lambda: {**SEEN, "exposure_time": begins(IMU)},
    "a stamp of last year, first": lambda: {"sensor_time": np.floor(begins(IMU - 3e7)), **SEEN},
    "two stamps": lambda: {**SEEN, "sensor_time": begins(IMU), "device_time": begins(IMU + 0.3)},
}  # fmt: skip


@pytest.mark.parametrize("case", OTHER)
def test_other_columns_do_not_replace_the_time_of_receipt(tmp_path: Path, case: str):
    write(tmp_path, OTHER[case](), {"recv_time": begins(GPS)})
    got = imported(tmp_path)
    np.testing.assert_allclose(got.drive.imu.time - got.drive.gps.time[0], LATE - GPS[0], atol=2e-6)
    assert not any("of the device" in note for note in got.notes)


def test_a_usual_time_stays_the_time(tmp_path: Path):
    """A table's `time` may be corrected, and is not called a time of receipt."""
    write(tmp_path, {"time": begins(IMU), "sensor_time": begins(LATE)}, {"time": begins(GPS)})
    got = imported(tmp_path)
    np.testing.assert_allclose(got.drive.imu.time - got.drive.gps.time[0], IMU - GPS[0], atol=2e-6)


@pytest.mark.parametrize("first", ["recv_time", "device_time"])
def test_an_unused_stamp_is_noted_with_the_way_to_use_it(tmp_path: Path, first: str):
    """Of two clocks that differ, the first column is the time, as before."""
    wanted = {"recv_time": LATE, "device_time": IMU}
    clocks = {"recv_time": begins(LATE), "device_time": 1e3 * IMU + 777}
    fixes = {"recv_time": begins(GPS), "device_time": 1e3 * GPS + 777}
    other = next(name for name in clocks if name != first)
    write(tmp_path, *({first: one[first], other: one[other]} for one in (clocks, fixes)))
    (note,) = {n for n in imported(tmp_path).notes if f"{other} is not used" in n}
    got = imported(tmp_path, time=note.split('--time "')[1].split('"')[0]).drive
    np.testing.assert_allclose(got.imu.time - got.gps.time[0], wanted[other] - GPS[0], atol=2e-6)
