import math
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.simulation.dynamics import GRAVITY
from sigmaswarm.simulation.motion import Motion
from sigmaswarm.simulation.sensors import (
    IMU_GRADES,
    ImuGrade,
    Triad,
    carla_force,
    measure_imu,
)

REAL = [name for name in IMU_GRADES if name != "ideal"]
WITH_BIAS = [name for name in REAL if IMU_GRADES[name].gyro.bias_std > 0]


def at_rest(count):
    still = np.zeros((count, 3))
    rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
    return Motion(still, still, rotation, np.zeros(count), still + np.array([0.0, 0.0, GRAVITY]), still)


def measured(grade, count, interval, seed=1):
    """Return accelerations and angular rates at rest, shape (2, 3, n)."""
    imu = measure_imu(np.arange(count) * interval, at_rest(count), grade, np.random.default_rng(seed))
    return np.array([[imu.ax, imu.ay, imu.az], [imu.gx, imu.gy, imu.gz]])


def allan_deviation(values, interval, tau):
    """Compute the Allan deviation of three axes together with an independent library."""
    allantools = pytest.importorskip("allantools", reason="allantools is not installed")
    found = [allantools.oadev(v, rate=1 / interval, data_type="freq", taus=[tau])[1][0] for v in values]
    return float(np.sqrt(np.mean(np.square(found))))


def gauss_markov_deviation(std, correlation_time, tau):
    """Allan deviation of a first-order Gauss-Markov process, from its autocorrelation std^2 exp(-t / T)."""
    r = tau / correlation_time
    return std * math.sqrt(2 / r**2 * (r - 1.5 + 2 * math.exp(-r) - 0.5 * math.exp(-2 * r)))


@pytest.mark.parametrize("name", REAL)
def test_allan_deviation_shows_the_white_noise(name):
    grade, interval, tau = IMU_GRADES[name], 0.01, 0.1
    for values, triad in zip(measured(grade, 60_000, interval), (grade.accel, grade.gyro), strict=True):
        found = allan_deviation(values, interval, tau) * math.sqrt(tau)
        print(f"{name}: noise density {found:.4g}, stated {triad.noise_density:.4g}")
        assert found == pytest.approx(triad.noise_density, rel=0.10)


@pytest.mark.parametrize("name", WITH_BIAS)
def test_allan_deviation_shows_the_bias(name):
    """Compare at the peak, 1.89 correlation times, after subtracting the remaining white noise.

    Quantization is omitted, since at this low rate the noise is too small to randomize it.
    """
    grade = IMU_GRADES[name]
    accel, gyro = (replace(triad, resolution=0.0) for triad in (grade.accel, grade.gyro))
    grade = replace(grade, accel=accel, gyro=gyro)
    interval, tau = grade.bias_time / 20, 1.9 * grade.bias_time
    for values, triad in zip(measured(grade, 200_000, interval), (grade.accel, grade.gyro), strict=True):
        white = triad.noise_density / math.sqrt(tau)
        found = math.sqrt(allan_deviation(values, interval, tau) ** 2 - white**2)
        found /= gauss_markov_deviation(1.0, grade.bias_time, tau)
        print(f"{name}: bias deviation {found:.4g}, stated {triad.bias_std:.4g}")
        assert found == pytest.approx(triad.bias_std, rel=0.10)


def test_turn_on_bias_covers_its_range_and_is_constant_in_a_run():
    grade = ImuGrade("test", Triad(turn_on=0.5), Triad(turn_on=0.1))
    runs = np.array([measured(grade, 4, 0.01, seed) for seed in range(400)]) - [
        [[0], [0], [GRAVITY]],
        [[0]] * 3,
    ]
    assert np.ptp(runs, axis=-1).max() < 1e-12
    for values, limit in zip(runs[..., 0].swapaxes(0, 1), (0.5, 0.1), strict=True):
        assert 0.95 * limit < np.abs(values).max() <= limit
        assert values.std() == pytest.approx(limit / math.sqrt(3), rel=0.1)


def test_scale_misalignment_saturation_and_quantization():
    motion = at_rest(5)
    ideal = measure_imu(np.arange(5) / 100, motion, IMU_GRADES["ideal"], np.random.default_rng(0))
    assert (ideal.az == GRAVITY).all() and (ideal.ax == 0).all()

    skewed = measured(ImuGrade("test", Triad(scale=0.03, misalignment=0.02)), 5, 0.01)[0, :, 0]
    assert 0 < abs(skewed[2] - GRAVITY) <= 0.03 * GRAVITY
    assert 0 < np.abs(skewed[:2]).max() <= 0.02 * GRAVITY

    assert measured(ImuGrade("test", Triad(reach=5.0)), 5, 0.01)[0, 2, 0] == 5.0
    steps = measured(ImuGrade("test", Triad(noise_density=0.1, resolution=0.25)), 500, 0.01)[0] / 0.25
    np.testing.assert_array_equal(steps, np.round(steps))


def test_grades_with_the_same_seed_have_the_same_noise_scaled():
    """Grades can be compared with the same noise at another size."""
    quiet, loud = (ImuGrade("test", Triad(noise_density=d)) for d in (0.01, 0.02))
    np.testing.assert_allclose(2 * measured(quiet, 50, 0.01)[0, 0], measured(loud, 50, 0.01)[0, 0])


def test_carlas_acceleration_is_a_second_difference_one_tick_late():
    time = np.arange(200) / 100
    still = np.zeros((200, 3))
    position = np.column_stack([time**3, np.zeros(200), np.zeros(200)])  # acceleration 6 t
    motion = Motion(position, still, np.broadcast_to(np.eye(3), (200, 3, 3)), np.zeros(200), still, still)
    force = carla_force(time, motion)
    assert force.shape == (198, 3)
    np.testing.assert_allclose(force[:, 0], 6 * (time[2:] - 0.01), atol=1e-8)
    np.testing.assert_allclose(force[:, 2], GRAVITY)
