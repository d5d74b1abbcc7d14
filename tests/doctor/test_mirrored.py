"""Fixes with exchanged coordinates: one finding that names the fixes, and no change of the IMU."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sigmaswarm
from doctor.faults import flipped_yaw, reversed_force, right_and_down
from sigmaswarm import Diagnosis, Drive
from sigmaswarm.cli.findings import mirror_maps
from sigmaswarm.doctor.fixes import course_of
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic, geodetic_to_enu, rotation_of
from support import quickly, some

LOOKS_THE_SAME = "exchanged x and y"


@cache
def simulated() -> Drive:
    return sigmaswarm.simulate("urban", gps="white-1m", duration=60, imu_rate=50)


@cache
def good(axes: int) -> Drive:
    drive = replace(simulated(), truth=None)
    missing = dict.fromkeys({6: (), 4: ("gx", "gy"), 3: ("az", "gx", "gy")}[axes])
    return replace(drive, imu=replace(drive.imu, **missing))


def mirrored(drive: Drive) -> Drive:
    return replace(drive, gps=replace(drive.gps, x=drive.gps.y, y=drive.gps.x))


def in_degrees(drive: Drive) -> Drive:
    """Return fixes with exchanged columns at 60 deg north, where a degree of longitude is half as long."""
    lat, lon, alt = enu_to_geodetic(
        np.stack([drive.gps.x, drive.gps.y, 0 * drive.gps.x], -1), (60.0, 10.0, 0.0)
    ).T
    x, y, _ = geodetic_to_enu(lon, lat, alt, (10.0, 60.0, 0.0)).T
    return replace(drive, gps=replace(drive.gps, x=x, y=y), frame="wgs84", origin=(10.0, 60.0, 0.0))


def with_truth(drive: Drive) -> Drive:
    return replace(mirrored(drive), truth=simulated().truth)


def sideways(drive: Drive) -> Drive:
    return replace(drive, imu=rotate_imu(drive.imu, rotation_of(0, 0, 90)))


def serious(found: Diagnosis) -> set[str]:
    return {finding.code for finding in found.findings if finding.severity == "serious"}


@pytest.mark.parametrize("axes", quickly([(6,), (4,)], lambda axes: axes == 4))
def test_exchanged_coordinates_are_reported_and_repaired(axes: int):
    drive = good(axes)
    wrong = mirrored(drive)
    found = sigmaswarm.diagnose(wrong)
    assert serious(found) == {"mirrored-fixes"}
    mended = sigmaswarm.repair(wrong, found)
    np.testing.assert_array_equal(mended.gps.x, drive.gps.x)
    np.testing.assert_array_equal(mended.gps.y, drive.gps.y)
    np.testing.assert_array_equal(mended.imu.ay, drive.imu.ay)
    assert not sigmaswarm.diagnose(mended).serious


def test_a_course_and_a_clock_are_checked_after_the_exchange():
    """Before the exchange, a correct course seems to be clockwise from north."""
    drive, gps = good(4), good(4).gps
    velocity = course_of(gps.time, gps.x + 1j * gps.y).velocity
    late = replace(gps, speed=np.abs(velocity), course=np.angle(velocity), time=gps.time + 1.5)
    found = sigmaswarm.diagnose(mirrored(replace(drive, gps=late)))
    assert serious(found) == {"mirrored-fixes", "clock-offset"}


@pytest.mark.parametrize("change", [in_degrees, with_truth])
def test_degrees_and_a_drive_with_truth_are_not_repaired(change: Callable[[Drive], Drive]):
    found = sigmaswarm.diagnose(change(good(4)))
    assert serious(found) == {"mirrored-fixes"}
    assert not any(finding.repair for finding in found.findings)


def at(drive: Drive, origin: tuple[float, float, float], signs: tuple[int, int]) -> Drive:
    """Return fixes at a place, with latitudes and longitudes multiplied by ``signs``."""
    lat, lon, alt = enu_to_geodetic(np.stack([drive.gps.x, drive.gps.y, 0 * drive.gps.x], -1), origin).T
    other = (signs[0] * origin[0], signs[1] * origin[1], origin[2])
    x, y, _ = geodetic_to_enu(signs[0] * lat, signs[1] * lon, alt, other).T
    return replace(drive, gps=replace(drive.gps, x=x, y=y), frame="wgs84", origin=other)


@pytest.mark.parametrize(
    ("origin", "signs"),
    quickly(
        [((37.4, -122.1, 9.0), (1, -1)), ((40.7, -74.0, 9.0), (1, -1)), ((-33.9, 18.4, 9.0), (-1, 1))],
        lambda origin, signs: origin[1] == -74.0,
    ),
)
@pytest.mark.parametrize("axes", some([6, 4]))
def test_a_missing_sign_of_degrees_is_reported_and_the_imu_is_kept(
    axes: int, origin: tuple[float, float, float], signs: tuple[int, int]
):
    wrong = at(good(axes), origin, signs)
    found = sigmaswarm.diagnose(wrong)
    assert serious(found) == {"mirrored-fixes"}
    finding = next(f for f in found.findings if f.code == "mirrored-fixes")
    assert finding.repair is None
    assert "lack a minus sign" in finding.what
    assert not mirror_maps(found)  # the log does not show which remedy is right
    for place in ("gps.lon=-(COLUMN_OF_LON)", "gps.lat=-(COLUMN_OF_LAT)", "imu.gz=-(COLUMN_OF_GZ)"):
        assert f'"{place}"' in finding.remedy
    assert not sigmaswarm.diagnose(at(good(axes), origin, (1, 1))).serious


def without_lateral(drive: Drive) -> Drive:
    noise = np.random.default_rng(1).normal(0, 0.1, len(drive.imu))
    return flipped_yaw(replace(drive, imu=replace(drive.imu, ay=noise)))


@pytest.mark.parametrize(
    ("axes", "change"),
    quickly(
        [(6, flipped_yaw), (4, without_lateral), (4, right_and_down), (6, sideways)],
        lambda axes, _: axes == 4,
    ),
)
def test_faults_of_the_imu_are_not_faults_of_the_fixes(axes: int, change: Callable[[Drive], Drive]):
    found = sigmaswarm.diagnose(change(good(axes)))
    assert found.serious
    assert "mirrored-fixes" not in found.codes


@pytest.mark.parametrize("case", ["no az", "sideways"])
def test_an_ambiguous_log_keeps_its_findings_and_names_the_fixes(case: str):
    drive = good(3) if case == "no az" else sideways(good(6))
    found = sigmaswarm.diagnose(mirrored(drive))
    assert "mirrored-fixes" not in found.codes
    assert any(
        LOOKS_THE_SAME in finding.remedy for finding in found.findings if finding.severity == "serious"
    )


@pytest.mark.parametrize("fault", [flipped_yaw, reversed_force])
def test_a_fault_of_one_sensor_does_not_name_the_fixes(fault: Callable[[Drive], Drive]):
    found = sigmaswarm.diagnose(fault(good(4)))
    assert found.serious
    assert not any(LOOKS_THE_SAME in finding.remedy for finding in found.findings)


def test_mirrored_fixes_give_no_mounting():
    with pytest.raises(InputError, match="mirror image"):
        sigmaswarm.find_mount(mirrored(good(6)))
