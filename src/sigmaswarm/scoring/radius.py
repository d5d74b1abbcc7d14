"""Compute the radius within which a position error lies with a given probability, and its coverage.

The filter's covariance does not always include the variance of correlated fix errors, which do not average out. The
total variance per axis is estimated as

    sigma^2 = P + max(s^2 - w^2 - min(g s^2, P), 0)

where P is the mean of the filter's variances of x and y, s is the standard deviation of the fixes (`receiver_std`), and
w is the standard deviation of their white noise (`white_noise`). If the filter has states for correlated errors, P
contains their variance g s^2, or a part of it if the errors last longer than the filter assumes. Otherwise, g = 0. A
short training drive determines a covariance from few independent errors. Therefore, error / sigma is modeled by
Student's t with `DOF` degrees of freedom. For a probability q,

    radius^2 = DOF ((1 - q)^(-2 / DOF) - 1) sigma^2

which is the quantile of 2 F(2, DOF).
"""

import math

import numpy as np
from pydantic import BaseModel

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import receiver_std, white_noise
from sigmaswarm.filters.parameters import FilterParameters

DOF = 7.0  # degrees of freedom, chosen on parts of development drives that tuning (seed 0) did not use
LEVELS = 0.95, 0.999  # probabilities
TRACKING = "tracking"  # key of the radii with all fixes
MIN_COVERAGE = 0.85  # fraction of errors inside the 95% radius below which a warning is given


class RadiusRecord(BaseModel):
    """Median radii of a filter's position on a drive, and the fraction of errors inside the radii.

    ``n``: number of errors; if there is no truth, number of estimates. ``sigma_ratio``: RMS of the filter's standard
    deviation divided by the RMS error, per axis. ``lasting_m``: RMS of the correlated fix errors that the filter's
    covariance does not include, m per axis.
    """

    n: int
    radius_95_m: float
    radius_999_m: float
    inside_95: float | None = None
    inside_999: float | None = None
    sigma_ratio: float | None = None
    lasting_m: float = 0.0


def factor_of(level: float) -> float:
    """Return the ratio of the radius for a probability ``level`` to sigma per axis."""
    return math.sqrt(DOF * ((1.0 - level) ** (-2.0 / DOF) - 1.0))


def lasting_variance(drive: Drive, parameters: FilterParameters, time: Array, variance: Array) -> Array:
    """Return the part of the variance of correlated fix errors that the filter's ``variance`` does not contain.

    Shape (n,), m2 per axis.
    """
    gps, typical = drive.gps, float(np.mean(np.square(receiver_std(drive))))
    if (std := gps.std) is None:
        stated = np.full(len(time), typical)
    else:
        last = np.maximum(np.searchsorted(gps.time, time, side="right") - 1, 0)
        stated = np.mean(np.square(std[:, last]), axis=0)
    white = white_noise(gps.x + 1j * gps.y) ** 2 / typical
    modeled = np.minimum((parameters.fix_error or 0.0) * stated, variance)
    return np.maximum((1.0 - white) * stated - modeled, 0.0)


def stated_radius(
    drive: Drive, parameters: FilterParameters, stated: tuple[Array, Array, Array | None]
) -> RadiusRecord | None:
    """Return the radii of a filter from times (s), variances (m2) and errors (m): see `Tracker.stated`."""
    time, variance, error = stated
    lasting = lasting_variance(drive, parameters, time, variance)
    return radius_record(variance, lasting, None if drive.truth is None else error)


def radius_record(variance: Array, lasting: Array, error: Array | None) -> RadiusRecord | None:
    """Summarize variances of the filter and of correlated errors (m2), and position errors (m).

    Return None if a variance is not finite, or if there are no variances.
    """
    total = variance + lasting
    if not len(total) or not np.isfinite(total).all():
        return None
    radii = [factor_of(level) * np.sqrt(total) for level in LEVELS]
    record = RadiusRecord(
        n=len(total),
        radius_95_m=float(np.median(radii[0])),
        radius_999_m=float(np.median(radii[1])),
        lasting_m=math.sqrt(float(np.mean(lasting))),
    )
    if error is None:
        return record
    inside = [float(np.mean(error <= radius)) for radius in radii]
    squared = float(np.mean(error**2))
    ratio = math.sqrt(2 * float(np.mean(variance)) / squared) if squared else None
    return record.model_copy(update={"inside_95": inside[0], "inside_999": inside[1], "sigma_ratio": ratio})
