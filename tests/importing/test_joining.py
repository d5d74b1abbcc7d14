"""A role with several tables: the times of the first table, interpolated values of the others, wrapped angles."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import imported
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import TableChoice
from support import diagonal

RATE = 0.5
"""rad/s of the circle: the course wraps every 12.6 s."""
TIME = np.arange(2000) * 0.01
FIXES, BESIDE = TIME[::20], TIME[7::20]

PARTS = """
[[imu]]
table = "imu.csv"
t = "t"
ax = "ax"
ay = "ay"
gz = "gz"
[[gps]]
table = "places.csv"
t = "t"
"""


def write(folder: Path, name: str, **columns: np.ndarray) -> None:
    pl.DataFrame(columns).write_csv(folder / name)


@pytest.fixture
def circle(tmp_path: Path) -> Path:
    """IMU and fixes of a circle of 20 m at 10 m/s, begun to the east."""
    zero = 0 * TIME
    write(tmp_path, "imu.csv", t=TIME, ax=zero, ay=zero + 5, gz=zero + RATE)
    write(
        tmp_path,
        "places.csv",
        t=FIXES,
        x=20 * np.sin(RATE * FIXES),
        y=-20 * np.cos(RATE * FIXES),
        alt=0 * FIXES,
    )
    return tmp_path


def joined(folder: Path, recipe: str):
    (folder / "r.toml").write_text(PARTS + recipe)
    return imported(folder, recipe=Recipe.load(folder / "r.toml")).drive


def test_course_across_its_wrap(circle: Path):
    write(circle, "velocity.csv", t=BESIDE, speed=10 + 0 * BESIDE, course=wrap_angle(RATE * BESIDE))
    recipe = (
        'x = "x"\ny = "y"\n[[gps]]\ntable = "velocity.csv"\nt = "t"\nspeed = "speed"\ncourse = "course"\n'
    )
    gps = joined(circle, recipe).gps
    assert len(gps) > 90 and np.abs(np.diff(gps.course)).max() > 6  # it does wrap
    np.testing.assert_allclose(wrap_angle(gps.course - RATE * gps.time), 0, atol=1e-12)


@pytest.mark.parametrize("written", [wrap_angle, np.array, lambda a: a % (2 * np.pi)])
def test_heading_across_its_wrap(circle: Path, written):
    """However the log has it: wrapped, unwrapped, from 0 to 2 pi."""
    write(circle, "heading.csv", t=BESIDE, theta=written(RATE * BESIDE + 3.0))
    recipe = 'x = "x"\ny = "y"\n[[truth]]\ntable = "places.csv"\nt = "t"\nx = "x"\ny = "y"\n'
    recipe += '[[truth]]\ntable = "heading.csv"\nt = "t"\ntheta = "theta"\n'
    truth = joined(circle, recipe).truth
    np.testing.assert_allclose(wrap_angle(truth.theta - RATE * truth.time - 3.0), 0, atol=1e-12)


def test_longitude_across_180(circle: Path):
    def longitude(time: np.ndarray) -> np.ndarray:
        return (180 + 9e-5 * (time - 10) + 180) % 360 - 180

    write(circle, "lonlat.csv", t=BESIDE, lat=0 * BESIDE - 17, lon=longitude(BESIDE))
    recipe = 'alt = "alt"\n[[gps]]\ntable = "lonlat.csv"\nt = "t"\nlat = "lat"\nlon = "lon"\n'
    gps = joined(circle, recipe).gps
    away = (gps.lon - longitude(gps.time) + 180) % 360 - 180
    np.testing.assert_allclose(away, 0, atol=1e-12)
    assert np.abs(gps.lon).max() <= 180
    np.testing.assert_allclose(
        np.diff(gps.x) / np.diff(gps.time), 9.59, atol=0.01
    )  # 9e-5 deg/s at 17 deg south


def test_what_is_no_degrees_stays_so_and_is_refused(circle: Path):
    write(circle, "lonlat.csv", t=BESIDE, lat=0 * BESIDE, lon=86_000_000 + 100 * BESIDE)
    recipe = 'alt = "alt"\n[[gps]]\ntable = "lonlat.csv"\nt = "t"\nlat = "lat"\nlon = "lon"\n'
    with pytest.raises(ValueError, match=r"lon = 8\.6e\+07 is not in degrees"):
        joined(circle, recipe)


def test_samples_of_one_time_keep_every_bit(circle: Path):
    theta = wrap_angle(RATE * FIXES + 0.1)
    write(circle, "heading.csv", t=FIXES, theta=theta)
    recipe = 'x = "x"\ny = "y"\n[[truth]]\ntable = "places.csv"\nt = "t"\nx = "x"\ny = "y"\n'
    recipe += '[[truth]]\ntable = "heading.csv"\nt = "t"\ntheta = "theta"\n'
    np.testing.assert_array_equal(joined(circle, recipe).truth.theta, theta)


@pytest.mark.parametrize(
    ("chosen", "others"),
    diagonal(
        [{"imu": "imu.csv"}, {"imu": "imu.csv", "gps": "fixes.csv"}],
        ["gps", "truth", "gps truth", "gps odometer"],
    ),
)
def test_a_chosen_table_is_that_of_the_role_s_log(circle: Path, chosen: dict[str, str], others: str):
    """--imu-table next to --gps or --truth: other logs need no table of this name."""
    (circle / "places.csv").rename(circle / "fixes.csv")
    shutil.copy(circle / "imu.csv", circle / "spare_imu.csv")
    separate = circle / "separate"
    separate.mkdir()
    shutil.copy(circle / "fixes.csv", separate / "fixes.csv")
    write(separate, "odometer.csv", t=FIXES, wheel_speed=10 + 0 * FIXES)
    files = {
        "gps": separate / "fixes.csv",
        "truth": separate / "fixes.csv",
        "odometer": separate / "odometer.csv",
    }
    drive = imported(
        circle, choice=TableChoice(chosen), **{role: files[role] for role in others.split()}
    ).drive
    assert len(drive.imu) == len(TIME) and len(drive.gps) == len(FIXES)
    assert (drive.truth is not None) == ("truth" in others)
    with pytest.raises(InputError, match=r"no table 'none\.csv'; choose from fixes\.csv, imu\.csv"):
        imported(circle, choice=TableChoice({"imu": "none.csv"}), gps=files["gps"])


@pytest.mark.parametrize(("late", "rate"), diagonal([7200, -3600, 36_000, 100_000, 30], [100, 1000]))
def test_tables_of_the_imu_that_do_not_overlap_are_described_before_the_import(
    tmp_path: Path, late: int, rate: int
):
    """The clock of the gyro is ahead; the message contains the expression for whole hours."""
    epoch, time = 1_714_000_000, np.arange(0, 20, 1 / rate)
    force = {"x": 0 * time, "y": 0 * time + 5, "z": 0 * time + 9.81}
    write(tmp_path, "accelerometer.csv", time=epoch + time, **force)
    write(tmp_path, "gyroscope.csv", time=epoch + late + time, x=0 * time, y=0 * time, z=0 * time + RATE)
    places = {"x": 20 * np.sin(RATE * FIXES), "y": -20 * np.cos(RATE * FIXES)}
    write(tmp_path, "gps.csv", time=epoch + FIXES, **places)
    found = inspect_request(Request(tmp_path))
    (said,) = [note for note in found.notes if "do not overlap in time" in note]
    assert not found.works and f"gyroscope.csv covers {epoch + late} to" in said
    with pytest.raises(InputError, match=r"gyroscope\.csv covers"):
        imported(tmp_path)
    example = re.search(r'for example t = "(.+)" for gyroscope.csv, since the clocks differ by', said)
    assert bool(example) == (late % 3600 == 0)
    if example:
        first, second = found.recipe.roles["imu"]
        second = replace(second, columns={**second.columns, "t": example[1]})
        recipe = replace(found.recipe, roles={**found.recipe.roles, "imu": (first, second)})
        assert len(imported(tmp_path, recipe=recipe).drive.imu) == len(time)
