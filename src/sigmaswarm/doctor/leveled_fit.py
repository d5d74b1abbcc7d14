"""Estimate the delay of the fixes with an IMU of six axes, whose gyro measures the changes of tilt.

`acceleration_fit` explains slopes by a constant per window, so its windows are short. Since the gyro measures the tilt
here, the windows are twice as long. They contain larger changes of speed, which determine the delay more accurately.
"""

import math

import numpy as np

from sigmaswarm.doctor.acceleration_fit import SMALL_SAMPLE, gyro_heading, usable_windows
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.verdicts import DIAGONAL_TOLERANCE, MIN_VARIED
from sigmaswarm.doctor.windows import Complex, integral, regress, with_prior
from sigmaswarm.drives.checks import GRAVITY
from sigmaswarm.drives.drive import Drive

WINDOW = 20.0  # s, length of a window
# Smallest number of windows. With the four windows of a minute, the residuals hardly show the standard deviation: in
# two of 2,400 minutes without an offset, the result exceeded 4.5 standard deviations.
MIN_WINDOWS = 7
# Prior means and standard deviations, by index of the unknown: scale k, yaw of the IMU (rad), and coordinates of l (m)
PRIORS = {1: (1.0, DIAGONAL_TOLERANCE), 2: (0.0, 0.1), 7: (0.0, 0.5), 8: (0.0, 0.5)}
MAX_ROUNDS = 10  # largest number of iterations
MAX_STEP = 0.3  # s, largest change of the delay in one iteration
CONVERGED = 2e-3  # s; a smaller change ends the iterations


def leveled_delay(drive: Drive, course: Course, delay: float) -> tuple[float, float] | None:
    """Return the delay of the fixes and its standard deviation, s; None if the drive does not determine them.

    The acceleration, east + i north, is

        k e^(i theta) (ax + i ay) + e^(i theta) b - i g phi,   phi = integral of e^(i theta) (gx + i gy + c)

    with the tilt phi. An error l of the lever arm adds e^(i theta) l to the path. k, b, c and l are common to all
    windows. Each window has its own parabola, for its initial position, speed and tilt. The IMU must have the vehicle's
    axes.

    ``delay``: initial value, s.
    """
    imu, rows = drive.imu, usable_windows(drive.imu.time, course, WINDOW)
    if imu.gx is None or imu.gy is None or len(rows) < MIN_WINDOWS:
        return None
    force, rates = imu.ax + 1j * imu.ay, imu.gx - np.median(imu.gx) + 1j * (imu.gy - np.median(imu.gy))
    t = course.time[rows] - course.time[rows].mean(axis=1, keepdims=True)
    own = [(t / np.ptp(t)) ** k + 0j for k in range(3)]
    common = np.array([1.0, 0.0, 0.0])  # k, b and c; complex after the first round
    for _ in range(MAX_ROUNDS):
        at, heading = course.time - delay, np.exp(1j * gyro_heading(imu.time, course, imu.gz, delay))
        tilt, drift = (-1j * GRAVITY * integral(imu.time, heading * rate) for rate in (rates, 1.0 + 0j))
        once = [integral(imu.time, a) for a in (tilt, heading * force, heading, drift)]
        leaning, *moved = (np.interp(at, imu.time, integral(imu.time, v))[rows] for v in once)
        known, *speeds = (np.interp(at, imu.time, v)[rows] for v in once)
        speed = known + sum(k * v for k, v in zip(common, speeds, strict=True))
        paths: list[Complex] = [*moved, np.interp(at, imu.time, heading)[rows] + 0j]
        columns = [-speed, *(factor * path for path in paths for factor in (1.0, 1j))]
        fixes = course.position[rows] - complex(*drive.lever_arm) * paths[-1]
        fit = regress(fixes - leaning, columns, own, np.ones(t.shape), 4)
        solution, covariance = fit.solution, fit.covariance * (1 + SMALL_SAMPLE / len(rows))
        for k, (mean, std) in PRIORS.items():
            solution, covariance = with_prior(solution, covariance, k, mean, std)
        common = solution[1:7:2] + 1j * solution[2:8:2]
        step = float(np.clip(solution[0], -MAX_STEP, MAX_STEP))
        delay += step
        if abs(step) < CONVERGED:
            break
    else:
        return None
    varied = fit.unexplained(0) / math.sqrt(t.size)
    return (delay, math.sqrt(covariance[0, 0])) if varied > MIN_VARIED else None
