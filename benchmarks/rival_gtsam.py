"""GTSAM's iSAM2 with preintegrated IMU factors, causal, from the same start as our filters.

Forster, Carlone, Dellaert, Scaramuzza, "On-Manifold Preintegration for Real-Time Visual-Inertial Odometry" (TRO 2017);
Kaess et al., "iSAM2" (IJRR 2012). There is a node (pose, velocity, biases) at every fix, and every 0.2 s if there is no
fix. `CombinedImuFactor` connects it to the previous node, `GPSFactorArm` to the fix (east and north; the height is
free). A factor of our own states that the car has no lateral and no vertical velocity at a point ``behind`` the IMU.
Between nodes, the causal estimate is scored: the latest node, propagated by the IMU samples.
"""

import math
import time
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from scipy.interpolate import CubicHermiteSpline

from sigmaswarm import Drive, InitialState
from sigmaswarm.arrays import Array

NODES = 0.2
"""Time (s) between nodes without fixes."""
SOON = 2e-3
"""Shortest time between two nodes, s."""
FREE = 1e3
"""Standard deviation (m) of the height of fixes, which the drives do not contain."""
TILT = math.radians(3.0)
"""Standard deviation (rad) of roll and pitch at the start, as in our filters with attitude."""


@dataclass(frozen=True)
class Noise:
    """Noise parameters of GTSAM: densities for the IMU, standard deviations for the others.

    Attributes
    ----------
    accel, gyro : float
        White noise, m/s2/sqrt(Hz) and rad/s/sqrt(Hz).
    accel_walk, gyro_walk : float
        Random walks of the biases, m/s3/sqrt(Hz) and rad/s2/sqrt(Hz).
    accel_bias, gyro_bias : float
        Standard deviations of the initial biases, m/s2 and rad/s.
    fix : float
        Standard deviation of the fixes, m per axis.
    slide : float
        Standard deviation of the lateral and vertical velocity, m/s.
    behind : float
        Distance from the IMU back to the point without lateral velocity, m.
    """

    accel: float = 0.05
    gyro: float = 5e-4
    accel_walk: float = 1e-3
    gyro_walk: float = 1e-5
    accel_bias: float = 0.1
    gyro_bias: float = 3e-3
    fix: float = 1.0
    slide: float = 0.1
    behind: float = 0.5


@dataclass(frozen=True)
class Run:
    """Estimates at the IMU samples after the start: time, s; x, y, m; heading, rad, not wrapped."""

    time: Array
    x: Array
    y: Array
    theta: Array


def _no_slide(pose: int, velocity: int, rate: Array, noise: Noise) -> gtsam.CustomFactor:
    """Return the non-holonomic constraint of a node: the velocity behind the IMU is along the body's x axis."""
    # The velocity there is v + w x (-l, 0, 0), in the body's axes.
    turning = np.array([-noise.behind * rate[2], noise.behind * rate[1]])

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        rotation = values.atPose3(pose).rotation().matrix()
        seen = rotation.T @ values.atVector(velocity)
        if jacobians is not None:
            x, y, z = seen
            by_pose = np.zeros((2, 6))
            # for R exp(xi), the velocity in the body's axes changes by v x xi
            by_pose[:, :3] = [[z, 0.0, -x], [-y, x, 0.0]]
            jacobians[0], jacobians[1] = by_pose, rotation.T[1:]
        return seen[1:] + turning

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(2, noise.slide), [pose, velocity], error)


def _parameters(noise: Noise) -> gtsam.PreintegrationCombinedParams:
    parameters = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    parameters.setAccelerometerCovariance(noise.accel**2 * np.eye(3))
    parameters.setGyroscopeCovariance(noise.gyro**2 * np.eye(3))
    parameters.setBiasAccCovariance(noise.accel_walk**2 * np.eye(3))
    parameters.setBiasOmegaCovariance(noise.gyro_walk**2 * np.eye(3))
    parameters.setIntegrationCovariance(1e-8 * np.eye(3))
    return parameters


class Smoother:
    """iSAM2 with its latest node."""

    def __init__(self, start: InitialState, noise: Noise) -> None:
        self.noise, self.count = noise, 0
        options = gtsam.ISAM2Params()
        options.setRelinearizeThreshold(0.01)
        options.setFactorization("QR")  # the Cholesky factorization fails in long outages
        self.isam = gtsam.ISAM2(options)
        x, y, vx, vy, theta = start.mean
        self.pose = gtsam.Pose3(gtsam.Rot3.Ypr(theta, 0.0, 0.0), np.array([x, y, 0.0]))
        self.velocity, self.bias = np.array([vx, vy, 0.0]), gtsam.imuBias.ConstantBias()
        spread = np.sqrt(np.diag(start.covariance))
        position = float(np.mean(spread[:2]))
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        deviations = [TILT, TILT, spread[4], position, position, 0.1]
        graph.add(gtsam.PriorFactorPose3(X(0), self.pose, _diagonal(deviations)))
        graph.add(gtsam.PriorFactorVector(V(0), self.velocity, _diagonal([*spread[2:4], 0.5])))
        biases = _diagonal([noise.accel_bias] * 3 + [noise.gyro_bias] * 3)
        graph.add(gtsam.PriorFactorConstantBias(B(0), self.bias, biases))
        values.insert(X(0), self.pose)
        values.insert(V(0), self.velocity)
        values.insert(B(0), self.bias)
        self.isam.update(graph, values)
        self.sums = gtsam.PreintegratedCombinedMeasurements(_parameters(noise), self.bias)

    def integrate(self, force: Array, rate: Array, dt: float) -> None:
        self.sums.integrateMeasurement(force, rate, dt)

    def predicted(self) -> gtsam.NavState:
        """Return the latest node, propagated by the later samples."""
        return self.sums.predict(gtsam.NavState(self.pose, self.velocity), self.bias)

    def node(self, rate: Array, fix: Array | None, arm: Array) -> None:
        """Add a node at the present time; ``fix``: x, y (m), if there is a fix."""
        i, j = self.count, self.count + 1
        here = self.predicted()
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if (
            self.sums.deltaTij() < SOON
        ):  # such a short step would have almost no noise: add the fix to the previous node
            j = i
        else:
            graph.add(gtsam.CombinedImuFactor(X(i), V(i), X(j), V(j), B(i), B(j), self.sums))
            graph.add(_no_slide(X(j), V(j), rate - self.bias.gyroscope(), self.noise))
            values.insert(X(j), here.pose())
            values.insert(V(j), here.velocity())
            values.insert(B(j), self.bias)
        if fix is not None:
            height = here.position()[2]
            deviations = _diagonal([self.noise.fix, self.noise.fix, FREE])
            graph.add(gtsam.GPSFactorArm(X(j), np.array([fix[0], fix[1], height]), arm, deviations))
        self.isam.update(graph, values)
        self.pose = self.isam.calculateEstimatePose3(X(j))
        self.velocity = self.isam.calculateEstimateVector(V(j))
        self.bias = self.isam.calculateEstimateConstantBias(B(j))
        if j > i:
            self.sums.resetIntegrationAndSetBias(self.bias)
        self.count = j


def run(drive: Drive, start: InitialState, noise: Noise, hidden: Array | None = None) -> Run:
    """Run over a drive from its start; ``hidden`` fixes, a mask (m,), are not used."""
    return _driven(drive, start, noise, hidden)[0]


@dataclass(frozen=True)
class Batch:
    """The smoothed run, the causal run before it, and the processor time (s) of the optimizer alone."""

    run: Run
    causal: Run
    spent: float


def run_batch(drive: Drive, start: InitialState, noise: Noise, hidden: Array | None = None) -> Batch:
    """Optimize all factors of a drive together by the Levenberg-Marquardt method, starting from iSAM2's last estimate.

    Between nodes, the position is a cubic polynomial of their positions and velocities, and the heading is linear.
    """
    causal, smoother, times = _driven(drive, start, noise, hidden)
    graph, first = smoother.isam.getFactorsUnsafe(), smoother.isam.calculateBestEstimate()
    begun = time.process_time()
    found = gtsam.LevenbergMarquardtOptimizer(graph, first).optimize()
    spent = time.process_time() - begun
    nodes = range(smoother.count + 1)
    poses, speeds = [found.atPose3(X(j)) for j in nodes], np.array([found.atVector(V(j)) for j in nodes])
    places = np.array([pose.translation() for pose in poses])
    theta = np.unwrap([pose.rotation().yaw() for pose in poses])
    track = CubicHermiteSpline(np.array(times), places[:, :2], speeds[:, :2])(causal.time)
    return Batch(
        Run(causal.time, track[:, 0], track[:, 1], np.interp(causal.time, times, theta)), causal, spent
    )


def _driven(
    drive: Drive, start: InitialState, noise: Noise, hidden: Array | None
) -> tuple[Run, "Smoother", list[float]]:
    """Return the causal estimates, the smoother at the end, and the times of its nodes."""
    imu, gps = drive.imu, drive.gps
    assert imu.az is not None and imu.gx is not None and imu.gy is not None
    force = np.column_stack([imu.ax, imu.ay, imu.az])
    rate = np.column_stack([imu.gx, imu.gy, imu.gz])
    arm = np.array(drive.metadata.get("gps_lever_arm_m", (0.0, 0.0, 0.0)), float)
    shown = gps.time > start.time
    if hidden is not None:
        shown &= ~hidden
    fixes = np.column_stack([gps.time, gps.x, gps.y])[shown]
    smoother, now, at_node, waiting = Smoother(start, noise), start.time, start.time, 0
    times = [start.time]
    first = int(np.searchsorted(imu.time, start.time, side="right"))
    rows = np.empty((len(imu.time) - first, 4))
    for k in range(first, len(imu.time)):
        # The sample is constant over its interval, also if a fix divides the interval.
        while waiting < len(fixes) and fixes[waiting, 0] <= imu.time[k]:
            if fixes[waiting, 0] > now:
                smoother.integrate(force[k], rate[k], fixes[waiting, 0] - now)
            now = at_node = fixes[waiting, 0]
            smoother.node(rate[k], fixes[waiting, 1:], arm)
            times += [now] * (smoother.count + 1 - len(times))
            waiting += 1
        if imu.time[k] > now:
            smoother.integrate(force[k], rate[k], imu.time[k] - now)
            now = imu.time[k]
        if now - at_node >= NODES + 0.05:  # a fix is missing
            smoother.node(rate[k], None, arm)
            times += [now] * (smoother.count + 1 - len(times))
            at_node = now
        state = smoother.predicted() if now > at_node else gtsam.NavState(smoother.pose, smoother.velocity)
        x, y, _ = state.position()
        rows[k - first] = now, x, y, state.attitude().yaw()
    return Run(rows[:, 0], rows[:, 1], rows[:, 2], np.unwrap(rows[:, 3])), smoother, times


def _diagonal(deviations: list[float]) -> gtsam.noiseModel.Diagonal:
    return gtsam.noiseModel.Diagonal.Sigmas(np.array(deviations, float))
