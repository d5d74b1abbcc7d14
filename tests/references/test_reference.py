"""Truth from the fixes of a reference receiver, compared with the simulator's truth; rejected input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sigmaswarm
from sigmaswarm.drives.drive import Drive, Gps
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic, wrap_angle
from sigmaswarm.importing.fixes import read_fixes
from sigmaswarm.references import reference
from sigmaswarm.simulation.gps import GPS_GRADES
from sigmaswarm.simulation.scenarios import simulate

ARM = (0.9, -0.4, 1.2)
ACCURACY = 0.05
ORIGIN = (51.05, 13.74, 113.25)
EPOCH = 1_700_000_000
FLOAT, OUTAGE = (16.0, 17.2), (22.0, 52.0)
"""Times in s: float solutions with errors of 1 m, which the IMU bridges, and an outage that is too long for the IMU."""
OPTIONS = {"run": 3, "duration": 60.0}


@pytest.fixture(scope="module")
def cheap() -> Drive:
    """Return a drive with truth and with a known origin and time."""
    drive = simulate("urban", gps="white-1m", **OPTIONS)
    return replace(drive, origin=ORIGIN, metadata={**drive.metadata, "time_origin_s": EPOCH})


@pytest.fixture(scope="module")
def rtk() -> Gps:
    gps = simulate("urban", gps=replace(GPS_GRADES["f9p-rtk"], lever_arm=ARM), **OPTIONS).gps
    float_ = (gps.time >= FLOAT[0]) & (gps.time < FLOAT[1])
    std = np.where(float_, 0.5, gps.std_x)
    gps = replace(gps, x=gps.x + float_, std_x=std, std_y=std)
    return gps.select((gps.time < OUTAGE[0]) | (gps.time > OUTAGE[1]))


@pytest.fixture(scope="module")
def made(cheap: Drive, rtk: Gps) -> Drive:
    return reference(replace(cheap, truth=None), rtk, lever_arm=ARM, accuracy=ACCURACY)


def write_pos(path: Path, gps: Gps, ahead: float = 0.0) -> Path:
    """Write the fixes in the format of RTKLIB, in UTC; those with a standard deviation of 0.5 m are float solutions."""
    enu = np.column_stack([gps.x, gps.y, np.zeros(len(gps))])
    lines = ["%  UTC    latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"]
    for t, place, std in zip(gps.time, enu_to_geodetic(enu, ORIGIN), gps.std_x, strict=True):
        date = str(np.datetime64(round((t + EPOCH + ahead) * 1e3), "ms")).replace("-", "/").replace("T", " ")
        quality = 2 if std > 0.1 else 1
        lines.append(f"{date} {place[0]:.10f} {place[1]:.10f} {place[2]:.4f} {quality} 12 0.0100 0.0100 0.02")
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.long
def test_the_errors_of_the_truth_agree_with_its_standard_deviations(cheap: Drive, made: Drive):
    got, true = made.truth, cheap.truth
    at = np.searchsorted(true.time, got.time)
    np.testing.assert_array_equal(true.time[at], got.time)  # the times of the IMU
    for name in "xy":
        error = np.abs(getattr(got, name) - getattr(true, name)[at])
        assert np.mean(error <= 2 * getattr(got, f"std_{name}")) > 0.95
        assert error.max() < 0.2  # although the antenna is 1 m away
    turned = np.abs(wrap_angle(got.theta - true.theta[at]))
    assert np.degrees(np.sqrt(np.mean(turned**2))) < 0.3
    for name in ("imu", "gps", "odometer"):
        assert getattr(made, name) is getattr(cheap, name)


def test_unknown_parts_are_omitted(made: Drive):
    got, about = made.truth, made.metadata["reference"]
    inside = (got.time > OUTAGE[0] + 12) & (got.time < OUTAGE[1] - 12)
    assert not inside.any()
    assert np.any((got.time > FLOAT[0] + 0.3) & (got.time < FLOAT[1] - 0.3))  # bridged by the IMU
    assert max(got.std_x.max(), got.std_y.max()) <= ACCURACY
    assert about["fixes_taken"] == about["fixes_given"] - 6
    assert 0.3 < about["share"] < 0.8


def test_the_log_of_the_receiver_is_converted_to_the_drive_s_clock_and_frame(
    tmp_path: Path, cheap: Drive, rtk: Gps
):
    log = read_fixes(write_pos(tmp_path / "rtk.pos", rtk, ahead=7.0), cheap, offset=-7.0)
    np.testing.assert_allclose(log.gps.time, rtk.time, atol=1e-3)
    np.testing.assert_allclose([log.gps.x, log.gps.y], [rtk.x, rtk.y], atol=1e-3)
    np.testing.assert_array_equal(log.sure, rtk.std_x <= 0.1)  # Q


def test_fixes_of_another_drive_are_converted_to_the_same_positions(tmp_path: Path, cheap: Drive, rtk: Gps):
    later = replace(
        cheap, gps=replace(rtk, time=rtk.time + 5), metadata={"time_origin_s": EPOCH - 5}, truth=None
    )
    later = replace(later, imu=replace(later.imu, time=later.imu.time + 5), name="rtk", odometer=None)
    log = read_fixes(sigmaswarm.write_drive(later, tmp_path / "rtk"), cheap)
    np.testing.assert_allclose(log.gps.time, rtk.time, atol=1e-9)
    np.testing.assert_array_equal(log.gps.x, rtk.x)


def wrong(cheap: Drive, rtk: Gps, tmp_path: Path) -> dict[str, tuple[Drive, object, dict[str, float], str]]:
    pos = write_pos(tmp_path / "rtk.pos", rtk)
    (tmp_path / "poem.txt").write_text("no log\n")
    return {
        "no overlap": (cheap, replace(rtk, time=rtk.time + 900), {}, "0 common fixes are too few; convert both"),
        "no file": (cheap, tmp_path / "none.pos", {}, "does not exist"),
        "no log": (cheap, tmp_path / "poem.txt", {}, "poem.txt: has only one column"),
        "no accuracy": (cheap, replace(rtk, std_x=None, std_y=None), {}, "contains no standard deviations of its"),
        "no place": (replace(cheap, origin=None), pos, {}, "has no origin; write origin"),
        "no clock": (replace(cheap, metadata={}), pos, {}, "on the drive's clock"),
        "all worse": (cheap, rtk, {"accuracy": 0.005}, "0 of these have a stated standard deviation of at most 0.005"),
        "nonsense": (cheap, rtk, {"accuracy": -1.0}, "accuracy = -1"),
    }  # fmt: skip


CASES = ("no overlap", "no file", "no log", "no accuracy", "no place", "no clock", "all worse", "nonsense")


@pytest.mark.parametrize("case", CASES)
def test_wrong_input_causes_one_line_with_a_remedy(cheap: Drive, rtk: Gps, tmp_path: Path, case: str):
    drive, fixes, options, said = wrong(cheap, rtk, tmp_path)[case]
    with pytest.raises(InputError) as caught:
        reference(drive, fixes, **options)
    assert said in str(caught.value), caught.value
    assert len(str(caught.value).splitlines()) == 1
