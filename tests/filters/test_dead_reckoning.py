"""Dead reckoning, compared with Newton's equations in a loop, and with truth for an exact IMU."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters.run import run_imu_only
from support import make_drive


def loop(drive: Drive, initial: InitialState) -> np.ndarray:
    """Integrate from sample to sample. Fixes split steps, and each part uses the heading at its start."""
    x, y, vx, vy, theta = initial.mean.tolist()
    now, states = initial.time, []
    fixes = [t for t in drive.gps.time if initial.time < t <= drive.imu.time[-1]]
    for k in range(len(drive.imu)):
        t_k = drive.imu.time[k]
        if t_k <= initial.time:
            continue
        for end in [*(t for t in fixes if now < t < t_k), t_k]:
            dt = end - now
            ae = math.cos(theta) * drive.imu.ax[k] - math.sin(theta) * drive.imu.ay[k]
            an = math.sin(theta) * drive.imu.ax[k] + math.cos(theta) * drive.imu.ay[k]
            x, y = x + vx * dt + ae * dt * dt / 2, y + vy * dt + an * dt * dt / 2
            vx, vy, theta = vx + ae * dt, vy + an * dt, theta + drive.imu.gz[k] * dt
            now = end
        states.append([x, y, vx, vy, math.atan2(math.sin(theta), math.cos(theta))])
    return np.array(states)


@pytest.mark.parametrize("seed", range(3))
def test_it_follows_newton_s_equations(seed: int):
    drive = make_drive(duration=15.0, jitter=0.3, seed=seed)
    estimate, expected = run_imu_only(drive), loop(drive, initial_state(drive))
    np.testing.assert_array_equal(estimate.time, drive.imu.time[drive.imu.time > initial_state(drive).time])
    np.testing.assert_allclose(estimate.mean[:, :4], expected[:, :4], atol=1e-8)
    np.testing.assert_allclose(np.exp(1j * estimate.mean[:, 4]), np.exp(1j * expected[:, 4]), atol=1e-9)
    assert np.all((estimate.mean[:, 4] > -np.pi) & (estimate.mean[:, 4] <= np.pi))


def test_with_an_exact_imu_and_a_true_start_it_follows_truth():
    drive = make_drive(duration=40.0, seed=2)
    t = drive.truth
    i = 500
    true = np.array([t.x[i], t.y[i], t.vx[i], t.vy[i], t.theta[i]])
    estimate = run_imu_only(drive, initial=InitialState(true, np.eye(5), float(t.time[i])))
    after = t.select(slice(i + 1, None))
    error = np.hypot(estimate.mean[:, 0] - after.x, estimate.mean[:, 1] - after.y)
    assert error.max() < 2.0  # over 300 m: each sample applies to one interval, whose middle is 5 ms away
    assert estimate.initial.time == t.time[i]


def test_fixes_after_the_start_have_no_effect():
    drive = make_drive(duration=15.0)
    start = initial_state(drive)
    moved = replace(drive, gps=replace(drive.gps, x=drive.gps.x + 100.0 * (drive.gps.time > start.time)))
    np.testing.assert_array_equal(run_imu_only(moved).mean, run_imu_only(drive).mean)
