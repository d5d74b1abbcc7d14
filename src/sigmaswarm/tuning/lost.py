"""Whether a tuned filter keeps its way on the drives that it was tuned on: an objective hardly sees where it does not.

While it is tuned a filter is not set right where it is lost, so that its cost there is that of a wrong track; but a
likelihood that bears outliers bears a lost filter, too.
"""

from collections.abc import Iterable

from sigmaswarm.drives.drive import Drive
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recording import Recording
from sigmaswarm.filters.recovery import said_of_restarts
from sigmaswarm.filters.run import replay_of

NAMED = 3
"""Drives in one message."""


def restarts_of(drive: Drive, parameters: FilterParameters, *, as_recorded: bool) -> tuple[str, list[float]]:
    """A drive's name, and when a filter that is watched started anew on it, s."""
    replay = replay_of(drive, as_recorded=as_recorded)
    return drive.name, Recording(replay, parameters, recover=True).finished().restarts


def said_of_lost(found: Iterable[tuple[str, list[float]]]) -> list[str]:
    """What a user should know of a filter that was lost on its own training drives, in a sentence."""
    lost = [said_of_restarts(name, times) for name, times in found if times]
    if not lost:
        return []
    more = f"; and on {len(lost) - NAMED} more drives" if len(lost) > NAMED else ""
    return [
        f"DON'T USE IT: the tuned filter {'; it '.join(lost[:NAMED])}{more}, though it was tuned there; leave --model "
        "and --use out, which then suit the logs, or tune on more drives"
    ]
