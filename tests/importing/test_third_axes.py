"""Every reader of a log with an IMU keeps az, gx and gy, so that a filter with attitude can run on the drive."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from fuzzing.seeds import SEEDS
from importing.logs import a_drive, imported
from sigmaswarm.errors import InputError
from sigmaswarm.importing.formats import READERS
from support import quickly

FIXES_ALONE = {"rtklib", "ubx", "nmea"}
ONE_GYRO = {"csv", "parquet", "drive-enu"}
"""Logs that have the yaw rate alone."""
WITH_ALL = [name for name, seed in SEEDS.items() if not seed.beside and name not in ONE_GYRO]


def test_every_reader_is_asked():
    assert {SEEDS[name].form for name in WITH_ALL} - {""} == READERS.keys() - FIXES_ALONE


@pytest.mark.parametrize(
    "name", quickly([(name,) for name in WITH_ALL], lambda name: WITH_ALL.index(name) % 4 == 0)
)
def test_the_third_axes_are_kept(name: str, tmp_path: Path):
    seed = SEEDS[name]
    imu = seed.read(seed.write(tmp_path), tmp_path).imu
    assert imu.az is not None
    assert imu.gx is not None
    assert imu.gy is not None
    if name != "kitti":  # its log is made of a drive that has no third axes, and holds zeros
        assert np.median(imu.az) == pytest.approx(9.8, abs=0.1)
        assert 0.005 < np.std(imu.gx) < 0.02
        assert 0.005 < np.std(imu.gy) < 0.02


@pytest.mark.parametrize("turned", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_an_exchanged_accelerometer_and_gyro_are_refused_and_the_remedy_helps(
    tmp_path: Path, turned: tuple[int, int, int]
):
    """Tables of x, y and z, whose names alone show the sensor; gravity may be on any axis."""
    drive = a_drive(20.0)
    imu, axes = drive.imu, ("x", "y", "z")

    def write(force: str, rate: str) -> Path:
        folder = tmp_path / force
        folder.mkdir()
        for name, letter in ((force, "a"), (rate, "g")):
            values = {c: getattr(imu, letter + axes[k]) for c, k in zip(axes, turned, strict=True)}
            pl.DataFrame({"time": imu.time, **values}).write_csv(folder / f"{name}.csv")
        gps = {"time": drive.gps.time, "lat": drive.gps.lat, "lon": drive.gps.lon}
        pl.DataFrame(gps).write_csv(folder / "gps.csv")
        return folder

    with pytest.raises(InputError, match=r"accelerometer and gyro are exchanged; exchange their names$"):
        imported(write("gyroscope", "accelerometer"))
    right = imported(write("accelerometer", "gyroscope")).drive.imu
    np.testing.assert_allclose(right.az, getattr(imu, "a" + axes[turned[2]]))
