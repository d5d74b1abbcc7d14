"""Simulate IMUs of several grades, and odometers that count pulses of the rear wheels. `gps` simulates receivers.

Sources: [T] data sheet of the chip. [L] the CARLA Leaderboard's sensor set-up. [R] from memory, not verified.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Imu, Odometer
from sigmaswarm.geodesy import STANDARD_GRAVITY
from sigmaswarm.simulation.dynamics import GRAVITY, REAR_SPIN, STEP, Vehicle
from sigmaswarm.simulation.environments import Named, by_name
from sigmaswarm.simulation.motion import Motion

_DEG = math.pi / 180
_G = STANDARD_GRAVITY


@dataclass(frozen=True)
class Triad:
    """Errors of three accelerometers (unit m/s2) or three gyros (unit rad/s).

    Attributes
    ----------
    noise_density : float
        Density of the white noise, unit/sqrt(Hz). The standard deviation of a sample is the density times sqrt(rate).
    bias_std : float
        Standard deviation of the first-order Gauss-Markov bias.
    turn_on : float
        Limit of an additional bias that is constant during a drive and uniformly distributed within +- this value.
    scale, misalignment : float
        Limits of the relative scale errors and of the relative cross-axis errors, which are uniformly distributed.
    reach : float
        Limit of the measured value.
    resolution : float
        Quantization step; 0 if there is no quantization.
    """

    noise_density: float = 0.0
    bias_std: float = 0.0
    turn_on: float = 0.0
    scale: float = 0.0
    misalignment: float = 0.0
    reach: float = math.inf
    resolution: float = 0.0


@dataclass(frozen=True)
class ImuGrade(Named):
    """A named grade of IMU. `bias_time` is the correlation time of the Gauss-Markov biases, s."""

    accel: Triad = field(default_factory=Triad)
    gyro: Triad = field(default_factory=Triad)
    bias_time: float = 100.0
    carla: bool = False
    source: str = ""


def _accel(per_sqrt_hour: float, bias: float, **more: float) -> Triad:
    """Convert from m/s/sqrt(h) and m/s2."""
    return Triad(per_sqrt_hour / 60, bias, **more)


def _gyro(per_sqrt_hour: float, bias_per_hour: float, **more: float) -> Triad:
    """Convert from deg/sqrt(h) and deg/h."""
    return Triad(per_sqrt_hour * _DEG / 60, bias_per_hour * _DEG / 3600, **more)


_MPU = {"scale": 0.03, "misalignment": 0.02}  # [T] sensitivity tolerance, cross-axis sensitivity

# The ideal sensor, real sensors, and grades of other simulators
IMU_GRADES = by_name(
    ImuGrade("ideal", source="no errors"),
    ImuGrade(
        "mpu-6050",
        _accel(0.24, 0.0, turn_on=0.050 * _G, reach=4 * _G, resolution=_G / 8192, **_MPU),
        _gyro(0.3, 0.0, turn_on=20 * _DEG, reach=500 * _DEG, resolution=_DEG / 65.5, **_MPU),
        source="InvenSense PS-MPU-6000A: uncalibrated, as shipped from the factory, +-4 g and +-500 deg/s",
    ),
    ImuGrade(
        "icm-20602",  # reach and resolution [R]
        _accel(0.2, 1000e-5, reach=4 * _G, resolution=_G / 8192),
        _gyro(0.2, 200, reach=500 * _DEG, resolution=_DEG / 65.5),
        bias_time=3600.0,
        source="i2Nav awesome-gins-datasets: noise parameters tuned on drives of a car",
    ),
    ImuGrade(
        "adis16465",  # reach and resolution [R]
        _accel(0.1, 200e-5, reach=8 * _G, resolution=8 * _G / 2**31),
        _gyro(0.1, 25, reach=500 * _DEG, resolution=500 * _DEG / 2**31),
        bias_time=3600.0,
        source="i2Nav awesome-gins-datasets: noise parameters tuned on drives of a car",
    ),
    ImuGrade(
        "adis16405",  # reach and resolution [R]
        _accel(0.2, 0.2e-3 * _G, turn_on=0.050 * _G, reach=18 * _G, resolution=3.33e-3 * _G),
        _gyro(2.0, 0.007 * 3600, turn_on=3 * _DEG, reach=300 * _DEG, resolution=0.05 * _DEG),
        source="NaveGo",
    ),
    ImuGrade(
        "adis16488",  # reach and resolution [R]
        _accel(0.029, 0.1e-3 * _G, turn_on=0.016 * _G, reach=18 * _G, resolution=18 * _G / 2**31),
        _gyro(0.3, 6.5, turn_on=0.2 * _DEG, reach=450 * _DEG, resolution=450 * _DEG / 2**31),
        source="NaveGo",
    ),
    ImuGrade("gnss-ins-sim-low", _accel(0.05, 2e-4), _gyro(0.75, 10), source="gnss-ins-sim"),
    ImuGrade("gnss-ins-sim-mid", _accel(0.03, 5e-5), _gyro(0.25, 3.5), source="gnss-ins-sim"),
    ImuGrade("gnss-ins-sim-high", _accel(2.5e-5, 3.6e-6), _gyro(2e-3, 0.1), source="gnss-ins-sim"),
    ImuGrade(
        "carla",
        # 0.001 m/s2 and 0.001 rad/s per sample at 100 Hz [L], as densities. The bias of the gyro is an assumption.
        Triad(1e-4),
        Triad(1e-4, turn_on=1e-3),
        carla=True,
        source="CARLA Leaderboard sensor set-up (0.001 m/s2, 0.001 rad/s per sample at 100 Hz)",
    ),
)


def gauss_markov(rng: np.random.Generator, count: int, axes: int, ratio: float) -> Array:
    """Draw stationary first-order Gauss-Markov sequences (count, axes) of unit variance.

    ``ratio`` is the sampling interval divided by the correlation time.
    """
    shocks = rng.standard_normal((count, axes))
    keep = math.exp(-ratio)
    shocks[1:] *= math.sqrt(1 - keep**2)  # the first value has the stationary variance
    return np.asarray(lfilter([1.0], [1.0, -keep], shocks, axis=0))


def _add_errors(
    true: Array, triad: Triad, interval: float, bias_time: float, rng: np.random.Generator
) -> Array:
    """Add the errors of a triad to true values (n, 3). The number of random numbers does not depend on the grade."""
    turn_on = triad.turn_on * rng.uniform(-1, 1, 3)
    mixing = triad.misalignment * rng.uniform(-1, 1, (3, 3))
    np.fill_diagonal(mixing, 1 + triad.scale * rng.uniform(-1, 1, 3))
    white = triad.noise_density / math.sqrt(interval) * rng.standard_normal(true.shape)
    bias = triad.bias_std * gauss_markov(rng, len(true), 3, interval / bias_time)
    reading = np.clip(true @ mixing.T + turn_on + bias + white, -triad.reach, triad.reach)
    return np.round(reading / triad.resolution) * triad.resolution if triad.resolution > 0 else reading


def measure_imu(times: Array, motion: Motion, grade: ImuGrade, rng: np.random.Generator) -> Imu:
    """Measure the motion of the IMU at ``times`` (n,), s. With a `carla` grade, the first two samples are missing."""
    force, rate = motion.specific_force, motion.angular_rate
    if grade.carla:
        force, rate, times = carla_force(times, motion), rate[2:], times[2:]
    interval = float(np.median(np.diff(times)))
    force = _add_errors(force, grade.accel, interval, grade.bias_time, rng)
    rate = _add_errors(rate, grade.gyro, interval, grade.bias_time, rng)
    (ax, ay, az), (gx, gy, gz) = force.T, rate.T
    return Imu(times, ax, ay, gz, az=az, gx=gx, gy=gy)


def carla_force(times: Array, motion: Motion) -> Array:
    """Compute the specific force (n - 2, 3) as CARLA's IMU sensor does, from the third sample on.

    The force is the acceleration from the last three positions, which is one tick late, plus gravity. Both are rotated
    with the present attitude (carla-simulator/carla, InertialMeasurementUnit.cpp).
    """
    steps = np.diff(times)[:, None]
    speeds = np.diff(motion.position, axis=0) / steps
    acceleration = 2 * np.diff(speeds, axis=0) / (steps[1:] + steps[:-1])
    acceleration[:, 2] += GRAVITY
    return np.einsum("nji,nj->ni", motion.rotation[2:], acceleration)


@dataclass(frozen=True)
class OdometerGrade(Named):
    """A named grade of odometer.

    Attributes
    ----------
    rate : float
        Rate of the readings, Hz.
    window : float
        Length of the counting window before a reading, s. The delay of a reading is half of this length.
    teeth : int
        Pulses of both rear wheels together per revolution.
    scale_std : float
        Standard deviation of the scale error (reading / true speed - 1), drawn for each drive.
    resolution : float
        Resolution of the speed on the bus, m/s.
    slowest : float
        Lowest reported speed, m/s; lower speeds are reported as zero.
    """

    rate: float
    window: float
    teeth: int
    scale_std: float = 0.01
    resolution: float = 0.0
    slowest: float = 0.0
    source: str = ""


ODOMETER_GRADES = by_name(
    OdometerGrade("ideal", 100.0, 0.002, 1_000_000, 0.0, source="exact wheel speed; the only error is slip"),
    OdometerGrade(
        "pulses",
        50.0,
        0.1,
        96,
        source="a ring of 48 teeth on each rear wheel; from the author's memory, not verified",
    ),
    OdometerGrade(
        *("can", 83.0, 0.05, 10_000),
        resolution=0.01 / 3.6,
        slowest=0.3,
        source="CAN speed as in comma2k19: 83 Hz, fine resolution, from the times between pulses; the lowest speed "
        "is from the author's memory, not verified",
    ),
)
"""Grades by name.

The standard deviation of the scale error, 1%, is a typical value for the wear and pressure of tires, not verified. The
odometer of comma2k19's car reads 0.8% too low.
"""


def measure_odometer(
    record: Array, car: Vehicle, grade: OdometerGrade, rng: np.random.Generator
) -> tuple[Odometer, float]:
    """Measure the wheel speed in a record (n, 21 or more) of the car. Return the readings and the drawn scale."""
    scale = 1.0 + grade.scale_std * rng.standard_normal()
    phase, tooth = rng.uniform(0.0, 1.0, 2)
    time = np.arange(grade.window + phase / grade.rate, (len(record) - 1) * STEP, 1 / grade.rate)
    turned = np.concatenate([[0.0], np.cumsum(record[:-1, REAR_SPIN]) * STEP]) * grade.teeth / (2 * np.pi)
    moments = np.arange(len(record)) * STEP
    passed = [np.floor(np.interp(t, moments, turned) + tooth) for t in (time - grade.window, time)]
    length = 2 * np.pi * car.wheel_radius / grade.teeth
    speed = scale * length * (passed[1] - passed[0]) / grade.window
    if grade.resolution > 0:
        speed = grade.resolution * np.round(speed / grade.resolution)
    return Odometer(time, np.where(np.abs(speed) < grade.slowest, 0.0, speed)), scale
