"""Textbook filters for cars, with which tests compare `compiled/run.py`."""

from collections.abc import Set
from dataclasses import replace

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.events import FIX, HEADING, LATERAL, ODOMETER, STANDSTILL, VELOCITY, events_of
from sigmaswarm.drives.timeline import FIX_THETA, FIX_VAR_THETA, Timeline
from sigmaswarm.filters.constants import (
    GAP_TILT_STD,
    HEADING_GATE,
    MOST_REJECTED,
    SLIP_GATE,
    STANDSTILL_RATE_NOISE,
    gap_covariance,
    process_noise_per_step,
)
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.models import THETA, CarModel, lateral_arm, require_driven_by_imu, velocity
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.starts import measured_by, require_accuracy, require_axes, require_odometer, start_of
from sigmaswarm.filters.textbook import ExtendedKalmanFilter, SigmaPoints, UnscentedKalmanFilter
from sigmaswarm.filters.textbook.adaptive import FuzzyNoise, SageHusa, StrongTracking, StudentT
from sigmaswarm.filters.textbook.kalman import GaussianFilter, Prediction
from sigmaswarm.filters.textbook.manifold import ErrorStateKalmanFilter, ManifoldUnscentedKalmanFilter
from sigmaswarm.filters.tilted import STEP_FIRST
from sigmaswarm.geodesy import wrap_angle


class Car:
    """Filter on a drive's timeline, in textbook form; the exported script for FilterPy contains this class.

    ``filter`` has the interface of `GaussianFilter`; its ``mean`` and ``covariance`` may be set before a step.
    ``noise`` has the current diagonals of Q and R. For ``measured`` see `starts.measured_by`.
    """

    def __init__(
        self,
        timeline: Timeline,
        parameters: FilterParameters,
        model: CarModel,
        filter: GaussianFilter,
        measured: Set[str],
    ) -> None:
        p = parameters
        self.timeline, self.parameters, self.model, self.filter = timeline, p, model, filter
        # Q of the fix error is 0 in a step, since the error is propagated only at fixes
        self._fix_error_noise = np.zeros(len(filter.mean) - len(p.process_noise))
        q = process_noise_per_step(p, timeline.nominal_interval)
        r = np.array(p.measurement_noise)
        fuzzy = p.kind == "fuzzy-ukf"
        self.fuzzy = FuzzyNoise(q, r, p.forgetting, p.fuzzy_widths, p.fuzzy_gains) if fuzzy else None
        self.adaptive = SageHusa(q, r, p.forgetting)
        self.noise = self.fuzzy or self.adaptive
        self.tracking = StrongTracking(p.forgetting)
        self.robust = None if p.robust_dof is None else StudentT(p.robust_dof)
        if p.accuracy_scale is not None:
            require_accuracy(timeline)
        if p.odometer_noise is not None:
            require_odometer(timeline.drive)
        self._imu = timeline.imu(model.imu)
        self._tilts = [i for i, name in enumerate(model.names) if name in ("roll", "pitch")]
        self.flags, self._wheels = events_of(timeline, measured)
        self._wheels_of_step = np.cumsum(self.flags & ODOMETER != 0) - 1
        self._fix_of_step = np.cumsum(timeline.updates | timeline.hides) - 1
        self._rejected = 0
        self._since = 0.0

    def step(self, i: int) -> None:
        line, p = self.timeline, self.parameters
        imu, model = self._imu[i], self.model
        unseen = gap_covariance(len(self.filter.mean), line.dt[i], line.gap[i])
        for tilt in self._tilts:
            unseen[tilt, tilt] += GAP_TILT_STD**2 * line.gap[i] * line.dt[i]
        q = np.concatenate([self.noise.process_noise, self._fix_error_noise])
        self.filter.predict(line.dt[i], imu, np.diag(q) * line.q_scale[i] + unseen)
        self._since += line.q_scale[i]
        if self.flags[i] & FIX:
            fix = line.fixes[self._fix_of_step[i]]
            self._update_with_fix(fix[:2], fix[4:6], float(line.end[i]))
            if self.flags[i] & VELOCITY and p.velocity_noise is not None:
                self.filter.update(fix[2:4], p.velocity_noise * np.eye(2), velocity)
            if self.flags[i] & HEADING:
                self._update_with_heading(fix[FIX_THETA], fix[FIX_VAR_THETA], float(line.gz[i]))
        if self.flags[i] & LATERAL and p.lateral_noise is not None:
            arm = lateral_arm(self.filter.mean, p.rear_axle, p.tire_slip)
            lateral = model.lateral(float(line.gz[i]), arm)
            self.filter.update(np.zeros(1), np.array([[p.lateral_noise]]), lateral)
        if self.flags[i] & ODOMETER and p.odometer_noise is not None:
            speed, age, extra = self._wheels[self._wheels_of_step[i]]
            wheels = model.odometer(float(line.ax[i]), p.odometer_latency + age)
            noise = np.array([[p.odometer_noise + extra]])
            innovation = self.filter.measure(np.array([speed / p.odometer_scale]), noise, wheels)
            if innovation.nis <= SLIP_GATE:
                self.filter.correct(innovation)
        if self.flags[i] & STANDSTILL and p.standstill_noise is not None:
            self.filter.update(np.zeros(2), p.standstill_noise * np.eye(2), velocity)
            if biases := [*model.gyro_axes.values()]:
                shown = np.array([imu[model.imu.index(axis)] for axis in model.gyro_axes])
                noise = STANDSTILL_RATE_NOISE * np.eye(len(shown))
                self.filter.update(shown, noise, lambda state: state[biases])

    def _update_with_fix(self, fix: Array, stated: Array, time: float) -> None:
        times = self.fuzzy.times_r if self.fuzzy else 1.0
        noise = self.noise.measurement_noise + times * (self.parameters.accuracy_scale or 0.0) * stated
        if self.model.fix_error:
            self._age_fix_error(stated)
        innovation = self.filter.measure(fix, np.diag(noise))
        gate = self.parameters.gate
        if gate is None or innovation.nis <= gate or self._rejected >= MOST_REJECTED:
            self._rejected = 0
            if self.parameters.kind == "strong-tracking-ukf":
                innovation = self.tracking.inflate(self.filter, innovation)
            if self.robust:
                innovation = self.robust.weigh(self.filter, innovation, time)
            if self.fuzzy:
                innovation = self.fuzzy.weigh(innovation)
            elif self.parameters.kind == "adaptive-ukf":
                self.adaptive.adapt(innovation, self._since)
            self.filter.correct(innovation)
        else:
            self._rejected += 1
        self._since = 0.0

    def _update_with_heading(self, theta: float, stated: float, yaw_rate: float) -> None:
        """Update with a heading (rad) that is ``latency`` s old, and its stated variance (rad2).

        ``yaw_rate`` is in rad/s.

        S is increased if the NIS would exceed `HEADING_GATE`.
        """
        p, near = self.parameters, float(self.filter.mean[THETA])
        z = near + wrap_angle(theta + p.latency * yaw_rate - near)
        noise = np.array([[(p.heading_noise or 0.0) + stated]])
        innovation = self.filter.measure(np.array([z]), noise, self.model.heading(near))
        least = innovation.nu @ innovation.nu / HEADING_GATE
        self.filter.correct(replace(innovation, variance=np.maximum(innovation.variance, least)))

    def _age_fix_error(self, stated: Array) -> None:
        """Propagate the correlated error from the previous fix to this fix.

        ``stated`` contains the variances that the receiver states for this fix, (2,) m2; 0 if it states none.
        """
        raise NotImplementedError


class TextbookCar(Car):
    """Textbook filter on a drive's timeline. For ``heading_first`` see `run_textbook`."""

    def __init__(
        self,
        timeline: Timeline,
        parameters: FilterParameters,
        initial: InitialState,
        *,
        heading_first: bool = True,
        redraw_sigma_points: bool = True,
    ) -> None:
        p = parameters
        require_driven_by_imu(p.model, "run_textbook")
        mean, covariance = start_of(initial, p)
        model = FILTERS[p.kernel]
        require_axes(timeline.drive, p.model)
        first = STEP_FIRST if model.tilts else (THETA,)
        points = SigmaPoints(p.alpha, p.beta, p.kappa, first=first if heading_first else ())
        given = model.process, model.position(timeline.lever.tolist(), p.latency), mean, covariance
        if p.kind == "ekf":
            filter = (ErrorStateKalmanFilter if model.tilts else ExtendedKalmanFilter)(*given)
        elif model.tilts:
            filter = ManifoldUnscentedKalmanFilter(*given, points)
        else:
            redraws = redraw_sigma_points
            filter = UnscentedKalmanFilter(*given, points, redraw_sigma_points=redraws, angles=(THETA,))
        super().__init__(timeline, p, model, filter, measured_by(p))

    def _age_fix_error(self, stated: Array) -> None:
        p, filter = self.parameters, self.filter
        phi = float(np.exp(-self._since * self.timeline.nominal_interval / p.fix_error_time))
        f, q = np.eye(len(filter.mean)), np.zeros_like(filter.covariance)
        f[-2:, -2:] *= phi  # the other states do not change
        variance = (p.fix_error or 0.0) * np.where(stated > 0, stated, p.fix_std**2)
        q[-2:, -2:] = np.diag(variance * (1.0 - phi * phi))  # Q of the error between two fixes
        filter.mean, filter.covariance = f @ filter.mean, f @ filter.covariance @ f.T + q
        filter.prediction = Prediction(filter.mean, filter.covariance, filter.prediction.cross @ f.T)
