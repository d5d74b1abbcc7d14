"""Consistency of a filter's covariances: NIS, NEES, whiteness of the innovations, and coverage of the stated radius.

Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and Navigation, Wiley 2001, section
5.4.

A position error lies within the radius with a given probability. The filter's covariance does not always
include the variance of correlated fix errors, which do not average out. The total variance per axis is estimated as

    sigma^2 = P + max(s^2 - w^2 - min(g s^2, P), 0)

where P is the mean of the filter's variances of x and y, s is the standard deviation of the fixes (`receiver_std`), and
w is the standard deviation of their white noise (`white_noise`). g s^2 is the variance of the filter's states for
correlated fix errors; g = 0 without these states. P includes g s^2, or a part of it if the errors last longer than the
filter assumes. Errors on a short training drive are few independent values, so the tuned covariance is uncertain.
Therefore, error / sigma is modeled by Student's t with `DOF` degrees of freedom. For a probability q,

    radius^2 = DOF ((1 - q)^(-2 / DOF) - 1) sigma^2

which is the quantile of 2 F(2, DOF).
"""

import math
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sigmaswarm.arrays import Array
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.sensors import receiver_std, white_noise
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Innovations, run_innovations

GATE_95 = -2 * math.log(0.05)  # 95% quantile of NIS for a consistent filter: 5.99
MAX_NEES = 4.0  # largest mean NEES of a consistent position covariance; a 95% band is unknown
MIN_NEES = 1.5  # smallest mean NEES of a consistent position covariance
LAGS = 10  # fixes, largest lag of the autocorrelation
_KEYS = {  # in scores.json
    "nis_band": "nis_band_95",
    "inside_gate": "share_inside_95_gate",
    "white_band": "autocorrelation_band_95",
    "missed": "missed_m",
    "expected": "expected_m",
    "own_sigma": "own_sigma_m",
}
_CONFIG = ConfigDict(
    frozen=True,
    alias_generator=lambda name: _KEYS.get(name, name),
    populate_by_name=True,
    serialize_by_alias=True,
)


class Consistency(BaseModel):
    """Consistency of a filter's covariances on one drive.

    Attributes
    ----------
    n_fixes : int
    mean_nis : float
        2 for a consistent filter, larger for an overconfident filter.
    nis_band : (float, float)
        95% band of the mean NIS of a consistent filter with ``n_fixes`` independent innovations.
    inside_gate : float
        Fraction of the fixes inside the 95% gate (NIS up to `GATE_95`).
    autocorrelation : list of float, length LAGS
        Autocorrelation of the normalized innovations at lags 1 to LAGS, mean of both axes; near 0 for white
        innovations.
    white_band : float
        Half width of the 95% band of the autocorrelation of white innovations.
    white_p : float
        p-value of Ljung and Box's test for whiteness (1978).
    mean_nees : float or None
        Mean NEES of the position at truth times: 2 for a consistent filter, None if not computed. A 95% band is
        unknown, since position errors are correlated over time.
    missed, expected : float or None
        RMS of the innovations, and the RMS that their covariances predict, m.
    own_sigma : float or None
        RMS of the filter's position standard deviation, m; None if not computed.
    """

    model_config = _CONFIG

    n_fixes: int
    mean_nis: float
    nis_band: tuple[float, float]
    inside_gate: float
    autocorrelation: list[float] = Field(min_length=1)
    white_band: float = math.nan
    white_p: float
    mean_nees: float | None = None
    missed: float | None = None
    expected: float | None = None
    own_sigma: float | None = None


def consistency(
    drive: Drive | PreparedDrive, parameters: FilterParameters, mean_nees: float = math.nan
) -> Consistency | None:
    """Compute a filter's consistency over a drive. Return None if the filter failed or had too few fixes.

    ``mean_nees`` is stored in the result, but not computed here.
    """
    return consistency_of(run_innovations(drive, parameters), mean_nees)


def consistency_of(
    innovations: Innovations, mean_nees: float = math.nan, own_sigma: float = math.nan
) -> Consistency | None:
    """Compute the consistency from innovations.

    Return None for at most 2 LAGS innovations, or an invalid covariance.
    """
    n, s = len(innovations.time), innovations.covariance
    if n <= 2 * LAGS or not np.isfinite(s).all():
        return None
    if not (np.all(s[:, 0, 0] > 0) and np.all(np.linalg.det(s) > 0)):
        return None
    from scipy.special import chdtrc, gammaincinv  # 0.1 s to import

    nis, values = innovations.nis, innovations.normalized.T
    # The mean is not subtracted, since innovations of a consistent filter have zero mean.
    correlations = np.array([[x[k:] @ x[:-k] / (x @ x) for k in range(1, LAGS + 1)] for x in values])
    ljung_box = n * (n + 2) * float(np.sum(correlations**2 / (n - np.arange(1, LAGS + 1))))
    low, high = 2 * gammaincinv(n, [0.025, 0.975]) / n  # quantiles of chi-square with 2n degrees of freedom
    return Consistency(
        n_fixes=n,
        mean_nis=float(nis.mean()),
        nis_band=(float(low), float(high)),
        inside_gate=float(np.mean(nis <= GATE_95)),
        autocorrelation=correlations.mean(axis=0).tolist(),
        white_band=float(1.96 / np.sqrt(2 * n)),
        white_p=float(chdtrc(2 * LAGS, ljung_box)),
        mean_nees=None if math.isnan(mean_nees) else mean_nees,
        missed=float(np.sqrt(np.mean(np.square(innovations.innovation).sum(axis=1)))),
        expected=float(np.sqrt(np.mean(np.trace(s, axis1=1, axis2=2)))),
        own_sigma=None if math.isnan(own_sigma) else own_sigma,
    )


Kind = Literal[
    "optimistic",
    "pessimistic",
    "alike",
    "lasting",
    "correlated",
    "consistent",
    "optimistic_position",
    "unknown",
]
"""Kind of a verdict on a filter.

- ``optimistic``: innovations are larger than their covariances predict (overconfident).
- ``pessimistic``: innovations are smaller than their covariances predict.
- ``alike``: innovations are smaller than predicted, and consecutive innovations are strongly correlated; only without
  truth.
- ``lasting``: innovations are smaller than predicted, since predictions contain the errors of the fixes; errors against
  truth agree with the covariances.
- ``correlated``: innovations are as large as their covariances predict, but correlated; only without truth.
- ``optimistic_position``: innovations are not larger than predicted, but position errors against truth are larger than
  the covariance predicts.
"""
EQUAL_CORRELATION = 0.5  # lag-1 correlation above which consecutive innovations are strongly correlated
MAX_CORRELATION = 0.2  # lag-1 correlation above which a mean NIS of 2 does not prove consistency
FORECASTS = "This result is for predictions of the fixes; without truth, position errors can't be checked"

VERDICTS: dict[Kind, str] = {
    "optimistic": "is overconfident: the standard deviations of its predictions are {nis_size}",
    "pessimistic": "is underconfident: the standard deviations of its predictions are {nis_size}",
    "alike": (
        "has correlated innovations, and their predicted standard deviations are {nis_size}. The receiver smooths its "
        "fixes, or their errors are correlated. The error that all fixes have in common can't be estimated without "
        "truth"
    ),
    "lasting": (
        "has a low NIS but a correct NEES, since the errors of consecutive fixes are correlated. Its position "
        "covariances are correct and should not be reduced"
    ),
    "correlated": (
        "has innovations of the correct size, but they are correlated. The receiver's errors are correlated, or the "
        "model does not describe a part of the motion. The position error may be larger than its standard deviation"
    ),
    "consistent": "is consistent: the errors of its predictions agree with its standard deviations",
    "optimistic_position": (
        "is overconfident about its position: the standard deviations are {nees_size}. NIS does not show this, since "
        "the predictions contain the same slowly changing errors as the fixes, and these errors cancel in the "
        "innovations"
    ),
    "unknown": f"had too few fixes to determine its consistency, which needs more than {2 * LAGS}",
}


def verdicts(results: Sequence[Consistency | None]) -> dict[Kind, str]:
    """Return one sentence for each kind of verdict on several drives."""
    known = [one for one in results if one]
    without_truth = bool(known) and all(one.mean_nees is None for one in known)
    messages: dict[Kind, str] = {}
    for kind, text in VERDICTS.items():
        own = [one for one in known if kind in _kinds(one)]
        count = len(results) - len(known) if kind == "unknown" else len(own)
        if not count:
            continue
        sizes = {
            "nis_size": _size([one.mean_nis for one in own], "NIS"),
            "nees_size": _size([one.mean_nees or 0.0 for one in own], "NEES"),
        }
        where = f"on {count} of {len(results)} drives " if len(results) > 1 else ""
        forecasts = f". {FORECASTS}" if without_truth and kind not in ("unknown", "alike") else ""
        messages[kind] = f"{where}the filter {text.format(**sizes)}{forecasts}"
    return messages


def _kinds(one: Consistency) -> Iterator[Kind]:
    (low, high), nis, nees = one.nis_band, one.mean_nis, one.mean_nees
    neighbors = one.autocorrelation[0]
    if nis > high:
        yield "optimistic"
    elif nis < low:
        if nees is None:
            yield "alike" if neighbors > EQUAL_CORRELATION else "pessimistic"
        else:
            yield "lasting" if MIN_NEES <= nees <= MAX_NEES and nees > 2 * nis else "pessimistic"
    else:
        yield "correlated" if nees is None and neighbors > MAX_CORRELATION else "consistent"
    if nis <= high and nees is not None and nees > MAX_NEES:
        yield "optimistic_position"


def _size(mean_squares: Sequence[float], what: str) -> str:
    mean = sum(mean_squares) / max(len(mean_squares), 1)
    return f"{describe_ratio(math.sqrt(2 / mean) if mean > 0 else math.inf)} (mean {what} {mean:.2g}, should be 2)"


def describe_ratio(ratio: float) -> str:
    """Describe a ratio of standard deviations to the correct values, for example as ``20% too small``."""
    size = "large" if ratio > 1 else "small"
    if 0.5 < ratio < 2:
        return f"{100 * abs(ratio - 1):.0f}% too {size}"
    factor = max(ratio, 1 / ratio)
    return f"too {size} by a factor of {f'{factor:.2g}' if factor < 99.5 else f'{factor:,.0f}'}"


DOF = 7.0  # degrees of freedom, chosen on parts of development drives that tuning (seed 0) did not use
LEVELS = 0.95, 0.999  # probabilities
TRACKING = "tracking"  # key of the radii with all fixes
MIN_COVERAGE = 0.85  # fraction of errors inside the 95% radius below which a warning is given


class RadiusRecord(BaseModel):
    """Median radii of a filter's position on a drive, and the fraction of errors inside the radii.

    ``n`` is the number of errors or, without truth, the number of estimates. ``sigma_ratio`` is the RMS of the filter's
    standard deviation divided by the RMS error, per axis. ``lasting_m`` is the RMS of the correlated fix errors that
    the filter's covariance does not include, m per axis.
    """

    n: int
    radius_95_m: float
    radius_999_m: float
    inside_95: float | None = None
    inside_999: float | None = None
    sigma_ratio: float | None = None
    lasting_m: float = 0.0


def factor_of(level: float) -> float:
    """Return the radius, in sigmas per axis, that contains the error with the probability ``level``."""
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
    """Return the radii of a filter from times (s), variances (m2) and errors (m) (see `Tracker.stated`)."""
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
