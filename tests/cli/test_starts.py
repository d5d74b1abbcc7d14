"""Commands around the start of a drive: a stated heading, parts without a start, ideal sensors."""

import numpy as np
import pytest
from tests.cli.conftest import Command

from sigmaswarm import Drive, read_drive, write_drive


def still(length: float = 60.0) -> Drive:
    """A vehicle that stands."""
    t, at = np.arange(0, length, 0.02), np.arange(0.5, length - 1, 0.5)
    zero, noise = np.zeros(len(t)), np.random.default_rng(1).normal(0, 0.5, (2, len(at)))
    imu = {"t": t, "ax": zero, "ay": zero, "gz": zero + 1e-4 * np.sin(t)}
    return Drive.from_frames(imu, {"t": at, "x": noise[0], "y": noise[1]}, name="still")


@pytest.mark.parametrize(("north", "heading"), [(0.0, 90.0), (90.0, 0.0), (225.0, 225.0)])
def test_import_writes_a_heading_from_north(
    sigmaswarm: Command, tmp_path, north: float, heading: float
) -> None:
    log = write_drive(still(), tmp_path / "log")
    ended = sigmaswarm(
        "import", log / "imu.csv", "--gps", log / "gps.csv", "--out", tmp_path / "new",
        "--heading-from-north", north,
    )  # fmt: skip
    assert ended.code == 0, ended.err
    assert read_drive(tmp_path / "new").metadata["heading_deg"] == heading


def test_split_says_that_a_part_has_no_start(sigmaswarm: Command, tmp_path) -> None:
    write_drive(still(), tmp_path / "still")
    ended = sigmaswarm("split", tmp_path / "still", "--out", tmp_path / "parts")
    assert ended.code == 0 and "still-test can't be used by itself" in ended.err.replace("\n", " ")


@pytest.mark.parametrize(("imu", "gps"), [("ideal", "ideal"), ("ideal", "white-1m"), ("mpu-6050", "ideal")])
def test_ideal_sensors_give_a_drive_that_is_read_back(
    sigmaswarm: Command, tmp_path, imu: str, gps: str
) -> None:
    ended = sigmaswarm(
        "simulate", "--imu", imu, "--gps", gps, "--maneuver", "urban", "--environment", "clear", "--runs", 1,
        "--duration", 30, "--out", tmp_path / "d",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    (folder,) = (tmp_path / "d").iterdir()
    assert len(read_drive(folder).imu) > 100
