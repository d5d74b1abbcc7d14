"""A repaired drive is as good as the original: the planted fault is removed, and the numbers agree."""

import warnings
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sigmaswarm
from doctor.faults import FAULTS, MORE, codes_of
from sigmaswarm import Diagnosis, Drive, Finding
from sigmaswarm.doctor.findings import Repair
from sigmaswarm.doctor.mounting import angle_of, rotate_imu
from sigmaswarm.doctor.repairs import leave_different_axes
from sigmaswarm.doctor.repairs import repair as repaired
from sigmaswarm.geodesy import rotation_of
from sigmaswarm.importing.mounting import parse_mount
from sigmaswarm.scoring import verified_repair
from support import DRIVES, SHARED, needs_shared, quickly

MENDABLE = [fault for fault in [*FAULTS, *MORE] if fault != "gaps"]
EXACT = {"yaw-flipped", "deg/s", "g", "axes-swapped", "force reversed", "right and down"}
"""Faults whose repair restores all numbers of the sensors."""
ROUGH = {"gravity": 0.6, "15 deg": 0.1}
"""Largest RMS difference of ax, ay from the original, m/s2; a repaired tilt also removes the constant bias."""


@cache
def drive_of(name: str) -> Drive:
    """Return a drive; simulated ones have no truth, so their diagnosis takes half the time."""
    if name.startswith("simulated"):
        length, rate = (60.0, 50.0) if "short" in name else (180.0, 100.0)
        drive = sigmaswarm.simulate("urban", gps="white-1m", duration=length, imu_rate=rate)
        return replace(drive, truth=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)
        return sigmaswarm.read_drive(DRIVES / name)


def same(drive: Drive, good: Drive) -> bool:
    """Return whether all numbers of the sensors agree."""
    pairs = [
        (getattr(new, field.name), getattr(old, field.name))
        for new, old in ((drive.imu, good.imu), (drive.gps, good.gps))
        for field in fields(old)
    ]
    return all(
        a is b
        or (
            a is not None and b is not None and np.shape(a) == np.shape(b) and np.allclose(a, b, 1e-12, 1e-12)
        )
        for a, b in pairs
    )


def check(name: str, fault: str) -> None:
    good, plant = drive_of(name), (FAULTS | MORE)[fault][0]
    codes = codes_of(fault, good)
    sick = plant(good)
    found = sigmaswarm.diagnose(sick)
    assert codes <= found.codes
    assert {f.code for f in found.findings if f.severity == "serious"} <= codes  # no other serious finding
    mended = sigmaswarm.repair(sick, found)
    assert same(mended, good) or fault not in EXACT
    left = sigmaswarm.diagnose(good if fault in EXACT else mended)  # the numbers are the same
    assert not left.serious
    assert not {finding.code for finding in left.findings if finding.severity != "note"} & codes
    for column in ("ax", "ay"):
        off = getattr(mended.imu, column) - getattr(good.imu, column)
        assert np.sqrt(np.mean(off**2)) < ROUGH.get(fault, 1e-9)
    limit = {"gravity": 0.05, "15 deg": 1e-3}.get(fault, 1e-12)  # a rotation includes small roll and pitch
    np.testing.assert_allclose(mended.imu.gz, good.imu.gz, atol=limit)
    if mended.gps.std_x is not None and fault.startswith("stated"):
        assert np.median(mended.gps.std_x) == pytest.approx(1.0, rel=0.1)
    if "late" in fault or "early" in fault:
        assert mended.gps.time[0] == pytest.approx(good.gps.time[0], abs=0.1)
    if fault == "outliers":
        kept = np.isin(good.gps.time, mended.gps.time)
        np.testing.assert_array_equal(mended.gps.x, good.gps.x[kept])
        assert kept.mean() == pytest.approx(0.98, abs=0.005)


QUICK = {"outliers", "yaw-flipped", "0.5 s late", "gravity"}
"""One fault of each kind; `test_three_faults_at_once` repairs three faults together."""


@pytest.mark.parametrize("fault", quickly([(f,) for f in MENDABLE], lambda f: f in QUICK))
def test_a_repaired_simulated_drive(fault: str):
    check("simulated" if "0.2 s" in fault else "simulated, short", fault)


@pytest.mark.long
@needs_shared
@pytest.mark.parametrize("fault", [f for f in MENDABLE if "0.2 s" not in f])
def test_a_repaired_recording(fault: str):
    check("kitti-09-30-0033", fault)


def test_three_faults_at_once():
    good = drive_of("simulated, short")
    sick = FAULTS["g"][0](FAULTS["axes-swapped"][0](FAULTS["deg/s"][0](good)))
    found = sigmaswarm.diagnose(sick)
    assert {"accelerometer-unit", "accelerometer-axes", "gyro-unit"} <= found.codes
    mended = sigmaswarm.repair(sick, found)
    np.testing.assert_allclose(mended.imu.ax, good.imu.ax, atol=1e-9)
    np.testing.assert_allclose(mended.imu.ay, good.imu.ay, atol=1e-9)
    np.testing.assert_allclose(mended.imu.gz, good.imu.gz, atol=1e-12)
    assert set(mended.metadata["repaired"]) == {"accelerometer-unit", "accelerometer-axes", "gyro-unit"}
    assert found.serious and not sigmaswarm.diagnose(mended).serious


def test_only_some_findings_are_repaired():
    good = drive_of("simulated, short")
    sick = FAULTS["g"][0](FAULTS["deg/s"][0](good))
    found = sigmaswarm.diagnose(sick)
    mended = sigmaswarm.repair(sick, found, only=["gyro-unit"])
    np.testing.assert_allclose(mended.imu.gz, good.imu.gz, atol=1e-12)
    np.testing.assert_array_equal(mended.imu.ax, sick.imu.ax)
    assert mended.metadata["repaired"] == ["gyro-unit"]
    assert sigmaswarm.repair(sick, found, only=[]) is sick


def test_jumps_of_the_clock_are_removed():
    """There are two jumps; the time of the second one in the finding includes the shift by the first."""
    good = sigmaswarm.simulate("urban", gps="white-1m", duration=120, seed=3)
    truth = good.truth
    assert truth is not None
    steady = np.convolve(np.hypot(np.gradient(truth.x), np.gradient(truth.y)), np.ones(400), "same")
    half = len(steady) // 2
    moments = [float(truth.time[k + int(np.argmax(steady[k : k + half]))]) for k in (0, half)]
    jumps = 4.0, 2.5

    def jumped(time: np.ndarray) -> np.ndarray:
        return time + sum(jump * (time > moment) for jump, moment in zip(jumps, moments, strict=True))

    sick = replace(
        good,
        **{
            name: replace(getattr(good, name), time=jumped(getattr(good, name).time))
            for name in ("imu", "gps", "truth")
        },
    )
    found = sigmaswarm.diagnose(sick)
    assert [f.code for f in found.findings].count("clock-jump") == 2
    mended = sigmaswarm.repair(sick, found)
    for name in ("imu", "gps", "truth"):
        np.testing.assert_allclose(getattr(mended, name).time, getattr(good, name).time, rtol=0, atol=1e-9)
    assert mended.metadata["repaired"].count("clock-jump") == 1


def test_lost_time_next_to_a_jump_is_kept():
    """Both clocks miss 4 s, but the car drove for only 2 s of them."""
    good = sigmaswarm.simulate("cruise", gps="white-1m", seed=3)
    imu, gps = (t.select((t.time <= 15.0) | (t.time > 17.0)) for t in (good.imu, good.gps))
    imu, gps = (replace(t, time=np.where(t.time > 15.0, t.time + 3.0, t.time)) for t in (imu, gps))
    (found,) = (
        f
        for f in sigmaswarm.diagnose(replace(good, imu=imu, gps=gps)).findings
        if f.code in {"clock-jump", "logger-pause"}
    )
    assert found.code == "clock-jump"
    assert found.repair is None


def test_repair_without_findings_changes_nothing():
    drive = drive_of("simulated, short")
    assert sigmaswarm.repair(drive, sigmaswarm.diagnose(drive)) is drive


@pytest.mark.long
@needs_shared
def test_the_repaired_raw_log_is_similar_to_the_corrected_log():
    sick, good = drive_of("dresden-as-recorded"), drive_of("dresden")
    mended = sigmaswarm.repair(sick, sigmaswarm.diagnose(sick))
    for column, limit in (("ax", 0.35), ("ay", 0.5), ("gz", 0.02)):
        off = getattr(mended.imu, column) - getattr(good.imu, column)  # the same samples, shifted in time
        assert np.sqrt(np.mean(off**2)) < limit


@pytest.mark.parametrize(
    ("code", "repair"),
    quickly(
        [
            ("clock-offset", Repair("shift-fixes", (-1.5,))),
            ("gyro-sign", Repair("gyro", (2.0, -1.0))),
            ("mounting", Repair("rotate", (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))),
        ],
        lambda code, _: code == "gyro-sign",
    ),
)
def test_a_repair_that_makes_forecasts_worse_is_withheld(code: str, repair: Repair):
    good = drive_of("simulated, short")
    wrong = Finding(code, "serious", "a false finding", "imu.csv", (0.0, 1.0), 0.999, "do not", repair)
    with pytest.warns(
        sigmaswarm.SigmaswarmWarning, match=f"{code} not repaired, since with the repair a filter predicts"
    ):
        kept = sigmaswarm.repair(good, Diagnosis(good.name, (wrong,)))
    np.testing.assert_array_equal(kept.imu.gz, good.imu.gz)
    np.testing.assert_array_equal(kept.gps.time, good.gps.time)
    assert kept.metadata["withheld"] == [code]
    sick = replace(FAULTS["g"][0](good), metadata={"withheld": ["accelerometer-unit"]})
    assert not any(f.repair for f in sigmaswarm.diagnose(sick).findings if f.code == "accelerometer-unit")
    # A correct repair is applied together with it.
    sick = FAULTS["g"][0](good)
    found = sigmaswarm.diagnose(sick)
    with pytest.warns(sigmaswarm.SigmaswarmWarning, match="not repaired"):
        mended = sigmaswarm.repair(sick, replace(found, findings=(*found.findings, wrong)))
    np.testing.assert_allclose(mended.imu.ax, good.imu.ax, atol=1e-9)


BEFORE = (10.0, 20.0, 30.0)
"""Mounting that the import has applied, deg."""
OTHER = Rotation.random(random_state=3).as_matrix()
ABOUT_X = np.diag([1.0, -1.0, -1.0])


def about_z(angle: float) -> np.ndarray:
    return Rotation.from_euler("z", angle).as_matrix()


def rotate(matrix: np.ndarray) -> Repair:
    return Repair("rotate", tuple(matrix.ravel().tolist()))


@pytest.mark.parametrize(
    ("axes", "repairs", "rotation"),
    [
        (6, [rotate(OTHER)], OTHER),
        (6, [Repair("turn", (0.3,)), rotate(OTHER)], about_z(0.3) @ OTHER),
        (6, [rotate(Rotation.from_euler("xyz", BEFORE, degrees=True).as_matrix().T)], "taken back"),
        (6, [Repair("gyro", (2.0, np.pi / 180)), Repair("level", (0.3, 0.1))], np.eye(3)),
        (6, [Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, 1.02)), rotate(OTHER)], OTHER),
        (6, [Repair("accelerometer", (0.0, -1.0, 1.0, 0.0, 1.0))], "no rotation"),
        (6, [Repair("tilt-rates", (-1.0, 0.0, 0.0, 1.0))], "no rotation"),
        (6, [Repair("accelerometer", (-1.0, 0.0, 0.0, -1.0, -1.0))], "no rotation"),
        (3, [Repair("accelerometer", (0.0, -1.0, 1.0, 0.0, 1.0))], about_z(np.pi / 2)),
        (3, [Repair("accelerometer", (1.0, 0.0, 0.0, -1.0, 1.0)), Repair("gyro", (2.0, -1.0))], ABOUT_X),
        (3, [Repair("turn", (0.3,))], about_z(0.3)),
        (3, [Repair("accelerometer", (1.0, 0.0, 0.0, -1.0, 1.0))], "no rotation"),
    ],
)
def test_the_mounting_is_the_rotation_from_the_raw_samples(axes: int, repairs: list[Repair], rotation):
    stated = BEFORE if axes == 6 else (0.0, 0.0, 30.0)
    before = Rotation.from_euler("xyz", stated, degrees=True).as_matrix()
    drive = drive_of("simulated, short")
    if axes == 3:
        drive = replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None))
    drive = replace(drive, metadata={"imu_mounting_deg": [*stated]})
    findings = [
        Finding(r.action, "serious", "wrong", "imu.csv", (0.0, 1.0), 0.999, "mend", r) for r in repairs
    ]
    mended = repaired(drive, Diagnosis(drive.name, tuple(findings)))
    if isinstance(rotation, str):
        assert mended.mounting is None
        return
    whole = parse_mount(",".join(map(str, mended.mounting)))
    np.testing.assert_allclose(whole, rotation @ before, atol=1e-9)
    if axes == 6 and {r.action for r in repairs} <= {"rotate", "turn"}:  # the numbers, too
        raw = rotate_imu(drive.imu, before.T)
        np.testing.assert_allclose(rotate_imu(raw, whole).gy, mended.imu.gy, atol=1e-9)


@pytest.mark.long
def test_the_remedy_of_a_turned_drive_is_the_mounting_of_its_log():
    """The doctor finds the remaining rotation, but an import starts from the raw samples."""
    good = sigmaswarm.simulate("urban", gps="white-1m", duration=120, terrain="flat", run=4)
    total = Rotation.from_euler("xyz", (0, -25, 90), degrees=True).as_matrix()
    raw = replace(good, imu=rotate_imu(good.imu, total.T))
    imported = replace(
        raw, imu=rotate_imu(raw.imu, about_z(np.pi / 2)), metadata={"imu_mounting_deg": [0, 0, 90]}
    )
    diagnosis = sigmaswarm.diagnose(imported)
    (found,) = [finding for finding in diagnosis.findings if finding.code == "mounting"]
    again = parse_mount(found.remedy.rpartition("--mount ")[2])
    mended = sigmaswarm.repair(imported, diagnosis)
    assert np.degrees(Rotation.from_matrix(again @ total.T).magnitude()) < 3
    for rotation in (again, parse_mount(",".join(map(str, mended.mounting)))):
        np.testing.assert_allclose(rotate_imu(raw.imu, rotation).ax, mended.imu.ax, atol=0.05)


@pytest.mark.parametrize(("after", "withheld"), [((2.1, 4.9, 0.9, 2.0), False), ((3.1, 4.9, 2.3, 4.9), True)])
def test_a_rotation_is_withheld_by_the_mean_of_all_forecasts(monkeypatch, after, withheld: bool):
    """With the correct rotation of a phone, one of four forecasts was worse, and the repair was withheld."""
    drive, errors = drive_of("simulated, short"), iter([(2.9, 4.4, 2.2, 4.6), after, after, after])
    monkeypatch.setattr(verified_repair, "_forecasts", lambda *_: np.array(next(errors)))
    rotation = Repair("rotate", tuple(about_z(0.5).ravel().tolist()))
    found = Finding("mounting", "serious", "turned", "imu.csv", (0.0, 1.0), 0.999, "turn", rotation)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)
        mended = sigmaswarm.repair(drive, Diagnosis(drive.name, (found,)))
    assert ("withheld" in mended.metadata) == withheld
    assert (mended.mounting is None) == withheld


@needs_shared
@pytest.mark.long
@pytest.mark.parametrize("mount", ["0,-60,30", "180,0,0", "60,0,0", "x=-z,y=y"])
@pytest.mark.filterwarnings("ignore::sigmaswarm.SigmaswarmWarning")
def test_the_phone_with_a_wrong_mounting_gets_the_right_one(mount: str):
    log = SHARED / "cases" / "data" / "phone-in-holder"
    drive, plain = (sigmaswarm.import_log(log, mount=each) for each in (mount, "auto"))
    mended = sigmaswarm.repair(drive, sigmaswarm.diagnose(drive))
    assert "withheld" not in mended.metadata
    off = rotation_of(*mended.mounting) @ rotation_of(*plain.mounting).T
    assert np.degrees(angle_of(off)) < 0.2
    by_hand = rotation_of(0, -66.5, 0)
    assert np.degrees(angle_of(rotation_of(*plain.mounting) @ by_hand.T)) < 5


@needs_shared
@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.filterwarnings("ignore::sigmaswarm.SigmaswarmWarning")
def test_the_phone_drifts_little_in_outages(seed: int):
    """With a constant subtracted from ax instead of a rotation, it drifted 3.9 m in 5 s and 22.5 m in 30 s."""
    drive = sigmaswarm.import_log(SHARED / "cases" / "data" / "phone-in-holder", mount="auto")
    first, last = sigmaswarm.split_time(drive)
    tuned = sigmaswarm.tune([first], trials=1, particles=16, generations=20, seed=seed)
    found = sigmaswarm.evaluate([last], tuned.parameters)
    assert found.mean("tuned", "outage_drift_m") <= 2.7
    assert found.mean("tuned", "long_outage_drift_m") <= 9.0


@pytest.mark.parametrize(
    ("repairs", "different"),
    [
        ([Repair("gyro", (2.0, -1.0))], False),
        ([Repair("gyro", (2.0, -1.0)), Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, -1.0))], True),
        ([Repair("gyro", (2.0, -1.0)), Repair("rotate", tuple(rotation_of(5, 3, 0).ravel()))], False),
        ([Repair("rotate", tuple(rotation_of(180, 50, 60).ravel()))], False),
        ([Repair("tilt-rates", (-1.0, 0.0, 0.0, -1.0)), Repair("accelerometer", (1.0, 0.0, 0.0, 1.0, -1.0))], False),
    ],
    ids=["one sensor", "signs of both sensors", "and a tilt", "rotation", "left-handed axes"],
)  # fmt: skip
def test_repairs_that_leave_two_sensors_with_different_axes(repairs: list[Repair], different: bool):
    assert leave_different_axes(drive_of("simulated short"), repairs) == different


def test_faults_of_the_axes_that_are_not_repaired_do_not_dismiss_a_late_clock():
    """The IMU is turned by -90 deg, gz has the wrong sign, and the fixes are 0.4 s late."""
    good = sigmaswarm.simulate("urban", run=9, duration=200.0, imu_rate=50.0, gps="white-1m", gps_rate=1.0)
    i = good.imu
    turned = replace(i, ax=-i.ay, ay=i.ax, gx=-i.gy, gy=i.gx, gz=-i.gz)
    drive = replace(good, imu=turned, gps=replace(good.gps, time=good.gps.time + 0.4), truth=None)
    found = {f.code: f for f in sigmaswarm.diagnose(drive).findings if f.severity == "serious"}
    assert found.keys() == {"mounting", "gyro-sign", "clock-offset"}
    known = "if you know that this fault exists, "
    assert found["mounting"].remedy.startswith(
        f"{known}rotate all six axes: import with --mount 0,0,-90, and check"
    )
    assert found["gyro-sign"].remedy.startswith(f"{known}change the sign of gz, and check again; or ")
    assert found["clock-offset"].remedy.startswith(
        "correct the IMU's axes and check again; then subtract 0.4"
    )
    mended = sigmaswarm.repair(drive, sigmaswarm.diagnose(drive))
    assert "withheld" not in mended.metadata
    # The remedies work: with gz corrected, the doctor repairs the other faults.
    known = replace(drive, imu=replace(turned, gz=-turned.gz))
    mended = sigmaswarm.repair(known, sigmaswarm.diagnose(known))
    assert {*mended.metadata["repaired"]} >= {"mounting", "clock-offset"}
    assert not sigmaswarm.diagnose(mended).serious
