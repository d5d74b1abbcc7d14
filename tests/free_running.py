"""Compare whole runs of filters, with a twin: the same filter with a slightly different initial heading."""

from dataclasses import dataclass, replace

import numpy as np

from oracles.extended import THETA, covariance_error, mean_error
from oracles.filterpy_car import FilterPyCar
from sigmaswarm.drives import events
from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.timeline import Timeline
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets
from stepwise import steps_with_fixes

TWIN_TURN = 1e-13  # rad, change of the twin's initial heading
TWIN_LIMIT = 1e-12  # if the twin differs by more, the filter is chaotic, and a comparison proves nothing


@dataclass(frozen=True, eq=False)
class FreeRun:
    """One parameter set: distances of the compiled means (n, at IMU samples) from those of FilterPy and of a twin."""

    filterpy: np.ndarray
    filterpy_covariance: np.ndarray
    twin: np.ndarray

    @property
    def judged(self) -> np.ndarray:
        """Samples before the first one where the twin differs by more than TWIN_LIMIT."""
        return np.maximum.accumulate(self.twin) < TWIN_LIMIT


def free_run(
    timeline: Timeline, initial: InitialState, p: FilterParameters, n_steps: int | None = None
) -> FreeRun:
    """Run the compiled filter, FilterPy with the same root of P, and a compiled twin with a changed heading."""
    their_mean, their_covariance = filterpy_run(timeline, initial, p, n_steps, theta_first=True)
    n = len(their_mean)
    ours, twin = (compiled_run(timeline, start, p) for start in (initial, moved(initial, TWIN_TURN)))
    return FreeRun(
        filterpy=mean_error(ours[0][:n], their_mean),
        filterpy_covariance=covariance_error(ours[1][:n], their_covariance),
        twin=mean_error(twin[0][:n], ours[0][:n]),
    )


def compiled_run(
    timeline: Timeline, initial: InitialState, p: FilterParameters
) -> tuple[np.ndarray, np.ndarray]:
    """Return means and covariances of the compiled filter over the whole timeline."""
    run = FilterRun(FilterPass(timeline, initial, Targets.none(timeline)), p).whole()
    assert run.sound.all(), "the compiled filter failed"
    return run.mean, run.covariance


def filterpy_run(
    timeline: Timeline,
    initial: InitialState,
    p: FilterParameters,
    n_steps: int | None = None,
    *,
    theta_first: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Return means and covariances of FilterPy, which uses no measurements except fixes."""
    theirs = FilterPyCar(timeline, p, theta_first=theta_first)
    theirs.restart(initial.mean, initial.covariance)
    states = []
    for i, fix in steps_with_fixes(timeline, n_steps):
        theirs.step(i, events.IMU if fix is None else events.FIX, fix)
        if timeline.sampled[i]:
            states.append((theirs.mean, theirs.covariance))
    mean, covariance = map(np.array, zip(*states, strict=True))
    return mean, covariance


def moved(initial: InitialState, turn: float) -> InitialState:
    """Return the initial state with its heading changed by ``turn`` (rad)."""
    return replace(initial, mean=initial.mean + turn * np.eye(5)[THETA])
