"""Compare R with the receiver's accuracy: a prior for objectives without truth, and warnings about an implausible R.

Many receivers smooth their fixes. For smoothed fixes, the likelihood is largest if R corresponds to centimeters, and a
filter with this R copies the fixes. The prior penalizes an R below the receiver's variance. It penalizes a larger R
only with fix-error, since receivers state standard deviations that are too small in cities. The prior is counted once
per fix. If it were counted once in total, its relative weight would decrease with the number of fixes, as if the errors
of the fixes were independent.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.doctor.evidence import MAX_SCATTER_RATIO, fix_scatter
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD, stated_std
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import DriveError
from sigmaswarm.filters.kernel_array import ParameterTable
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.wording import to_do

PRIOR_STD = 0.5  # prior standard deviation of log10 R below the receiver's variance
PRIOR_STD_ABOVE = 0.25  # prior standard deviation of log10 R above that variance, for fix-error only
MAX_STD_RATIO = 3.0  # ratio of the receiver's standard deviation to that of R above which a warning is given
MIN_STATED_SHARE = 0.05  # a warning is given if stated variances are at most this fraction of R
SPAN = 600.0  # s in the middle of a drive in which scatter is measured; more time gives the same result
MIN_PRIOR_COST = 0.02  # nats per fix; a larger cost of the prior leads to a remark
MIN_SCATTER = 0.5  # m per axis; if fixes scatter less, the receiver smooths them or uses RTK
UNKNOWN = "A log without truth does not show an error that all fixes have in common"
AT_THE_TOP = "at the top of drive.toml"
TUNE_AGAIN = "tune again with a new folder"
IF_KNOWN = f"If you know the accuracy (m per axis), write it as gps_std_m {AT_THE_TOP}; then {TUNE_AGAIN}"
NO_STD = f"The fixes do not show their accuracy either. {IF_KNOWN}"


@dataclass(frozen=True)
class StdCheck:
    """A standard deviation of the fixes, m per axis, with which the baseline drifts less than with the assumed one.

    ``drift_m`` and ``assumed_m`` are the RMS drifts (m) of the baseline with this and with the assumed standard
    deviation, in outages of ``length_s`` on the training drives.
    """

    std: float
    length_s: float
    drift_m: float
    assumed_m: float

    @property
    def message(self) -> str:
        return (
            "the receiver states no accuracy. `tune` used the scatter of the fixes as their standard deviation, "
            f"{self.std:.2g} m per axis: with this value the baseline drifts {self.drift_m:.3g} m instead of "
            f"{self.assumed_m:.3g} m in outages of {self.length_s:g} s. The true value may be larger, since the "
            f"scatter does not contain slowly varying errors. {IF_KNOWN}"
        )


def prior_costs(parameter_sets: Sequence[FilterParameters], std: Array) -> Array:
    """Return the penalties of the prior on R, nats per fix, shape (n, m), for n parameter sets and m drives.

    The penalty is 0.5 (log10(R / std^2) / 0.5)^2 if R is smaller than std^2, otherwise 0, averaged over both axes.
    ``std``, shape (m, 2), is the `receiver_std` of each drive, in meters. With the option accuracy, R is that of the
    median fix. With fix-error, R includes the variance of the correlated errors, and the penalty of an R larger than
    std^2 is 0.5 (log10(R / std^2) / 0.25)^2.
    """
    log = np.log10(typical_variance(parameter_sets, std) / std**2)
    correlated = ParameterTable.of(parameter_sets).column("fix_error")[:, None, None] > 0.0
    above = np.where(correlated, np.maximum(log / PRIOR_STD_ABOVE, 0.0), 0.0)
    return 0.5 * np.mean((np.minimum(log / PRIOR_STD, 0.0) + above) ** 2, axis=2)


def typical_variance(parameter_sets: Sequence[FilterParameters], std: Array) -> Array:
    """Return the variances, shape (n, m, 2), that n filters assume for fixes of m drives with accuracy ``std``."""
    table = ParameterTable.of(parameter_sets)
    scale = table.column("accuracy_scale") + table.column("fix_error")
    return table.column("measurement_noise")[:, None, :] + scale[:, None, None] * std**2


@dataclass(frozen=True)
class FixNoise:
    """Estimates of the errors of a drive's fixes, m per axis; NaN if unknown.

    ``stated`` is the median standard deviation that the receiver states. ``scatter`` is the standard deviation of the
    fixes about paths of ten seconds that agree with the IMU.
    """

    stated: float
    scatter: float


def fix_noise(drive: Drive) -> FixNoise:
    """Estimate the errors of a drive's fixes. ``scatter`` is measured in the middle `SPAN` seconds."""
    middle = float(drive.imu.time[0] + drive.imu.time[-1]) / 2
    try:
        scatter = fix_scatter(clip(drive, middle - SPAN / 2, middle + SPAN / 2)) or np.nan
    except DriveError:
        scatter = np.nan
    return FixNoise(median_stated_std(drive), float(scatter))


def median_stated_std(drive: Drive) -> float:
    """Return the median standard deviation that the receiver states, m per axis; NaN if it states none."""
    return float(np.mean(stated_std(drive) or np.nan))


def noise_warnings(
    parameters: FilterParameters,
    drives: Sequence[FixNoise],
    check: StdCheck | None = None,
    use: Sequence[str] = (),
) -> list[str]:
    """Warn if R contradicts the training drives' fixes.

    ``check`` is the standard deviation that replaces the assumed one. ``use`` contains the values of ``--use`` in the
    proposed command.
    """
    if parameters.accuracy_scale is not None or not drives:
        return []
    r = float(np.mean(parameters.measurement_noise)) ** 0.5
    stated, scatter = (_median([getattr(one, what) for one in drives]) for what in ("stated", "scatter"))
    unknown = np.isnan(stated) and check is None
    if parameters.fix_error is not None:
        why = (
            "the log does not state the accuracy of its fixes. The filter assumes correlated errors with a standard "
            f"deviation of {UNSTATED_GPS_STD:g} m per axis. {IF_KNOWN}"
        )
        return [why] if unknown and scatter < MIN_SCATTER else []
    if r * MAX_STD_RATIO < stated:
        why = f"the receiver states a standard deviation of {stated:.2g} m"
    elif r * MAX_STD_RATIO < scatter:
        why = f"the fixes scatter by {scatter:.2g} m about a path that is consistent with the IMU"
    else:
        if stated > MAX_SCATTER_RATIO * scatter:
            why = (
                f"the receiver states a standard deviation of {stated:.2g} m per axis, but its fixes scatter by only "
                f"{scatter:.2g} m, so their errors are correlated"
            )
        elif unknown and scatter < MIN_SCATTER:
            why = (
                f"the log does not state the accuracy of its fixes. Their small scatter of {scatter:.2g} m per axis "
                "does not prove that they are accurate, since correlated errors cause little scatter"
            )
        else:
            return []
        return [_remedied(f"{why}. {UNKNOWN}", stated, use)]
    message = f"the filter assumes a standard deviation of the fixes of {r:.2g} m per axis, but {why}"
    why = f"{message}. Therefore the filter copies the fixes, with their errors"
    why = f"{why}. Predictions of the fixes do not show correlated errors. {UNKNOWN}"
    return [_remedied(why, stated, use)]


def _remedied(why: str, stated: float, use: Sequence[str]) -> str:
    if np.isnan(stated):
        return f"{why}. {IF_KNOWN}"
    also = ", or evaluate with the truth of a reference receiver"
    return to_do(f"tune with --use {' '.join([*use, 'accuracy'])}{also}", why)


def prior_warnings(
    parameters: FilterParameters,
    weight: float,
    names: Sequence[str],
    receiver: Array,
    noise: Sequence[FixNoise],
    assumed: Sequence[bool],
) -> list[str]:
    """Report the first drive on which the prior changed R noticeably.

    ``receiver`` contains standard deviations of the prior, m. ``assumed`` is True for drives where they are only
    assumed.
    """
    costs = weight * prior_costs([parameters], receiver)[0]
    r = np.sqrt(np.mean(typical_variance([parameters], receiver)[0], axis=1))
    drives = zip(names, receiver.mean(axis=1), noise, r, costs, assumed, strict=True)
    for name, std, one, tuned, cost, unknown in drives:
        if cost <= MIN_PRIOR_COST or tuned * MAX_STD_RATIO < std:
            continue
        compromise = (
            f"R (measurement noise) corresponds to {tuned:.2g} m per axis, a compromise between the innovations "
            "and"
        )
        if np.isfinite(one.stated):
            lasting = (
                f". The fixes scatter by only {one.scatter:.2g} m, so their errors seem correlated. {UNKNOWN}"
            )
            addition = lasting if std > MAX_SCATTER_RATIO * one.scatter else ""
            return [f"on {name}, {compromise} the stated {std:.2g} m{addition}"]
        if unknown:
            why = (
                f"the drive {name} does not state the accuracy of its fixes. `tune` assumed {std:.2g} m per axis, as "
                "for a typical receiver, so the filter may follow the fixes too closely or too loosely. "
                f"{compromise} this value. If the receiver smooths its fixes, NIS will be low"
            )
            return [f"{why}. {NO_STD if parameters.fix_error is None else IF_KNOWN}"]
        return [f"on {name}, {compromise} the {std:.2g} m of noise that the fixes show"]
    return []


def accuracy_warnings(
    parameters: FilterParameters, stated: Sequence[float], use: Sequence[str] = ()
) -> list[str]:
    """Warn if the stated accuracies hardly affect R.

    ``stated`` is the median stated standard deviation of each drive, m. ``use`` contains the values of ``--use`` in the
    proposed command.
    """
    std = _median(stated)
    if parameters.accuracy_scale is None or not np.isfinite(std):
        return []
    share = parameters.accuracy_scale * std**2
    share /= share + float(np.mean(parameters.measurement_noise))
    if share > MIN_STATED_SHARE:
        return []
    why = (
        f"the stated accuracy contributes only {share:.0%} of R, so `accuracy` has hardly any effect. The stated "
        "accuracy hardly changes from fix to fix, or is unrelated to the errors of the fixes"
    )
    rest = " ".join(name for name in use if name != "accuracy")
    return [to_do(f"tune with --use {rest}" if rest else "omit accuracy from --use", why)]


def _median(values: Sequence[float]) -> float:
    known = [v for v in values if np.isfinite(v)]
    return float(np.median(known)) if known else float("nan")
