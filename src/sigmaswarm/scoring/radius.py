"""Compute the radius within which a position error lies with a stated probability, and its coverage.

A filter averages the fixes, but correlated errors do not average out, and a log does not show them. The variance of the
position error contains that of the correlated errors, which the filter's covariance may lack. The total variance per
axis is estimated as

    sigma^2 = P + max(s^2 - w^2 - g s^2, 0)

where P is the mean of the filter's variances of x and y, s is the standard deviation of the fixes (`receiver_std`), and
w is the standard deviation of their white noise (`white_noise`). If the filter has states for correlated errors, P
contains their variance g s^2; otherwise g = 0. For a receiver with white errors nothing is added. A short training
drive determines a covariance from few independent errors. Therefore error / sigma is modeled by Student's t
distribution with `DOF` degrees of freedom, and for a probability q

    radius^2 = DOF ((1 - q)^(-2 / DOF) - 1) sigma^2

which is the quantile of 2 F(2, DOF). The filter's estimates and covariances do not change.
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
"""Degrees of freedom of Student's t for error / sigma, chosen on the parts of the development drives that tunings with
seed 0 did not use."""
LEVELS = 0.95, 0.999
"""Probabilities of the radii that an evaluation reports."""
TRACKING = "tracking"
"""Key of the radii of runs with all fixes."""
LOW = 0.85
"""Share of errors inside the 95% radius below which an evaluation warns."""


class RadiusRecord(BaseModel):
    """Radii of a filter's position on a drive, and the share of errors inside them.

    ``n`` is the number of errors, or of estimates without truth. ``radius_95_m`` and ``radius_999_m`` are medians.
    ``inside_95`` and ``inside_999`` are the shares of the errors inside the radii. ``sigma_ratio`` is the RMS of the
    filter's sigma divided by the RMS error, per axis. These three are None without truth. ``lasting_m`` is the RMS of
    the correlated errors, m per axis.
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
    """Return the radius, m, within which the true position lies with a given probability, at each time of an estimate.

    Parameters
    ----------
    estimate : Estimate
        Result of `run_filter` or `smooth`.
    drive : Drive
        Drive of the estimate; the fixes determine the white part of their errors.
    parameters : FilterParameters
        Parameters of the filter.
    level : float
        The probability, above 0 and below 1.

    Returns
    -------
    ndarray, shape (n,)

    Raises
    ------
    InputError
        If ``level`` is not between 0 and 1, or the estimate has no covariance.
    """
    if not 0.0 < level < 1.0:
        raise InputError(f"level = {level:g}: must lie above 0 and below 1")
    if not estimate.covariance.size:
        raise InputError("the estimate has no covariance; use one of run_filter or smooth")
    variance = np.mean(np.diagonal(estimate.covariance[:, :2, :2], axis1=1, axis2=2), axis=1)
    return factor_of(level) * np.sqrt(variance + lasting_variance(drive, parameters, estimate.time))


def factor_of(level: float) -> float:
    """Return the radius of a probability divided by sigma per axis."""
    return math.sqrt(DOF * ((1.0 - level) ** (-2.0 / DOF) - 1.0))


def lasting_variance(drive: Drive, parameters: FilterParameters, time: Array) -> Array:
    """Return the variance per axis, m2, of correlated fix errors that the filter does not model, at each time, (n,)."""
    gps, typical = drive.gps, float(np.mean(np.square(receiver_std(drive))))
    white = white_noise(gps.x + 1j * gps.y) ** 2 / typical
    share = max(1.0 - white - (parameters.fix_error or 0.0), 0.0)
    if gps.std_x is None or gps.std_y is None:
        return np.full(len(time), share * typical)
    last = np.maximum(np.searchsorted(gps.time, time, side="right") - 1, 0)
    return share * (gps.std_x[last] ** 2 + gps.std_y[last] ** 2) / 2


def radius_record(variance: Array, lasting: Array, error: Array | None) -> RadiusRecord | None:
    """Summarize radii from variances of the filter and of correlated errors, m2, and position errors, m, each (n,).

    Returns None if there are no values or the filter failed.
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
