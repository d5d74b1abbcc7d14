"""Drives of different vehicles are reported, and those of one vehicle are not."""

from dataclasses import replace

import pytest

from sigmaswarm import SigmaswarmWarning, tune
from sigmaswarm.drives.mounting import AXES_KEY, KEY
from sigmaswarm.drives.sensors import differences, log_properties
from sigmaswarm.simulation import simulate
from support import make_drive

IMPORTED = {AXES_KEY: {"ax": "acc_x"}}


def found(*drives) -> list[str]:
    return [*differences([log_properties(drive) for drive in drives])]


@pytest.mark.parametrize(
    ("rates", "first", "second", "said"),
    [
        ({"imu_rate": 60.0}, {}, {}, ["the rate of the IMU is 100 Hz in a but 60 Hz in b"]),
        ({"gps_rate": 1.0}, {}, {}, ["the rate of the receiver is 5 Hz in a but 1 Hz in b"]),
        ({"imu_rate": 80.0, "gps_rate": 4.0}, {}, {}, []),
        ({}, {KEY: [0, 0, 90]}, IMPORTED, ["the mountings of the IMU in a and b differ by 90 deg"]),
        (
            {},
            {KEY: [0, 0, 170]},
            {KEY: [0, 0, -175]},
            ["the mountings of the IMU in a and b differ by 15 deg"],
        ),
        ({}, {KEY: [0, 0, 179]}, {KEY: [2, 0, -176]}, []),
        ({}, {KEY: [0, 0, 90]}, {}, []),  # the second drive states no mounting
    ],
)
def test_clear_differences_are_described(rates: dict, first: dict, second: dict, said: list[str]):
    drives = make_drive(duration=20.0, name="a"), make_drive(duration=20.0, name="b", **rates)
    pair = [replace(drive, metadata=about) for drive, about in zip(drives, (first, second), strict=True)]
    assert found(*pair) == said
    assert found(pair[0]) == found(pair[1]) == []


def test_simulated_drives_of_one_grade_have_the_same_sensors():
    drives = [
        simulate("urban", environment=where, duration=30.0, gps="ublox-m8", seed=i)
        for i, where in enumerate(("clear", "rain"))
    ]
    assert found(*drives) == []


@pytest.mark.usefixtures("undiagnosed")
def test_tune_warns_in_python_too():
    drives = [make_drive(duration=20.0, name=name, imu_rate=rate) for name, rate in (("a", 100), ("b", 60))]
    with pytest.warns(
        SigmaswarmWarning, match="different vehicles or sensors: the rate of the IMU is 100 Hz in a"
    ):
        tune(drives, model="planar5", particles=2, generations=1)
