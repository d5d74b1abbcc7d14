"""The filters for cars, put together from the textbook's parts: one step of it reads like the equations.

`compiled/run.py` does the same; tests hold the two together, one step at a time.
"""

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.models import MODELS, THETA, gps_position, gyro_bias, lateral_velocity, velocity
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import (
    FIX,
    LATERAL,
    MOST_REJECTED,
    STANDSTILL,
    STANDSTILL_RATE_NOISE,
    VELOCITY,
    converted,
    flags_of,
    gap_covariance,
    require_accuracy,
    start_of,
    switches,
)
from sigmaswarm.filters.textbook import ExtendedKalmanFilter, SigmaPoints, UnscentedKalmanFilter
from sigmaswarm.filters.textbook.adaptive import SageHusa, StrongTracking, StudentT
from sigmaswarm.filters.textbook.gaussian import Array, GaussianFilter


class TextbookCar:
    """A textbook filter on a drive's time line.

    Parameters
    ----------
    timeline : Timeline
    parameters : FilterParameters
    initial : InitialState
    heading_first, redraw_sigma_points : bool
        See `run_textbook`.

    Attributes
    ----------
    filter : GaussianFilter
        Its ``mean`` and ``covariance`` may be set before a step.
    noise : SageHusa
        The diagonals of Q and R that are in force.
    """

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
        self.timeline, self.parameters = timeline, p
        mean, covariance = start_of(initial, p)
        lever = (float(timeline.lever[0]), float(timeline.lever[1]))
        self.model = MODELS[p.model]
        f, h = self.model.process, gps_position(lever, p.latency)
        self.filter: GaussianFilter
        if p.kind == "ekf":
            self.filter = ExtendedKalmanFilter(f, h, mean, covariance)
        else:
            points = SigmaPoints(p.alpha, p.beta, p.kappa, first=(THETA,) if heading_first else ())
            self.filter = UnscentedKalmanFilter(
                f,
                h,
                mean,
                covariance,
                points,
                redraw_sigma_points=redraw_sigma_points,
                angles=(THETA,),
            )
        q = converted(p, timeline.nominal_interval)
        self.noise = SageHusa(q, np.array(p.measurement_noise), p.forgetting)
        self.tracking = StrongTracking(p.forgetting)
        self.robust = None if p.robust_dof is None else StudentT(p.robust_dof)
        if p.accuracy_scale is not None:
            require_accuracy(timeline)
        self._imu = np.column_stack([getattr(timeline, axis) for axis in self.model.imu])
        self.flags = flags_of(timeline, *switches(p))
        self._fix_of_step = np.cumsum(timeline.absorbs | timeline.hides) - 1
        self._rejected = 0
        self._since = 0.0

    def step(self, i: int) -> None:
        """Take the time line's step i: predict, then absorb what there is at its end."""
        line, p = self.timeline, self.parameters
        imu, yaw_rate = self._imu[i], float(line.gz[i])
        unseen = gap_covariance(len(self.filter.mean), line.dt[i], line.gap[i])
        self.filter.predict(line.dt[i], imu, np.diag(self.noise.process_noise) * line.q_scale[i] + unseen)
        self._since += line.q_scale[i]
        if self.flags[i] & FIX:
            fix = line.fixes[self._fix_of_step[i]]
            self._absorb_fix(fix[:2], fix[4:], float(line.end[i]))
            if self.flags[i] & VELOCITY and p.velocity_noise is not None:
                self.filter.update(fix[2:4], p.velocity_noise * np.eye(2), velocity)
        if self.flags[i] & LATERAL and p.lateral_noise is not None:
            self.filter.update(
                np.zeros(1), np.array([[p.lateral_noise]]), lateral_velocity(yaw_rate, p.rear_axle)
            )
        if self.flags[i] & STANDSTILL and p.standstill_noise is not None:
            self.filter.update(np.zeros(2), p.standstill_noise * np.eye(2), velocity)
            if self.model.gyro_bias is not None:
                self.filter.update(np.array([yaw_rate]), np.array([[STANDSTILL_RATE_NOISE]]), gyro_bias)

    def _absorb_fix(self, fix: Array, stated: Array, time: float) -> None:
        noise = self.noise.measurement_noise + (self.parameters.accuracy_scale or 0.0) * stated
        innovation = self.filter.measure(fix, np.diag(noise))
        gate = self.parameters.gate
        if gate is None or innovation.nis <= gate or self._rejected >= MOST_REJECTED:
            self._rejected = 0
            if self.parameters.kind == "strong-tracking-ukf":
                innovation = self.tracking.stretch(self.filter, innovation)
            if self.robust:
                innovation = self.robust.weigh(self.filter, innovation, time)
            if self.parameters.kind == "adaptive-ukf":
                self.noise.adapt(innovation, self._since)
            self.filter.absorb(innovation)
        else:
            self._rejected += 1
        self._since = 0.0
