"""The estimate of the lever arm, compared with planted lever arms and with least squares with truth."""

from dataclasses import replace

import numpy as np
import pytest

import sigmaswarm
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline
from sigmaswarm.tuning.lever_arm import LeverArmEstimate, estimate_lever_arm
from support import DRIVES, make_drive, needs_shared


def planted(drive: Drive, forward: float, left: float) -> Drive:
    """Return the drive with fixes of an antenna at this lever arm; truth gives the heading."""
    gps, truth = drive.gps, drive.truth
    theta = np.interp(gps.time, truth.time, np.unwrap(truth.theta))
    c, s = np.cos(theta), np.sin(theta)
    return replace(
        drive, gps=replace(gps, x=gps.x + c * forward - s * left, y=gps.y + s * forward + c * left)
    )


def by_least_squares(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Return the arm and its std, m, given the true acceleration and heading: z = p0 + v0 t + p(t) + R l."""
    gps, truth = drive.gps, drive.truth
    theta = np.interp(gps.time, truth.time, np.unwrap(truth.theta))
    x, y = (np.interp(gps.time, truth.time, column) for column in (truth.x, truth.y))
    one, zero, c, s = np.ones(len(gps)), np.zeros(len(gps)), np.cos(theta), np.sin(theta)
    east = np.column_stack([c, -s, one, zero, gps.time, zero])
    north = np.column_stack([s, c, zero, one, zero, gps.time])
    columns = np.vstack([east, north])
    solution = np.linalg.lstsq(columns, np.concatenate([gps.x - x, gps.y - y]))[0]
    return solution[:2], np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))[:2]


def quiet(drive: Drive, model: str, **options: float) -> FilterParameters:
    """Return a filter for an IMU with almost no noise."""
    kind = "ukf" if model == "planar5" else "ekf"
    like = FilterParameters(
        *(0.1, 2.0, 0.0, (1.0,) * len(MODELS[model].states), (1.0,) * 2),
        model=model,
        kind=kind,
        **options,
    )
    given = baseline(drive, like)
    noise = tuple(1e-4 * q for q in given.process_noise)
    more = {"imu_noise": (1e-8, 1e-6)} if model == "robot-localization" else {}
    return replace(given, process_noise=noise, measurement_noise=(1.0, 1.0), **more)


@pytest.mark.parametrize("model", ["planar5", "planar8", "tilted12", "robot-localization"])
def test_the_estimate_agrees_with_least_squares_with_truth(model: str):
    drive = planted(make_drive(duration=150.0, seed=4, imu_rate=50.0), -1.5, 0.6)
    expected, least = by_least_squares(drive)
    found = estimate_lever_arm(drive, quiet(drive, model))
    std = np.array(found.std)
    assert np.all(std > 0.95 * least)  # no filter is more certain than least squares with truth
    assert np.all(std < 4 * least)
    assert np.all(np.abs([found.forward, found.left] - expected) < 2.5 * std)
    assert np.all(np.abs(np.array([found.forward, found.left]) - (-1.5, 0.6)) < 3 * std)


@pytest.fixture(scope="module")
def urban() -> Drive:
    """Return five minutes with a good IMU and enough turns to determine the arm."""
    drive = sigmaswarm.simulate(
        "urban", imu="gnss-ins-sim-mid", gps="white-1m", duration=300.0, seed=11, imu_rate=50.0
    )
    return planted(drive, 2.1, -0.7)


@pytest.fixture(scope="module")
def found(urban: Drive) -> LeverArmEstimate:
    return estimate_lever_arm(replace(urban, truth=None), within=0.25)


def test_an_urban_drive_determines_the_arm_without_truth(found: LeverArmEstimate):
    assert found.observable == (True, True)
    assert abs(found.forward - 2.1) < 0.2
    assert abs(found.left + 0.7) < 0.2
    assert str(found).startswith(
        f"antenna {found.forward:.2f} m ahead (std {found.std[0]:.2f} m) and {-found.left:.2f} m right (std 0."
    )


def test_the_estimate_replaces_the_stated_arm_and_keeps_the_height(urban: Drive, found: LeverArmEstimate):
    stated = replace(urban, metadata={**urban.metadata, "gps_lever_arm_m": [0.0, 0.0, 1.1]})
    copy = found.applied(stated)
    assert copy.lever_arm.tolist() == [round(found.forward, 4), round(found.left, 4)]
    assert copy.antenna_height == 1.1
    assert copy.metadata["repaired"] == ["lever-arm"]
    assert stated.metadata["gps_lever_arm_m"] == [0.0, 0.0, 1.1]
    parameters = sigmaswarm.baseline(urban)
    error = {
        d: np.hypot(
            *(
                np.interp(urban.truth.time, e.time, e.mean[:, k]) - t
                for k, t in enumerate((urban.truth.x, urban.truth.y))
            )
        )
        for d, e in ((d.name, sigmaswarm.run(d, parameters)) for d in (urban, replace(copy, name="copy")))
    }
    assert np.mean(error["copy"]) < np.mean(error[urban.name])


def test_an_arm_that_the_turns_do_not_determine_is_not_changed(urban: Drive):
    begin = sigmaswarm.simulate("cruise", gps="white-1m", seed=1)
    drive = replace(planted(begin, 1.0, 0.0), metadata={**begin.metadata, "gps_lever_arm_m": [0.7, 0.2]})
    found = estimate_lever_arm(drive, quiet(drive, "planar8"))
    assert found.observable == (False, False)
    assert max(found.std) > 0.3
    assert ": the 95% error exceeds 0.15 m; for this accuracy the log needs " in str(found)
    assert found.applied(drive) is drive


def test_each_axis_is_judged_separately(urban: Drive):
    """Turns often determine the lateral axis before the longitudinal one."""
    found = LeverArmEstimate(1.5, -0.6, std=(0.12, 0.06), stated=(0.7, 0.2), within=0.15)
    assert found.observable == (False, True)
    assert str(found) == (
        "antenna 0.60 m right (std 0.06 m) of the IMU; drive.toml states 0.70 m ahead and 0.20 m left; 1.50 m ahead "
        "(std 0.12 m): the 95% error exceeds 0.15 m; for this accuracy the log needs 2.5 times as many turns; the "
        "value in drive.toml is kept"
    )
    copy = found.applied(replace(urban, metadata={**urban.metadata, "gps_lever_arm_m": [0.7, 0.2, 1.1]}))
    assert copy.metadata["gps_lever_arm_m"] == [0.7, -0.6, 1.1]
    assert found.to_dict()["observable"] == [False, True]


def test_a_stated_arm_is_a_prior_with_its_standard_deviation(urban: Drive):
    parameters, arms = quiet(urban, "tilted12", lateral_noise=0.04), {}
    for std in (0.01, 1.0, None):
        about = {
            "gps_lever_arm_m": [1.0, 1.0],
            **({} if std is None else {"gps_lever_arm_std_m": [std, std]}),
        }
        arms[std] = estimate_lever_arm(replace(urban, metadata={**urban.metadata, **about}), parameters)
    assert abs(arms[0.01].forward - 1.0) < 0.05
    assert abs(arms[0.01].left - 1.0) < 0.05
    assert max(arms[0.01].std) < 0.02
    assert (arms[None].forward, arms[None].left) == (arms[1.0].forward, arms[1.0].left)  # 1 m by default
    assert abs(arms[1.0].left + 0.7) < 0.4
    assert "; drive.toml states 1.00 m ahead and 1.00 m left" in str(arms[0.01])


def test_two_drives_of_one_vehicle_determine_it_better_than_one():
    drives = [planted(make_drive(duration=100.0, seed=seed, imu_rate=50.0), 0.8, -0.3) for seed in (1, 2)]
    parameters = quiet(drives[0], "planar8")
    single, other, both = (estimate_lever_arm(some, parameters) for some in (drives[0], drives[1], drives))
    assert max(both.std) < min(max(single.std), max(other.std))
    assert np.all(np.abs(np.array([both.forward - 0.8, both.left + 0.3])) < 3 * np.array(both.std))


def test_outliers_have_little_effect():
    drive = planted(make_drive(duration=150.0, seed=4, imu_rate=50.0), -1.5, 0.6)
    parameters = quiet(drive, "planar8", robust_dof=4.0)
    x = drive.gps.x.copy()
    x[100::50] += 20.0
    found = estimate_lever_arm(replace(drive, gps=replace(drive.gps, x=x)), parameters)
    assert np.all(np.abs(np.array([found.forward + 1.5, found.left - 0.6])) < 3 * np.array(found.std))


@pytest.mark.long
@needs_shared
@pytest.mark.filterwarnings("ignore::sigmaswarm.errors.DriveWarning")  # a gap of 0.13 s
def test_a_planted_arm_in_a_real_drive_is_estimated_within_its_standard_deviation():
    drive = planted(sigmaswarm.read_drive(DRIVES / "kitti-09-26-0022"), -1.5, 0.6)
    found = estimate_lever_arm(drive)
    assert max(found.std) < 0.5
    assert np.all(np.abs(np.array([found.forward + 1.5, found.left - 0.6])) < 3 * np.array(found.std))


def test_errors_are_reported_with_one_line(urban: Drive):
    other = replace(urban, metadata={**urban.metadata, "gps_lever_arm_m": [1.0, 0.0]})
    with pytest.raises(InputError, match="there are no drives; pass at least one"):
        estimate_lever_arm([])
    with pytest.raises(InputError, match="the drives contain different gps_lever_arm_m"):
        estimate_lever_arm([urban, other])
    with pytest.raises(InputError, match="within = 0 m is not positive and finite; specify"):
        estimate_lever_arm(urban, within=0.0)
