"""A prior on R from the accuracy of the receiver, which a log without truth does not determine.

Many receivers smooth their fixes: from one to the next they err by centimeters, over minutes by meters. The likelihood
of the next fix depends on the centimeters alone, so its optimum has an R of centimeters and copies the fixes. The prior
adds the receiver's data sheet: a log-normal distribution of R about the stated variance, as a lower limit (receivers in
cities state too little, and a larger R costs nothing). Correlated errors are common to all fixes, so more fixes do not
outweigh the prior: it counts once for each of them.
"""

from collections.abc import Sequence

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.table import ParameterTable

DECADES = 0.5
"""Standard deviation of log10 R below that of the receiver."""
DECADES_ABOVE = 0.25
"""The same above it, with states for correlated fix errors, which a large R would replace."""


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
        that uses each fix's stated accuracy is that of the median fix. With `FilterParameters.fix_error` R includes the
        variance of the correlated errors, and 0.25 replaces 0.5 where it is larger.
    """
    log = np.log10(typical_variance(parameter_sets, std) / std**2)
    lasts = ParameterTable.of(parameter_sets).column("fix_error")[:, None, None] > 0.0
    off = np.minimum(log / DECADES, 0.0) + np.where(lasts, np.maximum(log / DECADES_ABOVE, 0.0), 0.0)
    return 0.5 * np.mean(off**2, axis=2)


def typical_variance(parameter_sets: Sequence[FilterParameters], std: Array) -> Array:
    """Variance of the median fix, m2 east and north, shape (n, m, 2); ``std`` as in `prior_costs`."""
    table = ParameterTable.of(parameter_sets)
    floor, scale = (
        table.column("measurement_noise"),
        table.column("accuracy_scale") + table.column("fix_error"),
    )
    return floor[:, None, :] + scale[:, None, None] * std**2
