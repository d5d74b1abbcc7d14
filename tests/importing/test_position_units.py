"""Latitude and longitude in minutes, seconds and other fractions of a degree, at several places."""

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from importing.logs import a_drive, imported
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from support import diagonal, quickly

DRIVE = a_drive(12.0)
PLACES = {
    "Karlsruhe": (49.0, 8.4),
    "Sydney": (-33.9, 151.2),
    "London": (51.5, -0.1),
    "Denver": (39.7, -105.0),
}


def write(folder: Path, place: tuple[float, float], names: tuple[str, str], per_degree: float) -> Path:
    imu, gps = DRIVE.imu, DRIVE.gps
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), (*place, 100.0)).T
    quoted = [name.replace('"', '""') for name in names]
    rows = zip(imu.time.tolist(), imu.ax, imu.ay, imu.az, imu.gz, strict=True)
    lines = ["t,ax,ay,az,gz", *(",".join(map(str, row)) for row in rows)]
    (folder / "imu.csv").write_text("\n".join(lines))
    rows = zip(gps.time.tolist(), (lat * per_degree).tolist(), (lon * per_degree).tolist(), strict=True)
    cells = (f"{t},{a:.0f},{b:.0f}" if per_degree > 1e5 else f"{t},{a!r},{b!r}" for t, a, b in rows)
    (folder / "gps.csv").write_text("\n".join([f't,"{quoted[0]}","{quoted[1]}"', *cells]))
    return folder


def scale_error(drive: Drive) -> float:
    """Return the relative error of the distances between fixes."""
    got, wanted = (np.abs(np.diff(d.gps.x + 1j * d.gps.y)) for d in (drive, DRIVE))
    return abs(float(np.sum(got) / np.sum(wanted)) - 1)


@pytest.mark.parametrize(
    ("place", "lat", "lon", "per_degree"),
    diagonal(
        PLACES,
        [
            ("lat_min", "lon_min", 60),
            ("latitude [min]", "longitude [min]", 60),
            ("lat [']", "lon [']", 60),
            ("lat_in_minutes", "lon_in_minutes", 60),
            ("lat_sec", "lon_sec", 3600),
            ('lat ["]', 'lon ["]', 3600),
            ("latitude_1e7", "longitude_1e7", 1e7),
            ("latE7", "lonE7", 1e7),
            ("lat", "lon", 1e7),
        ],
    ),
)
def test_a_unit_in_the_name_is_converted(tmp_path: Path, lat: str, lon: str, per_degree: float, place: str):
    assert scale_error(imported(write(tmp_path, PLACES[place], (lat, lon), per_degree)).drive) < 0.01


@pytest.mark.parametrize(
    ("place", "per_degree", "mapped"),
    quickly(
        product(PLACES, [60, 3600, 1e5, 1e6], [False, True]),
        lambda place, _, mapped: mapped == (place in ("Sydney", "Denver")) and place != "London",
    ),
)
def test_the_first_remedy_for_values_that_are_not_degrees_works(
    tmp_path: Path, per_degree: float, place: str, mapped: bool
):
    """Also if the user mapped the columns without a factor. Small arcminutes are read as ddmm.mmmm, with a note."""
    folder = write(tmp_path, PLACES[place], ("lat", "lon"), per_degree)
    maps = ["gps.lat=lat", "gps.lon=lon"] if mapped else []
    try:
        said = " ".join(imported(folder, maps=maps).notes)
        assert per_degree == 60 and "ddmm.mmmm; if they are arcminutes" in said
    except InputError as error:
        said = str(error)
    remedy = re.findall(r'"(gps\.(?:lat|lon)=[^"]+)"', said)[:2]
    assert [text.split("=")[0] for text in remedy] == ["gps.lat", "gps.lon"]
    assert scale_error(imported(folder, maps=remedy).drive) < 0.01


@pytest.mark.parametrize("unit", ["min", "s", "furlong"])
def test_degrees_under_a_name_with_another_unit_are_refused(tmp_path: Path, unit: str):
    """lat_min may be the smallest latitude: a value that is possible in degrees is not divided by 60."""
    folder = write(tmp_path, PLACES["Denver"], (f"lat [{unit}]", f"lon [{unit}]"), 1)
    with pytest.raises(InputError, match=r"is a unit of|is not known") as caught:
        imported(folder)
    remedy = re.findall(r'"(gps\.(?:lat|lon)=[^"]+)"', str(caught.value))[:2]
    assert remedy == [f"gps.{n}=`{n} [{unit}]`" for n in ("lat", "lon")]
    assert scale_error(imported(folder, maps=remedy).drive) < 0.01
