"""Warnings about drives with other sensors than those of the training drives."""

import pytest

from sigmaswarm import evaluate, tune
from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD, receiver_std
from sigmaswarm.scoring.remarks import other_sensors
from support import make_drive


def record(rate: float = 100.0, fixes: float = 5.0, std: float | None = 1.0) -> DriveRecord:
    return DriveRecord(
        name="friday",
        duration_s=100.0,
        imu_samples=round(100 * rate),
        fixes=round(100 * fixes),
        receiver_std_m=std,
    )


@pytest.mark.parametrize(
    ("drive", "said"),
    [
        (record(), ""),
        (record(rate=80.0, fixes=4.0, std=1.9), ""),
        (record(std=None), ""),
        (record(std=UNSTATED_GPS_STD), ""),
        (record(rate=50.0), "IMU 50 Hz instead of 100 Hz"),
        (record(std=0.02), "standard deviation of the fixes 0.02 m instead of 1 m"),
        (record(rate=400.0, std=4.0), "IMU 400 Hz instead of 100 Hz, standard deviation of the fixes 4 m"),
    ],
)
def test_clearly_different_sensors_are_named(drive: DriveRecord, said: str):
    found = other_sensors(drive, [record(), record(), record(rate=98.0, std=1.2)])
    assert (said in found) if said else not found
    assert not other_sensors(drive, [])


def test_an_assumed_accuracy_is_not_compared():
    assert not other_sensors(record(std=0.1), [record(std=UNSTATED_GPS_STD)])
    assert "0.1 m instead of 1 m" in other_sensors(record(std=0.1), [record(std=UNSTATED_GPS_STD), record()])


def test_a_tuning_and_an_evaluation_record_the_standard_deviation_of_the_fixes(undiagnosed: None):
    drive = make_drive(duration=30.0, imu_rate=50.0)
    tuning = tune(drive, model="planar5", particles=2, generations=1)
    (trained,) = [DriveRecord(**entry) for entry in tuning.data]
    tested = evaluate(drive, tuning.parameters).setup.data[0]
    assert (
        trained.receiver_std_m == tested.receiver_std_m == pytest.approx(max(receiver_std(drive)), rel=0.01)
    )
    assert not other_sensors(tested, [trained])
