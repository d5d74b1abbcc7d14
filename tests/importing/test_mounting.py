from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from importing.logs import a_drive, imported
from sigmaswarm.errors import InputError
from sigmaswarm.importing.mounting import parse_mount, rotate
from sigmaswarm.importing.recipe import Recipe

angles = st.floats(-180, 180)


@given(angles, angles, angles)
def test_angles_are_scipys(roll: float, pitch: float, yaw: float):
    oracle = Rotation.from_euler("xyz", [roll, pitch, yaw], degrees=True).as_matrix()  # about fixed axes
    np.testing.assert_allclose(parse_mount(f"{roll!r},{pitch!r},{yaw!r}"), oracle, atol=1e-12)
    np.testing.assert_allclose(
        parse_mount(repr(yaw)), Rotation.from_euler("z", yaw, degrees=True).as_matrix(), atol=1e-12
    )


@pytest.mark.parametrize(
    ("text", "matrix"),
    [
        ("x=-y,y=x", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ("x=-y", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ("x=x,z=-z", [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
        ("z=-z", [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
        ("x=z, y=x, z=y", [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        ("90", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    ],
)
def test_axes(text: str, matrix: list[list[int]]):
    np.testing.assert_array_equal(parse_mount(text), matrix)


@pytest.mark.parametrize("text", ["", "x", "nan", "1,2", "x=y,y=x,z=z", "x=x,y=x", "x=q", "x=x,x=y", "inf"])
def test_refuses(text: str):
    with pytest.raises(InputError, match="mount"):
        parse_mount(text)


def test_a_sensor_turned_left_sees_a_start_on_its_right():
    """An IMU whose x points to the vehicle's left: accelerating forward is -y in the sensor."""
    still, push = np.zeros(3), np.full(3, 2.0)
    imu = {"ax": still, "ay": -push, "az": np.full(3, 9.8), "gx": still, "gy": still, "gz": push}
    turned = rotate(imu, parse_mount("90"))
    np.testing.assert_array_equal(turned["ax"], push)
    np.testing.assert_array_equal(turned["ay"], still)
    np.testing.assert_array_equal(turned["gz"], push)


@pytest.mark.parametrize(
    ("mount", "stated"),
    [
        ("", None),
        ("0,0,0", None),
        ("90", [0.0, 0.0, 90.0]),
        ("x=-y,y=x", [0.0, 0.0, 90.0]),
        ("x=x,y=-y", [180.0, 0.0, 0.0]),
        ("12.25", [0.0, 0.0, 12.25]),
    ],
)
def test_the_drive_states_it(tmp_path: Path, mount: str, stated: list[float] | None):
    """Also that of an IMU with three axes; x=x,y=-y then needs no other axis."""
    log = a_drive(5.0)
    rows = np.column_stack([log.imu.time, log.imu.ax, log.imu.ay, log.imu.gz])
    np.savetxt(tmp_path / "imu.csv", rows, delimiter=",", header="time_s,ax,ay,gz", comments="")
    fixes = np.column_stack([log.gps.time, log.gps.lat, log.gps.lon])
    np.savetxt(tmp_path / "gps.csv", fixes, "%.12f", ",", header="time_s,lat,lon", comments="")
    drive = imported(tmp_path, recipe=Recipe(mount=mount)).drive
    assert drive.metadata.get("imu_mounting_deg") == stated


def test_what_is_missing_matters_only_where_it_is_needed():
    planar = {"ax": np.ones(2), "ay": np.zeros(2), "gz": np.ones(2)}
    assert set(rotate(planar, parse_mount("90"))) == {"ax", "ay", "gz"}
    with pytest.raises(InputError, match=r"ax needs the accelerometer's az"):
        rotate(planar, parse_mount("0,10,0"))
