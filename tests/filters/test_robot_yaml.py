"""An ekf.yaml of robot_localization as a filter: read settings, rejected settings, and uses as a start."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from oracles.robot_localization import NAME
from sigmaswarm import evaluate, tune
from sigmaswarm.datasets.dataset import LocalDataset
from sigmaswarm.drives.drive import Odometer
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.exports.robot_localization import robot_localization
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import filter_for
from sigmaswarm.filters.robot_yaml import NOT_FUSED
from sigmaswarm.tuning.space import search_space
from support import make_drive

pytestmark = pytest.mark.usefixtures("undiagnosed")

P = FilterParameters(
    1.0, 0.0, 0.0, (1e-4, 1e-4, 3e-4, 4e-4, 5e-6, 6e-3, 7e-3, 8e-4), (1.5, 1.5), model=NAME, kind="ekf",
    nominal_interval=0.01, imu_noise=(1e-3, 0.5), lateral_noise=0.2, gate=9.0,
)  # fmt: skip
DRIVE = make_drive(duration=30.0)


def entries(*on: int) -> list[bool]:
    return [k in on for k in range(15)]


USUAL: dict[str, Any] = {
    "two_d_mode": True,
    "odom0": "odometry/gps",
    "odom0_config": entries(0, 1),
    "odom0_pose_rejection_threshold": 4.0,
    "imu0": "imu/data",
    "imu0_config": entries(11, 12, 13),
    "process_noise_covariance": np.diag(np.arange(1.0, 16.0) / 100).ravel().tolist(),
}


def load(folder: Path, content: Any, text: str | None = None) -> FilterParameters:
    file = folder / "ekf.yaml"
    file.write_text(text if text is not None else yaml.safe_dump(content))
    return FilterParameters.load(file)


def test_a_usual_configuration_is_read(tmp_path: Path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = load(tmp_path, {"ekf_filter_node": {"ros__parameters": USUAL}})
    assert found.process_noise == (0.01, 0.02, 0.07, 0.08, 0.06, 0.13, 0.14, 0.12)
    assert (found.gate, found.lateral_noise, found.odometer_noise) == (16.0, None, None)
    assert (found.nominal_interval, len(found.imu_noise)) == (1.0, 3)  # ay is fused
    assert load(tmp_path, USUAL) == found  # as in ROS 1, without a node
    assert load(tmp_path, {"/**": {"ekf": {"ros__parameters": USUAL}}}) == found


def test_of_two_filters_the_one_with_fixes_is_read(tmp_path: Path):
    local = {key: value for key, value in USUAL.items() if "odom0" not in key}
    nodes = {"ekf_local": {"ros__parameters": local}, "ekf_map": {"ros__parameters": USUAL}}
    assert load(tmp_path, nodes).gate == 16.0


def test_inputs_are_those_that_the_file_fuses(tmp_path: Path):
    wheels = {"odom1": "wheel/odometry", "odom1_config": entries(6, 7)}
    found = load(tmp_path, USUAL | wheels | {"imu0_config": entries(11)})
    assert found.imu_noise == (1e-4, NOT_FUSED)
    assert found.odometer_noise is not None and found.lateral_noise is not None
    limits = {"imu0_twist_rejection_threshold": 3.0, "imu0_linear_acceleration_rejection_threshold": 5.0}
    assert load(tmp_path, USUAL | limits).imu_gate == (9.0, 25.0)
    assert load(tmp_path, USUAL | {"odom0_pose_rejection_threshold": 1e308}).gate is None
    text = (
        "imu0_config: ["
        + ", ".join(["true"] * 15)
        + "]\nprocess_noise_covariance: ["
        + "1e-3, " * 14
        + "1e-3]"
    )
    with pytest.warns(
        SigmaswarmWarning,
        match="although the file does not set it to true; imu0: the yaw is replaced by the heading of the fixes",
    ):
        assert load(tmp_path, None, text).process_noise == (1e-3,) * 8  # YAML 1.1 reads 1e-3 as text


def test_an_exported_configuration_is_read_as_the_same_filter(tmp_path: Path):
    found = load(tmp_path, None, robot_localization(P, 0.01)["ekf.yaml"])
    assert np.array(found.process_noise) * 0.01 == pytest.approx(P.process_noise, rel=1e-14)
    assert (found.gate, len(found.imu_noise)) == (9.0, 2)
    assert found.lateral_noise is not None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a: [", "is not valid YAML"),
        ("&a {again: *a, '': 1}", "has neither process_noise_covariance"),
        ("frequency: 30.0", "has neither process_noise_covariance nor a setting like imu0_config"),
        ("imu0_config: [true]", "imu0_config must be 15 booleans"),
        ("process_noise_covariance: [1, 2]", "must be 225 numbers, or 15 for the diagonal"),
        (f"process_noise_covariance: {[-1.0] * 15}", "has a variance that is negative or not finite"),
        (yaml.safe_dump(USUAL | {"odom0_pose_rejection_threshold": "far"}), "must be a positive number"),
    ],
)
def test_files_that_are_no_configuration_are_rejected_with_one_line(tmp_path: Path, content: str, said: str):
    with pytest.raises(InputError, match=said) as refused:
        load(tmp_path, None, content)
    assert "\n" not in str(refused.value) and "ekf.yaml" in str(refused.value)


def test_variances_are_those_that_the_messages_state(tmp_path: Path):
    load(tmp_path, USUAL)
    file = tmp_path / "ekf.yaml"
    stated = replace(DRIVE, metadata={"imu_stated_noise": [2e-4, 0.3], "gps_std_m": 1.5})
    found = filter_for(file, LocalDataset([stated]))
    assert (found.imu_noise, found.measurement_noise) == ((2e-4, 0.3, 0.3), (2.25, 2.25))
    gps = replace(DRIVE.gps, std_x=np.ones(len(DRIVE.gps)), std_y=np.ones(len(DRIVE.gps)))
    found = filter_for(file, LocalDataset([replace(DRIVE, gps=gps)]))
    assert (found.accuracy_scale, found.measurement_noise) == (1.0, (1e-9, 1e-9))
    load(tmp_path, USUAL | {"twist0_config": entries(6), "imu0_config": entries(12)})
    assert filter_for(file, LocalDataset([stated])).odometer_noise is None  # the drive has no odometer
    wheels = Odometer(np.array([0.0, 1.0]), np.zeros(2))
    found = filter_for(file, LocalDataset([replace(stated, odometer=wheels)]))
    assert found.odometer_noise == pytest.approx(0.01)
    assert found.imu_noise == (NOT_FUSED, 0.3)


def test_a_start_is_a_point_of_the_search_and_the_result_is_no_worse(tmp_path: Path):
    space = search_space(NAME, "log10", 0.02, kind="ekf", use=("lateral", "gate"))
    point = space.point_of(P)
    assert space.decode(point[np.newaxis])[0].process_noise == pytest.approx([2 * q for q in P.process_noise])
    assert space.decode(point[np.newaxis])[0].lateral_noise == pytest.approx(0.2)
    middle = space.point_of(replace(P, gate=None, process_noise=(0.0,) * 8))
    assert middle[-1] == (space.low[-1] + space.high[-1]) / 2 and (middle[:7] == space.low[:7]).all()

    good = tune([DRIVE], model=NAME, particles=8, generations=6)
    good.parameters.save(tmp_path / "good.toml")
    again = tune([DRIVE], start=tmp_path / "good.toml", particles=4, generations=1, out=tmp_path / "out")
    assert again.config.model == NAME
    assert again.start_cost == pytest.approx(good.cost, rel=1e-9)
    assert again.cost == again.start_cost  # the four random filters are worse
    assert any("the search started" in remark for remark in again.remarks)
    assert type(again).load(tmp_path / "out").start_cost == again.start_cost
    with pytest.raises(InputError, match="start"):  # the start is part of the configuration
        tune([DRIVE], start=P, particles=4, generations=1, out=tmp_path / "out", resume=True)
    with pytest.raises(
        InputError, match=r"the start filter is robot-localization \(ekf\), but planar8 \(ukf\) is tuned"
    ):
        tune([DRIVE], model="planar8", kind="ukf", start=P, particles=4, generations=1)


@pytest.mark.long
def test_a_configuration_is_compared_in_an_evaluation(tmp_path: Path):
    load(tmp_path, USUAL)
    scores = evaluate([DRIVE], P, against=tmp_path / "ekf.yaml")
    assert scores.names["against"] == f"other EKF, {NAME}"
    assert scores.mean("against", "position_rmse_m") != scores.mean("tuned", "position_rmse_m")
    without = evaluate([DRIVE], P, against=replace(scores.against, imu_noise=scores.against.imu_noise[:2]))
    assert without.mean("against", "heading_rmse_deg") < scores.mean("against", "heading_rmse_deg")
