"""Write the noise of an IMU in the formats and units of other packages, and as keys of drive.toml.

The model of a bias depends on the package: a Gauss-Markov process (KF-GINS) or a random walk (Kalibr, drive.toml).
"""

from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Literal

from sigmaswarm.errors import InputError
from sigmaswarm.exports.robot_localization import yaml_number
from sigmaswarm.filters.presets import BIAS_WALKS
from sigmaswarm.noise.records import (
    DEG_PER_HOUR,
    DEG_PER_SQRT_HOUR,
    HOUR,
    MGAL,
    MPS_PER_SQRT_HOUR,
    SENSORS,
    AxisNoise,
    Noise,
)

NoiseTarget = Literal["sigmaswarm", "kf-gins", "kalibr", "robot_localization", "matlab"]


def noise_texts(noise: Noise, target: NoiseTarget) -> dict[str, str]:
    """Return the noise of an IMU in the format of a package, as texts by file name.

    Parameters
    ----------
    noise : Noise
    target : {"sigmaswarm", "kf-gins", "kalibr", "robot_localization", "matlab"}
        sigmaswarm: keys of drive.toml, which `baseline` reads. kf-gins: ``imunoise`` of its YAML file. kalibr:
        imu.yaml, with VINS's keys. robot_localization: covariances of sensor_msgs/Imu. matlab: parameters of imuSensor.

    Raises
    ------
    InputError
        If the target is unknown, or if a sensor was not measured.
    """
    if target not in _WRITERS:
        raise InputError(f"there is no noise target {target!r}; choose one of {', '.join(_WRITERS)}")
    known = {a.axis for a in noise.axes}
    for sensor, (axes, _) in SENSORS.items():
        if not known & set(axes.split()):
            raise InputError(
                f"{noise.name}: no axis of the {sensor} was measured, but {target} needs one; choose another log"
            )
    file, written = _WRITERS[target]
    sign = "%" if target == "matlab" else "#"
    lines = [f"Noise of the IMU of {noise.name}, {noise.rate:.6g} Hz, by sigmaswarm", *noise.remarks]
    lines += [
        f"{axis} was not measured; the value is the RMS of the other axes"
        for axes, _ in SENSORS.values()
        for axis in axes.split()
        if axis not in known
    ]
    if not all(axis.bias(noise.longest)[0] for axis in noise.axes):
        lines.append("axes without a measured bias have the bias random walk of an ICM-20602")
    comments = [f"{sign} {' '.join(line.split())}" for line in lines]
    return {file: "\n".join([*comments, *written(noise), ""])}


_white = attrgetter("white.value")


def _walk_of(noise: Noise, sensor: str) -> Callable[[AxisNoise], float]:
    """Return a function of an axis: the random walk of its bias, unit/sqrt(s), or a typical value if not measured."""

    def walk(axis: AxisNoise) -> float:
        std, time = axis.bias(noise.longest)
        return std * (2 / time) ** 0.5 or BIAS_WALKS[sensor] ** 0.5

    return walk


def _listed(values: Sequence[float]) -> str:
    return f"[{', '.join(_number(v) for v in values)}]"


def _number(value: float) -> str:
    return yaml_number(float(f"{value:.6g}"))


def _drive(noise: Noise) -> list[str]:
    lines: list[str] = []
    for sensor, (_, unit) in SENSORS.items():
        walk = noise.mean(sensor, _walk_of(noise, sensor))
        lines += [
            f"{sensor}_noise_density = {_number(noise.mean(sensor, _white))}  # {unit}/sqrt(Hz)",
            f"{sensor}_bias_walk = {_number(walk)}  # {unit}/sqrt(s)",
        ]
    return lines


def _kf_gins(noise: Noise) -> list[str]:
    times = [axis.bias(noise.longest)[1] for axis in noise.axes]
    time = sum(times) / len(times)  # the file has one correlation time; the random walks do not change
    white, bias = (DEG_PER_SQRT_HOUR, MPS_PER_SQRT_HOUR), (DEG_PER_HOUR, MGAL)
    arw, vrw = (
        [scale * v for v in noise.of(s, _white)] for s, scale in zip(("gyro", "accel"), white, strict=True)
    )
    gyro, accel = (
        [scale * (time / 2) ** 0.5 * walk for walk in noise.of(s, _walk_of(noise, s))]
        for s, scale in zip(("gyro", "accel"), bias, strict=True)
    )
    return [
        "imunoise:  # axes forward, right, down; the signs of the axes do not matter",
        f"  arw: {_listed(arw)}  # deg/sqrt(h)",
        f"  vrw: {_listed(vrw)}  # m/s/sqrt(h)",
        f"  gbstd: {_listed(gyro)}  # deg/h",
        f"  abstd: {_listed(accel)}  # mGal",
        "  gsstd: [1000.0, 1000.0, 1000.0]  # ppm, from KF-GINS's example: a log at rest does not show scale factors",
        "  asstd: [1000.0, 1000.0, 1000.0]  # ppm, from the same example",
        f"  corrtime: {_number(time / HOUR)}  # h",
    ]


def _kalibr(noise: Noise) -> list[str]:
    white = {s: _number(noise.mean(s, _white)) for s in SENSORS}
    walk = {s: _number(noise.mean(s, _walk_of(noise, s))) for s in SENSORS}
    return [
        f"accelerometer_noise_density: {white['accel']}  # m/s^2/sqrt(Hz), continuous time",
        f"accelerometer_random_walk: {walk['accel']}  # m/s^3/sqrt(Hz)",
        f"gyroscope_noise_density: {white['gyro']}  # rad/s/sqrt(Hz)",
        f"gyroscope_random_walk: {walk['gyro']}  # rad/s^2/sqrt(Hz)",
        f"update_rate: {_number(noise.rate)}  # Hz",
        "rostopic: /imu/data  # set your topic",
        "# VINS-Mono and VINS-Fusion: the same densities under other names. These programs use them as the standard",
        f"# deviation of a sample; for the measured noise multiply by {noise.rate**0.5:.4g} (square root of the rate).",
        f"acc_n: {white['accel']}",
        f"acc_w: {walk['accel']}",
        f"gyr_n: {white['gyro']}",
        f"gyr_w: {walk['gyro']}",
    ]


def _robot_localization(noise: Noise) -> list[str]:
    lines = [f"# Covariances of sensor_msgs/Imu at {noise.rate:.6g} Hz: density squared times rate"]
    for sensor, name, unit in (
        ("gyro", "angular_velocity_covariance", "(rad/s)^2"),
        ("accel", "linear_acceleration_covariance", "(m/s^2)^2"),
    ):
        variances = [noise.rate * v**2 for v in noise.of(sensor, _white)]
        cells = [variances[i // 4] if i % 4 == 0 else 0.0 for i in range(9)]
        lines.append(f"{name}: {_listed(cells)}  # {unit}")
    return lines


def _matlab(noise: Noise) -> list[str]:
    lines = [f"imu = imuSensor('accel-gyro', 'SampleRate', {_number(noise.rate)});"]
    for sensor, name in (("accel", "Accelerometer"), ("gyro", "Gyroscope")):
        unit = SENSORS[sensor][1]
        white, flicker, walk = (
            _listed(noise.of(sensor, attrgetter(f"{part}.value")))
            for part in ("white", "instability", "walk")
        )
        lines += [
            f"imu.{name} = {sensor}params( ...  % two-sided densities: set NoiseType, if available, to double-sided",
            f"    'NoiseDensity', {white}, ...  % {unit}/sqrt(Hz)",
            f"    'BiasInstability', {flicker}, ...  % {unit}",
            f"    'RandomWalk', {walk});  % {unit}/sqrt(s)",
        ]
    return lines


_WRITERS: dict[NoiseTarget, tuple[str, Callable[[Noise], list[str]]]] = {
    "sigmaswarm": ("imu_noise.toml", _drive),
    "kf-gins": ("kf-gins.yaml", _kf_gins),
    "kalibr": ("imu.yaml", _kalibr),
    "robot_localization": ("imu_covariances.yaml", _robot_localization),
    "matlab": ("imu_noise.m", _matlab),
}
