"""Filters that nobody tuned. The paper says "default parameters" and gives none.

Three presets, planar5 UKFs, stand for what people do by hand:

``defaults``
    What people start with: Q = I, R = I, alpha 0.1, beta 2, kappa 0.
``datasheet``
    What a careful engineer writes: R from the receiver's stated accuracy, Q from the IMU's noise density.
    Where the drive states neither, R = 2.1^2 m2 (u-blox M8, 2.5 m CEP) and an MPU-6050's densities.
``paper``
    The paper's published optimum: alpha 0.03, beta 2.5, kappa 0.48, Q = 2 I, R = 0.1 I.

What a tuning has to beat is the data sheet's filter of the same model and parts: ``datasheet(drive, like=tuned)``.
"""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD, stated_std
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.parameters import FilterParameters

PresetName = Literal["defaults", "datasheet", "paper"]

DEFAULTS = FilterParameters(0.1, 2.0, 0.0, (1.0,) * 5, (1.0,) * 2)
PAPER = FilterParameters(0.03, 2.5, 0.48, (2.0,) * 5, (0.1,) * 2)

MPU6050_ACCEL_NOISE_DENSITY = 0.24 / 60
"""m/s2/sqrt(Hz), from 0.24 m/s/sqrt(h) (MPU-6050 datasheet: 400 ug/sqrt(Hz))."""
MPU6050_GYRO_NOISE_DENSITY = np.radians(0.3) / 60
"""rad/s/sqrt(Hz), from 0.3 deg/sqrt(h) (MPU-6050 datasheet: 0.005 deg/s/sqrt(Hz))."""


BIAS_WALKS = {"accel": 2 * 0.01**2 / 3600, "gyro": 2 * np.radians(200 / 3600) ** 2 / 3600}
"""Per second, (m/s2)2 and (rad/s)2: 0.01 m/s2 and 200 deg/h over an hour, as of an ICM-20602 (i2Nav's
awesome-gins-datasets); that an MPU-6050's bias wanders its data sheet does not say."""
BY_HAND = {
    "velocity_noise": 0.1**2,
    "lateral_noise": 0.2**2,
    "standstill_noise": 0.05**2,
    "odometer_noise": 0.1**2,
    "gate": 9.2,
    "accuracy_scale": 1.0,
    "robust_dof": 4.0,
}
"""What engineers write of what has no data sheet: m2/s2; the 99% gate; what the receiver states is right."""
HALF_A_WHEELBASE = 1.3
"""m from the rear axle to an IMU in the middle of a car."""
ACCURACY_FLOOR = 0.1**2
"""m2: R beside what the receiver states of each fix."""


def datasheet(drive: Drive, like: FilterParameters | None = None) -> FilterParameters:
    """What a careful engineer writes from the data sheets of a drive's sensors, without any tuning.

    The receiver's is `drives.sensors.stated_std`; the IMU's densities are ``accel_noise_density`` (m/s2/sqrt(Hz)) and
    ``gyro_noise_density`` (rad/s/sqrt(Hz)) of drive.toml. What has no data sheet is in `BY_HAND`.

    Parameters
    ----------
    drive : Drive
    like : FilterParameters, optional
        A filter of whose model, kind and parts it is to be: what a tuning has to beat. None: the paper's planar5 UKF.
    """
    plain = _planar(drive)
    if like is None or like == plain:
        return plain
    dt, gyro = drive.nominal_interval, plain.process_noise[THETA]
    beyond = MODELS[like.model].states[len(plain.process_noise) :]
    walks = (BIAS_WALKS[state.bias_of] * dt if state.bias_of else gyro for state in beyond)
    return replace(
        plain,
        model=like.model,
        kind=like.kind,
        process_noise=(*plain.process_noise, *walks),
        measurement_noise=plain.measurement_noise if like.accuracy_scale is None else (ACCURACY_FLOOR,) * 2,
        rear_axle=HALF_A_WHEELBASE if like.lateral_noise is not None else 0.0,
        **{name: value for name, value in BY_HAND.items() if getattr(like, name) is not None},
    )


def _planar(drive: Drive) -> FilterParameters:
    stated = drive.metadata
    std_x, std_y = stated_std(drive) or (UNSTATED_GPS_STD, UNSTATED_GPS_STD)
    accel = float(stated.get("accel_noise_density", MPU6050_ACCEL_NOISE_DENSITY))
    gyro = float(stated.get("gyro_noise_density", MPU6050_GYRO_NOISE_DENSITY))
    dt = drive.nominal_interval
    # White noise of density s over one step: s^2 dt in velocity and heading, s^2 dt^3 / 3 in position.
    q_position, q_velocity, q_heading = accel**2 * dt**3 / 3, accel**2 * dt, gyro**2 * dt
    return FilterParameters(
        DEFAULTS.alpha,
        DEFAULTS.beta,
        DEFAULTS.kappa,
        (q_position, q_position, q_velocity, q_velocity, q_heading),
        (std_x**2, std_y**2),
        nominal_interval=dt,
    )


def preset(name: PresetName, drive: Drive) -> FilterParameters:
    """The manual parameters of that name for a drive."""
    if name == "datasheet":
        return datasheet(drive)
    fixed = {"defaults": DEFAULTS, "paper": PAPER}
    if name not in fixed:
        raise InputError(f"no preset is called {name!r}; choose one of {', '.join(get_args(PresetName))}")
    return fixed[name]
