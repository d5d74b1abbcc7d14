"""Faults of the heading column: findings and repairs."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.checks.receiver import check_heading, check_stated_heading
from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.doctor.evidence import Evidence, gather
from sigmaswarm.doctor.findings import Diagnosis, Finding
from sigmaswarm.doctor.repairs import repair
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.tables import NO_HEADING
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.simulation.scenarios import simulate
from support import quickly

FAULTS: dict[str, tuple[Callable[[Array], Array], str, str]] = {
    "sign": (np.negative, "heading-convention", "heading is in rad clockwise from east"),
    "degrees": (np.degrees, "heading-convention", "heading is in deg counter-clockwise from east"),
    "from north": (lambda h: np.pi / 2 - h, "heading-convention", "heading is in rad clockwise from north"),
    "as NMEA": (
        lambda h: (90.0 - np.degrees(h)) % 360.0,
        "heading-convention",
        "heading is in deg clockwise from north",
    ),
    "mounted askew": (lambda h: h + np.radians(6.0), "heading-offset", "heading differs from the course by"),
    "mounted across": (lambda h: h - np.pi / 2, "heading-offset", "heading differs from the course by"),
}


@cache
def good() -> Drive:
    return simulate("urban", gps="white-1m", duration=90, heading="dual-antenna", seed=1, imu_rate=50)


@cache
def evidence() -> Evidence:
    return gather(good())


def found_in(drive: Drive) -> list[Finding]:
    """Return the findings of the good drive with a changed heading."""
    return list(check_heading(replace(evidence(), drive=drive)))


def with_column(heading: Array, std: Array | None = None) -> Drive:
    return replace(good(), gps=replace(good().gps, heading=heading, std_heading=std))


def test_a_good_heading_has_no_finding_and_is_recommended():
    found = {f.code: f.what for f in diagnose(good()).findings}
    assert not any(code.startswith("heading") for code in found)
    assert re.search(
        r"To add heading \(of the fixes\), write --use lateral .*robust.* heading$", found["use"]
    )


@pytest.mark.parametrize(
    "name", quickly([(n,) for n in FAULTS], lambda n: n in ("as NMEA", "from north", "mounted across"))
)
def test_faults_are_named_and_repaired(name: str):
    spoil, code, said = FAULTS[name]
    heading, std = good().gps.heading, good().gps.std_heading
    assert heading is not None and std is not None
    degrees = name in ("degrees", "as NMEA")
    drive = with_column(spoil(heading), np.degrees(std) if degrees else std)
    (found,) = found_in(drive)
    assert found.code == code and said in found.what
    assert found.severity == ("warning" if name == "mounted askew" else "serious")
    mended = repair(drive, Diagnosis(drive.name, (found,)))
    assert mended.gps.heading is not None and mended.gps.std_heading is not None
    assert np.abs(wrap_angle(mended.gps.heading - heading)).max() < np.radians(1.0)
    np.testing.assert_allclose(mended.gps.std_heading, std)
    assert not found_in(mended)


@pytest.mark.parametrize("late", [0.4, -0.3])
def test_a_delay_is_found_by_the_gyro(late: float):
    heading, time = good().gps.heading, good().gps.time
    assert heading is not None
    (found,) = found_in(with_column(np.interp(time - late, time, np.unwrap(heading))))
    assert found.code == "heading-delay" and found.repair is None
    assert abs(float(found.what.split()[-2]) - abs(late)) < 0.06
    assert ("lags" in found.what) == (late > 0)


def test_noise_as_heading_matches_no_convention():
    rng = np.random.default_rng(0)
    (found,) = found_in(with_column(rng.uniform(-3.0, 3.0, len(good().gps))))
    assert found.what == "the heading agrees with the direction of travel in no known convention"


def test_a_fix_without_a_heading_has_none_after_a_repair():
    heading, std = good().gps.heading, good().gps.std_heading
    assert heading is not None and std is not None
    lost = np.arange(len(heading)) % 5 == 0
    drive = with_column(np.where(lost, 0.0, np.degrees(heading)), np.where(lost, NO_HEADING, np.degrees(std)))
    (found,) = found_in(drive)
    mended = repair(drive, Diagnosis(drive.name, (found,))).gps
    assert mended.std_heading is not None
    np.testing.assert_allclose(mended.std_heading, np.where(lost, NO_HEADING, std))


@pytest.mark.long
def test_a_delay_of_the_fixes_is_not_a_delay_of_the_heading():
    drive = replace(good(), gps=replace(good().gps, time=good().gps.time + 18.0))
    assert not [found for found in check_heading(gather(drive)) if found.code == "heading-delay"]


def stated(heading: float) -> list[Finding]:
    """Return the findings of the good drive without headings, with heading_deg in drive.toml."""
    gps = replace(good().gps, heading=None, std_heading=None)
    drive = replace(good(), gps=gps, metadata={**good().metadata, "heading_deg": heading % 360.0})
    return list(check_stated_heading(replace(evidence(), drive=drive)))


@pytest.mark.parametrize("off", [90.0, -45.0, 180.0, None])
def test_a_stated_heading_that_contradicts_the_course_is_reported_and_its_remedy_helps(off: float | None):
    """Heading None: the true heading, but clockwise from north."""
    truth = good().truth
    assert truth is not None
    true = float(np.degrees(np.interp(good().imu.time[0], truth.time, np.unwrap(truth.theta))))
    assert not stated(true) and not stated(true + 12.0) and not stated(true - 12.0)
    (found,) = stated(90.0 - true if off is None else true + off)
    assert found.code == "heading-offset" and found.severity == ("warning" if off == 180.0 else "serious")
    assert off is not None or "clockwise from north" in found.what
    told = re.search(r"heading_deg = (\d+) .* --heading-from-north (\d+)", found.remedy)
    assert told
    for right in (float(told[1]), 90.0 - float(told[2])):
        assert abs(wrap_angle(np.radians(right - true))) < np.radians(8.0)
        assert not stated(right)
