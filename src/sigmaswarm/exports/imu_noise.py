"""Noise parameters of an IMU in the units and files of other programs."""

import math

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.noise import AXES, AxisNoise, ImuNoise, Interval

PACKAGES = ("sigmaswarm", "kf-gins", "kalibr", "robot_localization", "matlab")
"""Programs for which `as_text` writes noise parameters, in their own units."""


def as_text(noise: ImuNoise, package: str) -> str:
    """Write noise parameters as a program's configuration has them.

    Parameters
    ----------
    noise : ImuNoise
    package : str
        "sigmaswarm": lines of drive.toml, from which `baseline` starts. "kf-gins": deg/sqrt(h), m/s/sqrt(h), deg/h,
        mGal, h. "kalibr": imu.yaml, continuous-time densities; VINS takes the same. "robot_localization": variances
        of the IMU's messages at the log's rate. "matlab": imuSensor.

    Raises
    ------
    InputError
        The package is unknown.
    """
    if package not in PACKAGES:
        raise InputError(f"no package is called {package!r}; choose one of {', '.join(PACKAGES)}")
    return {
        "sigmaswarm": _drive_toml,
        "kf-gins": _kf_gins,
        "kalibr": _kalibr,
        "robot_localization": _covariances,
        "matlab": _matlab,
    }[package](noise)


def _row(noise: ImuNoise, sensor: str, parameter: str, factor: float = 1.0) -> str:
    """Values of the axes x, y, z; an axis without one takes the mean of the others."""
    usual = noise.mean(sensor, parameter)
    values = [noise.value(f"{sensor}{axis}", parameter, usual) * factor for axis in "xyz"]
    return ", ".join(f"{v:.6g}" for v in values)


def _drive_toml(noise: ImuNoise) -> str:
    return (
        f"accel_noise_density = {noise.mean('a', 'white'):.6g}  # m/s2/sqrt(Hz)\n"
        f"gyro_noise_density = {noise.mean('g', 'white'):.6g}  # rad/s/sqrt(Hz)\n"
    )


def _kf_gins(noise: ImuNoise) -> str:
    per_root_hour, per_hour = math.degrees(60), math.degrees(3600)
    times = [n.correlation_time for n in noise.axes.values() if n.correlation_time]
    bias = "bias_std" if times else "instability"
    return (
        "imunoise:\n"
        f"  arw: [{_row(noise, 'g', 'white', per_root_hour)}]  # deg/sqrt(h)\n"
        f"  vrw: [{_row(noise, 'a', 'white', 60)}]  # m/s/sqrt(h)\n"
        f"  gbstd: [{_row(noise, 'g', bias, per_hour)}]  # deg/h\n"
        f"  abstd: [{_row(noise, 'a', bias, 1e5)}]  # mGal\n"
        "  gsstd: [1000.0, 1000.0, 1000.0]  # ppm, not measured\n"
        "  asstd: [1000.0, 1000.0, 1000.0]  # ppm, not measured\n"
        f"  corrtime: {(float(np.median(times)) if times else 3600.0) / 3600:.4g}  # h\n"
    )


def _kalibr(noise: ImuNoise) -> str:
    return (
        f"accelerometer_noise_density: {noise.mean('a', 'white'):.6g}  # m/s^2/sqrt(Hz)\n"
        f"accelerometer_random_walk: {noise.mean('a', 'walk'):.6g}  # m/s^3/sqrt(Hz)\n"
        f"gyroscope_noise_density: {noise.mean('g', 'white'):.6g}  # rad/s/sqrt(Hz)\n"
        f"gyroscope_random_walk: {noise.mean('g', 'walk'):.6g}  # rad/s^2/sqrt(Hz)\n"
        f"update_rate: {noise.rate:.6g}  # Hz\n"
        "rostopic: /imu  # the topic of your IMU\n"
    )


def _covariances(noise: ImuNoise) -> str:
    lines = ["# Variances of a sample, for the driver of the IMU (sensor_msgs/Imu)"]
    for key, sensor, unit in (
        ("angular_velocity", "g", "(rad/s)^2"),
        ("linear_acceleration", "a", "(m/s2)^2"),
    ):
        usual = noise.mean(sensor, "white")
        x, y, z = (noise.value(f"{sensor}{axis}", "white", usual) ** 2 * noise.rate for axis in "xyz")
        lines.append(f"{key}_covariance: [{x:.6g}, 0.0, 0.0, 0.0, {y:.6g}, 0.0, 0.0, 0.0, {z:.6g}]  # {unit}")
    return "\n".join(lines) + "\n"


def _matlab(noise: ImuNoise) -> str:
    lines = [f"imu = imuSensor('accel-gyro', SampleRate={noise.rate:.6g});"]
    for name, sensor in (("Accelerometer", "a"), ("Gyroscope", "g")):
        values = {"NoiseDensity": "white", "BiasInstability": "instability", "RandomWalk": "walk"}
        lines += [f"imu.{name}.{key} = [{_row(noise, sensor, p)}];" for key, p in values.items()]
    return "\n".join(lines) + "\n"


def filter_noise(parameters: FilterParameters, rate: float) -> ImuNoise:
    """Return the noise of the IMU that a tuned filter assumes: its Q also holds errors of the model.

    Parameters
    ----------
    parameters : FilterParameters
    rate : float
        Hz of the IMU.

    Raises
    ------
    InputError
        The filter's model does not integrate the IMU.
    """
    model = MODELS[parameters.model]
    if model.measures_imu:
        raise InputError(
            f"{parameters.model} takes the IMU as a measurement; its Q says nothing about the IMU's noise"
        )
    scale = 1.0 if parameters.nominal_interval is None else 1 / parameters.nominal_interval
    density = {
        s.name: math.sqrt(q * scale) for s, q in zip(model.states, parameters.process_noise, strict=True)
    }
    axes: dict[str, AxisNoise] = {}
    for axis, driven, bias in (
        ("ax", "vx", "accel_bias_x"),
        ("ay", "vy", "accel_bias_y"),
        ("gx", "roll", "gyro_bias_x"),
        ("gy", "pitch", "gyro_bias_y"),
        ("gz", "theta", "gyro_bias_z"),
    ):
        if driven in density:
            white, walk, none = (Interval(v, v, v) for v in (density[driven], density.get(bias, 0.0), 0.0))
            axes[axis] = AxisNoise(axis, AXES[axis], white, none, walk, none)
    return ImuNoise("tuned filter", rate, 0.0, axes)
