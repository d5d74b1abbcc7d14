"""Every reader of a log with an IMU keeps az, gx and gy, so that a filter with attitude can run on the drive."""

from pathlib import Path

import numpy as np
import pytest

from fuzzing.seeds import SEEDS
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
