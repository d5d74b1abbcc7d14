"""A prior on R from the accuracy of the receiver, which a log without truth does not determine.

Many receivers smooth their fixes: from one to the next they err by centimeters, over minutes by meters. The likelihood
of the next fix sees the centimeters alone, and so the filter that it likes best has an R of centimeters, and copies the
fixes. What it lacks is in the receiver's data sheet: R is drawn from a log-normal distribution about the stated
variance, a floor rather than a point (receivers in cities state too little, and a larger R costs nothing). Errors that
last bind every fix alike, so no number of fixes outvotes the prior: it counts once for each of them.
"""

from collections.abc import Sequence

import numpy as np

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD, motion_in_noise, stated_std, white_noise
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.table import ParameterTable

DECADES = 0.5
"""Standard deviation of log10 R below that of the receiver."""
SHOWN = 0.25 * UNSTATED_GPS_STD
"""m per axis: a receiver that states nothing and errs by that much from one fix to the next does not smooth, and its
fixes show what it is; of one that errs by less nothing is known."""


def receiver_std(drive: Drive) -> tuple[float, float]:
    """How far the fixes of a drive's receiver may be off, m east and north.

    As it states; else the white noise that its fixes show, if that is large; else as of a u-blox M8.
    """
    if stated := stated_std(drive):
        return stated
    gps = drive.gps
    shown, moved = white_noise(gps.x + 1j * gps.y), motion_in_noise(float(np.median(np.diff(gps.time))))
    std = shown if shown > max(SHOWN, 3 * moved) else UNSTATED_GPS_STD
    return std, std


def prior_costs(parameter_sets: Sequence[FilterParameters], std: Array) -> Array:
    """Penalty of the prior per fix, added to the negative log-likelihood, nats.

    Parameters
    ----------
    parameter_sets : sequence of FilterParameters, length n
    std : ndarray, shape (m, 2)
        `receiver_std` of each drive, m.

    Returns
    -------
    ndarray, shape (n, m)
        0.5 (log10(R / std^2) / 0.5)^2 where R is smaller than std^2, else 0; the mean over both axes. R of a filter
        that goes by each fix's own accuracy is that of the median fix.
    """
    short = np.minimum(np.log10(typical_variance(parameter_sets, std) / std**2) / DECADES, 0.0)
    return 0.5 * np.mean(short**2, axis=2)


def typical_variance(parameter_sets: Sequence[FilterParameters], std: Array) -> Array:
    """R of the median fix, m2 east and north, shape (n, m, 2); ``std`` as in `prior_costs`."""
    table = ParameterTable.of(parameter_sets)
    floor, scale = table.column("measurement_noise"), table.column("accuracy_scale")
    return floor[:, None, :] + scale[:, None, None] * std**2
