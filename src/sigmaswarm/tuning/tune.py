"""`tune`: search the filter parameters that serve a set of drives best."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, Unpack, overload

import numpy as np

from sigmaswarm.doctor.suited import Equipment, equipment
from sigmaswarm.drives.drive import Drive, listed
from sigmaswarm.drives.overlap import SEEN_FILE, SavedLandmarks, overlap_of, save_landmarks
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.files import held_folder
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.fleets.gathering import held_drives
from sigmaswarm.fleets.held import Held
from sigmaswarm.tuning.config import ModelTuneConfig, SearchConfig, TuneConfig, validated_config
from sigmaswarm.tuning.custom import ModelProblem
from sigmaswarm.tuning.defaults import PLAIN, objective_for, with_filter
from sigmaswarm.tuning.margin import MARGIN, TILTED_MARGIN, with_margin
from sigmaswarm.tuning.objectives import objective_named
from sigmaswarm.tuning.options import SearchOptions, TuneOptions
from sigmaswarm.tuning.paper import papers_config
from sigmaswarm.tuning.problem import CarProblem, Problem, car_problem
from sigmaswarm.tuning.result import Tuning, Validation
from sigmaswarm.tuning.search import Progress, Search, Trial
from sigmaswarm.tuning.sensitivity import sensitivities
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

    from sigmaswarm.drives.places import Place

TAKES = "tune takes Drives, or Logs together with model=Model(...)"
C = TypeVar("C", bound=SearchConfig)
P = TypeVar("P")


@overload
def tune(
    drives: "Sequence[Drive | Place] | Drive | Place | Held",
    *,
    validation: "Sequence[Drive | Place] | Drive | Place | Held" = ...,
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
    drives: "Sequence[Drive | Place] | Sequence[Log] | Drive | Place | Log | Held",
    *,
    validation: "Sequence[Drive | Place] | Sequence[Log] | Drive | Place | Log | Held" = (),
    out: str | Path | None = None,
    resume: bool = False,
    paper: bool = False,
    executor: Executor | None = None,
    cluster: "Client | None" = None,
    progress: Callable[[Progress], None] | None = None,
    **config: Any,
) -> Tuning[Any]:
    """Tune a filter on drives: a swarm, or another optimizer, searches its parameters.

    Parameters
    ----------
    drives : Drive or sequence of Drive; Log or sequence of Log
        The training drives, or the logs of a model of your own. Keep others back for `evaluate`. With a ``cluster``
        also paths and URLs of drives, which its workers read, so that this process never holds them.
    validation : Drive or sequence of Drive
        Drives that the search does not see. What the objective says on them stands in the result; nothing is chosen
        by it.
    out : path, optional
        A folder for results; every generation is saved in it, so that a killed run can be resumed.
    resume : bool
        Go on with what ``out`` holds. The result has the same bits as that of an uninterrupted run.
    paper : bool
        The paper's setting, `PAPER`: a swarm of 30 x 50 on a linear scale, gps-rmse, planar5. Options that contradict
        it are refused.
    executor : concurrent.futures.Executor, optional
        Shares the work; threads on all cores by default. The result's bits do not depend on it.
    cluster : distributed.Client, optional
        Of a Dask cluster, whose workers hold the drives and do the work; nor do the bits depend on it.
    progress : callable, optional
        Called with a `Progress` after every generation.
    **config
        `TuneOptions`: objective, scale, particles, generations, trials, seed, model, ... Where neither ``model`` nor
        ``use`` is given, the filter is what suits all drives, by what they have: tilted12 or planar8, with lateral,
        standstill and what else the logs allow; ``config.model`` and ``config.use`` of the result say what it was.
        ``model`` may be a `Model` of your own; its objectives are truth-rmse and innovation-nll.

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
    asked = papers_config(config) if paper else config
    if isinstance(asked.get("model"), Model):
        if cluster is not None:
            raise InputError(
                "cluster: a model of your own is tuned in processes of this machine; leave it out"
            )
        problem, others, settings = _own_problem(listed(drives), listed(validation), asked)
    else:
        data, others = held_drives(drives, validation, cluster=cluster, executor=executor, takes=TAKES)
        problem, settings = _car_problem(data, others, asked)
    held_back = problem.on(others) if len(others) else None
    if held_back:
        check_apart(problem, held_back)
    with ExitStack() as stack:
        folder = seen = None
        if out is not None:  # made only once nothing is left that the user could have got wrong
            folder = tuning_folder(
                stack.enter_context(held_folder(Path(out))), problem, settings, resume=resume
            )
            if problem.seen:
                names = tuple((entry["name"], entry["sha256"]) for entry in problem.data)
                save_landmarks(problem.seen, folder.path / SEEN_FILE, names)
                seen = SavedLandmarks(folder.path / SEEN_FILE, names)
        pool = executor or stack.enter_context(ThreadPoolExecutor())
        tuning = tune_problem(problem, settings, pool, held_back=held_back, folder=folder, progress=progress)
    if isinstance(problem.seen, tuple):
        return tuning
    return replace(
        tuning, seen=tuple(problem.seen) if seen is None else seen
    )  # the cluster may end before it


def tuning_folder(path: Path, problem: Problem[Any], config: SearchConfig, *, resume: bool) -> ResultFolder:
    """The folder of a tuning, which remembers what was asked for on which data."""
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
    doubted: bool = True,
) -> Tuning[P]:
    """Run, resume or look up the trials of a tuning, and write its tuning.toml; without an executor in this thread.

    ``doubted``: hold the result against what the objective does not see, for somebody who is to use it.
    """
    search = Search(config, problem, executor, folder, progress)
    trials = tuple(search.trial(i) for i in range(config.trials))
    tuning = _chosen(trials, problem, held_back, config, executor, doubted=doubted)
    if folder is not None:
        tuning.save(folder.path / "tuning.toml")
    return tuning


def _own_problem(
    data: Sequence[Any], others: Sequence[Any], config: dict[str, Any]
) -> tuple[Problem[Any], Sequence[Any], SearchConfig]:
    """What is minimized for a model of the user's own, on logs; the logs held back; and the settings."""
    model: Model = config["model"]
    stray = [type(thing).__name__ for thing in (*data, *others) if not isinstance(thing, Log)]
    if stray:
        raise InputError(f"got a {stray[0]}; tune takes Drives, or Logs together with model=Model(...)")
    asked = validated_config(ModelTuneConfig, config | {"model": model.identity()})
    settings = _settled(asked, [*data, *others])
    return ModelProblem(data, model, settings), others, settings


def _car_problem(data: Held, others: Held, config: dict[str, Any]) -> tuple[CarProblem, TuneConfig]:
    """What is minimized for a car's filter, on drives."""
    everywhere = [*data.of_each(equipment), *others.of_each(equipment)]
    asked, _ = with_filter(config, everywhere)
    settings = _settled(validated_config(TuneConfig, asked), everywhere)
    problem = car_problem(data, settings)
    if problem.objective.warning:
        warnings.warn(problem.objective.warning, SigmaswarmWarning, stacklevel=3)
    if "robust" in settings.use and "innovation-nll" in settings.objective:
        warnings.warn(
            "to innovation-nll outliers count in full, whatever the filter makes of them; for robust take innovation-t",
            SigmaswarmWarning,
            stacklevel=3,
        )
    return problem, settings


def _settled(config: C, data: Sequence[Equipment | Log]) -> C:
    """The configuration with what its defaults stand for on this data."""
    model = config.model if isinstance(config, TuneConfig) else PLAIN
    return with_guards(config.model_copy(update={"objective": objective_for(data, config.objective, model)}))


def with_guards(config: C) -> C:
    """The configuration of a filter for cars, guarded where truth has no say: a prior on R, a margin."""
    if not isinstance(config, TuneConfig):
        return config
    objective = objective_named(config.objective)
    alone = objective.likelihood and not objective.needs_truth
    prior = float(alone) if config.prior is None else config.prior
    usual = TILTED_MARGIN if MODELS[config.model].tilts else MARGIN
    doubt = usual if alone and config.scale == "log10" else 0.0
    margin = doubt if config.margin is None else config.margin
    return config.model_copy(update={"prior": prior, "margin": margin})


def check_apart(problem: Problem[Any], held_back: Problem[Any]) -> None:
    """What was tuned on validates nothing."""
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


def _chosen(
    trials: tuple[Trial, ...],
    problem: Problem[P],
    held_back: Problem[P] | None,
    config: SearchConfig,
    executor: Executor | None,
    *,
    doubted: bool,
) -> Tuning[P]:
    best = int(np.argmin([trial.cost for trial in trials]))
    point, cost = trials[best].point, trials[best].cost
    if not np.isfinite(cost):
        raise InputError(
            "no parameter set gave a finite cost: every filter failed on at least one drive; "
            "look for NaN or wildly wrong values in the drives"
        )
    factor = 1.0
    if isinstance(config, TuneConfig) and config.margin:
        point, cost, factor = with_margin(problem, point, cost, config.margin, executor)
    validation = None
    if held_back:
        own, other = problem.judged(point, executor), held_back.judged(point, executor)
        names = tuple(entry["name"] for entry in held_back.data)
        validation = Validation(other, float(problem.rise(other, own)), names)
    return Tuning(
        parameters=problem.parameters(point),
        cost=cost,
        touched_bounds=problem.space.touched(point),
        trials=trials,
        best_trial=best,
        config=config,
        data=problem.data,
        seen=problem.seen,
        doubts=tuple(problem.warnings(point)) if doubted else (),
        sensitivities=sensitivities(problem, point, cost, executor),
        validation=validation,
        steps_per_set=int(problem.steps.sum()),
        raised_by=factor,
    )
