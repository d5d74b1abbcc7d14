"""Whether a tuned filter keeps its way on the drives that it was tuned on: an objective hardly sees where it does not.

While it is tuned a filter is not set right where it is lost, so that its cost there is that of a wrong track; but a
likelihood that bears outliers bears a lost filter, too. And forecasts of the next fix say little of the next minute: a
search that ended too early may leave a filter that forecasts nearly as well as the best, and drifts a kilometre.
"""

from collections.abc import Iterable

import numpy as np

from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.split import clip
from sigmaswarm.errors import InputError
from sigmaswarm.filters.divergence import said_of_restarts
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import baseline
from sigmaswarm.filters.recording import Recording
from sigmaswarm.filters.run import replay_of
from sigmaswarm.scoring.drifts import UNTUNED, Outages
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH
from sigmaswarm.wording import to_do

NAMED = 3
"""Drives in one message, and that are looked at for their drifts."""
WATCHED = 3600.0
"""s of a drive that a filter is watched over: of more, steps would take more memory than all else."""
FAR = 1.5
"""Times the drift of a filter that nobody tuned, to be told."""
FEW = 2
"""Placements of outages that are looked at first."""
NEAR = 1.2
"""Times the drift of a filter that nobody tuned, over the `FEW`, from which on all placements are looked at. Of 140
filters on simulated drives 71 drift `FAR`, and none of these less than this over the few: their ratio is off by 10%."""
LOOK = 600.0
"""s of a drive that are looked at for its drift, its middle."""
REMEDY = (
    "DON'T USE IT; leave --model and --use out, which then suit the logs, or tune with more --trials, or on more "
    "drives"
)


def restarts_of(ready: PreparedDrive, parameters: FilterParameters) -> tuple[str, list[float]]:
    """A drive's name, and when a filter that is watched started anew in its first `WATCHED`, s."""
    start = float(ready.drive.imu.time[0])
    replay = replay_of(_part(ready, start, start + WATCHED))
    return ready.drive.name, Recording(replay, parameters, recover=True).finished().restarts


def _part(ready: PreparedDrive, start: float, end: float) -> PreparedDrive:
    """A part of a drive, s on its clock; itself where it is no longer than that."""
    time = ready.drive.imu.time
    if start <= time[0] and time[-1] <= end:
        return ready
    return PreparedDrive(clip(ready.drive, start, end), as_recorded=ready.as_recorded)


def said_of_lost(found: Iterable[tuple[str, list[float]]]) -> list[str]:
    """What a user should know of a filter that was lost on its own training drives, in a sentence."""
    lost = [said_of_restarts(name, times) for name, times in found if times]
    if not lost:
        return []
    more = f"; and on {len(lost) - NAMED} more drives" if len(lost) > NAMED else ""
    return [to_do(REMEDY, f"the tuned filter {'; it '.join(lost[:NAMED])}{more}, though it was tuned there")]


def drifts_of(
    ready: PreparedDrive, parameters: FilterParameters, most: int | None = None
) -> tuple[float, float]:
    """What a filter and the same by data sheet drift over the long outages, m; NaN where none fits.

    ``most``: placements of them that are looked at; by default all.
    """
    middle = float(ready.drive.imu.time[0] + ready.drive.imu.time[-1]) / 2
    try:
        outages = Outages(
            _part(ready, middle - LOOK / 2, middle + LOOK / 2), length=LONG_OUTAGE_LENGTH, seed=0, most=most
        )
    except InputError:  # the car stands there
        return np.nan, np.nan
    outages.run({"tuned": parameters, UNTUNED: baseline(ready.drive, like=parameters)}, watched=False)
    return outages.drift("tuned"), outages.drift(UNTUNED)


def _together(found: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Over all drives; 0 where nothing is known."""
    known = np.array([pair for pair in found if np.isfinite(pair).all()])
    if not len(known):
        return 0.0, 0.0
    tuned, other = np.sqrt(np.mean(known**2, axis=0)).tolist()
    return tuned, other


def may_drift_far(found: Iterable[tuple[float, float]]) -> bool:
    """Whether a filter may, by a few outages, drift much further than one that nobody tuned: then all are to tell."""
    tuned, other = _together(found)
    return tuned > NEAR * other


def said_of_drifts(found: Iterable[tuple[float, float]]) -> list[str]:
    """The same of one that drifts much further than a filter that nobody tuned, over all drives together."""
    tuned, other = _together(found)
    if tuned <= FAR * other:
        return []
    why = (
        f"over {LONG_OUTAGE_LENGTH:g} s without fixes the tuned filter drifts {tuned:.3g} m where it was tuned, the "
        f"data-sheet filter, which nobody tuned, {other:.3g} m"
    )
    return [to_do(REMEDY, why)]
