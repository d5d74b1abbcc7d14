"""The smoother of a car's filter in textbook form."""

import numpy as np

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.filters import tilted
from sigmaswarm.filters.filter_run import failure_at
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, whole_pass
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.filters.textbook.loop import smooth_steps
from sigmaswarm.geodesy import wrap_angle


def smooth_textbook(
    drive: Drive | PreparedDrive,
    parameters: FilterParameters,
    *,
    initial: InitialState | None = None,
    heading_first: bool = True,
) -> Estimate:
    """Smooth the textbook filter; parameters as in `run_textbook`. The estimate ends if the filter fails."""
    drive_pass = whole_pass(drive, initial)
    line = drive_pass.timeline
    car = TextbookCar(line, parameters, drive_pass.initial, heading_first=heading_first)
    found = smooth_steps(car, len(line.dt))
    sampled = np.flatnonzero(line.sampled[: len(found.mean) - 1]) + 1
    mean, covariance = found.mean[sampled], found.covariance[sampled]
    mean[:, THETA] = wrap_angle(mean[:, THETA])
    failure = failure_at(line, line.end[found.failed]) if found.failed >= 0 else None
    covariance = tilted.as_angles(mean, covariance) if car.model.tilts else covariance
    n = parameters.n_states
    start = InitialState(found.mean[0, :n], found.covariance[0, :n, :n], drive_pass.initial.time)
    return Estimate(line.imu_time[: len(sampled)], mean[:, :n], covariance[:, :n, :n], start, failure)
