"""Geodesy against pymap3d, and the wrapping of angles against its definition."""

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.geodesy import enu_to_geodetic, geodetic_to_ecef, geodetic_to_enu, wrap_angle

latitude = st.floats(-90, 90)
longitude = st.floats(-180, 180)
altitude = st.floats(-400, 9000)
nearby = st.floats(-0.2, 0.2)  # deg, about 20 km


@given(latitude, longitude, altitude)
def test_ecef_is_pymap3ds(lat: float, lon: float, alt: float):
    np.testing.assert_allclose(
        geodetic_to_ecef(lat, lon, alt), pymap3d.geodetic2ecef(lat, lon, alt), rtol=0, atol=1e-8
    )


@given(st.floats(-89.7, 89.7), longitude, altitude, nearby, nearby, altitude)
def test_enu_is_pymap3ds_altitude_included(
    lat0: float, lon0: float, alt0: float, dlat: float, dlon: float, alt: float
):
    lat, lon = lat0 + dlat, lon0 + dlon
    ours = geodetic_to_enu(lat, lon, alt, (lat0, lon0, alt0))
    np.testing.assert_allclose(ours, pymap3d.geodetic2enu(lat, lon, alt, lat0, lon0, alt0), rtol=0, atol=1e-7)


@given(st.floats(-89.7, 89.7), longitude, altitude, *[st.floats(-2e4, 2e4)] * 2, st.floats(-500, 5000))
def test_enu_to_geodetic_is_pymap3ds_and_the_inverse(
    lat0: float, lon0: float, alt0: float, east: float, north: float, up: float
):
    lat, lon, alt = enu_to_geodetic([east, north, up], (lat0, lon0, alt0))
    theirs = pymap3d.enu2geodetic(east, north, up, lat0, lon0, alt0)
    assert lat == pytest.approx(theirs[0], abs=1e-11)  # deg, about 1 um
    assert alt == pytest.approx(theirs[2], abs=1e-6)
    np.testing.assert_allclose(
        geodetic_to_enu(lat, lon, alt, (lat0, lon0, alt0)), [east, north, up], atol=1e-7
    )


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
