"""`tune`: search the filter parameters with the lowest cost on a set of drives."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, Unpack, overload

import numpy as np

from sigmaswarm.datasets.dataset import Dataset, datasets_of
from sigmaswarm.drives.drive import Drive, listed
from sigmaswarm.drives.overlap import SEEN_FILE, SavedLandmarks, overlap_of, save_landmarks
from sigmaswarm.drives.sensors import sensors_of
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.files import held_folder
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.jobs import cores
from sigmaswarm.tuning.config import (
    ModelTuneConfig,
    SearchConfig,
    TuneConfig,
    current_options,
    paper_options,
    validated_config,
)
from sigmaswarm.tuning.custom import model_problem
from sigmaswarm.tuning.defaults import settled, with_filter
from sigmaswarm.tuning.inflation import inflated
from sigmaswarm.tuning.options import SearchOptions, TuneOptions
from sigmaswarm.tuning.problem import CarProblem, Problem, car_problem
from sigmaswarm.tuning.record import FILE
from sigmaswarm.tuning.result import Tuning, Validation
from sigmaswarm.tuning.search import Progress, Search, Trial
from sigmaswarm.tuning.sensitivity import sensitivities
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

    from sigmaswarm.drives.reader import Location

TAKES = "tune takes Drives, or Logs together with model=Model(...)"
ARGUMENTS = ("validation", "out", "resume", "paper", "executor", "cluster", "progress")
P = TypeVar("P")


@overload
def tune(
    drives: "Sequence[Drive | Location] | Drive | Location | Dataset",
    *,
    validation: "Sequence[Drive | Location] | Drive | Location | Dataset" = ...,
    out: str | Path | None = None,
    resume: bool = False,
    paper: bool = False,
    executor: Executor | None = None,
    cluster: "Client | None" = None,
    progress: Callable[[Progress], None] | None = None,
    **config: Unpack[TuneOptions],
) -> Tuning[FilterParameters]: ...
@overload
def tune(
    drives: Sequence[Log] | Log,
    *,
    model: Model,
    validation: Sequence[Log] | Log = ...,
    out: str | Path | None = None,
    resume: bool = False,
    paper: bool = False,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
    **config: Unpack[SearchOptions],
) -> Tuning[dict[str, float]]: ...
def tune(
    drives: "Sequence[Drive | Location] | Sequence[Log] | Drive | Location | Log | Dataset",
    *,
    validation: "Sequence[Drive | Location] | Sequence[Log] | Drive | Location | Log | Dataset" = (),
    out: str | Path | None = None,
    resume: bool = False,
    paper: bool = False,
    executor: Executor | None = None,
    cluster: "Client | None" = None,
    progress: Callable[[Progress], None] | None = None,
    **config: Any,
) -> Tuning[Any]:
    """Tune a filter on drives.

    Parameters
    ----------
    drives : Drive or sequence of Drive; Log or sequence of Log
        The training drives, or the logs of a model of your own. Keep others back for `evaluate`. With a ``cluster``
        also paths and URLs of drives, which its workers read.
    validation : Drive or sequence of Drive
        Drives that the search does not see. The result holds their cost; nothing is chosen by it.
    out : path, optional
        A folder for results. Every generation is saved in it, so that a killed run can be resumed.
    resume : bool
        Continue the run in ``out``. The result has the same bits as that of an uninterrupted run.
    paper : bool
        Use the paper's setting, `PAPER`: a swarm of 30 x 50 on a linear scale, gps-rmse, planar5. Options that
        contradict it are refused.
    executor : concurrent.futures.Executor, optional
        Runs the work; by default threads on all cores. The result's bits do not depend on it.
    cluster : distributed.Client, optional
        A Dask cluster whose workers read the drives and do the work. The result's bits do not depend on it.
    progress : callable, optional
        Called with a `Progress` after every generation.
    **config
        Fields of `TuneConfig`: objective, particles, generations, trials, seed, model, ... Without ``model`` and
        ``use`` the filter is chosen by the drives' sensors: tilted12 or planar8, with lateral, standstill and what
        else the logs allow; the result's ``config`` states the choice. ``model`` may be a `Model` of your own, whose
        objectives are truth-rmse and innovation-nll. ``optimizer`` may be a class of your own, see
        `tuning.optimizers`.

    Raises
    ------
    InputError
        If an option or the folder can't be used, the objective needs truth that a drive does not have, or no
        parameter set gave a finite cost.
    AlignmentError
        If a drive never moves far enough to start a filter.
    ClusterError
        If the cluster can't do the work: its scheduler is gone, a worker has other versions, the drives don't fit.
    """
    options = current_options(config_type(config), config, ARGUMENTS)
    options = paper_options(options) if paper else options
    if isinstance(options.get("model"), Model):
        if cluster is not None:
            raise InputError("cluster: a model of your own runs on this machine only; leave cluster out")
        problem, others, settings = _own_problem(listed(drives), listed(validation), options)
    else:
        data, others = datasets_of(drives, validation, cluster=cluster, executor=executor, takes=TAKES)
        problem, settings = _car_problem(data, others, options)
    held_back = problem.on(others) if len(others) else None
    if held_back:
        check_apart(problem, held_back)
    with ExitStack() as stack:
        folder = seen = None
        if out is not None:  # created only after all checks of the input
            folder = tuning_folder(
                stack.enter_context(held_folder(Path(out))), problem, settings, resume=resume
            )
            if problem.seen:
                names = tuple((entry["name"], entry["sha256"]) for entry in problem.data)
                save_landmarks(problem.seen, folder.path / SEEN_FILE, names)
                seen = SavedLandmarks(folder.path / SEEN_FILE, names)
        pool = executor or stack.enter_context(ThreadPoolExecutor(cores()))
        tuning = tune_problem(problem, settings, pool, held_back=held_back, folder=folder, progress=progress)
    if isinstance(problem.seen, tuple):
        return tuning
    # the cluster may be gone before the result is
    return replace(tuning, seen=tuple(problem.seen) if seen is None else seen)


def config_type(options: Mapping[str, Any]) -> type[SearchConfig]:
    """Return the model of the options: of a built-in filter model, or of one of the user's own."""
    return ModelTuneConfig if isinstance(options.get("model"), Model) else TuneConfig


def tuning_folder(path: Path, problem: Problem[Any], config: SearchConfig, *, resume: bool) -> ResultFolder:
    """Open the folder of a tuning, which records the configuration and the data."""
    asked = {**config.model_dump(mode="json"), "data": problem.data, "versions": versions()}
    return ResultFolder(path, asked, resume=resume)


def tune_problem(
    problem: Problem[P],
    config: SearchConfig,
    executor: Executor | None = None,
    *,
    held_back: Problem[P] | None = None,
    folder: ResultFolder | None = None,
    progress: Callable[[Progress], None] | None = None,
    diagnose: bool = True,
) -> Tuning[P]:
    """Run, resume or read the trials of a tuning, and write its tuning.toml.

    Without an executor all work is done in this thread. ``diagnose`` checks the filter for faults that the objective
    does not see.
    """
    search = Search(config, problem, executor, folder, progress)
    trials = tuple(search.trial(i) for i in range(config.trials))
    tuning = _best_of(trials, problem, held_back, config, executor, diagnose=diagnose)
    if folder is not None:
        tuning.save(folder.path / FILE)
    return tuning


def _own_problem(
    data: Sequence[Any], others: Sequence[Any], options: dict[str, Any]
) -> tuple[Problem[Any], Sequence[Any], SearchConfig]:
    """Set up the user's own model on logs; return the problem, the validation logs and the configuration."""
    model: Model = options["model"]
    stray = [type(thing).__name__ for thing in (*data, *others) if not isinstance(thing, Log)]
    if stray:
        raise InputError(f"got a {stray[0]}; tune takes Drives, or Logs together with model=Model(...)")
    config = validated_config(ModelTuneConfig, options | {"model": model.identity()})
    config = settled(config, [*data, *others])
    return model_problem(data, model, config), others, config


def _car_problem(data: Dataset, others: Dataset, options: dict[str, Any]) -> tuple[CarProblem, TuneConfig]:
    """Set up a built-in model on drives."""
    everywhere = [*data.map(sensors_of), *others.map(sensors_of)]
    config = settled(validated_config(TuneConfig, with_filter(options, everywhere)[0]), everywhere)
    problem = car_problem(data, config)
    if problem.objective.warning:
        warnings.warn(problem.objective.warning, SigmaswarmWarning, stacklevel=3)
    if "robust" in config.use and "innovation-nll" in config.objective:
        message = "innovation-nll counts outliers in full, robust or not; for robust use innovation-t"
        warnings.warn(message, SigmaswarmWarning, stacklevel=3)
    return problem, config


def check_apart(problem: Problem[Any], held_back: Problem[Any]) -> None:
    """Refuse validation drives that are, or overlap with, training drives."""
    seen = {entry["sha256"] for entry in problem.data}
    both = [entry["name"] for entry in held_back.data if entry["sha256"] in seen]
    if both:
        raise InputError(f"{both[0]} is among the training drives, too; hold others back for validation")
    known = tuple(problem.seen) if len(held_back.seen) else ()
    for drive in held_back.seen:
        if found := overlap_of(drive, known):
            raise InputError(
                f"{drive.name}: {found.seconds:.0f} s of it are in the training drives, too ({', '.join(found.of)}); "
                "hold others back for validation"
            )


def _best_of(
    trials: tuple[Trial, ...],
    problem: Problem[P],
    held_back: Problem[P] | None,
    config: SearchConfig,
    executor: Executor | None,
    *,
    diagnose: bool,
) -> Tuning[P]:
    best = int(np.argmin([trial.cost for trial in trials]))
    point, cost = trials[best].point, trials[best].cost
    if not np.isfinite(cost):
        reason = problem.why_none(point)
        raise InputError(
            "no parameter set gave a finite cost: every filter failed on at least one drive; "
            + (reason or "look for NaN or wildly wrong values in the drives")
        )
    factor = 1.0
    if isinstance(config, TuneConfig) and config.inflation:
        point, cost, factor = inflated(problem, point, cost, config.inflation, executor)
    validation = None
    if held_back:
        own, other = problem.judged(point, executor), held_back.judged(point, executor)
        names = tuple(entry["name"] for entry in held_back.data)
        validation = Validation(other, float(problem.rise(other, own)), names)
    evaluations = sum(trial.evaluations for trial in trials)
    return Tuning(
        parameters=problem.parameters(point),
        cost=cost,
        touched_bounds=problem.space.touched(point),
        trial_costs=tuple(trial.cost for trial in trials),
        best_trial=best,
        config=config,
        trials=trials,
        evaluations=evaluations,
        failures=sum(trial.failures for trial in trials),
        steps=sum(int(trial.steps[-1]) for trial in trials),
        full_steps=int(problem.steps.sum()) * evaluations,
        data=problem.data,
        seen=problem.seen,
        warnings=tuple(problem.warnings(point)) if diagnose else (),
        sensitivities=sensitivities(problem, point, cost, executor),
        validation=validation,
        inflation_factor=factor,
    )
