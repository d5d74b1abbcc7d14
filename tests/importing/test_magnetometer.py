"""A magnetometer's heading: calibrated on the drive itself, in tables and bags; refused on straight drives."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from importing.bags import ROS2, messages, write_ros
from importing.logs import EPOCH, ORIGIN, imported
from sigmaswarm.drives.drive import Drive, Gps, Imu, Truth
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic, wrap_angle
from sigmaswarm.importing.guess import magnetometer_part
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import TableChoice
from support import quickly

DECLINATION, DIP, FIELD = np.radians(4.0), np.radians(65.0), 0.5  # deg, deg, G
TRACKS = {
    "block": (0, 90, 0, 90, 0, 90, 0, 90, 0, 90),
    "eight": (0, 180, 180, 0, -180, -180, 0, 90, -90),
    "town": (0, 90, 0, -90, -90, 0, -120, 0, 60, -90),
    "highway": (0, 40, 0, -30, 0, 0, 60, -60, 0),
}
"""Turns, deg, of 20 s each."""
STEEL = 55.0, 65.0
"""s: a bridge."""
MAPS = ("mag.mx=mag_x", "mag.my=mag_y")
TABLE = TableChoice({"mag": "imu.csv"})


def a_track(turns: tuple[int, ...], seed: int) -> tuple[Imu, Gps, np.ndarray]:
    """A drive at 10 m/s with a biased gyro and fixes with 1 m of noise; and its heading at the IMU's times."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0 * len(turns), 0.02)
    k = np.minimum((time // 20).astype(int), len(turns) - 1)
    in_turn = (time % 20 > 8) & (time % 20 < 14)
    rate = np.where(in_turn, np.radians(turns)[k] / 6.0, 0.0)
    heading = 0.3 * seed + np.cumsum(rate) * 0.02
    x, y = (np.cumsum(10.0 * f(heading)) * 0.02 for f in (np.cos, np.sin))
    noise = rng.standard_normal((3, len(time)))
    gz = rate + 0.003 + 0.002 * noise[0]
    imu = Imu(time, 0.05 * noise[1], 10.0 * rate + 0.05 * noise[2], gz)
    at = slice(5, None, 10)
    east, north = (v[at] + rng.standard_normal(len(v[at])) for v in (x, y))
    return imu, Gps(time[at], east, north), heading


def field_of(time: np.ndarray, heading: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The field (n, 3), G, in the vehicle, with iron, noise, slopes of 0.5 deg and a bridge; and its constant part."""
    rng = np.random.default_rng(100 + seed)
    east, north = np.cos(DIP) * np.sin(DECLINATION), np.cos(DIP) * np.cos(DECLINATION)
    world = FIELD * np.array([east, north, -np.sin(DIP)])
    c, s, zero, one = np.cos(heading), np.sin(heading), np.zeros(len(time)), np.ones(len(time))
    level = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])  # the body's axes in the world
    field = np.einsum("ijn,j->ni", level, world)
    pitch, roll = (np.radians(0.5) * np.sin(2 * np.pi * time / period) for period in (37.0, 23.0))
    field += np.column_stack([-pitch * field[:, 2], roll * field[:, 2], zero])
    way = rng.uniform(-np.pi, np.pi)
    hard = 0.3 * np.array([np.cos(way), np.sin(way), 0.5])
    soft = np.eye(3) + 0.1 * np.array([[0.8, 0.6, 0.1], [0.6, -0.8, 0.2], [0.1, 0.2, 0.3]])
    begin, end = STEEL
    bridge = (0.2, 0.1)[seed % 2] * np.sin(np.pi * np.clip((time - begin) / (end - begin), 0, 1))[:, None]
    toward = rng.uniform(-np.pi, np.pi)
    field = field @ soft.T + hard + bridge * [np.cos(toward), np.sin(toward), 0.4]
    constant = hard + soft[:, 2] * world[2]  # the vertical field is constant in the vehicle, as hard iron is
    return field + 0.002 * rng.standard_normal(field.shape), constant[:2]


def a_log(folder: Path, track: str, seed: int = 0) -> tuple[Path, np.ndarray, np.ndarray]:
    """A folder of tables, the heading at the fixes, and the hard iron."""
    imu, gps, heading = a_track(TRACKS[track], seed)
    field, hard = field_of(imu.time, heading, seed)
    folder.mkdir(exist_ok=True)
    columns = {"t": imu.time + EPOCH, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}
    axes = dict(zip(("mag_x", "mag_y", "mag_z"), field.T, strict=True))
    pl.DataFrame(columns | axes).write_csv(folder / "imu.csv")
    pl.DataFrame({"t": gps.time + EPOCH, "x": gps.x, "y": gps.y}).write_csv(folder / "gps.csv")
    return folder, np.interp(gps.time, imu.time, heading), hard


def errors_of(drive: Drive, heading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the headings, deg, and which fixes have one."""
    gps = drive.gps
    assert gps.heading is not None and gps.std_heading is not None
    return np.degrees(wrap_angle(gps.heading - heading)), gps.std_heading < np.pi


def hard_iron(notes: tuple[str, ...]) -> np.ndarray:
    said = next(note for note in notes if "hard iron" in note).split("hard iron ")[1]
    return np.array([float(word.strip(",")) for word in said.split()[:2]])


@pytest.mark.parametrize("track", quickly([("block",), ("eight",), ("town",)], lambda track: track == "town"))
def test_hard_iron_within_two_percent_and_no_heading_near_steel(tmp_path: Path, track: str):
    for seed in range(2):
        folder, heading, hard = a_log(tmp_path / str(seed), track, seed)
        got = imported(folder, maps=MAPS, choice=TABLE)
        assert np.hypot(*(hard_iron(got.notes) - hard)) < 0.02 * 0.3
        off, known = errors_of(got.drive, heading)
        assert np.median(np.abs(off[known])) < 1.0 and np.quantile(np.abs(off[known]), 0.95) < 2.5
        assert got.drive.gps.std_heading is not None
        std = np.degrees(got.drive.gps.std_heading.min())
        assert 0.6 < np.sqrt(np.mean(off[known] ** 2)) / std < 1.5
        time = got.drive.gps.time
        inside = (time > STEEL[0] + 1.5) & (time < STEEL[1] - 1.5)
        assert not known[inside].any()
        assert known[(time < STEEL[0] - 2) | (time > STEEL[1] + 2)].mean() > 0.97


def test_too_little_turning_is_refused(tmp_path: Path):
    folder, _, _ = a_log(tmp_path / "log", "highway")
    with pytest.raises(InputError, match=r"cover [7-9]0 of 360 deg, too little"):
        imported(folder, maps=MAPS, choice=TABLE)


def test_a_field_that_does_not_turn_with_the_drive_is_refused(tmp_path: Path):
    folder, _, _ = a_log(tmp_path / "log", "block")
    maps = ("mag.mx=mag_z", "mag.my=0.3*sin(t/7)")
    with pytest.raises(InputError, match="rotation of the field differs from that of the vehicle"):
        imported(folder, maps=maps, choice=TABLE)


@pytest.mark.long
def test_axes_of_the_wrong_hand_or_turned_ones_change_no_heading(tmp_path: Path):
    folder, _, _ = a_log(tmp_path / "log", "town")
    right = imported(folder, maps=MAPS, choice=TABLE).drive.gps
    assert right.heading is not None and right.std_heading is not None
    mirrored, turned = ("mag.mx=mag_y", "mag.my=mag_x"), ("mag.mx=mag_y", "mag.my=-mag_x")
    for maps, wrong in ((mirrored, True), (turned, False)):
        got = imported(folder, maps=maps, choice=TABLE)
        off, known = errors_of(got.drive, right.heading)
        np.testing.assert_array_equal(known, right.std_heading < np.pi)
        assert np.abs(off[known]).max() < 1e-6
        assert any("rotate in the wrong direction" in note for note in got.notes) == wrong
    for options, said in (
        (
            {"maps": mirrored, "choice": TABLE, "recipe": Recipe(declination_deg=4.0)},
            "can't be applied; change the sign",
        ),
        ({"maps": MAPS, "choice": TABLE, "recipe": Recipe(declination_deg=400.0)}, "400 is out of range"),
        ({"recipe": Recipe(declination_deg=4.0)}, "--declination needs a magnetometer"),
    ):
        with pytest.raises(InputError, match=said):
            imported(folder, **options)


@pytest.mark.long
def test_a_stated_declination_and_the_mounting(tmp_path: Path):
    folder, heading, _ = a_log(tmp_path / "log", "town")
    for stated in (4.0, 0.0, -10.0):
        got = imported(folder, choice=TABLE, recipe=Recipe(declination_deg=stated))
        off, known = errors_of(got.drive, heading)
        assert abs(np.median(off[known]) - (4.0 - stated)) < 0.5
        assert any(f"declination {stated:+.1f} deg as stated" in note for note in got.notes)
        (tmp_path / "car.toml").write_text(got.recipe.to_toml())
        assert Recipe.load(tmp_path / "car.toml").declination_deg == stated
    turned = ("ax=ay", "ay=-ax", "mag.mx=mag_y", "mag.my=-mag_x", "mag.mz=mag_z")
    mounted = imported(folder, maps=turned, choice=TABLE, recipe=Recipe(declination_deg=-10.0, mount="90"))
    assert mounted.drive.gps.heading is not None and got.drive.gps.heading is not None
    np.testing.assert_allclose(mounted.drive.gps.heading, got.drive.gps.heading, atol=1e-6)
    axes = ("az=9.8+0*ax", "gx=0*ax", "gy=0*ax")
    with pytest.raises(InputError, match="the mounting needs mz"):
        imported(folder, maps=(*axes, "mag.mz="), choice=TABLE, recipe=Recipe(mount="0,10,0"))


def test_fixes_that_come_late_get_the_heading_at_their_positions(tmp_path: Path):
    folder, heading, _ = a_log(tmp_path / "log", "town")
    got = imported(folder, choice=TABLE, recipe=Recipe(gps_offset_s=0.5))
    off, known = errors_of(got.drive, heading)
    assert np.quantile(np.abs(off[known]), 0.95) < 3.0
    assert any("s before the time of its fix" in note for note in got.notes)


def test_without_a_choice_a_magnetometer_changes_nothing(tmp_path: Path):
    folder, _, _ = a_log(tmp_path / "log", "block")
    got = imported(folder)
    assert got.drive.gps.heading is None and "mag" not in got.recipe.roles
    assert "declination" not in got.recipe.to_toml()
    maps = ("gps.heading=x/1000", "gps.std_heading=0.1", *MAPS)
    with pytest.raises(InputError, match="the fixes already have a heading"):
        imported(folder, maps=maps, choice=TABLE)
    with pytest.raises(InputError, match="no column contains mx"):
        imported(folder, choice=TableChoice({"mag": "gps.csv"}), maps=("mag.mx=", "mag.my="))


def test_axes_are_found_by_name_in_a_chosen_table():
    for x, y in (
        ("imu.mag.x", "imu.mag.y"),
        ("magX", "magY"),
        ("Magnetometer x (µT)", "Magnetometer y (µT)"),
        ("mx", "my"),
    ):
        part = magnetometer_part("t", ("t", "x", "y", "accel_b_x", "accel_b_y", x, y, f"{x}_raw", f"{y}_raw"))
        assert [text.strip("`") for text in part.columns.values()] == [x, y]
    assert magnetometer_part("t", ("x", "y", "z")).columns == {"mx": "x", "my": "y", "mz": "z"}
    assert not magnetometer_part("t", ("ax", "ay")).columns


def test_a_bag_with_a_magnetic_field(tmp_path: Path):
    imu, gps, heading = a_track(TRACKS["block"][:5], 0)
    every = slice(None, None, 5)
    still = np.zeros(len(imu))
    imu = replace(imu, az=still + 9.8, gx=still, gy=still).select(every)
    lat, lon, alt = enu_to_geodetic(np.column_stack([gps.x, gps.y, np.zeros(len(gps))]), ORIGIN).T
    one = np.ones(len(gps))
    gps = replace(gps, lat=lat, lon=lon, alt=alt, std_x=one, std_y=one, speed=one, course=one)
    drive = Drive("logged", imu, gps, Truth(np.arange(0.0, 100.0, 5.0), *np.zeros((5, 20))), "wgs84", ORIGIN)
    field, hard = field_of(imu.time, heading[every], 0)
    types: Any = ROS2.types
    sent = list(messages(drive))
    for time, b in zip(imu.time, field, strict=True):
        ns = round(time * 1e9) + EPOCH * 10**9
        stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="imu")
        vector = types["geometry_msgs/msg/Vector3"](*(1e-4 * b))
        sent.append(("/imu/mag", time, types["sensor_msgs/msg/MagneticField"](header, vector, np.zeros(9))))
    bag = write_ros(tmp_path / "bag", iter(sent))
    got = imported(bag, choice=TableChoice({"mag": "/imu/mag"}))
    off, known = errors_of(got.drive, np.interp(gps.time, imu.time, heading[every]))
    assert np.hypot(*(1e4 * hard_iron(got.notes) - hard)) < 0.02 * 0.3
    assert np.median(np.abs(off[known])) < 1.0
    assert imported(bag).drive.gps.heading is None
