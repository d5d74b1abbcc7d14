"""Tune a UKF with PySwarms and FilterPy, as in a short script.

    python benchmarks/rival_pyswarms.py --seconds 5 --generations 2

The parameters, their bounds, the coefficients of the swarm and the cost are those of `sigmaswarm tune`. The drive, its
timeline and the initial state come from sigmaswarm, so both programs have the same work.
"""

import argparse
import math

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from pyswarms.single import GlobalBestPSO

from sigmaswarm import initial_state, simulate
from sigmaswarm.drives.prepared import prepare_drive

# alpha, beta, kappa, then log10 of the variances: five of Q per IMU step, two of R.
LOWEST = np.array([1e-3, 0.0, 0.0, *[-5.0] * 7])
HIGHEST = np.array([1.0, 3.0, 5.0, *[1.0] * 7])


def process(s, dt, u):
    """Propagate by Newton's equations in the plane, with floats, since NumPy is slow for single numbers."""
    x, y, vx, vy, theta = s
    ax, ay, yaw_rate = u
    sin, cos = math.sin(theta), math.cos(theta)
    east, north = cos * ax - sin * ay, sin * ax + cos * ay
    h = 0.5 * dt * dt
    return np.array(
        [
            x + vx * dt + east * h,
            y + vy * dt + north * h,
            vx + east * dt,
            vy + north * dt,
            theta + yaw_rate * dt,
        ]
    )


def position(s):
    return s[:2]


def make_filter(point, initial):
    alpha, beta, kappa = (float(value) for value in point[:3])
    points = MerweScaledSigmaPoints(5, alpha=alpha, beta=beta, kappa=kappa)
    ukf = UnscentedKalmanFilter(5, 2, dt=1.0, hx=position, fx=process, points=points)
    ukf.x, ukf.P = initial.mean.copy(), initial.covariance.copy()
    ukf.R = np.diag(10.0 ** point[8:])
    return ukf


class Course:
    """The first part of a drive as arrays, with ``n_samples`` IMU samples."""

    def __init__(self, drive, seconds=math.inf):
        self.initial = initial_state(drive)
        line = prepare_drive(drive, self.initial).timeline()
        end = int(np.searchsorted(np.cumsum(line.dt), seconds + 1e-6))
        self.dt, self.q_scale = line.dt[:end], line.q_scale[:end]
        self.imu = np.column_stack([line.ax, line.ay, line.gz])[:end]
        self.updates, self.sampled, self.fixes = line.updates[:end], line.sampled[:end], line.fixes[:, :2]
        self.n_samples = int(self.sampled.sum())
        self.share = self.n_samples / len(line.imu_time)
        time = line.imu_time[: self.n_samples]
        self.truth = np.column_stack(
            [np.interp(time, drive.truth.time, c) for c in (drive.truth.x, drive.truth.y)]
        )

    def rmse(self, point):
        """Return the position RMSE (m) of the filter at a search point; inf if the filter fails."""
        ukf = make_filter(point, self.initial)
        q = np.diag(10.0 ** point[3:8])
        fixes, track = iter(self.fixes), []
        try:
            for dt, u, scale, updates, sampled in zip(
                self.dt, self.imu, self.q_scale, self.updates, self.sampled, strict=True
            ):
                ukf.Q = q * scale
                ukf.predict(dt=dt, u=u)
                if updates:
                    ukf.update(next(fixes))
                if sampled:
                    track.append(ukf.x[:2])
        except np.linalg.LinAlgError:
            return math.inf
        return math.sqrt(np.mean(np.sum((np.array(track) - self.truth) ** 2, axis=1)))


def tune(course, *, particles=30, generations=50, seed=0):
    """Return the lowest cost and its search point."""
    np.random.seed(seed)  # noqa: NPY002 (PySwarms draws from the global generator)
    swarm = GlobalBestPSO(
        n_particles=particles,
        dimensions=len(LOWEST),
        options={"w": 0.7298, "c1": 1.5, "c2": 1.5},
        bounds=(LOWEST, HIGHEST),
    )
    return swarm.optimize(
        lambda points: np.array([course.rmse(p) for p in points]), generations, verbose=False
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--seconds",
        type=float,
        default=math.inf,
        help="length of the used part of the drive; by default the whole drive",
    )
    parser.add_argument("--generations", type=int, default=50)
    options = parser.parse_args()
    course = Course(simulate("urban", duration=600.0, seed=1), options.seconds)
    cost, point = tune(course, generations=options.generations)
    print(
        f"position RMSE {cost:.3f} m over {course.n_samples} IMU samples with {np.round(point, 3).tolist()}"
    )


if __name__ == "__main__":
    main()
