"""What robot_localization gets: its order, its units, and numbers that YAML reads as numbers."""

import math
from dataclasses import replace

import pytest
import yaml

from exported import tuned
from sigmaswarm.exports.robot_localization import robot_localization, yaml_number
from sigmaswarm.filters.parameters import FilterParameters

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


def test_sigma_points_keep_their_spread():
    read_, _ = read(replace(tuned("planar8", "ukf", 0.01), kappa=1.0))
    assert (read_["alpha"], read_["beta"]) == (0.5, 2.0)
    assert 15 + read_["kappa"] == 8 + 1.0
    assert "alpha" not in read(tuned("planar5", "ekf", 0.01))[0]


def test_the_gate_is_a_distance_there():
    assert read(tuned("planar5", "ukf", 0.01))[0]["odom0_pose_rejection_threshold"] == math.sqrt(9.2)
    assert "odom0_pose_rejection_threshold" not in read(tuned("planar5", "ukf", 0.01, everything=False))[0]


def test_it_says_what_it_is_and_what_it_can_not_have():
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


@pytest.mark.parametrize("value", [1e-5, 1.5e-12, 1e22, 0.1, 3.0, 0.0, 5e-324])
def test_yaml_reads_every_number_as_one(value: float):
    assert yaml.safe_load(yaml_number(value)) == value
