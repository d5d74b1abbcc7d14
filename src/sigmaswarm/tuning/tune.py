"""Search for the filter parameters with the lowest cost on a set of drives."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NotRequired, Required, TypedDict, TypeVar, Unpack, overload

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.datasets.dataset import Drives, make_datasets
from sigmaswarm.drives.drive import as_list
from sigmaswarm.drives.overlap import (
    TRAINING_DATA_FILE,
    Landmarks,
    SavedLandmarks,
    overlap_of,
    save_landmarks,
)
from sigmaswarm.drives.sensors import describe_vehicles, log_properties
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.files import locked_folder
from sigmaswarm.filters.custom.log import Log
from sigmaswarm.filters.custom.model import Model
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import filter_for
from sigmaswarm.scoring.batch import cores
from sigmaswarm.tuning.config import (
    MODEL_REMEDIES,
    PAPER_OPTIONS,
    ModelTuneConfig,
    SearchOptions,
    TuneConfig,
    TuneOptions,
    current_options,
    paper_options,
    validated_config,
)
from sigmaswarm.tuning.custom import model_problem
from sigmaswarm.tuning.defaults import complete_config, default_filter_options
from sigmaswarm.tuning.inflation import inflate, sensitivities
from sigmaswarm.tuning.problem import CarProblem, Problem, car_problem
from sigmaswarm.tuning.record import FILE
from sigmaswarm.tuning.result import Tuning, Validation
from sigmaswarm.tuning.search import Progress, TrialRunner
from sigmaswarm.tuning.space import SearchSpace
from sigmaswarm.tuning.store import CENTER, ResultFolder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

TAKES = "tune takes Drives, or Logs together with model=Model(...)"
ARGUMENTS = ("validation", "start", "out", "resume", "paper", "executor", "cluster", "progress")
NOT_ROBUST = "innovation-nll gives outliers full weight, even if the filter uses robust; use innovation-t"
P = TypeVar("P")


class RunOptions(TypedDict, total=False):
    """Arguments of `tune` other than data and configuration."""

    out: str | Path | None
    resume: bool
    paper: bool
    executor: Executor | None
    progress: Callable[[Progress], object] | None


class CarOptions(RunOptions, TuneOptions):
    cluster: "NotRequired[Client | None]"
    start: NotRequired[FilterParameters | str | Path | None]
    validation: NotRequired[Drives]


class ModelOptions(RunOptions, SearchOptions):
    model: Required[Model]
    validation: NotRequired[Sequence[Log] | Log]


@overload
def tune(drives: Drives, **options: Unpack[CarOptions]) -> Tuning[FilterParameters]: ...
@overload
def tune(drives: Sequence[Log] | Log, **options: Unpack[ModelOptions]) -> Tuning[dict[str, float]]: ...
def tune(
    drives: Any,
    *,
    validation: Any = (),
    out: str | Path | None = None,
    executor: Executor | None = None,
    cluster: "Client | None" = None,
    progress: Callable[[Progress], object] | None = None,
    **options: Any,
) -> Tuning[Any]:
    """Tune a filter on drives.

    Parameters
    ----------
    drives : Drive or sequence of Drive; Log or sequence of Log
        Training drives, or logs for a custom model. With ``cluster``, paths and URLs of drives are also possible.
    validation : as ``drives``
        Drives or logs that the search does not use. The result reports the cost on them.
    out : path, optional
        Folder for results. Every generation is saved, so an interrupted run can be resumed.
    executor : concurrent.futures.Executor, optional
        Executor that runs the filters; by default threads on all cores. The result is the same with every executor.
    cluster : distributed.Client, optional
        Dask cluster whose workers read the drives and run the filters. On processors of one type, the result is the
        same as without a cluster.
    progress : callable, optional
        Called with a `Progress` after every generation. If it returns False, the tuning stops.
    **options
        ``resume=True`` continues the run in ``out``; the result is the same as without interruption. ``paper=True``
        uses the paper's settings, `PAPER_OPTIONS`, and rejects options that contradict them. ``start`` is a filter, or
        its file (a tuning.toml, or an ekf.yaml of robot_localization). The first generation of the search is drawn
        around this filter or, by default, around the `baseline` of the first drive. With ``paper`` or a custom model,
        the first generation is uniform within the bounds. The other options are fields of `TuneConfig`: objective,
        particles, generations, trials, seed, ... If ``model`` and ``use`` are not given, the filter depends on the
        drives' sensors; ``config`` of the result contains the chosen filter. ``model`` may be a custom `Model`, and
        ``optimizer`` a custom class: see `tuning.optimizers`.

    Raises
    ------
    InputError
        If an option or the folder is invalid, a drive lacks the truth that the objective needs, or every parameter set
        has an infinite cost.
    AlignmentError
        If no filter can start on a drive, for example because the vehicle is too slow.
    TuningStopped
        If ``progress`` returned False.
    ClusterError
        If the scheduler stopped, a worker's software versions differ from the client's, or the drives exceed the
        workers' memory.
    """
    resume, paper, start = (options.pop(name, None) for name in ("resume", "paper", "start"))
    options = _search_options(options, paper=bool(paper))
    problem, held_back, first, choice = _problem_of(drives, validation, options, start, (executor, cluster))
    with ExitStack() as stack:
        folder = None
        center = _center(problem) if first is None else first
        if out is not None:  # created only after all checks of the input
            locked = stack.enter_context(locked_folder(Path(out)))
            folder = tuning_folder(locked, problem, resume=bool(resume), start=first, center=center)
            center = None if folder.center is None else np.array([*folder.center.values()])
        marks = _landmarks_of(problem, folder)
        pool = executor or stack.enter_context(ThreadPoolExecutor(cores()))
        options = {
            "held_back": held_back,
            "folder": folder,
            "progress": progress,
            "start": first,
            "center": center,
        }
        return replace(tune_problem(problem, pool, **options), seen=marks, choice=choice)


def _search_options(options: dict[str, Any], *, paper: bool) -> dict[str, Any]:
    kind = ModelTuneConfig if isinstance(options.get("model"), Model) else TuneConfig
    options = current_options(kind, options, ARGUMENTS)
    if paper and kind is ModelTuneConfig:
        raise InputError("paper = True is only possible with built-in models; omit paper")
    return paper_options(options) if paper else options


def _landmarks_of(problem: Problem[Any], folder: ResultFolder | None) -> Sequence[Landmarks]:
    """Compute, save and return the landmarks of the drives before the search, since a cluster may stop later."""
    marks = problem.seen
    if folder is None or not marks:
        return tuple(marks)
    file = folder.path / TRAINING_DATA_FILE
    names = tuple((entry["name"], entry["sha256"]) for entry in problem.data)
    save_landmarks(marks, file, names)
    return marks if isinstance(marks, Sequence) else SavedLandmarks(file, names)


def _problem_of(
    drives: Any,
    validation: Any,
    options: dict[str, Any],
    start: FilterParameters | str | Path | None,
    where: "tuple[Executor | None, Client | None]",
) -> tuple[Problem[Any], Problem[Any] | None, Array | None, str]:
    """Return the optimization problems (training, validation), the start filter as a point, and `Tuning.choice`."""
    model: Any = options.get("model")
    executor, cluster = where
    first: Array | None = None
    choice = ""
    others: Any
    if isinstance(model, Model):
        if cluster is not None:
            raise InputError("a custom model runs only on this machine; omit cluster")
        if start is not None:
            raise InputError(f"start is only possible with built-in models; {MODEL_REMEDIES['start']}")
        data, others = as_list(drives), as_list(validation)
        stray = [type(thing).__name__ for thing in (*data, *others) if not isinstance(thing, Log)]
        if stray:
            raise InputError(f"got a {stray[0]}; {TAKES}")
        config = validated_config(ModelTuneConfig, options | {"model": model.identity()})
        problem = model_problem(data, model, complete_config(config, [*data, *others]))
    else:
        data, others = make_datasets(drives, validation, cluster=cluster, executor=executor, takes=TAKES)
        sensors = [*data.map(log_properties), *others.map(log_properties)]
        given = None if start is None else filter_for(start, data)
        options = options if given is None else {"model": given.model, "kind": given.kind, **options}
        options, choice = default_filter_options(options, sensors)
        config = complete_config(validated_config(TuneConfig, options), sensors)
        problem = car_problem(data, config)
        first = None if given is None else start_point(problem.space, given)
        robust = "robust" in config.use and "innovation-nll" in config.objective
        other = describe_vehicles(problem.sensors)
        for warning in (other, problem.objective.warning, NOT_ROBUST if robust else None):
            if warning:
                warnings.warn(warning, SigmaswarmWarning, stacklevel=3)
    if not len(others):
        return problem, None, first, choice
    held_back = problem.with_data(others)
    check_disjoint(problem, held_back)
    return problem, held_back, first, choice


def start_point(space: SearchSpace, given: FilterParameters) -> Array:
    wanted = space.fixed["model"], space.fixed["kind"]
    if (given.model, given.kind) != wanted:
        raise InputError(
            f"the start filter is {given.model} ({given.kind}), but {' ('.join(wanted)}) is tuned; omit --model and "
            "--kind"
        )
    return space.point_of(given)


def _center(problem: Problem[Any]) -> Array | None:
    """Return the baseline as a search point; None for a custom model or the paper's uniform first generation."""
    config = problem.config.model_dump()
    papers = all(config.get(name) == value for name, value in PAPER_OPTIONS.items())
    return None if papers else problem.baseline_point()


def tuning_folder(
    path: Path,
    problem: Problem[Any],
    *,
    resume: bool,
    start: Array | None = None,
    center: Array | None = None,
) -> ResultFolder:
    wanted = {**problem.config.model_dump(mode="json"), "data": problem.data, "versions": versions()}
    for name, point in (("start", start), (CENTER, center)):
        if point is not None:
            wanted[name] = dict(zip(problem.space.names, point.tolist(), strict=True))
    return ResultFolder(path, wanted, resume=resume)


def tune_problem(
    problem: Problem[P],
    executor: Executor | None = None,
    *,
    held_back: Problem[P] | None = None,
    folder: ResultFolder | None = None,
    progress: Callable[[Progress], object] | None = None,
    diagnose: bool = True,
    start: Array | None = None,
    center: Array | None = None,
) -> Tuning[P]:
    """Run, resume or read the trials, and write tuning.toml.

    The first generation is drawn around ``center`` (`TrialRunner`). If the cost of ``start`` is lower than that of
    every trial, ``start`` is used as the best point. With ``diagnose``, the filter is checked for faults that the
    objective does not show.
    """
    config, search = problem.config, TrialRunner(problem, executor, folder, progress, center)
    trials = tuple(search.trial(i) for i in range(config.trials))
    best = int(np.argmin([trial.cost for trial in trials]))
    point, cost, factor = trials[best].point, trials[best].cost, 1.0
    start_cost = None if start is None else float(problem.costs(start[np.newaxis], executor)[0])
    if start is not None and start_cost is not None and start_cost < cost:
        point, cost = start, start_cost
    if not np.isfinite(cost):
        raise InputError(
            "no parameter set gave a finite cost: every filter failed on at least one drive; "
            + (problem.failure_reason(point) or "check the drives for NaN and for values in wrong units")
        )
    car: Problem[Any] = problem
    if isinstance(car, CarProblem) and car.config.inflation:
        point, cost, factor = inflate(car, point, car.config.inflation, executor)
    evaluations = sum(trial.evaluations for trial in trials)
    tuning = Tuning(
        parameters=problem.parameters(point),
        cost=cost,
        start_cost=start_cost,
        touched_bounds=problem.space.touched(point),
        trial_costs=tuple(trial.cost for trial in trials),
        best_trial=best,
        config=config,
        trials=trials,
        evaluations=evaluations,
        failures=sum(trial.failures for trial in trials),
        steps=sum(int(trial.steps[-1]) for trial in trials),
        full_steps=int(problem.steps.sum()) * evaluations,
        data=problem.recorded_data,
        **(problem.diagnosis(point, executor) if diagnose else {}),
        sensitivities=sensitivities(problem, point, cost, executor),
        validation=_validate(problem, held_back, point, executor) if held_back else None,
        inflation_factor=factor,
    )
    if folder is not None:
        tuning.save(folder.path / FILE)
    return tuning


def _validate(
    problem: Problem[P], held_back: Problem[P], point: Array, executor: Executor | None
) -> Validation:
    both = (problem, held_back)
    own, other = (float(one.costs_without_prior(point[np.newaxis], executor)[0]) for one in both)
    names = tuple(entry["name"] for entry in held_back.data)
    return Validation(other, float(problem.relative_increase(other, own)), names)


def check_disjoint(problem: Problem[Any], held_back: Problem[Any]) -> None:
    """Raise `InputError` if a validation drive overlaps with a training drive."""
    hashes = {entry["sha256"] for entry in problem.data}
    both = [entry["name"] for entry in held_back.data if entry["sha256"] in hashes]
    if both:
        raise InputError(f"{both[0]} is also a training drive; use other drives for validation")
    known = tuple(problem.seen)
    for drive in held_back.seen:
        if overlap := overlap_of(drive, known):
            raise InputError(
                f"{drive.name}: {overlap.seconds:.0f} s of this drive are also in the training drives "
                f"({', '.join(overlap.of)}); use other drives for validation"
            )
