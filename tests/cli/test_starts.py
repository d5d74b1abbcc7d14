"""Commands at the start of a drive: a stated heading, parts without a start, ideal sensors."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation
from tests.cli.conftest import Command

from sigmaswarm import Drive, read_drive, simulate, split_time, write_drive
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.drives.alignment import initial_state


def still(length: float = 60.0) -> Drive:
    """Return a standing vehicle."""
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


@pytest.mark.parametrize("unit", ["rad from east", "deg from north", "signed deg from north"])
def test_a_heading_column_starts_a_filter_without_travel(sigmaswarm: Command, tmp_path, unit: str) -> None:
    log = write_drive(still(), tmp_path / "log")
    heading = {"rad from east": 2.0, "deg from north": np.degrees(np.pi / 2 - 2.0) % 360,
               "signed deg from north": np.degrees(np.pi / 2 - 2.0)}[unit]  # fmt: skip
    gps = pl.read_csv(log / "gps.csv").with_columns(pl.lit(heading).alias("yaw of antennas"))
    gps.write_csv(log / "gps.csv")
    source = ("import", log / "imu.csv", "--gps", log / "gps.csv", "--out", tmp_path / "new")
    ended = sigmaswarm(*source, "--map", "heading=`yaw of antennas`")
    assert ended.code == 0, ended.err
    assert ("degrees clockwise from north" in ended.out) == ("deg" in unit)
    drive = read_drive(tmp_path / "new")
    for part in (drive, *split_time(drive)):
        start = initial_state(part)
        assert start.mean[4] == pytest.approx(2.0, abs=1e-3) and start.time < part.imu.time[0] + 1.0


def test_a_heading_column_of_a_moving_vehicle_is_in_the_convention_that_its_course_shows(
    sigmaswarm: Command, tmp_path
) -> None:
    drive = simulate("urban", duration=40.0, gps="white-1m")
    log = write_drive(drive, tmp_path / "log")
    theta = np.interp(drive.gps.time, drive.truth.time, np.unwrap(drive.truth.theta))
    gps = pl.read_csv(log / "gps.csv").with_columns(pl.Series("yaw", np.degrees(np.pi / 2 - theta) % 360))
    gps.write_csv(log / "gps.csv")
    source = ("import", log / "imu.csv", "--gps", log / "gps.csv", "--out", tmp_path / "new")
    assert sigmaswarm(*source, "--map", "heading=yaw").code == 0
    got = read_drive(tmp_path / "new")
    assert got.gps.heading == pytest.approx(np.angle(np.exp(1j * theta)), abs=1e-6)
    start = initial_state(got)
    assert start.mean[4] == pytest.approx(theta[0], abs=0.05) and start.time <= initial_state(drive).time


def test_split_reports_a_part_without_a_start(sigmaswarm: Command, tmp_path) -> None:
    write_drive(still(), tmp_path / "still")
    ended = sigmaswarm("split", tmp_path / "still", "--out", tmp_path / "parts")
    assert ended.code == 0 and "still-test can't be used as a drive" in ended.err.replace("\n", " ")
    assert (
        f"next: sigmaswarm doctor {tmp_path / 'parts' / 'still-train'} " in ended.out
        and "tune" not in ended.out
    )


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


@pytest.mark.long
def test_import_proposes_the_cut_of_a_log_whose_imu_was_moved(
    sigmaswarm: Command, tmp_path, monkeypatch
) -> None:
    drive = simulate("urban", duration=150.0, imu_rate=50.0, imu="icm-20602", gps="white-1m", run=4)
    tilted = rotate_imu(drive.imu, Rotation.from_euler("y", 40, degrees=True).as_matrix())
    late = drive.imu.time > 80
    names = ("ax", "ay", "az", "gx", "gy", "gz")
    moved = {n: np.where(late, getattr(tilted, n), getattr(drive.imu, n)) for n in names}
    log = write_drive(replace(drive, imu=replace(drive.imu, **moved), name="log"), tmp_path / "log")
    monkeypatch.chdir(tmp_path)
    said = sigmaswarm("import", log / "imu.csv", "--gps", log / "gps.csv", "--out", "day").out
    lines = [
        line.partition("sigmaswarm ")[2] for line in said.splitlines() if line.startswith(("next:", "then:"))
    ]
    assert lines[0].startswith("split day --at ") and lines[1] == "doctor parts --fix mended"
    assert sigmaswarm(*lines[0].split()).code == 0
    assert "repair_alone = true" in (tmp_path / "parts" / "day-test" / "drive.toml").read_text()
    assert sigmaswarm(*lines[1].split()).code == 0  # no serious finding remains
