"""Vehicle models: states, process f(state, dt, imu) and measurements h(state) in textbook form.

planar8 begins with the states of planar5, and tilted12 with those of planar8. Arrays: state (n,); imu (3,), which
contains ax, ay (m/s2) and the yaw rate (rad/s) in the body frame. `tilted` defines the model with roll and pitch.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters import tilted
from sigmaswarm.filters.names import FilterKind

MEASURED = {
    "velocity": "m2/s2",
    "lateral": "m2/s2",
    "standstill": "m2/s2",
    "odometer": "m2/s2",
    "heading": "rad2",
}
"""Measurements other than fixes, and the unit of their variance.

A filter uses the measurement NAME if its parameter NAME_noise is a number. NAME is also the option of ``tune --use``
and the event in `drives.events`; the kernels' row is R_NAME, and the macro in C is NAME_NOISE.
"""
NOISE_OF = {name: f"{name}_noise" for name in MEASURED}

THETA = 4  # index of the heading in the state of every model
ACCEL_BIAS = 5  # index of the accelerometer bias (forward), in models with this state
GYRO_BIAS = 7  # index of the gyro bias (z), in models with this state


def planar5(state: Array, dt: float, imu: Array) -> Array:
    """Propagate x, y, vx, vy, theta by Newton's equations in the plane, with the IMU as input (the paper's model).

    Further states do not change.
    """
    x, y, vx, vy, theta, *others = state
    ax, ay, yaw_rate = imu
    c, s = np.cos(theta), np.sin(theta)
    a_e, a_n = c * ax - s * ay, s * ax + c * ay
    return np.array(
        [
            x + vx * dt + a_e * dt**2 / 2,
            y + vy * dt + a_n * dt**2 / 2,
            vx + a_e * dt,
            vy + a_n * dt,
            theta + yaw_rate * dt,
            *others,
        ]
    )


def planar8(state: Array, dt: float, imu: Array) -> Array:
    """Propagate like planar5; first subtract constant biases of accelerometer (x, y) and gyro (z) from ``imu``."""
    return planar5(state, dt, imu - state[ACCEL_BIAS : GYRO_BIAS + 1])


def robot_localization(state: Array, dt: float, imu: Array) -> Array:
    """Propagate like the extended Kalman filter of ROS's robot_localization in ``two_d_mode``.

    State: x, y (m), vx, vy (m/s, body), yaw (rad), ax, ay (m/s2, body), yaw rate (rad/s). From the previous state, with
    A = vx d + ax d^2 / 2 and B = vy d + ay d^2 / 2, a step of d seconds computes

        x += cos(yaw) A - sin(yaw) B        y += sin(yaw) A + cos(yaw) B        yaw += d yaw rate
        vx += d ax                          vy += d ay                          P = J P J^T + d Q

    The model does not rotate the velocity with the body, so in a turn a fused ay becomes lateral speed. The
    measurements are states plus noise: the IMU measures the yaw rate, ax and ay; the wheels measure vx; a twist
    measures vy = 0; a fix measures x and y; two antennas measure yaw. A fix, gz or ax with nu^T S^-1 nu >= threshold^2
    is rejected. Source: https://github.com/cra-ros-pkg/robot_localization, branch rolling-devel.
    """
    x, y, vx, vy, theta, ax, ay, yaw_rate = state
    a, b = vx * dt + ax * dt**2 / 2, vy * dt + ay * dt**2 / 2
    c, s = np.cos(theta), np.sin(theta)
    moved = [x + c * a - s * b, y + s * a + c * b, vx + ax * dt, vy + ay * dt, theta + yaw_rate * dt]
    return np.array([*moved, ax, ay, yaw_rate])


def gps_position(lever: Sequence[float] = (0.0, 0.0), latency: float = 0.0) -> Callable[[Array], Array]:
    """Predict a fix: the position, ``latency`` s ago, of an antenna ``lever`` m forward and left of the IMU."""

    def h(state: Array) -> Array:
        c, s = np.cos(state[THETA]), np.sin(state[THETA])
        arm = np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]])
        return state[:2] - latency * state[2:4] + arm

    return h


def velocity(state: Array) -> Array:
    """Predict the velocity over ground, m/s east and north."""
    return state[2:4].copy()


def lateral_arm(state: Array, rear_axle: float, tire_slip: float) -> float:
    """Return how far (m) the IMU is in front of the point without lateral velocity: rear_axle - tire_slip v^2.

    The rear tires slip by an angle of ``tire_slip`` (s2/m) times the lateral acceleration, v yaw_rate. The lateral
    velocity at the rear axle is therefore -tire_slip v^2 yaw_rate, where v is the predicted speed.
    """
    return rear_axle - tire_slip * float(state[2] * state[2] + state[3] * state[3])


def lateral_velocity(yaw_rate: float, rear_axle: float) -> Callable[[Array], Array]:
    """Predict the velocity to the left (m/s) at a point ``rear_axle`` m behind the IMU; it is 0 without tire slip."""

    def h(state: Array) -> Array:
        bias = state[GYRO_BIAS] if len(state) > GYRO_BIAS else 0.0
        left = np.cos(state[THETA]) * state[3] - np.sin(state[THETA]) * state[2]
        return np.array([left - rear_axle * (yaw_rate - bias)])

    return h


def wheel_speed(ax: float, delay: float) -> Callable[[Array], Array]:
    """Predict the forward velocity (m/s) that the wheels measured ``delay`` s ago, from the acceleration ax, m/s2.

    The forward velocity is the same at the IMU and at the rear axle behind it.
    """

    def h(state: Array) -> Array:
        bias = state[ACCEL_BIAS] if len(state) > GYRO_BIAS else 0.0  # planar5 has the fix error at this index
        forward = np.cos(state[THETA]) * state[2] + np.sin(state[THETA]) * state[3]
        return np.array([forward - delay * (ax - bias)])

    return h


def heading(near: float) -> Callable[[Array], Array]:
    """Predict the heading (rad) of two antennas or a compass; planar models ignore ``near``."""
    del near
    return lambda state: state[THETA : THETA + 1].copy()


VARIANCE = (1e-5, 10.0)  # bounds of all variances in the paper; Q is per nominal IMU step
SMALL_VARIANCE = (1e-12, 10.0)  # bounds of Q for position and velocity
HEADING_VARIANCE = (1e-10, 1e-1)
"""Bounds of Q per second for the heading. The upper bound is a drift of 0.3 rad in 1 s, more than that of any gyro.

With a larger Q, a filter would estimate the heading from the fixes alone. Such a filter may have the highest
likelihood if the receiver smooths its fixes.
"""
CITY_VARIANCE = (1e-5, 1e3)  # bounds of R: between tall buildings, fixes have errors of tens of meters
BIAS_WALK = (1e-16, 1e-4)  # bounds of Q for the random walks of the biases


@dataclass(frozen=True)
class Sensor:
    """Unit of a sensor's bias, and the bounds of the bias's initial standard deviation."""

    unit: str
    start_std: tuple[float, float]


SENSORS = {"accel": Sensor("m/s2", (1e-3, 1.0)), "gyro": Sensor("rad/s", (1e-5, 0.1))}
"""Sensors in the order of `FilterParameters.bias_std`."""


@dataclass(frozen=True)
class State:
    name: str
    unit: str
    variance: tuple[float, float]  # bounds of the process noise, unit squared per nominal IMU step
    shared: str  # name of the search parameter; east and north share this name if their noise is the same
    bias_of: str | None = None  # the sensor in SENSORS with this bias, which starts at 0
    per_second: bool = False  # the bounds are per second
    start_std: float = 0.0  # initial std of a state that is neither a bias nor from the alignment

    @property
    def variance_unit(self) -> str:
        """The unit squared: m2/s4 for m/s2."""
        return re.sub(r"([a-z]+)(\d*)", lambda part: f"{part[1]}{2 * int(part[2] or 1)}", self.unit)


@dataclass(frozen=True)
class CarModel:
    """A model for cars: process and measurements, which do not depend on further states.

    ``filter_types`` are the compiled filter types, beginning with the default. If ``measures_imu`` is True, as for
    robot-localization, acceleration and yaw rate are states that the IMU measures with `FilterParameters.imu_noise`,
    and the velocity is in the body frame. Such a model supports neither smoothing nor live filters.
    """

    states: tuple[State, ...]
    process: Callable[[Array, float, Array], Array]  # f(state, dt, imu) -> state
    fix_variance: tuple[float, float]  # bounds of R per axis, m2
    imu: tuple[str, ...] = ("ax", "ay", "gz")  # axes that the process reads
    isotropic: bool = True  # east and north share their noise in the search
    position: Callable[[Sequence[float], float], Any] = gps_position
    lateral: Callable[[float, float], Any] = lateral_velocity
    odometer: Callable[[float, float], Any] = wheel_speed
    heading: Callable[[float], Any] = heading
    tilts: bool = False  # with roll and pitch: the covariance is that of an error, see `tilted`
    measures_imu: bool = False
    options: tuple[str, ...] | None = None  # supported measurements and features; None: all
    fix_error: bool = False  # the last two states are the correlated fix error: see `kernels`
    filter_types: tuple[FilterKind, ...] = ("ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf")

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(state.name for state in self.states)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Sensors with estimated biases, in the order of `SENSORS`."""
        return tuple(sensor for sensor in SENSORS if any(s.bias_of == sensor for s in self.states))

    @cached_property
    def gyro_axes(self) -> dict[str, int]:
        """Gyro axes with estimated biases (gx, gy, gz), and the indices of the biases in the state."""
        names = enumerate(self.states)
        return {f"g{state.name[-1]}": i for i, state in names if state.bias_of == "gyro"}

    @cached_property
    def gyro_indices(self) -> tuple[int, ...]:
        """State indices of the gyro biases about the x, y and z axes; -1 for an axis without an estimated bias."""
        return tuple(self.gyro_axes.get(f"g{axis}", -1) for axis in "xyz")


def _plane(variance: tuple[float, float]) -> tuple[State, ...]:
    return (
        State("x", "m", variance, "xy"),
        State("y", "m", variance, "xy"),
        State("vx", "m/s", variance, "vxy"),
        State("vy", "m/s", variance, "vxy"),
        State("theta", "rad", variance, "theta"),
    )


_BIASES = tuple(
    State(name, SENSORS[sensor].unit, BIAS_WALK, name, sensor)
    for name, sensor in (("accel_bias_x", "accel"), ("accel_bias_y", "accel"), ("gyro_bias_z", "gyro"))
)


def _per_second(state: State, variance: tuple[float, float], shared: str | None = None) -> State:
    return replace(state, variance=variance, per_second=True, shared=shared or state.shared)


_X, _Y, _VX, _VY, _THETA = _plane(SMALL_VARIANCE)
_FORWARD, _LEFT, _YAW = _BIASES
_HEADING = _per_second(_THETA, HEADING_VARIANCE)
_TILT = (1e-10, 1e-2)
_TILT_START = np.radians(3.0)  # due to slopes of roads; not tuned, since few drives mean few starts
_WALKS = {"accel": (1e-10, 1e-1), "gyro": (1e-14, 1e-4)}
_TILTED = (
    _X,
    _Y,
    *(_per_second(state, (1e-5, 1e2)) for state in (_VX, _VY)),
    _HEADING,
    *(_per_second(state, _WALKS["accel"], "accel_bias") for state in (_FORWARD, _LEFT)),
    _per_second(_YAW, _WALKS["gyro"]),
    State("roll", "rad", _TILT, "tilt", per_second=True, start_std=_TILT_START),
    State("pitch", "rad", _TILT, "tilt", per_second=True, start_std=_TILT_START),
    State("gyro_bias_x", "rad/s", _WALKS["gyro"], "gyro_bias_xy", "gyro", per_second=True),
    State("gyro_bias_y", "rad/s", _WALKS["gyro"], "gyro_bias_xy", "gyro", per_second=True),
)
_ROBOT = (
    *(_per_second(state, (1e-8, 10.0)) for state in (_X, _Y)),
    *(_per_second(state, (1e-6, 1e2), state.name) for state in (_VX, _VY)),
    _HEADING,
    State("ax", "m/s2", (1e-6, 1e3), "ax", per_second=True, start_std=1.0),
    State("ay", "m/s2", (1e-6, 1e3), "ay", per_second=True, start_std=1.0),
    State("yaw_rate", "rad/s", (1e-6, 1e2), "yaw_rate", per_second=True, start_std=0.316),
)

MODELS: dict[str, CarModel] = {
    "planar5": CarModel(_plane(VARIANCE), planar5, VARIANCE, isotropic=False),
    "planar8": CarModel((_X, _Y, _VX, _VY, _HEADING, *_BIASES), planar8, CITY_VARIANCE),
    "tilted12": CarModel(
        _TILTED,
        tilted.tilted12,
        CITY_VARIANCE,
        imu=tilted.AXES,
        position=tilted.antenna,
        lateral=tilted.rear_axle,
        odometer=tilted.wheels,
        heading=tilted.heading,
        tilts=True,
        filter_types=("ekf", "ukf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf"),
    ),
    "robot-localization": CarModel(
        _ROBOT,
        robot_localization,
        CITY_VARIANCE,
        measures_imu=True,
        options=("lateral", "odometer", "heading", "gate", "imu-gate", "accuracy"),
        filter_types=("ekf",),
    ),
}
"""Models by name. planar5 is the paper's model with the paper's bounds."""


def require_driven_by_imu(model: str, use: str) -> None:
    """Raise `InputError` if a model treats IMU samples as measurements. ``use`` is the name of the unsupported use."""
    if MODELS[model].measures_imu:
        raise InputError(f"{use} does not support {model}; use planar8 or tilted12")
