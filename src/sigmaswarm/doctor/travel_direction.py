"""Direction of travel in the IMU's axes: yaw and pitch of the mounting, without the noise of the fixes' positions.

A car's velocity lies along its x axis e. In the axes of the IMU at the start of a window,

    velocity = C (speed e + rate x lever) = v0 + g t + integral of C force

C is the rotation integrated from the gyro, to first order in roll and pitch; the fixes give the speed. Each window has
unknown v0 and g (gravity, slope, bias). Components perpendicular to e have more weight, since the speed's errors do not
affect them.
"""

from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.acceleration_fit import gyro_drift, usable_windows
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.windows import Complex, Regression, integral, regress, smoothed
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Imu

WINDOW, DEGREE = 20.0, 2  # s, duration of a window; degree of its polynomial in time
NOISE_RATIO = 4.0  # ratio of the velocity's noise along the direction of travel to that across it
ROUNDS = 2  # number of further fits; each uses the speed that the previous fit computes with the IMU
MIN_STRAIGHTNESS = 0.5  # smallest assumed ratio of mean velocity to speed; sharp turns lower this ratio


def direction_of_travel(imu: Imu, course: Course, delay: float) -> tuple[Array, Array] | None:
    """Return the leftward and upward slopes (2,) of the direction of travel, and their standard deviations.

    The IMU's axes must nearly agree with the vehicle's. ``delay`` is the delay of the fixes, s. Return None if no
    window is usable.
    """
    rows = usable_windows(imu.time, course, WINDOW)
    if not len(rows) or imu.gx is None or imu.gy is None or imu.az is None:
        return None
    time, at = imu.time, (course.time - delay)[rows]
    rate = imu.gz + gyro_drift(time, course, imu.gz, delay)
    heading = np.exp(1j * integral(time, rate))
    force: Complex = heading * (imu.ax + 1j * imu.ay)
    tilt = integral(time, heading * (imu.gx - imu.gx.mean() + 1j * (imu.gy - imu.gy.mean())))

    def since(values: Complex | Array) -> Complex:
        found: Any = np.interp(at, time, values)
        return found - found[:, :1]

    start, leaned = np.interp(at[:, :1], time, heading), np.interp(at[:, :1], time, tilt)
    turned = np.interp(at, time, heading) / start
    lean, gained = since(tilt) / start, since(integral(time, force))
    level = (gained - 1j * GRAVITY * (since(integral(time, tilt)) - leaned * (at - at[:, :1]))) / start
    up = since(integral(time, imu.az - np.median(imu.az) + np.imag(np.conj(tilt) * force)))
    up = up.real - np.imag(np.conj(leaned) * gained)
    # In turns the mean velocity is less than the speed.
    straight = np.abs(smoothed(time, heading, course.time - delay, course.span))
    speed = (np.abs(course.velocity) / np.maximum(straight, MIN_STRAIGHTNESS))[rows]
    back, zero = np.conj(turned), np.zeros(at.shape)

    def stack(across: Complex, up: Array) -> Complex:
        """Stack the forward, left and up components, (w, 3n); forward is the direction of travel."""
        return np.hstack([across.real, across.imag, up]) + 0j

    powers = np.linspace(-1, 1, at.shape[1]) ** np.arange(DEGREE + 1)[:, None]
    own = [stack(back * factor * power, zero) for power in powers for factor in (1, 1j)]
    own += [stack(0j * back, zero + power) for power in powers]
    yaw_rate, pitch_rate = (np.interp(at, time, v) for v in (rate, imu.gy))
    weight = np.hstack([zero + 1 / NOISE_RATIO, zero + 1, zero + 1])

    def fit(own_speed: Array) -> Regression:
        y = stack(back * level - speed, up - own_speed * np.imag(np.conj(lean) * turned))
        columns = [
            stack(1j * own_speed, zero),
            stack(0j * back, own_speed),
            stack(1j * yaw_rate, -pitch_rate),
        ]
        return regress(y, columns, own, weight, 4)

    found = fit(speed)
    for _ in range(ROUNDS):
        # Noise in a column would reduce its coefficient; the speed computed with the IMU has little noise.
        found = fit(speed + found.residual[:, : at.shape[1]].real)
    return found.solution[:2], np.sqrt(np.diag(found.covariance)[:2])
