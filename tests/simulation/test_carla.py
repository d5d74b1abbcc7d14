import importlib.metadata
import importlib.util

import numpy as np
import pytest

from oracles import carla_geodesy
from sigmaswarm.simulation.gps import METERS_PER_DEGREE
from standin.geodesy import from_geolocation, to_geolocation

ORIGINS = [(0.0, 0.0), (49.0, 8.0), (-33.0, 151.0)]
# Multiples of 1/8 m, which are exact in the single precision of CARLA's locations.
PLACES = [(0.0, 0.0), (100.0, 0.0), (0.0, 100.0), (-350.125, 220.5), (5000.0, -3000.0)]


def meters_apart(lat, lon, lat2, lon2):
    north = (lat - lat2) * METERS_PER_DEGREE
    east = (lon - lon2) * METERS_PER_DEGREE * np.cos(np.radians(lat2))
    return float(np.hypot(north, east).max())


@pytest.mark.parametrize("origin", ORIGINS)
def test_0914_equals_the_formula_of_its_source(origin):
    x, y = np.array(PLACES).T
    expected = np.array([carla_geodesy.formula_0914(*place, *origin) for place in PLACES]).T
    assert meters_apart(*to_geolocation(x, y, *origin), *expected) < 1e-6


@pytest.mark.parametrize("origin", ORIGINS)
def test_0916_equals_the_genuine_client(origin):
    if importlib.util.find_spec("carla") is None:
        pytest.skip("carla is not installed")
    if (version := importlib.metadata.version("carla")) != "0.9.16":
        pytest.skip(f"carla {version} is installed, not 0.9.16")
    x, y = np.array(PLACES).T
    expected = np.array(carla_geodesy.client_0916(PLACES, *origin)).T
    assert meters_apart(*to_geolocation(x, y, *origin, version="0.9.16"), *expected) < 1e-4


@pytest.mark.parametrize("version", ["0.9.14", "0.9.16"])
@pytest.mark.parametrize("origin", ORIGINS)
def test_the_conversion_can_be_inverted(origin, version):
    x, y = np.array(PLACES).T
    back = from_geolocation(*to_geolocation(x, y, *origin, version), *origin, version)
    np.testing.assert_allclose(back, [x, y], atol=1e-6)


def test_0916_mirrors_latitude():
    lat, _ = to_geolocation(np.zeros(1), np.array([100.0]), 49.0, 8.0, "0.9.14")
    lat_16, _ = to_geolocation(np.zeros(1), np.array([100.0]), 49.0, 8.0, "0.9.16")
    assert lat[0] < 49.0 < lat_16[0]
