"""Find faults of a tuned filter that the objective hardly shows: divergence, drift, a wrong scale of the covariance.

If all variances are multiplied by mean NIS / 2, the mean NIS becomes about 2. This factor can change the estimates,
since fixed variances of the initial state and robust weights make the gains depend on the scale. Therefore the change
of the RMSE is measured.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.filters.divergence import describe_restarts
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.fixes_alone import FixesAlone, MotionNoise
from sigmaswarm.filters.kernels import FILTERS, kernel_name
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.scoring.drifts import OutageDrifts, RunFactories
from sigmaswarm.scoring.methods import BASELINE, FIXES, METHODS, in_sentence
from sigmaswarm.scoring.remote import AnyBatchScorer
from sigmaswarm.scoring.targets import FORECAST_LENGTHS, LONG_OUTAGE_LENGTH, OUTAGE_LENGTH
from sigmaswarm.tables import Column, Table
from sigmaswarm.tuning.objectives import Objective
from sigmaswarm.tuning.receiver import StdCheck
from sigmaswarm.wording import count_of, to_do

MAX_NAMED_DRIVES = 3  # largest number of drives that a message names, and that are checked for drift
MONITORED_TIME = 3600.0  # s; divergence is checked up to this time after the filter's start, to save memory
MAX_DRIFT_RATIO = 1.5  # ratio to the baseline's drift above which a warning is given
FIRST_SETS = 2  # sets of outages that are checked first
RECHECK_RATIO = 1.2
"""Largest ratio of the filter's drift to the baseline's drift at which `FIRST_SETS` sets of outages suffice.

With this number of sets the ratio is accurate to 10%. For larger ratios, all sets are measured.
"""
MAX_CONFIRMED_RATIO = 0.8
"""Largest ratio of drifts at which the scatter of the fixes is used as their standard deviation.

The ratio is the drift of the baseline with this standard deviation, divided by its drift with the assumed one. On four
logs with ratios of 0.3 to 0.75, tuning with the scatter as the standard deviation reduced the 5 s drift on the held-out
part by 10 to 78% (one seed each). On two logs with ratios of 0.85 and 1.1, it increased this drift.
"""
CHECKED_TIME = 600.0  # s in the middle of a drive that are checked for drift
DO_NOT_USE = "DO NOT USE THIS FILTER"
REMEDY = f"{DO_NOT_USE}; check the drive with `sigmaswarm doctor`, or tune with more trials or on more drives"
MAX_CORRELATION = 0.3
"""Largest lag-1 autocorrelation of innovations without a warning.

For filters tuned without truth, the median autocorrelation was -0.05 and 0.12 with white fix errors, 0.15 with a
simulated u-blox M8, and 0.33 to 0.91 with real receivers.
"""
SCALE_REMEDY = "tune with '{objective} + 0.2 {measure}'"
MAX_RMSE_CHANGE = 0.02  # largest relative change of the position RMSE for which the factor is suggested
MAX_NIS_ERROR = 0.2  # largest difference of the scaled mean NIS / 2 from 1 for which the factor is suggested


@dataclass(frozen=True)
class DriftComparison:
    """RMS drifts (m) in outages of one length (s) on training drives: tuned filter, fixes alone, baseline."""

    length_s: float
    tuned_m: float
    baseline_m: float
    fixes_alone_m: float


def larger_drifts(forecasts: Sequence[DriftComparison]) -> list[str]:
    """Return a sentence for each method that drifts less than the tuned filter."""
    sentences: list[str] = []
    for method, key in ((BASELINE, "baseline_m"), (FIXES, "fixes_alone_m")):
        pairs = [(one.length_s, one.tuned_m, float(getattr(one, key))) for one in forecasts]
        worse = [
            f"{length:g} s ({tuned:.3g} m instead of {other:.3g} m)"
            for length, tuned, other in pairs
            if tuned > other and f"{tuned:.3g}" != f"{other:.3g}"
        ]
        if worse:
            name = in_sentence(method, METHODS[method])
            sentences.append(f"the tuned filter drifts MORE than {name} in outages of {', '.join(worse)}")
    return sentences


def drift_table(forecasts: Sequence[DriftComparison], durations: Sequence[float] = ()) -> Table:
    """Return a table of drifts.

    The caption states which part of the drives was measured. ``durations`` are the durations of the drives, s.
    """
    first = f"first {MAX_NAMED_DRIVES} " * (len(durations) > MAX_NAMED_DRIVES)
    part = f", {CHECKED_TIME:g} s in the middle of each" * (
        max(durations[:MAX_NAMED_DRIVES], default=0) > CHECKED_TIME
    )
    rows = ("tuned", "tuned_m"), (BASELINE, "baseline_m"), (FIXES, "fixes_alone_m")
    return Table(
        f"RMS position drift at the end of an outage (a time without fixes), on the {first}training drives{part}",
        (Column("method"), *(Column(f"{one.length_s:g} s outage", "m") for one in forecasts)),
        tuple((METHODS[method], *(getattr(one, key) for one in forecasts)) for method, key in rows),
        strong=frozenset((0,)),
    )


def forecasts_of(
    parameters: FilterParameters,
    noise: MotionNoise,
    scorer: AnyBatchScorer,
    shown_std: float | None = None,
    executor: Executor | None = None,
) -> Iterator[DriftComparison]:
    """Measure the drift over outages of several lengths in the middle part of the first drives.

    On a drive of at most `CHECKED_TIME`, an evaluation with the default seed has the same outages and drift. For
    ``shown_std`` see `baseline`.
    """
    some = scorer.subset(range(min(len(scorer.dataset), MAX_NAMED_DRIVES)))
    for length in FORECAST_LENGTHS:
        measure = partial(drifts_of, parameters=parameters, length=length, noise=noise, shown_std=shown_std)
        drifts = _mean_drifts(some.map_prepared(measure, executor))
        if drifts[0] > 0:
            yield DriftComparison(length, *drifts)


def divergence_or_drift_warnings(
    parameters: FilterParameters, scorer: AnyBatchScorer, shown_std: float | None = None, *, outages: bool
) -> list[str]:
    messages = divergence_warnings(scorer.map_prepared(partial(restarts_of, parameters=parameters)))
    if messages or not outages:
        return messages
    some = scorer.subset(range(min(len(scorer.dataset), MAX_NAMED_DRIVES)))
    measure = partial(drifts_of, parameters=parameters, shown_std=shown_std)
    few = some.map_prepared(partial(measure, most=FIRST_SETS))
    return drift_warnings(some.map_prepared(measure)) if drift_warnings(few, RECHECK_RATIO) else []


def divergence_warnings(restarts: Iterable[tuple[str, list[float]]]) -> list[str]:
    diverged = [describe_restarts(name, times) for name, times in restarts if times]
    if not diverged:
        return []
    more = len(diverged) - MAX_NAMED_DRIVES
    others = f"; it also diverged on {count_of(more, 'more drive')}" if more > 0 else ""
    these = "this is a training drive" if len(diverged) == 1 else "these are training drives"
    why = f"the tuned filter {'; it '.join(diverged[:MAX_NAMED_DRIVES])}{others}, although {these}"
    return [to_do(REMEDY, why)]


def drift_warnings(drifts: Iterable[tuple[float, ...]], most: float = MAX_DRIFT_RATIO) -> list[str]:
    tuned, other = _mean_drifts(drifts)[:2]
    if tuned <= most * other:
        return []
    why = (
        f"in outages of {LONG_OUTAGE_LENGTH:g} s on its training drives, the tuned filter drifts {tuned:.3g} m, but "
        f"the baseline only {other:.3g} m"
    )
    return [to_do(REMEDY, why)]


def restarts_of(ready: PreparedDrive, parameters: FilterParameters) -> tuple[str, list[float]]:
    """Return a drive's name, and the times (s) in its first hour at which a monitored filter was reset."""
    return ready.drive.name, FilterRun(_first_part(ready), parameters, recover=True).finished().restarts


def correlation_of(ready: PreparedDrive, parameters: FilterParameters) -> float:
    """Return the lag-1 autocorrelation of the innovations in a drive's first hour, averaged over both axes."""
    innovations = FilterRun(_first_part(ready), parameters).finished().innovations
    with np.errstate(all="ignore"):  # a failed filter gives NaN and infinity
        nu = innovations.innovation / np.sqrt(np.diagonal(innovations.covariance, axis1=1, axis2=2))
        return float(np.mean(np.mean(nu[1:] * nu[:-1], axis=0) / np.mean(nu**2, axis=0)))


def correlation_warnings(
    parameters: FilterParameters, correlations: Iterable[float], use: Sequence[str] = ()
) -> list[str]:
    """Warn if innovations are correlated, and the filter could model correlated fix errors but does not.

    ``use`` contains the values of ``--use`` in the proposed command.
    """
    known = [value for value in correlations if np.isfinite(value)]
    augmented = kernel_name(parameters.model, parameters.kind, fix_error=True)
    supported = parameters.kind in ("ukf", "ekf") and augmented in FILTERS
    if parameters.fix_error is not None or not supported or not known or np.median(known) < MAX_CORRELATION:
        return []
    why = (
        "the innovations are correlated from fix to fix, so the errors of the fixes are probably correlated, and the "
        f"filter's covariance is too small (autocorrelation at lag 1: {np.median(known):.2f})"
    )
    return [to_do(f"tune with --use {' '.join([*use, 'fix-error'])}", why)]


def _first_part(ready: PreparedDrive) -> FilterPass:
    start = float(ready.drive.imu.time[0])
    return whole_pass(_part(ready, start, start + MONITORED_TIME))


def _part(ready: PreparedDrive, start: float, end: float) -> PreparedDrive:
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
    shown_std: float | None = None,
) -> tuple[float, ...]:
    """Return the RMS drifts (m) of a filter and of the baseline. If ``noise`` is given, append that of `FixesAlone`.

    Drifts are measured in the middle of the drive, over at most ``most`` sets of outages of ``length`` s. They are NaN
    if the drive is too short for an outage.
    """
    filters = {"tuned": parameters, BASELINE: baseline(ready.drive, parameters, shown_std)}
    return _drifts(
        ready, filters, {} if noise is None else {FIXES: partial(FixesAlone, noise=noise)}, length, most
    )


def _drifts(
    ready: PreparedDrive,
    filters: Mapping[str, FilterParameters],
    also: RunFactories,
    length: float,
    most: int | None,
) -> tuple[float, ...]:
    middle = float(ready.drive.imu.time[0] + ready.drive.imu.time[-1]) / 2
    part = _part(ready, middle - CHECKED_TIME / 2, middle + CHECKED_TIME / 2)
    try:
        outages = OutageDrifts(part, length=length, seed=0, most=most)
    except InputError:  # the car does not move in this part
        return np.nan, np.nan
    outages.run(filters, also, monitored=False)
    return tuple(outages.drift(method) for method in (*filters, *also))


def confirmed_std(like: FilterParameters, std: float, scorer: AnyBatchScorer) -> StdCheck | None:
    """Run the baseline with ``std`` and with the assumed standard deviation of the fixes, and compare the drifts.

    ``std`` is in m per axis. The baseline has the model and the options of ``like``. Return None if the drifts
    are unknown. Also return None if the ratio of the drift with ``std`` to the drift with the assumed value is above
    `MAX_CONFIRMED_RATIO`. This ratio is a geometric mean over the lengths of the outages.
    """
    some = scorer.subset(range(min(len(scorer.dataset), MAX_NAMED_DRIVES)))
    found: dict[float, list[float]] = {}
    for length in FORECAST_LENGTHS if np.isfinite(std) else ():
        drifts = _mean_drifts(some.map_prepared(partial(_drifts_by_std, like=like, std=std, length=length)))
        found |= {length: drifts} if drifts[1] > 0 else {}
    logs = [np.log(drift / assumed) for drift, assumed in found.values()]
    if OUTAGE_LENGTH not in found or np.mean(logs) > np.log(MAX_CONFIRMED_RATIO):
        return None
    return StdCheck(std, OUTAGE_LENGTH, *found[OUTAGE_LENGTH])


def _drifts_by_std(
    ready: PreparedDrive, like: FilterParameters, std: float, length: float
) -> tuple[float, ...]:
    """Return the RMS drifts (m) of the baseline with the standard deviation ``std`` and with the assumed one."""
    filters = {
        name: baseline(ready.drive, like, shown) for name, shown in (("shown", std), ("assumed", None))
    }
    return _drifts(ready, filters, {}, length, None)


def _mean_drifts(drifts_of_drives: Iterable[tuple[float, ...]]) -> list[float]:
    known = np.array([drifts for drifts in drifts_of_drives if np.isfinite(drifts).all()])
    return np.mean(known, axis=0).tolist() if len(known) else [0.0, 0.0]


def scale_warnings(objective: Objective, parameters: FilterParameters, scorer: AnyBatchScorer) -> list[str]:
    """Warn if the cost does not depend on the scale of the covariance. Propose a factor if possible."""
    if not objective.scale_free:
        return []
    before, name = scorer.scores([parameters]), objective.name
    nis = float(before.mean_nis.mean())
    state = f"the mean NIS is {nis:.2g}, but should be 2"
    message = f"{name} does not depend on the scale of the covariances ({state})"
    remedy = SCALE_REMEDY.format(objective=name, measure="nees" if objective.needs_truth else "nis")
    if parameters.model != "planar5" and nis > 0:
        after = scorer.scores([parameters.scaled(nis / 2)])
        moved = float(after.position_rmse.mean() / before.position_rmse.mean() - 1)
        if abs(moved) <= MAX_RMSE_CHANGE and abs(float(after.mean_nis.mean()) / 2 - 1) <= MAX_NIS_ERROR:
            right = (
                f"With all variances multiplied by {nis / 2:.3g}, the mean NIS is about 2, and the position RMSE "
                f"changes by {moved:+.1%}"
            )
            return [to_do(f"{remedy}, or use FilterParameters.scaled({nis / 2:.3g})", f"{message}. {right}")]
    return [to_do(remedy, message)]
