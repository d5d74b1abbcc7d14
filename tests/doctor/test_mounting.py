"""The mounting: it follows a rotation of the drive, and is never a mirror image or the inverse rotation."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import sigmaswarm
from sigmaswarm import Drive
from sigmaswarm.doctor.checks.mounting import find_movement, find_turn
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.doctor.fixes import course_of
from sigmaswarm.doctor.mounting import Mounting, angle_of, mounting_of, rotate_imu
from sigmaswarm.doctor.repairs import AXIS_ACTIONS
from sigmaswarm.doctor.repairs import repair as repaired
from sigmaswarm.doctor.travel_direction import direction_of_travel
from sigmaswarm.drives.drive import Gps, Imu
from sigmaswarm.drives.mounting import with_rotation
from sigmaswarm.drives.split import clip
from sigmaswarm.geodesy import rotation_of
from support import DRIVES, needs_shared, quickly, several

GRADES = ["mpu-6050", "icm-20602", "adis16405", "ideal"]


@cache
def drive_of(grade: str, terrain: str = "rolling") -> Drive:
    """Return a drive without truth, whose diagnosis takes half the time."""
    drive = sigmaswarm.simulate(
        "urban", duration=150, imu=grade, gps="white-1m", terrain=terrain, run=4, imu_rate=50
    )
    return replace(drive, truth=None)


def estimate(drive: Drive, rotation: np.ndarray):
    """Return the estimated mounting of a drive with a rotated IMU, and its error, rad."""
    course = course_of(drive.gps.time, drive.gps.x + 1j * drive.gps.y)
    found = mounting_of(replace(drive, imu=rotate_imu(drive.imu, rotation)), course)
    return found, angle_of(found.rotation @ rotation) if found else 0.0


@pytest.mark.parametrize(
    ("grade", "seed"),
    quickly([(g, s) for g in GRADES for s in range(4)], lambda g, s: (g, s) == ("mpu-6050", 0)),
)
def test_a_random_rotation_is_found(grade: str, seed: int):
    found, error = estimate(drive_of(grade), Rotation.random(random_state=seed).as_matrix())
    assert found.confidence in ("sure", "likely")
    assert np.degrees(error) < 5
    assert np.linalg.det(found.repair) == pytest.approx(1)


def slowly_converging() -> Drive:
    """Return one minute with few turns, in which acceleration and direction of travel disagree."""
    options = {"gps": "f9p-rtk", "terrain": "hilly", "vibration": 1.0}
    drive = sigmaswarm.simulate("urban", run=26, duration=120.0, imu="adis16465", **options)
    first = drive.imu.time[0]
    return clip(replace(drive, truth=None), first + 60, first + 120)


@pytest.mark.parametrize(
    ("name", "seeds"),
    quickly([("mpu-6050", 1), ("slow", 3), ("icm-20602", 3)], lambda _, n: n == 1),
)
def test_the_estimate_of_a_turned_drive_is_the_turned_estimate(name: str, seeds: int):
    drive = slowly_converging() if name == "slow" else drive_of(name)
    plain, _ = estimate(drive, np.eye(3))
    for seed in range(seeds):
        rotation = Rotation.random(random_state=seed).as_matrix()
        found, _ = estimate(drive, rotation)
        assert np.degrees(angle_of(found.rotation @ rotation @ plain.rotation.T)) < 0.1


def test_a_small_rotation_is_repaired_in_a_whole_drive_and_not_in_a_part():
    drive = drive_of("adis16405", "flat")
    stated = replace(
        drive, imu=rotate_imu(drive.imu, rotation_of(0, 0, 6)), metadata={"imu_mounting_deg": [180, 0, 0]}
    )
    (whole,) = (found for found in sigmaswarm.diagnose(stated).findings if found.code == "mounting")
    cut = {"cut_from": {"drive": "log", "sha256": ""}}
    part = sigmaswarm.diagnose(replace(stated, metadata={**stated.metadata, **cut}))
    (small,) = (found for found in part.findings if found.code == "mounting")
    assert (whole.severity, small.severity) == ("warning", "note")
    assert whole.repair and not small.repair and part.whole == "log"
    assert whole.remedy.endswith(" instead of 180,0,0 (the new angles include this rotation)")
    alone = {"cut_from": {"drive": "log", "sha256": "", "repair_alone": True}}
    other = sigmaswarm.diagnose(replace(stated, metadata={**stated.metadata, **alone}))
    assert "warning" in [found.severity for found in other.findings if found.code == "mounting"]


WRONG = [(180, 0, 0), (0, 180, 0), (0, 0, 180), (90, 0, 0), (0, 90, 0), (0, 0, 90), (60, 0, 0), (0, -60, 30)]


@pytest.mark.parametrize("found", [(6.5, -65.1, -6.5), (181.0, 3.5, 2.0), (12.0, 1.0, 87.0), (0.0, 5.0, 3.0)])
def test_the_mounting_reported_is_the_same_for_every_mounting_of_the_import(
    found: tuple[float, float, float],
):
    """Earlier, the yaw of the remaining rotation included its tilt, and small angles were set to 0."""
    total, std = rotation_of(*found), np.radians([1.5, 0.8, 0.9])
    plain = Mounting(total, std, "sure", "", np.eye(3))
    for before in [
        *(rotation_of(*angles) for angles in WRONG),
        *Rotation.random(8, random_state=1).as_matrix(),
    ]:
        other = Mounting(total @ before.T, std, "sure", "", before)
        assert other.needed or angle_of(plain.mount @ before.T) < np.radians(8)
        np.testing.assert_allclose(other.mount, plain.mount, atol=1e-9)
        np.testing.assert_allclose(other.repair @ before, plain.mount if other.needed else before, atol=1e-9)


@pytest.mark.parametrize("yaw", [3.9, 4.9, 5.1])
def test_a_clear_rotation_is_not_rounded_in_a_whole_log_and_kept_in_a_part(yaw: float):
    """Earlier, a mounting upside down lost its rotation about z, which was within the tolerance of `needed`."""
    std, down = np.radians([1.1, 0.7, 0.8]), rotation_of(180, 0, 0)
    found = Mounting(rotation_of(180, 0.3, yaw), std, "sure", "", np.eye(3))
    assert found.needed and np.degrees(angle_of(found.mount @ found.rotation.T)) < 1e-5
    exact = Mounting(rotation_of(180, 0.3, 2.0), std, "sure", "", np.eye(3))
    np.testing.assert_allclose(exact.mount, down, atol=1e-12)
    assert not Mounting(rotation_of(0, 0.3, min(yaw, 4.9)), std, "sure", "", np.eye(3)).needed


@pytest.mark.parametrize(
    ("roll", "pitch", "needed"), [(0, 9, True), (9, 0, False), (0, -9, True), (180, 0, True)]
)
def test_a_tilt_is_compared_with_the_accuracy_of_its_own_axis(roll: float, pitch: float, needed: bool):
    """A hilly drive determines pitch three times as accurately as roll."""
    std = np.radians([2.9, 0.8, 0.8])
    assert Mounting(rotation_of(roll, pitch, 0), std, "likely", "", np.eye(3)).needed is needed


@pytest.mark.parametrize(
    ("angle", "std", "serious"),
    [(8, 2, False), (8, 1, True), (13, 2, True), (19, 4, False), (30, 7, True), (6.5, 1, False)],
)
def test_a_serious_rotation_is_large_and_many_standard_deviations(angle: float, std: float, serious: bool):
    each = np.full(3, np.radians(std / 3**0.5))
    found = Mounting(rotation_of(angle, 0, 0), each, "likely", "", np.eye(3))
    assert found.needed and found.serious is serious


@pytest.mark.parametrize(("total", "found"), [(5.0, False), (30.0, True)])
def test_an_imu_that_slips_slowly_has_no_sure_mounting(total: float, found: bool):
    """Earlier, the mean of the tilts was a "sure" mounting."""
    drive = replace(
        sigmaswarm.simulate("urban", seed=1, duration=160.0, gps="ublox-m8", terrain="hilly"), truth=None
    )
    angles = np.linspace(0.0, np.radians(total), len(drive.imu))
    rows = np.array([getattr(drive.imu, name) for name in ("ax", "ay", "az", "gx", "gy", "gz")]).T
    turn = Rotation.from_rotvec(np.outer(angles, [1.0, 0.0, 0.0]))
    ax, ay, az, gx, gy, gz = np.hstack([turn.apply(rows[:, :3]), turn.apply(rows[:, 3:])]).T
    imu = replace(drive.imu, ax=ax, ay=ay, az=az, gx=gx, gy=gy, gz=gz)
    diagnosis = sigmaswarm.diagnose(replace(drive, imu=imu))
    slipped = [f for f in diagnosis.findings if f.code == "mounting-slips"]
    assert [f.severity for f in slipped] == ["warning"] * found
    if found:
        assert "mounting" not in diagnosis.codes and "slowly tilts" in slipped[0].what


@pytest.mark.parametrize("start", quickly([(a,) for a in WRONG], lambda a: a == (0, -60, 30)))
def test_a_wrong_mounting_of_the_import_does_not_change_the_result(start: tuple[float, float, float]):
    drive = drive_of("mpu-6050")
    raw = replace(drive, imu=rotate_imu(drive.imu, rotation_of(6, -65, -4).T))
    answers = []
    for before in (np.eye(3), rotation_of(*start)):
        wrong = replace(raw, imu=rotate_imu(raw.imu, before), metadata=with_rotation(raw.metadata, before))
        (found,) = [f for f in sigmaswarm.diagnose(wrong).findings if f.code == "mounting"]
        mended = repaired(wrong, sigmaswarm.diagnose(wrong))
        answers.append(rotation_of(*mended.mounting))
        assert found.remedy.partition("--mount ")[2].partition(" instead of")[0] == ",".join(
            f"{a:g}" for a in np.round(mended.mounting, 1)
        )
    assert np.degrees(angle_of(answers[1] @ answers[0].T)) < 0.1


def test_a_stated_mounting_that_differs_a_little_is_a_note_with_the_mounting_of_the_log():
    drive = drive_of("mpu-6050")
    before = rotation_of(0, -63, 0)
    raw = replace(drive, imu=rotate_imu(drive.imu, rotation_of(0, -65, 0).T))
    stated = replace(raw, imu=rotate_imu(raw.imu, before), metadata=with_rotation(raw.metadata, before))
    (note,) = [f for f in sigmaswarm.diagnose(stated).findings if f.code == "mounting"]
    assert note.severity == "note" and note.repair is None and "--mount" in note.remedy
    assert not any(f.code == "mounting" for f in sigmaswarm.diagnose(drive).findings)


@cache
def at_constant_speed() -> Drive:
    """Simulate turns at 8 m/s, in which the mounting and the delay of the fixes are nearly indistinguishable."""
    options = {"gps": "white-1m", "terrain": "hilly", "vibration": 0.0}
    drive = sigmaswarm.simulate("urban", run=90, duration=120.0, imu="adis16465", **options)
    return replace(drive, truth=None)


def test_at_constant_speed_the_direction_of_travel_shows_a_large_angle():
    """Noise of the speed had reduced the estimated angle from 12 to 5 deg."""
    drive = at_constant_speed()
    window = clip(drive, drive.imu.time[0] + 42, drive.imu.time[0] + 102)
    course = course_of(window.gps.time, window.gps.x + 1j * window.gps.y)
    slopes, _ = direction_of_travel(rotate_imu(window.imu, rotation_of(0, 0, -12)), course, -0.1)
    assert np.degrees(np.arctan(slopes[0])) == pytest.approx(-12, abs=3)


@pytest.mark.parametrize("start", quickly([(42.0,), (43.5,), (49.0,), (50.5,)], lambda start: start == 42.0))
def test_a_window_at_constant_speed_gives_no_serious_finding(start: float):
    first = at_constant_speed().imu.time[0] + start
    assert not sigmaswarm.diagnose(clip(at_constant_speed(), first, first + 60)).serious


@pytest.mark.long
@pytest.mark.parametrize("terrain", ["flat", "hilly"])
def test_the_direction_of_travel_does_not_depend_on_hills(terrain: str):
    drive, turn = drive_of("icm-20602", terrain), Rotation.from_euler("zy", (4, -3), degrees=True)
    course = course_of(drive.gps.time, drive.gps.x + 1j * drive.gps.y)
    slopes, std = direction_of_travel(rotate_imu(drive.imu, turn.as_matrix()), course, 0.0)
    np.testing.assert_allclose(np.degrees(slopes), np.degrees(turn.apply([1, 0, 0])[1:]), atol=1.0)
    assert np.degrees(std).max() < 1.0


@pytest.mark.parametrize(
    ("sensor", "terrain"), quickly([("a", "flat"), ("g", "hilly")], lambda sensor, _: sensor == "a")
)
def test_reversed_signs_are_not_a_rotation(sensor: str, terrain: str):
    drive = drive_of("icm-20602", terrain)
    names = [sensor + axis for axis in "xyz"]
    flipped = replace(drive, imu=replace(drive.imu, **{n: -getattr(drive.imu, n) for n in names}))
    found, error = estimate(flipped, Rotation.random(random_state=5).as_matrix())
    assert found is not None
    assert np.degrees(error) < 5


@pytest.mark.parametrize(
    "names",
    quickly(
        [((n,),) for n in ("ax", "ay", "az")]
        + [(("ax", "gz"),), (("ay", "gz"),), (("ax", "ay", "az", "gx", "gy", "gz"),)],
        lambda names: names == ("ay", "gz"),
    ),
)
def test_a_mirror_image_is_not_a_mounting(names: tuple[str, ...]):
    """Only the roll of the body distinguishes the third to fifth case from a mounting rotated by 180 degrees."""
    drive = drive_of("icm-20602", "flat")
    mirrored = replace(drive, imu=replace(drive.imu, **{n: -getattr(drive.imu, n) for n in names}))
    found, _ = estimate(mirrored, Rotation.random(random_state=6).as_matrix())
    assert found.confidence == "no"


@pytest.mark.parametrize(
    ("fault", "size"),
    quickly([("pitches", a) for a in (20, 25, 30)] + [("ay", k) for k in (0.2, 1.8, 2.5)],
            lambda _, size: size in (20, 2.5)),
)  # fmt: skip
def test_forces_that_contradict_one_rotation_give_no_confidence(fault: str, size: float):
    """The sensor slowly pitches to and fro, or ay is another multiple of the product of speed and yaw rate."""
    drive = drive_of("icm-20602", "flat")
    imu, angle = drive.imu, np.radians(size) * np.sin(2 * np.pi * drive.imu.time / 150)
    turns = Rotation.from_rotvec(np.outer(angle, [0.0, 1.0, 0.0]))
    axes = {s: turns.apply(np.column_stack([getattr(imu, f"{s}{i}") for i in "xyz"])).T for s in "ag"}
    pitched = {f"{s}{i}": column for s in axes for i, column in zip("xyz", axes[s], strict=True)}
    changed = replace(imu, **(pitched if fault == "pitches" else {"ay": size * imu.ay}))
    found, _ = estimate(replace(drive, imu=changed), Rotation.random(random_state=1).as_matrix())
    expected = (
        "direction of gravity is not" if fault == "pitches" else "times the product of speed and yaw rate"
    )
    assert found.confidence == "no" and expected in found.reason


@pytest.mark.parametrize("gps", quickly([("ublox-m8",), ("f9p-rtk",)], lambda gps: gps == "f9p-rtk"))
def test_a_straight_road_gives_no_yaw(gps: str):
    found, _ = estimate(sigmaswarm.simulate("cruise", gps=gps, imu_rate=50), np.eye(3))
    assert found.confidence == "no"


@pytest.mark.long
@needs_shared
@pytest.mark.parametrize("name", ["colorado-1", "dresden", "kitti-09-30-0018", "kitti-09-30-0033"])
def test_a_recording_is_found_within_3_degrees(name: str):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)  # about gaps
        drive = sigmaswarm.read_drive(DRIVES / name)
    evidence = gather(drive)
    assert not evidence.mounted
    found, error = estimate(drive, Rotation.random(random_state=1).as_matrix())
    assert found.confidence in ("sure", "likely")
    assert np.degrees(error) < 3


@pytest.mark.parametrize(
    ("run", "imu", "span"),
    several([(158, "gnss-ins-sim-mid", (0.0, 120.0)), (179, "adis16405", (20.0, 80.0))]),
    ids=["at 8 m/s through a bend", "slopes of 7%"],
)
def test_a_rotation_of_the_imu_is_distinguished_from_hills(run: int, imu: str, span: tuple[float, float]):
    drive = sigmaswarm.simulate(
        "urban", run=run, duration=120.0, imu=imu, gps="f9p-rtk", terrain="hilly", vibration=1.0
    )
    drive = clip(replace(drive, truth=None), *span)
    assert find_turn(gather(drive)) is None
    turn = np.where(drive.imu.time > sum(span) / 2, 1j, 1.0)
    force = (drive.imu.ax + 1j * drive.imu.ay) * turn
    assert find_turn(gather(replace(drive, imu=replace(drive.imu, ax=force.real, ay=force.imag)))) is not None


@pytest.mark.parametrize(
    ("run", "imu", "gps", "terrain", "start"),
    several(
        [
            (743, "gnss-ins-sim-high", "f9p-rtk", "hilly", 53.0),
            (744, "mpu-6050", "white-1m", "flat", 36.0),
            (807, "gnss-ins-sim-high", "white-1m", "hilly", 35.0),
        ],
        3,
    ),
    ids=["one bend uphill", "one maneuver", "hard braking on a slope"],
)
def test_a_minute_with_few_maneuvers_shows_no_moved_imu(
    run: int, imu: str, gps: str, terrain: str, start: float
):
    drive = sigmaswarm.simulate(
        "urban", run=run, duration=120.0, imu=imu, gps=gps, terrain=terrain, vibration=float(run % 3 > 0)
    )
    part = clip(replace(drive, truth=None), start, start + 60.0)
    assert find_movement(part) is None and find_turn(gather(part)) is None


@pytest.mark.parametrize(
    ("axis", "angle"),
    quickly(
        [("y", 25.0), ("y", 40.0), ("y", 60.0), ("z", 90.0), ("z", -60.0)],
        lambda axis, angle: angle in (25.0, 90.0),
    ),
)
def test_an_imu_that_was_moved_within_a_log_is_reported_with_its_time(axis: str, angle: float):
    drive = drive_of("icm-20602", "flat")
    late = drive.imu.time > 80
    other = rotate_imu(drive.imu, Rotation.from_euler(axis, angle, degrees=True).as_matrix())
    columns = {
        n: np.where(late, getattr(other, n), getattr(drive.imu, n))
        for n in ("ax", "ay", "az", "gx", "gy", "gz")
    }
    found = {
        f.code: f for f in sigmaswarm.diagnose(replace(drive, imu=replace(drive.imu, **columns))).findings
    }
    assert found["mounting-changed"].span[0] == pytest.approx(80, abs=6)
    assert "split" in found["mounting-changed"].remedy
    assert not any(f.repair and f.repair.action in AXIS_ACTIONS for f in found.values())
    assert find_movement(drive) is None and find_turn(gather(drive)) is None
    in_g = replace(
        drive.imu, **{n: columns.get(n, getattr(drive.imu, n)) / 9.80665 for n in ("ax", "ay", "az")}
    )
    moved = find_movement(replace(drive, imu=in_g))
    assert (moved is None) == (axis == "z")


def handled(drive: Drive, begin: float, end: float, axis: str) -> Drive:
    """Rotate the IMU by 60 deg at 2 rad/s between two times; it stays rotated until the nearer end of the log."""
    imu, first = drive.imu, begin < drive.imu.time[0] + drive.duration / 2
    angle = 1.05 - 2 * (imu.time - begin) if first else 2 * (imu.time - begin)
    rotation = Rotation.from_rotvec(np.clip(angle, 0, 1.05)[:, None] * np.eye(3)["xyz".index(axis)])
    rate = np.where((imu.time > begin) & (imu.time < end), -2.0 if first else 2.0, 0.0)
    columns = {
        n: v
        for s in "ag"
        for n, v in zip(
            (f"{s}{i}" for i in "xyz"),
            rotation.apply(np.column_stack([getattr(imu, f"{s}{i}") for i in "xyz"])).T,
            strict=True,
        )
    }
    columns[f"g{axis}"] = columns[f"g{axis}"] - rate
    return replace(drive, imu=replace(imu, **columns))


@pytest.mark.parametrize(
    ("begin", "axis", "kept"),
    several([(2.0, "y", (2.5, 150.0)), (2.0, "z", None), (75.0, "y", None), (148.0, "x", (0.0, 148.0))]),
)
def test_a_log_end_with_the_imu_in_a_hand_is_removed(
    begin: float, axis: str, kept: tuple[float, float] | None
):
    """A rotation about the vertical is a turn of the vehicle; in the middle of a log, it is a different finding."""
    drive = replace(drive_of("icm-20602", "hilly"), metadata={"heading_deg": 90.0})
    sick = handled(drive, begin, begin + 0.525, axis)
    found = {f.code: f for f in sigmaswarm.diagnose(sick).findings}
    assert ("mounting-handled" in found) == (kept is not None)
    if kept is None:
        return
    finding = found["mounting-handled"]
    ends = (sick.imu.time[0], kept[0]) if kept[0] else (kept[1], sick.imu.time[-1])
    assert finding.span == pytest.approx(ends, abs=1.1)
    mended = repaired(sick, sigmaswarm.diagnose(sick))
    assert ("heading_deg" in mended.metadata) == ("heading_deg" not in finding.remedy) == (kept[0] == 0.0)
    for time in (mended.imu.time, mended.gps.time):
        np.testing.assert_allclose(time[[0, -1]], kept, atol=1.1)
    assert finding.repair and "mounting-handled" not in sigmaswarm.diagnose(mended).codes


def test_an_imu_in_a_hand_at_both_ends_has_a_finding_and_a_repair_for_each():
    drive = drive_of("icm-20602", "hilly")
    sick = handled(handled(drive, 2.0, 2.525, "y"), 148.0, 148.525, "x")
    findings = [f for f in sigmaswarm.diagnose(sick).findings if f.code == "mounting-handled"]
    first, last = sick.imu.time[[0, -1]]
    spans = [time for finding in findings for time in finding.span]
    assert spans == pytest.approx((first, 2.5, 148.0, last), abs=1.1)
    mended = repaired(sick, sigmaswarm.diagnose(sick))
    np.testing.assert_allclose(mended.imu.time[[0, -1]], (2.5, 148.0), atol=1.1)


def test_accelerations_without_gravity_show_no_moved_imu():
    drive = drive_of("icm-20602", "flat")
    assert drive.imu.az is not None
    assert find_movement(replace(drive, imu=replace(drive.imu, az=drive.imu.az - 9.81))) is None


def test_az_in_another_unit_shows_no_moved_imu():
    """With az in g, a constant change of ax of 0.5 m/s2 looks like a rotation by 26 deg."""
    drive = drive_of("icm-20602", "flat")
    imu = drive.imu
    assert imu.az is not None
    gentle = replace(imu, ax=imu.ax / 5 + 0.5 * (imu.time > 80), ay=imu.ay / 5)
    assert find_movement(replace(drive, imu=gentle)) is None
    for sign in (1, -1):
        assert find_movement(replace(drive, imu=replace(gentle, az=sign * imu.az / 9.80665))) is None


def blind(drive: Drive) -> Drive:
    """Return the IMU of a drive with the fixes of a parked receiver, so that no course shows an axis."""
    noise = np.random.default_rng(1).standard_normal((2, len(drive.gps)))
    return replace(drive, gps=type(drive.gps)(drive.gps.time, *noise), truth=None)


def test_without_a_course_an_inverted_imu_is_rotated_and_a_wrong_sign_of_az_is_changed():
    drive = blind(sigmaswarm.simulate("urban", duration=90, gps="white-1m", terrain="hilly", vibration=1.0))
    head = replace(drive, imu=rotate_imu(drive.imu, np.diag([1.0, -1.0, -1.0])))
    flipped = replace(drive, imu=replace(drive.imu, az=-drive.imu.az))
    for sick, code in ((head, "mounting"), (flipped, "accelerometer-up")):
        found = sigmaswarm.diagnose(sick)
        assert {f.code for f in found.findings if f.repair} == {code}
        mended = sigmaswarm.repair(sick, found)
        for name in ("ax", "ay", "az", "gx", "gy", "gz"):
            np.testing.assert_array_equal(getattr(mended.imu, name), getattr(drive.imu, name), err_msg=name)


def test_a_slow_robot_in_circles_with_z_down():
    rng, t = np.random.default_rng(2), np.arange(0, 100, 0.025)
    rate = 0.25 * np.clip(3 * np.sin(2 * np.pi * t / 60), -1, 1)
    speed = 2.2 + 0.4 * np.sin(t / 7)
    theta = np.cumsum(rate) * 0.025
    place = np.cumsum(speed * np.exp(1j * theta)) * 0.025
    noise = 0.03 * rng.standard_normal((6, len(t)))
    force = np.array([np.gradient(speed, 0.025), speed * rate, np.full(len(t), 9.81)]) + noise[:3]
    roll = 0.03 * np.cos(3 * t)
    gyro = np.array([roll, roll[::-1], rate]) + 0.1 * noise[3:]
    imu = Imu(t, *force[:2], gyro[2], az=force[2], gx=gyro[0], gy=gyro[1])
    fixes = place[::40] + 0.1 * (rng.standard_normal(100) + 1j * rng.standard_normal(100))
    drive = Drive("robot", rotate_imu(imu, np.diag([1.0, -1.0, -1.0])), Gps(t[::40], fixes.real, fixes.imag))
    found = {f.code: f for f in sigmaswarm.diagnose(drive).findings}
    assert "roll 180.0, pitch 0.0, yaw 0.0" in found["mounting"].what
    assert [code for code, f in found.items() if f.severity != "note"] == ["mounting"]


@pytest.mark.long
def test_windows_of_a_minute_never_give_a_certain_but_reversed_mounting():
    drive, wrong = drive_of("mpu-6050", "hilly"), []
    for start in (0.0, 20.0, 60.0, 80.0):
        found, error = estimate(
            clip(drive, start, start + 60), Rotation.random(random_state=int(start)).as_matrix()
        )
        if found and found.confidence != "no" and error > np.radians(20):
            wrong.append((start, error))
    assert not wrong


@pytest.mark.parametrize(
    ("angles", "seed"),
    quickly(
        [((180, 0, 0), 1), ((0, 0, 180), 2), ((100, 40, -120), 3)], lambda angles, _: angles == (180, 0, 0)
    ),
)
def test_a_vehicle_without_springs_has_no_reversed_axis(angles: tuple[float, float, float], seed: int):
    """Noise of the gyro and the error of the estimate, multiplied by the yaw rate, looked like a roll in turns."""
    rng, t = np.random.default_rng(seed), np.arange(0, 150, 0.02)
    speed = 8 * np.clip((t - 3) / 4, 0, 1) * (0.75 + 0.25 * np.sin(t / 6))
    rate = np.where(speed > 1, 0.15 * np.sin(t / 9), 0.0)
    theta = 0.7 + np.cumsum(rate) * 0.02
    x, y = np.cumsum(speed * np.cos(theta)) * 0.02, np.cumsum(speed * np.sin(theta)) * 0.02

    def noise(std: float) -> np.ndarray:
        return rng.normal(0, std, len(t))

    ax, ay, gz = np.gradient(speed, t) + noise(0.05), speed * rate + noise(0.05), rate + noise(0.002)
    imu = Imu(t, ax, ay, gz, az=9.81 + noise(0.05), gx=noise(0.002), gy=noise(0.002))
    east, north = (np.interp(t[3::10], t, v) + rng.normal(0, 0.7, len(t[3::10])) for v in (x, y))
    drive = Drive("robot", imu, Gps(t[3::10], east, north))
    found, error = estimate(drive, Rotation.from_euler("xyz", angles, degrees=True).as_matrix())
    assert found.confidence == "sure", found.reason
    assert np.degrees(error) < 1
