"""The configuration for robot_localization: order, units, and numbers in a form that YAML reads as numbers."""

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

import sigmaswarm
from exported import tuned
from sigmaswarm import evaluate
from sigmaswarm.errors import InputError
from sigmaswarm.exports.names import Target
from sigmaswarm.exports.robot_localization import robot_localization, yaml_number
from sigmaswarm.exports.targets import export_texts
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.view import accuracy_section
from support import make_drive

ORDER = ["x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az"]


def read(p: FilterParameters, interval: float = 0.01) -> tuple[dict, str]:
    text = robot_localization(p, interval)["robot_localization.yaml"]
    ((node, inside),) = yaml.safe_load(text).items()
    assert node == ("ekf_filter_node" if p.kind == "ekf" else "ukf_filter_node")
    return inside["ros__parameters"], text


def test_process_noise_is_per_second_and_in_its_order():
    p = FilterParameters(0.3, 2.0, 1.0, (1e-5, 2e-5, 3e-4, 5e-4, 7e-8), (1.5, 2.5))
    for interval in (0.01, 0.02):
        flat = read(p, interval)[0]["process_noise_covariance"]
        assert len(flat) == 225 and all(type(value) is float for value in flat)
        assert all(value == 0.0 for k, value in enumerate(flat) if k % 16)
        diagonal = dict(zip(ORDER, flat[::16], strict=True))
        ours = {name: diagonal[name] * interval for name in ("x", "y", "yaw", "vx", "vy")}
        assert ours == pytest.approx({"x": 1e-5, "y": 2e-5, "yaw": 7e-8, "vx": 4e-4, "vy": 4e-4})
        assert (diagonal["z"], diagonal["ax"], diagonal["az"]) == (0.06, 0.01, 0.015)


def test_its_ukf_has_narrow_sigma_points():
    read_, text = read(replace(tuned("planar8", "ukf", 0.01), kappa=1.0))
    assert (read_["alpha"], read_["beta"], read_["kappa"]) == (0.001, 2.0, 0.0)
    assert "NaN" in text
    assert "alpha" not in read(tuned("planar5", "ekf", 0.01))[0]


def test_it_does_not_fuse_ay():
    assert dict(zip(ORDER, read(tuned("planar5", "ekf", 0.01))[0]["imu0_config"], strict=True)) == {
        name: name in ("vyaw", "ax") for name in ORDER
    }


def test_the_gate_is_the_square_root_of_the_nis():
    assert read(tuned("planar5", "ukf", 0.01))[0]["odom0_pose_rejection_threshold"] == math.sqrt(9.2)
    assert "odom0_pose_rejection_threshold" not in read(tuned("planar5", "ukf", 0.01, everything=False))[0]


def test_the_file_states_its_limits_and_lists_unsupported_parts():
    _, text = read(replace(tuned("planar8", "adaptive-ukf", 0.01), latency=0.12))
    for said in (
        "STARTING POINT",
        "NOT the tuned filter",
        "biases",
        "lateral",
        "standstill",
        "adaptation",
        "0.12 s",
    ):
        assert said in text
    assert "[1.0, 0.0, 0.0,  0.0, 1.2, 0.0,  0.0, 0.0, 2.2]" in text
    _, plain = read(tuned("planar5", "ukf", 0.01, everything=False))
    assert "biases" not in plain and "lateral" not in plain and "latency" not in plain


KNOWN = re.compile(
    r"frequency|sensor_timeout|two_d_mode|smooth_lagged_data|history_length|dynamic_process_noise_covariance"
    r"|(map|odom|base_link|world)_frame|(odom|pose|twist|imu)0(_config|_differential|_relative)?"
    r"|odom0_pose_rejection_threshold|imu0_remove_gravitational_acceleration|initial_state"
    r"|odom1(_config|_differential|_relative)?|imu0_(twist|linear_acceleration)_rejection_threshold"
    r"|initial_estimate_covariance|process_noise_covariance"
)
"""Fields that robot_localization reads."""
ROBOT = FilterParameters(
    1.0, 0.0, 0.0, (1e-5, 1e-5, 3e-4, 5e-4, 7e-8, 2e-3, 1e-2, 4e-5), (1.5, 1.5), model="robot-localization",
    kind="ekf", nominal_interval=0.01, imu_noise=(2e-4, 0.5), lateral_noise=0.03, gate=9.0,
)  # fmt: skip


def test_a_filter_of_this_type_is_exported_exactly():
    texts = robot_localization(ROBOT, 0.01)
    assert list(texts) == ["ekf.yaml", "ekf.launch.py", "README.md"]
    inside = yaml.safe_load(texts["ekf.yaml"])["ekf_filter_node"]["ros__parameters"]
    assert [name for name in inside if not KNOWN.fullmatch(name)] == []
    diagonal = dict(zip(ORDER, inside["process_noise_covariance"][::16], strict=True))
    own = ("x", "y", "vx", "vy", "yaw", "ax", "ay", "vyaw")
    assert tuple(0.01 * diagonal[name] for name in own) == pytest.approx(ROBOT.process_noise, rel=1e-15)
    assert inside["odom0_pose_rejection_threshold"] == 3.0
    fused = {name: [k for k, on in zip(ORDER, inside[f"{name}_config"], strict=True) if on]
             for name in ("odom0", "imu0", "twist0")}  # fmt: skip
    assert fused == {"odom0": ["x", "y"], "imu0": ["vyaw", "ax"], "twist0": ["vy"]}
    start = inside["initial_estimate_covariance"]
    assert len(inside["initial_state"]) == 15 and len(start) == 225 and min(start[::16]) > 0
    for stated in ("0.0002 rad2/s2", "0.5 m2/s4", "1.5 and 1.5 m2", "0.03 m2/s2"):
        assert stated in texts["README.md"]
    compile(texts["ekf.launch.py"], "ekf.launch.py", "exec")
    (message,) = re.findall(r'NO_SLIP = "(.*)"', texts["ekf.launch.py"])
    assert yaml.safe_load(message)["twist"]["covariance"][7] == 0.03


def test_unused_parts_of_a_filter_of_this_type_are_omitted():
    texts = robot_localization(replace(ROBOT, lateral_noise=None, gate=None, accuracy_scale=0.5), 0.01)
    inside = yaml.safe_load(texts["ekf.yaml"])["ekf_filter_node"]["ros__parameters"]
    assert "twist0" not in inside and "odom0_pose_rejection_threshold" not in inside
    assert "no_slip" not in texts["README.md"] + texts["ekf.launch.py"].replace("NO_SLIP", "")
    assert "0.5 times the receiver's variance, plus 1.5" in texts["README.md"]


NAVSAT = {
    *("frequency", "delay", "magnetic_declination_radians", "yaw_offset", "zero_altitude"),
    *("publish_filtered_gps", "use_odometry_yaw", "wait_for_datum"),
}
"""Fields that navsat_transform_node reads."""


def test_odometer_and_thresholds_of_the_imu_are_written_and_read_back(tmp_path: Path):
    p = replace(ROBOT, odometer_noise=0.09, imu_gate=(16.0, 25.0))
    texts = robot_localization(p, 0.01)
    content = yaml.safe_load(texts["ekf.yaml"])
    inside = content["ekf_filter_node"]["ros__parameters"]
    assert [name for name in inside if not KNOWN.fullmatch(name)] == []
    assert set(content["navsat_transform_node"]["ros__parameters"]) == NAVSAT
    assert [k for k, on in zip(ORDER, inside["odom1_config"], strict=True) if on] == ["vx"]
    assert inside["imu0_twist_rejection_threshold"] == 4.0
    assert inside["imu0_linear_acceleration_rejection_threshold"] == 5.0
    assert "0.09 m2/s2, ten messages per second" in texts["README.md"]
    assert 'executable="navsat_transform_node"' in texts["ekf.launch.py"]
    (tmp_path / "ekf.yaml").write_text(texts["ekf.yaml"])
    found = FilterParameters.load(tmp_path / "ekf.yaml")
    assert (found.imu_gate, found.gate) == ((16.0, 25.0), 9.0)
    assert found.odometer_noise is not None


@pytest.mark.long
def test_the_page_compares_it_with_its_defaults_and_another_filter():
    drive = make_drive(duration=40.0)
    own = tuned("planar8", "ekf", 0.01, everything=False)
    found = evaluate([drive], ROBOT, against=own)
    text = accuracy_section(found.view)
    rows = {row[1]: row for row in (line.split(" | ") for line in text.splitlines()) if len(row) > 2}
    assert {"ekf.yaml", "default process noise, same inputs", "other EKF, planar8"} < rows.keys()
    assert float(rows["ekf.yaml"][2]) == pytest.approx(found.mean("tuned", "position_rmse_m"), rel=5e-3)
    noisy = replace(ROBOT, measurement_noise=(1e-3, 1e-3))  # follows each fix
    for own, rival, said in ((noisy, ROBOT, "HIGHER than the other"), (ROBOT, noisy, "lower than the other")):
        text = accuracy_section(evaluate([drive], own, against=rival).view)
        assert said in text.splitlines()[-1]


def test_the_page_without_truth_contains_only_the_drift():
    found = evaluate([replace(make_drive(duration=40.0), truth=None)], ROBOT)
    text = accuracy_section(found.view)
    assert "| 5 s outage drift, m |" in text and "position RMSE" not in text


@pytest.mark.parametrize("target", ["c99", "filterpy"])
def test_a_filter_of_this_type_is_exported_only_to_ros(target: Target):
    with pytest.raises(InputError, match=f"{target} does not support robot-localization; use planar8"):
        export_texts(ROBOT, target)


def test_the_target_can_be_written_with_a_hyphen():
    assert sigmaswarm.export(ROBOT, "robot-localization") == export_texts(ROBOT, "robot_localization")


@pytest.mark.parametrize("value", [1e-5, 1.5e-12, 1e22, 0.1, 3.0, 0.0, 5e-324])
def test_yaml_reads_every_number_as_a_number(value: float):
    assert yaml.safe_load(yaml_number(value)) == value
