"""Findings of the doctor on the odometer, and the results of its repairs."""

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from sigmaswarm import Drive, Odometer, diagnose, read_drive, repair, simulate
from sigmaswarm.doctor.checks import odometer as subject
from sigmaswarm.doctor.checks import timing
from sigmaswarm.doctor.evidence import Evidence, gather
from sigmaswarm.doctor.findings import Diagnosis
from sigmaswarm.drives.suggestion import suggest_filter
from sigmaswarm.filters.parameters import FilterParameters
from support import DRIVES, needs_shared, quickly

Fault = Callable[[Odometer], Odometer]


def times(factor: float) -> Fault:
    return lambda wheels: replace(wheels, speed=factor * wheels.speed)


def shifted(seconds: float) -> Fault:
    return lambda wheels: replace(wheels, time=wheels.time + seconds)


def stuck(begin: float, length: float, value: float | None = None) -> Fault:
    """Repeat the value at a time, or a given value, for some seconds."""

    def plant(wheels: Odometer) -> Odometer:
        held = np.interp(begin, wheels.time, wheels.speed) if value is None else value
        there = (wheels.time >= begin) & (wheels.time < begin + length)
        return replace(wheels, speed=np.where(there, held, wheels.speed))

    return plant


def slipping(wheels: Odometer) -> Odometer:
    """Wheel spin of 50% for 3 s, and locked wheels for 3 s a minute later, both while driving."""
    spun = (wheels.time >= SPUN) & (wheels.time < SPUN + 3.0)
    locked = (wheels.time >= LOCKED) & (wheels.time < LOCKED + 3.0)
    return replace(wheels, speed=np.where(spun, 1.5 * wheels.speed, np.where(locked, 0.0, wheels.speed)))


SPUN, LOCKED = 75.0, 135.0
FAULTS: dict[str, tuple[str, Fault]] = {
    "3% high": ("odometer-scale", times(1.03)),
    "5% low": ("odometer-scale", times(0.95)),
    "backwards": ("odometer-sign", times(-1.0)),
    "km/h": ("odometer-unit", times(3.6)),
    "late": ("odometer-clock", shifted(0.5)),
    "early": ("odometer-clock", shifted(-0.3)),
    "stuck": ("odometer-stuck", stuck(90.0, 15.0, 11.0)),
    "stuck at zero": ("odometer-stuck", stuck(60.0, 15.0, 0.0)),
    "slipping": ("odometer-slip", slipping),
}


@cache
def evidence() -> Evidence:
    """Simulate 300 s in a city with a cheap receiver and a CAN odometer with a scale close to 1."""
    drive = simulate("urban", seed=1, duration=300.0, odometer="can", vibration=1.0, imu_rate=50)
    assert abs(drive.metadata["odometer"]["scale"] - 1) < 0.01
    return gather(replace(drive, truth=None))


def planted(fault: Fault) -> Drive:
    wheels = evidence().drive.odometer
    assert wheels is not None
    return replace(evidence().drive, odometer=fault(wheels))


def found(drive: Drive) -> Diagnosis:
    return Diagnosis(drive.name, tuple(subject.check_odometer(replace(evidence(), drive=drive))))


def test_a_sound_odometer_has_no_finding():
    assert not found(evidence().drive).findings
    assert not list(
        subject.check_odometer(replace(evidence(), drive=replace(evidence().drive, odometer=None)))
    )


ONE_OF_EACH = ("3% high", "backwards", "km/h", "late", "stuck", "slipping")


@pytest.mark.parametrize("name", quickly([(name,) for name in FAULTS], lambda name: name in ONE_OF_EACH))
def test_each_fault_is_reported_and_repaired(name: str):
    code, fault = FAULTS[name]
    drive = planted(fault)
    diagnosis = found(drive)
    assert diagnosis.codes == {code}
    (finding,) = diagnosis.findings
    assert finding.repair is not None and finding.remedy and finding.where.startswith("odometer.csv")
    mended, sound = repair(drive, diagnosis).odometer, evidence().drive.odometer
    assert mended is not None and sound is not None
    assert not found(replace(drive, odometer=mended)).findings
    inside = (sound.time > 20) & (sound.time < 280)
    if code == "odometer-slip":
        for begin in (SPUN, LOCKED):
            assert not np.any((mended.time >= begin) & (mended.time < begin + 3.0))
        assert 6.0 <= (len(sound) - len(mended)) / 83.0 < 6.0 + 8 * subject.MAX_JUMP_TIME
        assert finding.span[0] < SPUN < LOCKED + 3.0 < finding.span[1]
    elif code != "odometer-stuck":
        again = np.interp(sound.time[inside], mended.time, mended.speed)
        assert np.mean(np.abs(again - sound.speed[inside])) < 0.25
    else:
        assert 0.8 * 15 < (len(sound) - len(mended)) / 83.0 < 1.4 * 15


@pytest.mark.long
@pytest.mark.parametrize("environment", ["clear", "slippery"])
@pytest.mark.parametrize("imu", ["icm-20602", "mpu-6050"])
def test_brakes_hills_and_snow_are_not_slip(imu: str, environment: str):
    for maneuver in ("brake", "urban"):
        length = {"duration": 90.0} if maneuver == "urban" else {}
        wheels = {"odometer": "can", "vibration": 1.0, "terrain": "hilly"}
        drive = simulate(maneuver, environment, imu=imu, **wheels, **length)
        assert "odometer-slip" not in diagnose(drive).codes


def test_an_accelerometer_without_information_on_the_wheels_is_not_used():
    turned = replace(evidence().drive.imu, ax=-evidence().drive.imu.ax)
    drive = replace(planted(slipping), imu=turned)
    assert "odometer-slip" not in {f.code for f in subject.check_odometer(replace(evidence(), drive=drive))}


def test_the_odometer_is_part_of_the_diagnosis_and_of_recommended_options():
    diagnosis = diagnose(planted(times(1.06)))
    assert "odometer-scale" in diagnosis.codes
    (use,) = (finding for finding in diagnosis.findings if finding.code == "use")
    assert "--use lateral standstill odometer" in use.what
    assert "odometer" in suggest_filter([evidence().drive]).use
    assert "odometer" not in suggest_filter([replace(evidence().drive, odometer=None)]).use


def test_remedies_propose_a_tuning_only_within_the_bounds_of_its_search():
    ranges = {
        one.name: one.metadata["search"] for one in fields(FilterParameters) if "search" in one.metadata
    }
    names = "odometer_scale", "odometer_latency", "latency"
    scale, wheels, fixes = ((ranges[name].lowest, ranges[name].highest) for name in names)
    assert scale == subject.TUNED_SCALES
    assert wheels == (0.0, subject.MAX_TUNED_LATENCY) and fixes == (0.0, timing.MAX_TUNED_LATENCY)
    faults = (times(1.03), True), (times(1.2), False), (shifted(0.5), False), (shifted(-0.3), False)
    for fault, tuned in faults:
        (finding,) = found(planted(fault)).findings
        assert ("let tune estimate" in finding.remedy) == tuned


@needs_shared
def test_a_real_odometer():
    drive = read_drive(DRIVES / "comma2k19")
    seen = gather(drive)
    assert not list(subject.check_odometer(seen))
    assert drive.odometer is not None
    high = replace(drive, odometer=times(1.04)(drive.odometer))
    assert [f.code for f in subject.check_odometer(replace(seen, drive=high))] == ["odometer-scale"]
