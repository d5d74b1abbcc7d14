"""The smoother of tilted12, compared with the maximum of the posterior of a whole drive, which is not recursive."""

from dataclasses import replace

import numpy as np

from filter_cases import equipped, parameters
from oracles.smoother import smooth_textbook
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.split import clip
from sigmaswarm.filters import tilted
from sigmaswarm.filters.constants import process_noise_per_step
from sigmaswarm.filters.starts import start_of
from sigmaswarm.filters.textbook.manifold import ErrorStateKalmanFilter
from support import timeline_of


def thinned():
    """Return six seconds after the start, with every tenth IMU sample, and a slope that the filter does not know."""
    drive = equipped()
    start = initial_state(drive)
    imu = drive.imu.select(slice(None, None, 10))
    assert imu.az is not None
    slope = np.radians(2.0)
    imu = replace(
        imu, ax=imu.ax - tilted.GRAVITY * np.sin(slope), az=tilted.GRAVITY * np.cos(slope) + 0 * imu.az
    )
    return clip(replace(drive, imu=imu), end=start.time + 6.0), start


def posterior(line, p, initial, rounds: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Return states (k + 1, 12) and their error covariances by Gauss-Newton iterations over all steps."""
    mean, covariance = start_of(initial, p)
    n, k, imu = tilted.N, len(line.dt), line.imu(tilted.AXES)
    antenna, noise = tilted.antenna(line.lever), np.diag(1 / np.array(p.measurement_noise))
    q = process_noise_per_step(p, line.nominal_interval)
    jacobian = ErrorStateKalmanFilter(tilted.tilted12, antenna, mean, covariance).sensitivity
    states = [mean]
    for i in range(k):
        states.append(tilted.tilted12(states[-1], line.dt[i], imu[i]))
    for _ in range(rounds):
        precision, right = np.zeros((n * (k + 1),) * 2), np.zeros(n * (k + 1))
        precision[:n, :n] = np.linalg.inv(covariance)
        right[:n] = precision[:n, :n] @ tilted.minus(mean, states[0])
        fixes = iter(line.fixes)
        for i in range(k):
            a, b = slice(n * i, n * i + n), slice(n * i + n, n * i + 2 * n)
            if line.dt[i] > 0:
                f = tilted.transition(states[i], line.dt[i], imu[i])
                off = tilted.minus(tilted.tilted12(states[i], line.dt[i], imu[i]), states[i + 1])
                w = np.diag(1 / (q * line.q_scale[i]))
                precision[a, a] += f.T @ w @ f
                precision[a, b] -= f.T @ w
                precision[b, a] -= w @ f
                precision[b, b] += w
                right[a] -= f.T @ w @ off
                right[b] += w @ off
            if line.updates[i]:
                h, z = jacobian(antenna, states[i + 1]), next(fixes)[:2]
                precision[b, b] += h.T @ noise @ h
                right[b] += h.T @ noise @ (z - antenna(states[i + 1]))
        whole = np.linalg.inv(precision)
        step = (whole @ right).reshape(-1, n)
        states = [tilted.plus(s, e) for s, e in zip(states, step, strict=True)]
    blocks = [whole[n * i : n * i + n, n * i : n * i + n] for i in range(k + 1)]
    return np.array(states), np.array(blocks)


def test_it_agrees_with_the_maximum_of_the_posterior():
    drive, start = thinned()
    p = parameters("tilted12")
    line = timeline_of(drive, start.time)
    assert line.fixes.shape[0] > 20
    assert np.all(line.dt > 0)
    ours = smooth_textbook(drive, p, initial=start)
    states, blocks = posterior(line, p, start)
    at = np.flatnonzero(line.sampled) + 1
    theirs = tilted.as_angles(states[at], blocks[at])
    for i, row in enumerate(at):
        std = np.sqrt(np.diag(blocks[row]))
        off = tilted.minus(ours.mean[i], states[row])
        assert np.all(np.abs(off) < 0.15 * std), (i, off / std)  # the remaining difference is of second order
        spread = np.sqrt(np.diag(theirs[i]))
        assert np.all(np.abs(ours.covariance[i] - theirs[i]) < 0.1 * np.outer(spread, spread)), i
    assert np.degrees(np.mean(np.abs(states[:, 9]))) > 0.5, "the slope is estimated"
