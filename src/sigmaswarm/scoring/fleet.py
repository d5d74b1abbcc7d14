"""Scores on drives that a cluster's workers hold: parameter sets go there, and numbers come back."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.table import ParameterTable
from sigmaswarm.fleets.fleet import Fleet, told_of_each
from sigmaswarm.fleets.held import Held, Kept
from sigmaswarm.fleets.holder import Refused, tried
from sigmaswarm.scoring.batch import Passes, Replayer, Replays, Scores

T = TypeVar("T")
Fits = Callable[[Replayer], None]
"""Raises an `InputError` where what was made ready does not serve; of a module, or a partial of such."""


def replays_on(held: Held, passes: Passes, fits: Fits) -> Replays:
    """Drives made ready where they are, for the passes that are asked for.

    Raises
    ------
    AlignmentError
        If a drive never moves far enough to start a filter.
    InputError
        What ``fits`` raises. On a fleet all drives are named that can't be used.
    """
    if isinstance(held, Fleet):
        return FleetReplays(held, passes, fits)
    return _made(
        [PreparedDrive(d, as_recorded=passes.as_recorded) for d in held.of_each(_itself)], passes, fits
    )


def _itself(drive: Drive) -> Drive:
    return drive


def _made(ready: Sequence[PreparedDrive], passes: Passes, fits: Fits) -> Replayer:
    replayer = Replayer(
        ready,
        outages=passes.outages,
        forecasts=passes.forecasts,
        outage_seed=passes.outage_seed,
    )
    fits(replayer)
    return replayer


class FleetReplays:
    """`Replays` on the workers of a cluster.

    Parameters
    ----------
    fleet : Fleet
    passes : Passes
    fits : callable
        See `replays_on`.
    steps : ndarray of int, shape (n_drives,), optional
        Where they are known.
    """

    def __init__(
        self, fleet: Fleet, passes: Passes, fits: Fits, steps: NDArray[np.int64] | None = None
    ) -> None:
        self.held, self._asked = fleet, (passes, fits)
        self.steps = (
            np.array(told_of_each(fleet.ask(_ready, *self._asked)), np.int64) if steps is None else steps
        )

    def subset(self, drives: Sequence[int]) -> "FleetReplays":
        """Of some of the drives, by index."""
        return FleetReplays(self.held.subset(drives), *self._asked, self.steps[list(drives)])

    def scores(self, parameter_sets: Sequence[FilterParameters], executor: Executor | None = None) -> Scores:
        """Scores of all sets on all drives; workers share the work, and the executor has none."""
        return Scores.unstacked(self._joined(Scores.stacked, parameter_sets))

    def measured(
        self,
        take: Callable[[Scores], Array],
        parameter_sets: Sequence[FilterParameters],
        executor: Executor | None = None,
    ) -> Array:
        """What a function of a module takes from the scores, shape (n_sets, n_drives)."""
        return self._joined(take, parameter_sets)

    def of_each_prepared(self, function: Callable[[PreparedDrive], T]) -> list[T]:
        """What a function of a module says of each drive."""
        passes, _ = self._asked
        return told_of_each(self.held.ask(of_each_prepared, function, passes.as_recorded))

    def _joined(self, take: Callable[[Scores], Array], parameter_sets: Sequence[FilterParameters]) -> Array:
        """Answers of shape (..., n_sets, n_drives), put in the order of the drives as one process has them."""
        sets = parameter_sets if isinstance(parameter_sets, ParameterTable) else tuple(parameter_sets)
        answers = self.held.ask(_taken, *self._asked, take, sets)
        shape = answers[0][1].shape[:-1]
        whole = np.empty((len(self.held), *shape[::-1])).T  # as `Replayer`: sums over drives depend on it
        for places, part in answers:
            whole[..., places] = part
        return whole


def _ready(kept: Sequence[Kept], _: Executor | None, passes: Passes, fits: Fits) -> list[Any]:
    """Make drives ready; the steps of each, or why it can't be."""
    return [_steps(one, passes, fits) for one in kept]


def _steps(one: Kept, passes: Passes, fits: Fits) -> int | Refused:
    try:
        return int(_replayer(one, passes, fits).steps[0])
    except InputError as error:
        return Refused(error)


def _replayer(one: Kept, passes: Passes, fits: Fits) -> Replayer:
    return one.once(passes, lambda _: _made([_prepared(one, passes.as_recorded)], passes, fits))


def _prepared(one: Kept, as_recorded: bool) -> PreparedDrive:
    return one.once(("prepared", as_recorded), partial(PreparedDrive, as_recorded=as_recorded))


def of_each_prepared(
    kept: Sequence[Kept], _: Executor | None, function: Callable[[PreparedDrive], Any], as_recorded: bool
) -> list[Any]:
    """For `Fleet.ask`: what a function says of each drive made ready, which shares it with what is replayed."""
    return [tried(function, _prepared(one, as_recorded)) for one in kept]


def _taken(
    kept: Sequence[Kept],
    pool: Executor | None,
    passes: Passes,
    fits: Fits,
    take: Callable[[Scores], Array],
    parameter_sets: Sequence[FilterParameters],
) -> Array:
    replayer = Replayer.together([_replayer(one, passes, fits) for one in kept])
    return take(replayer.scores(parameter_sets, pool))
