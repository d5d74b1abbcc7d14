"""`tune`: search the filter parameters that serve a set of drives best."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.tuning.config import TuneConfig, validated_config
from sigmaswarm.tuning.problem import CarProblem, Problem
from sigmaswarm.tuning.result import Tuning, versions
from sigmaswarm.tuning.search import Progress, Search, Trial
from sigmaswarm.tuning.store import ResultFolder


def tune(
    drives: Sequence[Drive] | Drive,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
    **config: Any,
) -> Tuning:
    """Tune a filter on drives with particle swarm optimization.

    Parameters
    ----------
    drives : Drive or sequence of Drive
        The training drives. Keep others back for `evaluate`.
    out : path, optional
        A folder for results; every generation is saved in it, so that a killed run can be resumed.
    resume : bool
        Go on with what ``out`` holds. The result has the same bits as that of an uninterrupted run.
    executor : concurrent.futures.Executor, optional
        Shares the work; threads on all cores by default. The result's bits do not depend on it.
    progress : callable, optional
        Called with a `Progress` after every generation.
    **config
        The fields of `TuneConfig`: objective, scale, particles, generations, trials, seed, model, ...

    Raises
    ------
    InputError
        If an option or the folder can't be used, the objective needs truth that a drive does not have, or no
        parameter set gave a finite cost.
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    drives = [drives] if isinstance(drives, Drive) else list(drives)
    settings = validated_config(config)
    problem = CarProblem(drives, settings)
    if problem.objective.warning:
        warnings.warn(problem.objective.warning, SigmaswarmWarning, stacklevel=2)
    folder = None
    if out is not None:  # made only once nothing is left that the user could have got wrong
        asked = {**settings.model_dump(mode="json"), "data": problem.data, "versions": versions()}
        folder = ResultFolder(Path(out), asked, resume=resume)
    with ExitStack() as stack:
        pool = executor or stack.enter_context(ThreadPoolExecutor())
        search = Search(settings, problem, pool, folder, progress)
        trials = tuple(search.trial(i) for i in range(settings.trials))
    tuning = _chosen(trials, problem, settings)
    if folder is not None:
        tuning.save(folder.path / "tuning.toml")
    return tuning


def _chosen(trials: tuple[Trial, ...], problem: Problem, config: TuneConfig) -> Tuning:
    best = int(np.argmin([trial.cost for trial in trials]))
    if not np.isfinite(trials[best].cost):
        raise InputError(
            "no parameter set gave a finite cost: every filter failed on at least one drive; "
            "look for NaN or wildly wrong values in the drives"
        )
    point = trials[best].point
    return Tuning(
        parameters=problem.space.decode(point[np.newaxis])[0],
        cost=trials[best].cost,
        touched_bounds=problem.space.touched(point),
        trials=trials,
        best_trial=best,
        config=config,
        data=problem.data,
    )
