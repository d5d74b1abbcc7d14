"""Filters without tuning: the baseline, with which a tuned filter is compared, and three presets of a planar5 UKF.

The paper mentions "default parameters" but does not state their values.

``defaults``
    A common first choice: Q = I, R = I, alpha 0.1, beta 2, kappa 0.
``datasheet``
    Values from data sheets: R from the receiver's stated accuracy, Q from the IMU's noise density. If the drive does
    not state these values, R = 2.1^2 m2 (u-blox M8, 2.5 m CEP), and Q is that of an MPU-6050.
``paper``
    The paper's published optimum: alpha 0.03, beta 2.5, kappa 0.48, Q = 2 I, R = 0.1 I.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from sigmaswarm.datasets.dataset import Dataset
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD, receiver_std, stated_std
from sigmaswarm.drives.tables import headings_of
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.parameters import SEARCHED, FilterParameters, described
from sigmaswarm.filters.robot_yaml import (
    HEADING_NOISE,
    MIN_VARIANCE,
    NOT_FUSED,
    PROCESS_NOISE,
    SPEED_NOISE,
    YAML,
)

PresetName = Literal["defaults", "datasheet", "paper"]

DEFAULTS = FilterParameters(0.1, 2.0, 0.0, (1.0,) * 5, (1.0,) * 2)
PAPER = FilterParameters(0.03, 2.5, 0.48, (2.0,) * 5, (0.1,) * 2)

MPU6050_ACCEL_NOISE_DENSITY = 0.24 / 60  # m/s2/sqrt(Hz), 0.24 m/s/sqrt(h) (datasheet: 400 ug/sqrt(Hz))
MPU6050_GYRO_NOISE_DENSITY = np.radians(0.3) / 60
"""Noise density of the gyro, rad/s/sqrt(Hz), from 0.3 deg/sqrt(h) (MPU-6050 datasheet: 0.005 deg/s/sqrt(Hz))."""
BIAS_WALKS = {"accel": 2 * 0.01**2 / 3600, "gyro": 2 * np.radians(200 / 3600) ** 2 / 3600}
"""Growth of the biases' variances per second, (m/s2)2 and (rad/s)2.

For a Gauss-Markov bias with standard deviation s and time constant tau, the growth is 2 s^2 / tau. The values s = 0.01
m/s2 and 200 deg/h, and tau = 1 h, are those of an ICM-20602 (i2Nav's awesome-gins-datasets). The data sheet of the
MPU-6050 states no such values.
"""
TYPICAL_VALUES: dict[str, float] = described("typical")
"""Typical values of parameters that no data sheet states; noise variances in m2/s2 or rad2.

The gate accepts 99% of good fixes, and the stated accuracy is used unchanged.
"""
HALF_A_WHEELBASE = 1.3  # m from the rear axle to an IMU in the middle of a car
MODEL_NOISE = {"accel": 0.3, "gyro": 1e-3}
"""Noise density for unmodeled effects (slopes, vibration, scale factors, mounting), m/s2/sqrt(Hz) and rad/s/sqrt(Hz).

The square of this density is added to the squared density of the sensor. IMUs at standstill have densities of 0.001 to
0.04 m/s2/sqrt(Hz) and 4e-5 to 2e-4 rad/s/sqrt(Hz). On six drives, a filter with the densities of data sheets alone
drifted 1.3 to 60 times as far in 5 s as the tuned filter.
"""
MIN_SHOWN_STD = 0.01  # m, lower limit of a standard deviation computed from the truth; typical of RTK
ADDED_VARIANCE = 0.1**2  # m2, added to the stated variance of each fix


def baseline(
    drive: Drive, like: FilterParameters | None = None, shown_std: float | None = None
) -> FilterParameters:
    """Set a filter's parameters from the data sheets of a drive's sensors, without tuning.

    The receiver's accuracy is the stated accuracy or, if none is stated, ``shown_std`` or an estimate from the fixes.
    The IMU's noise densities are ``accel_noise_density`` (m/s2/sqrt(Hz)) and ``gyro_noise_density`` (rad/s/sqrt(Hz)) of
    drive.toml, or those of an MPU-6050, combined with `MODEL_NOISE`. The random walks of the biases are
    ``accel_bias_walk`` (m/s2/sqrt(s)) and ``gyro_bias_walk`` (rad/s/sqrt(s)) of drive.toml, which ``sigmaswarm noise``
    measures, or `BIAS_WALKS`. Parameters that no data sheet states have `TYPICAL_VALUES`.

    Parameters
    ----------
    drive : Drive
    like : FilterParameters, optional
        Filter whose model, type and options the result has. If None, the result is the preset ``datasheet``, a planar5
        UKF with values from data sheets only (without `MODEL_NOISE` and without an estimate from the fixes).
    shown_std : float, optional
        Standard deviation of the receiver's fixes, m per axis, from the truth or the scatter of the training drives'
        fixes.
    """
    if like is None:
        return _planar(drive, stated_std(drive) or (UNSTATED_GPS_STD, UNSTATED_GPS_STD))
    shown = None if shown_std is None else max(shown_std, MIN_SHOWN_STD)
    std = stated_std(drive) or (receiver_std(drive) if shown is None else (shown, shown))
    plain = _planar(drive, std, MODEL_NOISE)
    if MODELS[like.model].measures_imu:
        return _robot_localization(drive, like, plain)
    dt, gyro = drive.nominal_interval, plain.process_noise[THETA]
    beyond = MODELS[like.model].states[len(plain.process_noise) :]
    walks = (_bias_walk(drive, state.bias_of) * dt if state.bias_of else gyro for state in beyond)
    return replace(
        plain,
        model=like.model,
        kind=like.kind,
        process_noise=(*plain.process_noise, *walks),
        measurement_noise=plain.measurement_noise if like.accuracy_scale is None else (ADDED_VARIANCE,) * 2,
        rear_axle=HALF_A_WHEELBASE if like.lateral_noise is not None else 0.0,
        **{name: value for name, value in TYPICAL_VALUES.items() if getattr(like, name) is not None},
    )


def baseline_of(
    drive: Drive, model: ModelName, use: Collection[str], shown_std: float | None = None
) -> FilterParameters:
    """Return the baseline of a model's EKF with options of ``tune --use``."""
    used: dict[str, Any] = {
        name: value for name, value in TYPICAL_VALUES.items() if SEARCHED[name].option in use
    }
    noises = (1.0,) * len(MODELS[model].states), (1.0, 1.0)
    like = FilterParameters(0.1, 2.0, 0.0, *noises, model=model, kind="ekf", **used)
    return baseline(drive, like, shown_std)


def _bias_walk(drive: Drive, sensor: str) -> float:
    stated = drive.metadata.get(f"{sensor}_bias_walk")
    return BIAS_WALKS[sensor] if stated is None else float(stated) ** 2


def _robot_localization(drive: Drive, like: FilterParameters, plain: FilterParameters) -> FilterParameters:
    states = accuracy = None
    if like.accuracy_scale is not None:
        accuracy, states = 1.0, (ADDED_VARIANCE,) * 2
    return replace(
        plain,
        model=like.model,
        kind=like.kind,
        process_noise=tuple(drive.nominal_interval * q for q in PROCESS_NOISE),
        measurement_noise=states or plain.measurement_noise,
        accuracy_scale=accuracy,
        imu_noise=_stated_imu(drive, plain),
        lateral_noise=like.lateral_noise and SPEED_NOISE,
        odometer_noise=like.odometer_noise and SPEED_NOISE,
        heading_noise=like.heading_noise and HEADING_NOISE,
    )


def filter_for(given: FilterParameters | str | Path, dataset: Dataset) -> FilterParameters:
    """Load a filter; for an ekf.yaml, use the variances stated in the messages of the first drive's log."""
    if isinstance(given, FilterParameters):
        return given
    parameters = FilterParameters.load(given)
    if Path(given).suffix not in YAML:
        return parameters
    (stated,) = dataset.subset([0]).map(partial(_as_stated, p=parameters))
    return stated


def _as_stated(drive: Drive, p: FilterParameters) -> FilterParameters:
    """Return a robot_localization filter with the variances that are stated in the messages of a drive's log."""
    gyro, accel = _stated_imu(drive, p)[:2]
    stated = [gyro, *[accel] * (len(p.imu_noise) - 1)]
    imu = tuple(r if r == NOT_FUSED else variance for r, variance in zip(p.imu_noise, stated, strict=True))
    variances: dict[str, Any] = {"measurement_noise": baseline(drive).measurement_noise}
    if drive.gps.std is not None:
        variances = {"measurement_noise": (MIN_VARIANCE,) * 2, "accuracy_scale": 1.0}
    wheels = p.odometer_noise if drive.odometer is not None else None
    heading, (_, of_fixes) = p.heading_noise, headings_of(drive.gps)
    if not np.isfinite(of_fixes).any():
        heading = None
    elif (
        heading is not None and np.nanmedian(np.where(np.isfinite(of_fixes), of_fixes, np.nan)) > MIN_VARIANCE
    ):
        heading = MIN_VARIANCE
    return replace(p, imu_noise=imu, odometer_noise=wheels, heading_noise=heading, **variances)


def _stated_imu(drive: Drive, p: FilterParameters) -> tuple[float, ...]:
    """Return the variances of gz and ax that are stated in the log's messages, otherwise those of ``p``."""
    return tuple(map(float, drive.metadata.get("imu_stated_noise", p.imu_noise)))


def _planar(
    drive: Drive, std: tuple[float, float], more: Mapping[str, float] = MappingProxyType({})
) -> FilterParameters:
    """Return a planar5 UKF for fixes with ``std`` (east, north; m).

    ``more`` contains additional noise densities of the IMU.
    """
    stated, dt = drive.metadata, drive.nominal_interval
    accel = float(stated.get("accel_noise_density", MPU6050_ACCEL_NOISE_DENSITY)) ** 2
    gyro = float(stated.get("gyro_noise_density", MPU6050_GYRO_NOISE_DENSITY)) ** 2
    accel, gyro = accel + more.get("accel", 0.0) ** 2, gyro + more.get("gyro", 0.0) ** 2
    # White noise of density s over one step: s^2 dt in velocity and heading, s^2 dt^3 / 3 in position.
    q_position, q_velocity, q_heading = accel * dt**3 / 3, accel * dt, gyro * dt
    return replace(
        DEFAULTS,
        process_noise=(q_position, q_position, q_velocity, q_velocity, q_heading),
        measurement_noise=(std[0] ** 2, std[1] ** 2),
        nominal_interval=dt,
    )


def preset(name: PresetName, drive: Drive) -> FilterParameters:
    """Return the parameters of a preset for a drive."""
    if name == "datasheet":
        return baseline(drive)
    fixed = {"defaults": DEFAULTS, "paper": PAPER}
    if name not in fixed:
        raise InputError(f"there is no preset {name!r}; choose one of {', '.join(get_args(PresetName))}")
    return fixed[name]
