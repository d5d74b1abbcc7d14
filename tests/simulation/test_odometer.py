"""The simulated odometer: pulses, scale and slip of the car's own wheels."""

from pathlib import Path

import numpy as np
import pytest

from sigmaswarm import Drive, InputError, read_drive, simulate, write_drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.simulation import ODOMETER_GRADES
from sigmaswarm.simulation.environments import find_vehicle


def true_speed(drive: Drive, age: float) -> np.ndarray:
    """Return the forward speed at the times to which the readings refer, m/s."""
    truth, odometer = drive.truth, drive.odometer
    assert truth is not None and odometer is not None
    forward = np.cos(truth.theta) * truth.vx + np.sin(truth.theta) * truth.vy
    return np.interp(odometer.time - age, truth.time, forward)


@pytest.mark.parametrize("name", ODOMETER_GRADES)
def test_readings_are_the_scaled_speed_within_one_pulse(name: str):
    drive, grade = simulate("turns", seed=3, imu="ideal", odometer=name), ODOMETER_GRADES[name]
    assert drive.odometer is not None
    scale = drive.metadata["odometer"]["scale"]
    assert (scale == 1.0) == (name == "ideal")
    speed, told = true_speed(drive, grade.window / 2), drive.odometer.speed
    fast = (speed > 3.0) & (drive.odometer.time > 2.0)
    _, car = find_vehicle("model3")
    pulse = 2 * np.pi * car.wheel_radius / grade.teeth / grade.window
    ratio = np.sum(told[fast]) / np.sum(speed[fast])
    assert ratio == pytest.approx(scale, abs=0.003)  # freely rolling tires slip by a few thousandths
    off = told[fast] / scale - speed[fast]
    assert np.quantile(np.abs(off), 0.95) < pulse + 0.01 * 15 + grade.resolution
    np.testing.assert_allclose(np.median(np.diff(drive.odometer.time)), 1 / grade.rate, rtol=1e-6)


def test_slow_wheels_read_zero_while_the_car_moves():
    drive = simulate("urban", seed=1, duration=60.0, odometer="pulses")
    assert drive.odometer is not None
    speed, told = true_speed(drive, 0.05), drive.odometer.speed
    creeping = (speed > 0.02) & (speed < 0.15)
    assert creeping.sum() > 5
    assert 0.1 < np.mean(told[creeping] == 0.0) < 1.0
    levels = np.unique(np.round(told, 9))
    assert np.diff(levels).min() > 0.2  # one more pulse in 0.1 s


def test_wheels_slip_more_on_a_slippery_road():
    slippery, dry = (
        simulate("accelerate", where, seed=2, odometer="ideal") for where in ("slippery", "clear")
    )
    most = []
    for drive in (slippery, dry):
        assert drive.odometer is not None
        speed = true_speed(drive, 0.001)
        most.append(np.max(np.where(speed > 3.0, drive.odometer.speed / np.maximum(speed, 1.0), 1.0)))
    assert most[0] > most[1] > 1.0
    assert most[0] > 1.015  # traction control keeps the slip at the maximum of the tire force


def test_the_odometer_changes_no_other_sensor_and_is_part_of_the_drive(tmp_path: Path):
    bare, wheeled = (simulate("brake", seed=4, odometer=odometer) for odometer in (None, "pulses"))
    assert bare.odometer is None and "odometer" not in bare.metadata
    np.testing.assert_array_equal(bare.imu.ax, wheeled.imu.ax)
    np.testing.assert_array_equal(bare.gps.x, wheeled.gps.x)
    again = read_drive(write_drive(wheeled, tmp_path / "drive"))
    assert fingerprint(again) == fingerprint(wheeled)
    with pytest.raises(InputError, match="choose from ideal, pulses, can"):
        simulate("brake", odometer="radar")
