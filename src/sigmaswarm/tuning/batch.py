"""Run many parameter sets on many drives: `run_batch`."""

from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.datasets.dataset import Dataset, make_datasets
from sigmaswarm.drives.drive import Drive, as_list
from sigmaswarm.drives.sensors import LogProperties, log_properties
from sigmaswarm.drives.tables import Mask
from sigmaswarm.errors import InputError
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.batch import BatchScorer, PassOptions, cores
from sigmaswarm.scoring.remote import AnyBatchScorer, make_scorer
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import forecast_windows
from sigmaswarm.tuning.objectives import Objective, parse_objective
from sigmaswarm.wording import printable


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Costs and scores of parameter sets on drives.

    Drifts over 5 s and forecasts are NaN unless the objective needs them. The drifts over 1 s and 30 s, and the
    quantiles of the position errors, are always NaN; `evaluate` computes them.

    Attributes
    ----------
    costs : ndarray, shape (n_sets,)
        Values of the objective; ``inf`` for a set that failed on any drive.
    scores : tuple of tuple of Score
        ``scores[i][j]`` is the score of set i on drive j.
    failed : ndarray of bool, shape (n_sets,)
        True for a set with which, on any drive, a covariance became indefinite or a value was not finite.
    """

    costs: Array
    scores: tuple[tuple[Score, ...], ...]
    failed: Mask


def run_batch(
    drives: Sequence[Drive] | Drive,
    parameter_sets: Sequence[FilterParameters] | FilterParameters,
    *,
    objective: str = "truth-rmse",
    worst: float = 1.0,
    outage_seed: int = 0,
    as_recorded: bool = False,
    executor: Executor | None = None,
) -> BatchResult:
    """Run every parameter set over every drive and score it.

    Parameters
    ----------
    drives : Drive or sequence of Drive
    parameter_sets : FilterParameters or sequence of FilterParameters
    objective : str
        A name in `OBJECTIVES`, or a weighted sum of such names.
    worst : float
        The cost of a set is the mean over this fraction of the drives, namely those with the highest costs of the set.
        1 means all drives.
    outage_seed : int
        Seed of the outages, for objectives that hide fixes.
    as_recorded : bool
        Run without preprocessing: use stale fixes, and treat IMU gaps as ordinary steps.
    executor : concurrent.futures.Executor, optional
        Executor that runs the filters; by default threads on all cores. The result is the same with every executor.

    Raises
    ------
    InputError
        If the objective is unknown, a drive is too short or lacks the truth that the objective needs, or an argument
        has the wrong type.
    AlignmentError
        If no filter can start on a drive, for example because the vehicle is too slow.
    """
    (dataset,) = make_datasets(drives, takes="run_batch takes Drives")
    sets: list[Any] = as_list(parameter_sets)
    stray = [type(one).__name__ for one in sets if not isinstance(one, FilterParameters)]
    if stray:
        raise InputError(f"got a {stray[0]}; run_batch takes FilterParameters")
    given: Any = executor
    if given is not None and not isinstance(given, Executor):
        raise InputError(
            f"executor = {printable(given)} is not an executor; use concurrent.futures.ThreadPoolExecutor(2), or "
            "omit executor"
        )
    goal = parse_objective(objective)
    check_drives(dataset.map(log_properties), goal)
    scorer = scorer_for(goal, dataset, outage_seed, as_recorded=as_recorded)
    with nullcontext(executor) if executor else ThreadPoolExecutor(cores()) as pool:
        scores = scorer.scores(sets, pool)
    by_set = tuple(tuple(scores[i, j] for j in range(len(dataset))) for i in range(len(sets)))
    return BatchResult(goal.costs(scores, worst), by_set, np.asarray(scores.failed.any(axis=1)))


def check_drives(drives: Sequence[Drive | LogProperties], objective: Objective) -> None:
    if not drives:
        raise InputError("no drives were given; name at least one drive folder")
    missing = [drive.name for drive in map(log_properties, drives) if not drive.truth]
    if objective.needs_truth and missing:
        raise InputError(
            f"{missing[0]}: has no truth, which the objective {objective.name} needs; "
            "without truth, tune with innovation-nll"
        )


def scorer_for(
    objective: Objective, dataset: Dataset, seed: int, *, as_recorded: bool, branched: bool = True
) -> AnyBatchScorer:
    passes = PassOptions(
        objective.needs_outages,
        objective.needs_forecasts,
        outage_seed=seed,
        branched=branched,
        as_recorded=as_recorded,
    )
    return make_scorer(dataset, passes, partial(require_fit, objective=objective.name, seed=seed))


def require_fit(scorer: BatchScorer, objective: str, seed: int) -> None:
    """Raise `InputError` if a drive has no data after the start of the filter that the objective needs."""
    needs_truth = parse_objective(objective).needs_truth
    for i, (drive, initial) in enumerate(zip(scorer.drives, scorer.initial, strict=True)):
        span, truth = f"a filter runs from {initial.time:g} to {drive.imu.time[-1]:g} s", drive.truth
        if not needs_truth and not (drive.gps.time > initial.time).any():
            raise InputError(
                f"{drive.name}: no fix follows the start of a filter at {initial.time:g} s; use a longer drive"
            )
        if needs_truth and truth is not None and not scorer.passes["tracking"][i].targets.n_positions:
            raise InputError(
                f"{drive.name}: truth covers t = {truth.time[0]:g} to {truth.time[-1]:g} s, but {span}; convert truth "
                "and sensors to one clock"
            )
        if "forecasts" in scorer.passes and not scorer.passes["forecasts"][i].n_hidden:
            what, drives = f"a time too short to hide fixes for 3 to 5 s, as {objective} requires", "longer"
            if len(forecast_windows(drive, initial, seed=seed)):
                what = f"but there are no fixes in the windows of 3 to 5 s in which {objective} hides fixes"
                drives = "other"
            raise InputError(f"{drive.name}: {span}, {what}; use {drives} drives or innovation-nll")
