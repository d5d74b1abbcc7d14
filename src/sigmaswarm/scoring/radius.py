"""Radius within which a position error lies with a stated probability, and its coverage.

A filter averages the fixes. Where their errors are correlated, they do not average out, and a log does not show them:
the position keeps the variance of these errors, whatever the filter's covariance is. Per axis it is taken as

    sigma^2 = P + max(s^2 - w^2 - g s^2, 0)

with P the mean of the filter's variances of x and y, s the standard deviation of the fixes (`receiver_std`), and w the
white noise that they show (`white_noise`). A filter that has states for correlated errors has their variance g s^2 in
P; otherwise g = 0. Nothing is added for a receiver with white errors. A short training drive determines a covariance
from few independent errors. So the error over sigma has Student's t distribution with `DOF` degrees of freedom, and for
a probability q

    radius^2 = DOF ((1 - q)^(-2 / DOF) - 1) sigma^2

which is the quantile of 2 F(2, DOF). The estimates of the filter and its covariance remain as they are.
"""

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.sensors import receiver_std, white_noise
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate

DOF = 7.0
"""Degrees of freedom: chosen on the parts of the development drives that tunings did not see, seed 0."""
LEVELS = 0.95, 0.999
"""Probabilities of the radii that an evaluation reports."""
TRACKING = "tracking"
"""Key of the radii with all fixes."""
LOW = 0.85
"""Share of errors inside the 95% radius below which an evaluation warns."""


class RadiusRecord(BaseModel):
    """Radii of a filter's position on a drive, and how many errors they contain.

    ``n`` counts the errors, or without truth the estimates. ``radius_95_m`` and ``radius_999_m`` are medians.
    ``inside_95``, ``inside_999``: shares of the errors inside. ``sigma_ratio``: RMS sigma of the filter alone over
    the RMS error, per axis. Unknown without truth: None. ``lasting_m``: m per axis, RMS of the correlated errors.
    """

    n: int
    radius_95_m: float
    radius_999_m: float
    inside_95: float | None = None
    inside_999: float | None = None
    sigma_ratio: float | None = None
    lasting_m: float = 0.0


def position_radius(
    estimate: Estimate, drive: Drive, parameters: FilterParameters, level: float = 0.95
) -> NDArray[np.float64]:
    """Radius within which the true position lies with a stated probability, m, at each time of an estimate.

    Parameters
    ----------
    estimate : Estimate
        Of `run_filter` or `smooth`.
    drive : Drive
        The drive, whose fixes show how much of their error is white.
    parameters : FilterParameters
        The filter.
    level : float
        The probability, above 0 and below 1.

    Returns
    -------
    ndarray, shape (n,)

    Raises
    ------
    InputError
        If ``level`` is no probability, or the estimate has no covariance.
    """
    if not 0.0 < level < 1.0:
        raise InputError(f"level = {level:g}: must lie above 0 and below 1")
    if not estimate.covariance.size:
        raise InputError("the estimate has no covariance; use one of run_filter or smooth")
    variance = np.mean(np.diagonal(estimate.covariance[:, :2, :2], axis1=1, axis2=2), axis=1)
    return factor_of(level) * np.sqrt(variance + lasting_variance(drive, parameters, estimate.time))


def factor_of(level: float) -> float:
    """Radius of a probability over sigma per axis."""
    return math.sqrt(DOF * ((1.0 - level) ** (-2.0 / DOF) - 1.0))


def lasting_variance(drive: Drive, parameters: FilterParameters, time: Array) -> Array:
    """Variance per axis of the correlated error of the last fix before each time, (n,) m2, that a filter leaves out."""
    gps, typical = drive.gps, float(np.mean(np.square(receiver_std(drive))))
    white = white_noise(gps.x + 1j * gps.y) ** 2 / typical
    share = max(1.0 - white - (parameters.fix_error or 0.0), 0.0)
    if gps.std_x is None or gps.std_y is None:
        return np.full(len(time), share * typical)
    last = np.maximum(np.searchsorted(gps.time, time, side="right") - 1, 0)
    return share * (gps.std_x[last] ** 2 + gps.std_y[last] ** 2) / 2


def radius_record(variance: Array, lasting: Array, error: Array | None) -> RadiusRecord | None:
    """Summarize radii from a filter's variances and those of correlated errors, (n,) m2, and the errors, (n,) m.

    None where there are no values, or the filter failed.
    """
    total = variance + lasting
    if not len(total) or not np.isfinite(total).all():
        return None
    radii = [factor_of(level) * np.sqrt(total) for level in LEVELS]
    found = RadiusRecord(
        n=len(total),
        radius_95_m=float(np.median(radii[0])),
        radius_999_m=float(np.median(radii[1])),
        lasting_m=math.sqrt(float(np.mean(lasting))),
    )
    if error is None:
        return found
    inside = [float(np.mean(error <= radius)) for radius in radii]
    squared = float(np.mean(error**2))
    ratio = math.sqrt(2 * float(np.mean(variance)) / squared) if squared else None
    return found.model_copy(update={"inside_95": inside[0], "inside_999": inside[1], "sigma_ratio": ratio})
