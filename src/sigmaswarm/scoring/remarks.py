"""Sentences about scores."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.drives.sensors import UNSTATED_GPS_STD
from sigmaswarm.filters.divergence import describe_restarts
from sigmaswarm.scoring.consistency import MAX_CORRELATION, TRACKING, Consistency, RadiusRecord
from sigmaswarm.scoring.methods import (
    BASELINE,
    DRIFTS,
    FIXES,
    METHODS,
    POSITION_MEASURES,
    Measure,
    in_sentence,
)
from sigmaswarm.scoring.records import ScoresRecord
from sigmaswarm.scoring.tracks import FirstTrack
from sigmaswarm.wording import count_of

COMPLETE_SHARE = 0.99  # fraction of the time with truth above which gaps are not reported
MIN_INFORMATIVE_NIS = 1.0  # mean NIS below which innovations do not show the position error
# Ratio of a method's error to the tuned filter's error, below which a method without tuning is reported as better
MAX_ERROR_RATIO = 0.9

# Ratio of the error with correlated fix errors to the filter's estimate above which a range is stated
MAX_LASTING_RATIO = 1.5
COMMON_ERROR = "The estimate does not account for errors that all fixes share"

# Properties of sensors: name, unit, factor. A drive has other sensors if a property is at least the largest value of
# the training drives times the factor, or at most the smallest value divided by the factor.
SENSORS = ("IMU", "Hz", 1.5), ("standard deviation of the fixes", "m", 2.5)


def restarted(scores: ScoresRecord) -> tuple[str, ...]:
    return tuple(
        f"the tuned filter {describe_restarts(drive, times)}"
        for drive, by_method in scores.restarts.items()
        if (times := by_method.get("tuned"))
    )


def describe_training_drives(drive: DriveRecord) -> str:
    """Return a sentence on the part of a drive that the tuning used, with the names of other drives that contain it."""
    used, whole = drive.seen_s or 0.0, drive.duration_s or 0.0
    part = "all" if round(used) >= round(whole) else f"{used:.0f}"
    others = [name for name in drive.seen_in if name != drive.name]
    as_others = f", as part of {', '.join(others)}" if others else ""
    return f"the tuning used {part} of the {whole:.0f} s of {drive.name}{as_others}"


def describe_drives(data: Sequence[DriveRecord]) -> str:
    called = count_of(len(data), "drive")
    training = [describe_training_drives(drive) for drive in data if drive.seen_s]
    if training:
        partly = "PARTLY " if len(training) < len(data) else ""
        return f"{called} ({partly}TRAINING DATA: {'; '.join(training)})"
    return called + " that the tuning did not use" * all(drive.seen_s is not None for drive in data)


def other_sensors(drive: DriveRecord, training: Sequence[DriveRecord]) -> str:
    """Describe sensors of an evaluated drive that clearly differ from those of all training drives; "" if none do.

    Assumed standard deviations of fixes are not compared.
    """
    differences: list[str] = []
    drives = drive, *training
    rates = [(one.imu_samples or 0) / (one.duration_s or np.inf) for one in drives]
    stds = [one.receiver_std_m or 0.0 for one in drives]
    values = rates, [0.0 if std == UNSTATED_GPS_STD else std for std in stds]
    for (name, unit, ratio), (here, *known) in zip(SENSORS, values, strict=True):
        others = [value for value in known if value]
        if others and here and not min(others) / ratio < here < max(others) * ratio:
            differences.append(f"{name} {here:.3g} {unit} instead of {np.median(others):.3g} {unit}")
    if not differences:
        return ""
    return (
        f"the sensors or surroundings of {drive.name} differ from those of the training drives "
        f"({', '.join(differences)}). The filter can be far less accurate on this drive than on the training drives; "
        "tune on drives with these sensors, and compare the two filters with --against"
    )


def partly_scored(data: Sequence[DriveRecord]) -> tuple[str, ...]:
    return tuple(
        f"the errors on {drive.name} cover {drive.truth_share:.0%} of the time after the start of the filters, since "
        "there is no truth at other times"
        for drive in data
        if drive.has_truth and drive.truth_share is not None and drive.truth_share < COMPLETE_SHARE
    )


def worse_than_raw(scores: ScoresRecord) -> tuple[str, ...]:
    messages: list[str] = []
    for drive, by_method in scores.drives.items():
        worse = [
            f"{what} {tuned:.3g} m instead of {raw:.3g} m"
            for measure, what in POSITION_MEASURES.items()
            if (tuned := by_method["tuned"].get(measure)) is not None
            and (raw := by_method["raw_gps"].get(measure)) is not None
            and tuned > raw
        ]
        if worse:
            messages.append(f"on {drive} the tuned filter is WORSE than the raw fixes: {', '.join(worse)}")
    return tuple(messages)


def worse_than_untuned(scores: ScoresRecord, shown: Mapping[str, Measure]) -> dict[str, str]:
    """Return a message for each method without tuning that is more accurate than the tuned filter in some measures."""
    messages: dict[str, str] = {}
    for method in (BASELINE, FIXES):
        name = in_sentence(method, METHODS[method])
        worse, known = _worse_measures(scores, shown, method)
        values = ", ".join(
            f"{shown[m].title} {tuned:.3g} {shown[m].unit} instead of {other:.3g} {shown[m].unit}"
            for m, (tuned, other) in worse.items()
        )
        if _is_worse(worse, known):
            messages[method] = f"the tuned filter is WORSE than {name}: {values}"
        elif worse:
            among = f"{len(worse)} of {known} measures"
            messages[method] = f"the tuned filter is worse than {name} in {among}: {values}"
    return messages


def is_worse_than_untuned(scores: ScoresRecord, shown: Mapping[str, Measure]) -> bool:
    return any(_is_worse(*_worse_measures(scores, shown, method)) for method in (BASELINE, FIXES))


def _is_worse(worse: Collection[str], known: int) -> bool:
    return "position_rmse_m" in worse or 2 * len(worse) > known


def _worse_measures(
    scores: ScoresRecord, shown: Mapping[str, Measure], method: str
) -> tuple[dict[str, tuple[float, float]], int]:
    """Return the means (tuned, method) of the measures that are over 10% lower for the method.

    Also return the number of measures with both means.
    """
    known = {
        m: (tuned, other)
        for m in ("position_rmse_m", "heading_rmse_deg", *DRIFTS)
        if m in shown
        and (tuned := scores.mean_of("tuned", m)) is not None
        and (other := scores.mean_of(method, m)) is not None
    }
    return {m: pair for m, pair in known.items() if pair[1] < MAX_ERROR_RATIO * pair[0]}, len(known)


def estimate_position_errors(scores: ScoresRecord, data: Sequence[DriveRecord]) -> tuple[str, ...]:
    """Estimate the position error on each of the first three drives without truth."""
    without_truth = [one.name for one in data if one.has_truth is False]
    known = [(name, c) for name in without_truth if (c := scores.consistency.get(name)) and c.own_sigma]
    return tuple(_without_truth(name, c, scores.radius.get(name, {}).get(TRACKING)) for name, c in known[:3])


def describe_first_track(track: FirstTrack) -> str:
    """Return sentences on the position error on a training drive. Return "" if unknown."""
    name, rmse = track.picture.whole.name, track.position_rmse
    if np.isfinite(rmse["tuned"]):
        known = [m for m in (BASELINE, "raw_gps") if np.isfinite(rmse[m])]
        others = ", ".join(f"{METHODS[m]} {rmse[m]:.2g} m" for m in known)
        return (
            f"Position error on {name}: {rmse['tuned']:.2g} m RMSE ({others}). This is a training drive, so expect "
            "larger errors on other drives"
        )
    if track.consistency is None or not track.consistency.own_sigma:
        return ""
    return _without_truth(name, track.consistency, track.radius)


def _without_truth(drive: str, consistency: Consistency, radius: RadiusRecord | None) -> str:
    return f"Position error on {drive}: {describe_position(consistency, radius.lasting_m if radius else 0.0)}"


def describe_position(consistency: Consistency, lasting: float = 0.0) -> str:
    """Describe a filter's position error on a drive without truth: an estimate, followed by the evidence.

    The estimate is the RMS of the filter's position standard deviations. The error is unknown if the innovations are
    far smaller than expected, or smaller than expected and correlated. An unknown error can be as large as the expected
    innovations. It can also be as large as the errors that successive fixes share, since innovations do not show these
    errors. ``lasting`` is the RMS of the shared errors, m per axis. The covariance does not include them.
    """
    own, missed = consistency.own_sigma or 0.0, consistency.missed or 0.0
    (low, high), nis = consistency.nis_band, f"mean NIS {consistency.mean_nis:.2g}, should be 2"
    expected = consistency.expected or 0.0
    alike = consistency.autocorrelation[0] > MAX_CORRELATION
    largest = (own**2 + 2 * lasting**2) ** 0.5
    if consistency.mean_nis < low and (alike or consistency.mean_nis < MIN_INFORMATIVE_NIS):
        guess = ""
        if largest > max(expected, own):
            guess = (
                f". If successive fixes share errors of {lasting:.2g} m per axis, the position error is about "
                f"{largest:.2g} m RMS"
            )
        elif expected > own:
            guess = (
                ". The position error may be as large as the difference between prediction and fix that the filter "
                f"expects, {expected:.2g} m RMS"
            )
        return (
            f"unknown, since there is no truth{guess}. The filter's covariance corresponds to {own:.2g} m RMS, but "
            f"this value is not reliable: the innovations are smaller than expected ({nis}). The receiver smooths its "
            "fixes, or their errors are correlated"
        )
    size, source = f"{own:.2g} m RMS", "estimated by the filter, since there is no truth"
    included = f"The fixes, with their own errors, differ from the predictions by {missed:.2g} m RMS"
    if consistency.mean_nis > high:
        return f"more than the {size} that the filter estimates. {included}, more than the filter expects ({nis})"
    if largest > MAX_LASTING_RATIO * own:
        return (
            f"between {own:.2g} and {largest:.2g} m RMS, estimated without truth. The upper value includes errors that "
            f"successive fixes share. The lower value is from the filter's covariance. The log does not show the size "
            f"of the shared errors; the upper value assumes {lasting:.2g} m per axis"
        )
    if consistency.mean_nis < low:
        return f"about {size}, {source}. {COMMON_ERROR}. {included}, which is less than expected ({nis})"
    if alike:
        return (
            f"{size} or more, {source}. Consecutive fixes differ from the predictions in the same direction. "
            f"{included}, as expected, but the innovations are correlated"
        )
    return f"about {size}, {source}. {COMMON_ERROR}. {included}, as expected"
