"""Geodesy compared with textbook formulas, and the wrapping of angles with its definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sigmaswarm.doctor.mounting import AXIS_PERMUTATIONS
from sigmaswarm.geodesy import enu_to_geodetic, geodetic_to_enu, roll_pitch_yaw, rotation_of, wrap_angle

longitude = st.floats(-180, 180)
altitude = st.floats(-400, 9000)
nearby = st.floats(-0.2, 0.2)  # deg, about 20 km


def by_hand(lat: float, lon: float, alt: float, origin: tuple[float, float, float]) -> np.ndarray:
    """Convert with the textbook's formulas through earth-fixed coordinates (NIMA TR8350.2)."""

    def ecef(lat: float, lon: float, alt: float) -> np.ndarray:
        lat, lon = np.radians([lat, lon])
        e2 = (2 - 1 / 298.257223563) / 298.257223563
        n = 6378137.0 / np.sqrt(1 - e2 * np.sin(lat) ** 2)
        r = (n + alt) * np.cos(lat)
        return np.array([r * np.cos(lon), r * np.sin(lon), (n * (1 - e2) + alt) * np.sin(lat)])

    lat0, lon0 = np.radians(origin[:2])
    up = np.array([np.cos(lat0) * np.cos(lon0), np.cos(lat0) * np.sin(lon0), np.sin(lat0)])
    east = np.array([-np.sin(lon0), np.cos(lon0), 0.0])
    return np.array([east, np.cross(up, east), up]) @ (ecef(lat, lon, alt) - ecef(*origin))


@given(st.floats(-89.7, 89.7), longitude, altitude, nearby, nearby, altitude)
def test_enu_is_the_textbooks(lat0: float, lon0: float, alt0: float, dlat: float, dlon: float, alt: float):
    place, origin = (lat0 + dlat, lon0 + dlon, alt), (lat0, lon0, alt0)
    np.testing.assert_allclose(geodetic_to_enu(*place, origin), by_hand(*place, origin), rtol=0, atol=2e-8)


@given(st.floats(-89.7, 89.7), longitude, altitude, *[st.floats(-2e4, 2e4)] * 2, st.floats(-500, 5000))
def test_enu_to_geodetic_is_the_inverse(
    lat0: float, lon0: float, alt0: float, east: float, north: float, up: float
):
    origin = lat0, lon0, alt0
    place = enu_to_geodetic([east, north, up], origin)
    np.testing.assert_allclose(geodetic_to_enu(*place, origin), [east, north, up], rtol=0, atol=2e-8)


def test_arrays_keep_their_shape():
    lat = np.array([[51.0, 51.1], [51.2, 51.3]])
    enu = geodetic_to_enu(lat, 13.8, 100.0, (51.0, 13.8, 100.0))
    assert enu.shape == (2, 2, 3)
    np.testing.assert_allclose(enu[0, 0], 0.0, atol=1e-9)
    np.testing.assert_allclose(enu_to_geodetic(enu, (51.0, 13.8, 100.0))[..., 0], lat, atol=1e-12)


angle = st.floats(-1e4, 1e4)


@given(angle)
def test_wrapped_angles_lie_in_the_half_open_interval_and_point_the_same_way(a: float):
    wrapped = wrap_angle(a)
    assert -np.pi < wrapped <= np.pi
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * a), abs=1e-11)


@given(angle, st.integers(-1000, 1000))
def test_wrapping_does_not_see_whole_turns(a: float, turns: int):
    difference = wrap_angle(a + 2 * np.pi * turns) - wrap_angle(a)
    assert np.exp(1j * difference) == pytest.approx(1, abs=1e-11)


@pytest.mark.parametrize("a", [0.0, 3.0, -3.0, np.pi])
def test_angles_in_range_stay(a: float):
    assert wrap_angle(a) == pytest.approx(a, abs=1e-15)


def test_the_ends_of_the_interval():
    assert wrap_angle(-np.pi) == np.pi
    assert wrap_angle(np.pi) == np.pi
    np.testing.assert_array_equal(wrap_angle(np.array([np.pi, -np.pi])), [np.pi, np.pi])
    assert isinstance(wrap_angle(1), float)


def test_angles_and_rotation_are_inverse_also_where_x_is_vertical():
    for matrix in AXIS_PERMUTATIONS:
        np.testing.assert_array_equal(rotation_of(*roll_pitch_yaw(matrix, 1)), matrix)
    for seed in range(20):
        matrix = Rotation.random(random_state=seed).as_matrix()
        np.testing.assert_allclose(rotation_of(*roll_pitch_yaw(matrix, 9)), matrix, rtol=0, atol=1e-10)
        upright = rotation_of(0.0, 90.0 - 10.0 ** -(seed + 1), 25.0)
        np.testing.assert_allclose(rotation_of(*roll_pitch_yaw(upright, 9)), upright, rtol=0, atol=1e-9)
