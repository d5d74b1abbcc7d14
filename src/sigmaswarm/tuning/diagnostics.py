"""Find faults of a tuned filter that its objective hardly shows.

Divergence and drift: during a tuning a diverged filter is not reset, so its track is wrong. A likelihood that tolerates
outliers can still give such a filter a low cost. Errors of one-step forecasts hardly show long drifts: if the search
ends too early, the filter may forecast nearly as well as the best one, but drift by a kilometer.

Scale of the covariance: if all noise variances and the initial covariance are multiplied by one factor, the gains and
estimates of a Kalman filter do not change. Its covariances are multiplied and its NIS is divided by the factor.
Therefore the factor mean NIS / 2 makes the filter consistent, if its gains do not depend on the scale. This holds for
planar8 and tilted12, except with a gate or Student's t and at the start and the gaps of a drive. With planar5 the
heading uncertainty may reach degrees; then the scale changes the spread of the sigma points, and so the mean. The
effect of the factor on the position is therefore measured.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.filters.divergence import said_of_restarts
from sigmaswarm.filters.fix_error import FILTERS, kernel_name
from sigmaswarm.filters.fixes_alone import FixesAlone, MotionNoise
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.recording import Recording
from sigmaswarm.filters.run import replay_of
from sigmaswarm.scoring.drifts import FIXES, UNTUNED, Outages
from sigmaswarm.scoring.remote import Replays
from sigmaswarm.scoring.targets import FORECAST_LENGTHS, LONG_OUTAGE_LENGTH, OUTAGE_LENGTH
from sigmaswarm.wording import to_do

NAMED = 3
"""Drives named in one message, and checked for drift."""
WATCHED = 3600.0
"""Seconds of a drive that are checked for divergence; a longer check would increase the peak memory."""
FAR = 1.5
"""Drift relative to the baseline above which a warning is given."""
FEW = 2
"""Number of outage placements checked first."""
NEAR = 1.2
"""Drift ratio over these placements below which the others are skipped; it is accurate to 10%."""
LOOK = 600.0
"""Seconds in the middle of a drive that are checked for drift."""
REMEDY = "DO NOT USE IT; check the drive with `sigmaswarm doctor`, or tune with more trials or on more drives"
CORRELATED = 0.3
"""Lag-1 autocorrelation of innovations above which a warning is given.

Filters tuned without truth have these medians of three seeds: -0.05 and 0.12 on drives with white errors, 0.15 with a
simulated u-blox M8, and 0.33 to 0.91 with real receivers.
"""
SCALE_FREE = ("truth-rmse", "truth-pose")
"""Objectives that do not depend on the scale of the covariance."""
SCALE_REMEDY = "tune with '{objective} + 0.2 nees'"
SCALE_MOVED = 0.02
"""Largest relative change of the position RMSE for which the factor is suggested."""
SCALE_NEAR = 0.2
"""Largest relative error of the mean NIS, after scaling by the factor, for which the factor is suggested."""


@dataclass(frozen=True)
class Forecast:
    """RMS drift over outages of one length on training drives: tuned filter, baseline and fixes alone.

    Attributes
    ----------
    length_s : float
    tuned_m, untuned_m, fixes_alone_m : float
    """

    length_s: float
    tuned_m: float
    untuned_m: float
    fixes_alone_m: float

    def __str__(self) -> str:
        beaten = "" if self.tuned_m < self.fixes_alone_m else ": NOT BEATEN"
        others = f"fixes alone {self.fixes_alone_m:.3g} m{beaten}, baseline {self.untuned_m:.3g} m"
        return f"{self.length_s:g} s {self.tuned_m:.3g} m ({others})"


def said_of_forecasts(forecasts: Sequence[Forecast]) -> list[str]:
    """Return a sentence on the drifts, and one if the filter drifts further than the baseline over 5 s, or neither."""
    if not forecasts:
        return []
    worse = [
        f"drift over {one.length_s:g} s without fixes is larger than that of the baseline, on the training drives: "
        f"{one.tuned_m:.3g} m, baseline {one.untuned_m:.3g} m"
        for one in forecasts
        if one.length_s == OUTAGE_LENGTH and f"{one.tuned_m:.3g}" != f"{one.untuned_m:.3g}"
        if one.tuned_m > one.untuned_m
    ]
    return [f"drift without fixes: {', '.join(map(str, forecasts))}", *worse]


def forecasts_of(parameters: FilterParameters, noise: MotionNoise, replays: Replays) -> Iterator[Forecast]:
    """Measure the drift over outages of several lengths in the middle of the first drives."""
    some = replays.subset(range(min(len(replays.dataset), NAMED)))
    for length in FORECAST_LENGTHS:
        measure = partial(drifts_of, parameters=parameters, length=length, most=FEW, noise=noise)
        drifts = _together(some.of_each_prepared(measure))
        if drifts[0] > 0:
            yield Forecast(length, *drifts)


def loss_warnings(parameters: FilterParameters, replays: Replays, *, outages: bool) -> list[str]:
    """Warn if a filter diverges on its training drives or, with ``outages``, drifts too far."""
    found = divergence_warnings(replays.of_each_prepared(partial(restarts_of, parameters=parameters)))
    if found or not outages:
        return found
    some = replays.subset(range(min(len(replays.dataset), NAMED)))
    if not may_drift_far(some.of_each_prepared(partial(drifts_of, parameters=parameters, most=FEW))):
        return []
    return drift_warnings(some.of_each_prepared(partial(drifts_of, parameters=parameters)))


def divergence_warnings(found: Iterable[tuple[str, list[float]]]) -> list[str]:
    """Warn if a filter diverged on its training drives; ``found`` has the result of `restarts_of` for each drive."""
    diverged = [said_of_restarts(name, times) for name, times in found if times]
    if not diverged:
        return []
    more = f"; and on {len(diverged) - NAMED} more drives" if len(diverged) > NAMED else ""
    why = f"the tuned filter {'; it '.join(diverged[:NAMED])}{more}, although it was tuned there"
    return [to_do(REMEDY, why)]


def may_drift_far(found: Iterable[tuple[float, ...]]) -> bool:
    """Decide from a few outages if the drift must be measured with all; ``found``: `drifts_of` for each drive."""
    tuned, other = _together(found)[:2]
    return tuned > NEAR * other


def drift_warnings(found: Iterable[tuple[float, ...]]) -> list[str]:
    """Warn if a filter drifts much further than the baseline; ``found``: `drifts_of` for each drive."""
    tuned, other = _together(found)[:2]
    if tuned <= FAR * other:
        return []
    why = (
        f"over {LONG_OUTAGE_LENGTH:g} s without fixes the tuned filter drifts {tuned:.3g} m on its training drives, "
        f"the baseline {other:.3g} m"
    )
    return [to_do(REMEDY, why)]


def restarts_of(ready: PreparedDrive, parameters: FilterParameters) -> tuple[str, list[float]]:
    """Return a drive's name and the times at which a monitored filter was reset in its first hour, s."""
    start = float(ready.drive.imu.time[0])
    replay = replay_of(_part(ready, start, start + WATCHED))
    return ready.drive.name, Recording(replay, parameters, recover=True).finished().restarts


def correlation_of(ready: PreparedDrive, parameters: FilterParameters) -> float:
    """Return the lag-1 autocorrelation of a filter's innovations in a drive's first hour, the mean of both axes."""
    start = float(ready.drive.imu.time[0])
    replay = replay_of(_part(ready, start, start + WATCHED))
    found = Recording(replay, parameters).finished().innovations
    with np.errstate(all="ignore"):  # a failed filter gives NaN and infinity
        nu = found.innovation / np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
        return float(np.mean(np.mean(nu[1:] * nu[:-1], axis=0) / np.mean(nu**2, axis=0)))


def correlation_warnings(
    parameters: FilterParameters, found: Iterable[float], use: Sequence[str] = ()
) -> list[str]:
    """Warn if the innovations of most drives are correlated and the filter could model correlated fix errors.

    ``found``: `correlation_of` for each drive. ``use``: the current values of ``--use``, for the
    proposed command.
    """
    known = [value for value in found if np.isfinite(value)]
    augmented = kernel_name(parameters.model, parameters.kind, fix_error=True)
    supported = parameters.kind in ("ukf", "ekf") and augmented in FILTERS
    if parameters.fix_error is not None or not supported or not known or np.median(known) < CORRELATED:
        return []
    why = (
        f"the innovations are correlated from fix to fix (lag 1: {np.median(known):.2f}), as are the fix errors, "
        "and the stated covariance is too small"
    )
    return [to_do(f"tune with --use {' '.join([*use, 'fix-error'])}", why)]


def _part(ready: PreparedDrive, start: float, end: float) -> PreparedDrive:
    """Return the part of a drive from ``start`` to ``end``, s on its clock, or the whole drive if it is shorter."""
    time = ready.drive.imu.time
    if start <= time[0] and time[-1] <= end:
        return ready
    return PreparedDrive(clip(ready.drive, start, end), as_recorded=ready.as_recorded)


def drifts_of(
    ready: PreparedDrive,
    parameters: FilterParameters,
    most: int | None = None,
    *,
    length: float = LONG_OUTAGE_LENGTH,
    noise: MotionNoise | None = None,
) -> tuple[float, ...]:
    """Return the RMS drifts of a filter and of the baseline over outages, m; NaN if no outage fits.

    With ``noise`` a third value is the drift of the fixes alone. ``most`` limits the number of outage placements.
    """
    middle = float(ready.drive.imu.time[0] + ready.drive.imu.time[-1]) / 2
    part = _part(ready, middle - LOOK / 2, middle + LOOK / 2)
    try:
        outages = Outages(part, length=length, seed=0, most=most)
    except InputError:  # the car does not move in this part
        return np.nan, np.nan
    filters = {"tuned": parameters, UNTUNED: baseline(ready.drive, like=parameters)}
    also = {} if noise is None else {FIXES: partial(FixesAlone, noise=noise)}
    outages.run(filters, also, watched=False)
    return tuple(outages.drift(method) for method in (*filters, *also))


def _together(found: Iterable[tuple[float, ...]]) -> list[float]:
    """Return the RMS over the drives of each drift; zeros if no drive has any."""
    known = np.array([drifts for drifts in found if np.isfinite(drifts).all()])
    return np.sqrt(np.mean(known**2, axis=0)).tolist() if len(known) else [0.0, 0.0]


def scale_warnings(objective: str, parameters: FilterParameters, replays: Replays) -> list[str]:
    """Warn if the objective does not determine the scale of the covariance.

    For planar8 and tilted12 the warning states the factor for `FilterParameters.scaled` that makes mean NIS 2, if it
    hardly changes the positions.
    """
    if objective not in SCALE_FREE:
        return []
    before = replays.scores([parameters])
    nis = float(before.mean_nis.mean())
    said = f"{objective} leaves the scale of the covariances free: mean NIS is {nis:.2g} where 2 is expected"
    remedy = SCALE_REMEDY.format(objective=objective)
    if parameters.model != "planar5" and nis > 0:
        after = replays.scores([parameters.scaled(nis / 2)])
        moved = float(after.position_rmse.mean() / before.position_rmse.mean() - 1)
        if abs(moved) <= SCALE_MOVED and abs(float(after.mean_nis.mean()) / 2 - 1) <= SCALE_NEAR:
            right = f"all variances times {nis / 2:.3g} make mean NIS 2 and change the position RMSE by {moved:+.1%}"
            return [to_do(f"{remedy}, or use FilterParameters.scaled({nis / 2:.3g})", f"{said}; {right}")]
    return [to_do(remedy, said)]
