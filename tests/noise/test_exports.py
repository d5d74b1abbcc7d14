"""The format and units of each package, read by parsers of YAML and TOML."""

import math
import re
import tomllib

import numpy as np
import pytest
import yaml

from sigmaswarm.errors import InputError
from sigmaswarm.exports.imu_noise import noise_texts
from sigmaswarm.filters.presets import BIAS_WALKS
from sigmaswarm.noise import AxisNoise, Interval, Noise

WHITE = {"ax": 1e-3, "ay": 2e-3, "az": 3e-3, "gz": 1e-4}
"""Unit/sqrt(Hz)"""
RMS = math.sqrt(14 / 3) * 1e-3
WALK, TIME, FLICKER = 2e-5, 500.0, 3e-4


def exact(value: float) -> Interval:
    return Interval(value, value, 2 * value)


def noise(walk: float = WALK, flicker: float = 0.0, time: float = TIME, high: float | None = None) -> Noise:
    axes = [
        AxisNoise(
            axis, exact(white), exact(flicker), Interval(walk, 0.0, high or walk), time, 0.0, *np.ones((2, 1))
        )
        for axis, white in WHITE.items()
    ]
    return Noise("log", 200.0, tuple(axes), ((0.0, 3600.0),), ("a remark",))


def text_of(target: str, **changes) -> str:
    (text,) = noise_texts(noise(**changes), target).values()
    return text


def test_drive_toml():
    found = tomllib.loads(text_of("sigmaswarm"))
    assert found == {
        "accel_noise_density": pytest.approx(RMS, rel=1e-5),
        "accel_bias_walk": pytest.approx(WALK, rel=1e-5),
        "gyro_noise_density": pytest.approx(1e-4, rel=1e-5),
        "gyro_bias_walk": pytest.approx(WALK, rel=1e-5),
    }


def test_kf_gins():
    found = yaml.safe_load(text_of("kf-gins"))["imunoise"]
    std = WALK * math.sqrt(TIME / 2)
    assert found["arw"] == pytest.approx([np.degrees(1e-4) * 60] * 3, rel=1e-5)
    assert found["vrw"] == pytest.approx([0.06, 0.12, 0.18], rel=1e-5)
    assert found["gbstd"] == pytest.approx([np.degrees(std) * 3600] * 3, rel=1e-5)
    assert found["abstd"] == pytest.approx([std * 1e5] * 3, rel=1e-5)
    assert found["corrtime"] == pytest.approx(TIME / 3600, rel=1e-5)
    assert list(found) == ["arw", "vrw", "gbstd", "abstd", "gsstd", "asstd", "corrtime"]


def test_kalibr_and_vins():
    found = yaml.safe_load(text_of("kalibr"))
    expected = {
        "accelerometer_noise_density": RMS, "accelerometer_random_walk": WALK, "gyroscope_noise_density": 1e-4,
        "gyroscope_random_walk": WALK, "update_rate": 200.0, "acc_n": RMS, "acc_w": WALK, "gyr_n": 1e-4, "gyr_w": WALK,
    }  # fmt: skip
    assert {k: v for k, v in found.items() if k != "rostopic"} == pytest.approx(expected, rel=1e-5)


def test_robot_localization_at_the_log_s_rate():
    found = yaml.safe_load(text_of("robot_localization"))
    assert found["linear_acceleration_covariance"] == pytest.approx(
        list(np.diag([2e-4, 8e-4, 1.8e-3]).ravel()), rel=1e-5
    )
    assert found["angular_velocity_covariance"] == pytest.approx(list(2e-6 * np.eye(3).ravel()), rel=1e-5)


def test_matlab():
    text = text_of("matlab", flicker=FLICKER)
    assert "imuSensor('accel-gyro', 'SampleRate', 200.0)" in text
    found = {
        (sensor, name): yaml.safe_load(values)
        for sensor, body in re.findall(r"(\w+)params\((.*?)\);", text, re.DOTALL)
        for name, values in re.findall(r"'(\w+)', (\[.*?\])", body)
    }
    assert found["accel", "NoiseDensity"] == pytest.approx([1e-3, 2e-3, 3e-3])
    assert found["gyro", "BiasInstability"] == pytest.approx([FLICKER] * 3)
    assert found["gyro", "RandomWalk"] == pytest.approx([WALK] * 3)
    assert all(line.startswith(("%", "imu", "    '")) for line in text.splitlines())


def test_comments_name_remarks_and_unknown_axes():
    text = text_of("kalibr")
    assert "# a remark\n" in text
    assert "# gx was not measured; the value is the RMS of the other axes\n" in text
    assert "# az is not" not in text
    assert "ICM-20602" not in text
    assert "# axes without a measured bias have the bias random walk of an ICM-20602\n" in text_of(
        "kalibr", walk=0.0
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"time": math.inf}, WALK),
        ({"walk": 0.0, "high": 5e-5, "time": math.inf}, 5e-5),  # not seen: its upper end
        ({"walk": 0.0}, math.sqrt(BIAS_WALKS["gyro"])),  # a filter without a bias
        (
            {"walk": 0.0, "flicker": FLICKER},
            FLICKER * math.sqrt(2 * math.log(2) / math.pi / 0.3811 * 2 / TIME),
        ),
    ],
)
def test_the_bias_of_a_package_that_has_a_walk_alone(changes, expected):
    assert yaml.safe_load(text_of("kalibr", **changes))["gyroscope_random_walk"] == pytest.approx(
        expected, rel=1e-3
    )


def test_what_can_not_be_written():
    with pytest.raises(InputError, match="'ardupilot'; choose one of sigmaswarm, kf-gins"):
        noise_texts(noise(), "ardupilot")
    gyro = Noise("log", 100.0, noise().axes[-1:], (), ())
    with pytest.raises(InputError, match="no axis of the accel was measured, but matlab needs one"):
        noise_texts(gyro, "matlab")
