"""What is said of scores in sentences: who lost its way, who is worse than what, how far off a filter may be."""

from collections.abc import Mapping, Sequence

import numpy as np

from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.filters.divergence import said_of_restarts
from sigmaswarm.scoring.consistency import CORRELATED
from sigmaswarm.scoring.drifts import UNTUNED
from sigmaswarm.scoring.measures import METHODS, POSITION_MEASURES, Measure
from sigmaswarm.scoring.records import ConsistencyRecord, ScoresRecord
from sigmaswarm.scoring.tracks import FirstLook
from sigmaswarm.wording import counted


def restarted(scores: ScoresRecord) -> tuple[str, ...]:
    """A sentence for each drive on which the tuned filter lost its way."""
    return tuple(
        f"the tuned filter {said_of_restarts(drive, found['tuned'])}"
        for drive, found in scores.restarts.items()
        if found.get("tuned")
    )


def said_of_drives(data: Sequence[DriveRecord]) -> str:
    """What a sentence calls drives: how many they are, and how much of them the tuning saw."""
    called = counted(len(data), "drive")
    if not any(drive.seen_s for drive in data):
        known = all(drive.seen_s is not None for drive in data)
        return f"{called} that the tuning never saw" if known else called
    told = [
        f"the tuning saw {drive.seen_s:.0f} of the {drive.duration_s or 0:.0f} s of {drive.name}, in "
        f"{', '.join(drive.seen_in)}"
        for drive in data
        if drive.seen_s
    ]
    return f"{called} (NOT {'all ' if len(data) > 1 else ''}held out: {'; '.join(told)})"


ALL_OF_IT = 0.99
"""Share of a drive from which on nobody needs to be told that truth lacks somewhere."""


def partly_scored(data: Sequence[DriveRecord]) -> tuple[str, ...]:
    """A sentence for each drive of which truth is known in parts only."""
    return tuple(
        f"errors on {drive.name} are those of {drive.truth_share:.0%} of the time from the filters' start on: "
        "truth is not known of the rest"
        for drive in data
        if drive.has_truth and drive.truth_share is not None and drive.truth_share < ALL_OF_IT
    )


def worse_than_raw(scores: ScoresRecord) -> tuple[str, ...]:
    """A sentence for each drive on which the tuned filter's position is worse than the fixes that it was given."""
    said: list[str] = []
    for drive, found in scores.drives.items():
        pairs = {
            what: (found["tuned"].get(measure), found["raw_gps"].get(measure))
            for measure, what in POSITION_MEASURES.items()
        }
        worse = [
            f"{what} {tuned:.3g} m against {raw:.3g} m"
            for what, (tuned, raw) in pairs.items()
            if tuned is not None and raw is not None and tuned > raw
        ]
        if worse:
            said.append(f"on {drive} the tuned filter is WORSE than the raw fixes: {', '.join(worse)}")
    return tuple(said)


FAR_BELOW = 1.0
"""Mean NIS, half of what it should be, below which forecasts say nothing of the error."""
MOST_TOLD = 3
"""Drives of which it is said how far off the filter may be."""


def how_far(scores: ScoresRecord, data: Sequence[DriveRecord]) -> tuple[str, ...]:
    """How many metres the tuned filter is off on each of the first drives without truth, as far as the log tells."""
    blind = [one.name for one in data if one.has_truth is False]
    told = [(name, c) for name in blind if (c := scores.consistency.get(name)) and c.own_sigma_m]
    return tuple(_without_truth(name, c) for name, c in told[:MOST_TOLD])


def said_of_first_look(look: FirstLook) -> str:
    """How many metres the tuned filter is off on a drive that it was tuned on, in a sentence; empty if unknown."""
    name, rmse = look.picture.whole.name, look.position_rmse
    if np.isfinite(rmse["tuned"]):
        others = ", ".join(
            f"{METHODS[m]} {rmse[m]:.2g} m" for m in (UNTUNED, "raw_gps") if np.isfinite(rmse[m])
        )
        return f"{rmse['tuned']:.2g} m RMSE on {name} ({others}), where it was tuned: elsewhere it is rather more"
    if look.consistency is None or not look.consistency.own_sigma:
        return ""
    return _without_truth(name, ConsistencyRecord.of(look.consistency))


def _without_truth(drive: str, found: ConsistencyRecord) -> str:
    said = said_of_position(found)
    return f"How far off on {drive}, without truth? {said[0].upper()}{said[1:]}"


def said_of_position(found: ConsistencyRecord) -> str:
    """How many metres a filter is off on a drive without truth, as far as the log tells.

    That is its own word (RMS of its sigmas), held against its forecasts of the fixes. Where it misses these by far less
    than it expects, the receiver smooths its fixes, or their errors last: then it may be off by as much as they are.
    """
    own, missed, expected = found.own_sigma_m or 0.0, found.missed_m or 0.0, found.expected_m or 0.0
    (low, high), nis = found.nis_band_95, f"mean NIS {found.mean_nis:.2g} where 2 is right"
    alike = found.autocorrelation[0] > CORRELATED
    if found.mean_nis < low and (alike or found.mean_nis < FAR_BELOW):
        fixes = max(expected**2 - own**2, 0.0) ** 0.5
        return (
            f"this log can't tell: perhaps {fixes:.2g} m, by which the filter takes the fixes to be off. It says "
            f"{own:.2g} m (RMS) of itself, but its forecasts miss the fixes by less than it expects ({nis}): the "
            "receiver smooths its fixes, or their errors last"
        )
    said = f"{own:.2g} m (RMS), as the filter itself says"
    included = f"its forecasts miss the fixes by {missed:.2g} m, their own errors included"
    if found.mean_nis > high:
        return f"more than {said}: {included}, which is more than it expects ({nis})"
    if found.mean_nis < low:
        return f"{said}, or somewhat less: {included}, which is less than it expects ({nis})"
    if alike:
        return f"{said}, or more: {included}, as it expects, but each fix in part like the one before"
    return f"about {said}, and the log bears it out: {included}, as it expects. What all fixes share is not in it"


NOTABLE = 0.9
"""Share of the tuned filter's error below which another's is said to be less."""


def worse_than_untuned(scores: ScoresRecord, shown: Mapping[str, Measure]) -> tuple[str, ...]:
    """A sentence where the data-sheet filter is better on average over the drives, by what; else none."""
    compared = ("position_rmse_m", "heading_rmse_deg", "outage_drift_m", "long_outage_drift_m")
    pairs = {m: (scores.mean_of("tuned", m), scores.mean_of(UNTUNED, m)) for m in compared}
    known = {
        m: (tuned, other) for m, (tuned, other) in pairs.items() if tuned is not None and other is not None
    }
    worse = {m: pair for m, pair in known.items() if pair[1] < NOTABLE * pair[0]}
    if not worse:
        return ()
    each = ", ".join(
        f"{shown[m].title} {tuned:.3g} {shown[m].unit} against {other:.3g} {shown[m].unit}"
        for m, (tuned, other) in worse.items()
    )
    if "position_rmse_m" in worse or 2 * len(worse) > len(known):
        return (f"the tuned filter is WORSE than the data-sheet filter, which nobody tuned: {each}",)
    others = f"worse in {len(worse)} of {len(known)} measures"
    return (f"the tuned filter is {others} than the data-sheet filter, which nobody tuned: {each}",)
