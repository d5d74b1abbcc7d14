"""`compare`: several optimizers with the same budget on the same drives, over many seeds.

A folder of a comparison holds

    config.json       what was asked for and on which data; a resumed comparison must ask for the same
    runs/NAME-SEED/   the folder of each tuning, as `tune` writes it, and run.json once it is done
    times.csv         CPU seconds of each run: the only file that differs from one time to the next
"""

import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from sigmaswarm.datasets.dataset import datasets_of
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.sensors import sensors_of
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.experiments.compare.contenders import Contender, budget, contenders
from sigmaswarm.experiments.compare.record import Comparison, Outcome
from sigmaswarm.experiments.grid import Tell, run_grid
from sigmaswarm.files import held_folder, write_whole
from sigmaswarm.scoring.jobs import cores
from sigmaswarm.tuning.defaults import objective_for, with_filter
from sigmaswarm.tuning.options import SEEDS, CompareOptions
from sigmaswarm.tuning.problem import CarProblem, car_problem, car_space, usual_interval
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.tuning.tune import check_apart, tune_problem, tuning_folder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

    from sigmaswarm.datasets.dataset import Dataset
    from sigmaswarm.drives.reader import Location


def compare(
    drives: "Sequence[Drive | Location] | Drive | Location | Dataset",
    *,
    optimizers: Sequence[str] = ("pso", "ga", "ga-pso", "de", "cma-es", "random"),
    scales: Sequence[str] = ("log10",),
    seeds: int = SEEDS,
    validation: "Sequence[Drive | Location] | Drive | Location | Dataset" = (),
    out: str | Path | None = None,
    resume: bool = False,
    workers: int | None = None,
    cluster: "Client | None" = None,
    progress: Callable[[int, int], None] | None = None,
    **config: Unpack[CompareOptions],
) -> Comparison:
    """Compare optimizers at the same budget of evaluations on the same drives.

    Parameters
    ----------
    drives : Drive or sequence of Drive
        The training drives.
    optimizers : sequence of str
        Names, and settings of their own where wanted: ``pso:polish=300``, ``pso:particles=10,trials=3``. All must
        have the same budget: particles x generations x trials. The first one is what the others are tested against.
    scales : sequence of str
        log10, linear or both.
    seeds : int
        Runs of each, with seeds 0, 1, ...
    validation : Drive or sequence of Drive
        Drives that the search does not see: what the filters are worth on them.
    out : path, optional
        A folder for all runs; a killed comparison can be resumed.
    resume : bool
        Go on with what ``out`` holds; the result is the same as without the interruption, but for the times.
    workers : int, optional
        Threads; as many as cores by default. The result does not depend on it.
    cluster : distributed.Client, optional
        Of a Dask cluster, whose workers read the drives, then also given as paths and URLs, and do the work;
        ``workers`` is then how many tunings run side by side. The result does not depend on it.
    progress : callable, optional
        Called with the number of runs done, and of all, after every run.
    **config
        `CompareOptions`, what `tune` is asked for otherwise: objective, model, particles, generations, ...

    Raises
    ------
    InputError
        If an option, optimizer, drive or folder can't be used.
    """
    if seeds < 1:
        raise InputError(f"seeds = {seeds}: at least 1 is needed")
    for name in ("seed", "optimizer", "scale"):
        if name in config:
            raise InputError(f"{name}: is what is compared; use {name}s instead")
    for name in ("prior", "inflation", "margin"):
        if name in config:
            raise InputError(f"{name}: guards a tuning; a comparison compares plain costs, so leave it out")
    training, held_out = datasets_of(drives, validation, cluster=cluster)
    trained, tested = training.map(sensors_of), held_out.map(sensors_of)
    everywhere = [*trained, *tested]
    asked_filter, _ = with_filter({**config}, everywhere)
    objective = objective_for(everywhere, config.get("objective", "auto"), asked_filter["model"])
    plain = {"prior": 0.0, "inflation": 0.0}
    rivals = contenders(optimizers, scales, {**asked_filter, **plain, "objective": objective})
    problem = car_problem(training, rivals[0].config)
    beside = problem.on(held_out) if len(held_out) else None
    if beside:
        check_apart(problem, beside)
    if problem.objective.warning:
        warnings.warn(problem.objective.warning, SigmaswarmWarning, stacklevel=2)
    asked = _asked(rivals, seeds, problem, beside)
    cells = [_Run(rival, seed) for seed in range(seeds) for rival in rivals]
    with (
        TemporaryDirectory() as scratch,
        held_folder(Path(scratch if out is None else out)) as place,
        ThreadPoolExecutor(workers or (cores() if cluster is None else None)) as pool,
    ):
        folder = ResultFolder(place, asked, resume=resume or out is None)
        job = _Job(_searched(problem, rivals), beside, folder.path, threading.Lock())
        if not job.times.exists():
            write_whole(job.times, "optimizer,scale,seed,cpu_seconds\n")

        def told(done: int, total: int, _: object) -> None:
            if progress:
                progress(done, total)

        outcomes = run_grid(cells, job.run, pool, progress=told)
    return Comparison(
        contenders=tuple(rivals),
        runs={r.label: tuple(outcomes[_Run(r, seed)] for seed in range(seeds)) for r in rivals},
        budget=budget(rivals[0].config),
        steps_per_set=asked["steps_per_set"],
        drives=tuple(drive.name for drive in trained),
        test=tuple(drive.name for drive in tested),
    )


def _asked(
    rivals: Sequence[Contender], seeds: int, problem: CarProblem, beside: CarProblem | None
) -> dict[str, Any]:
    """What is compared on what: config.json."""
    return {
        "compared": {rival.label: rival.config.model_dump(mode="json", exclude={"seed"}) for rival in rivals},
        "seeds": seeds,
        "data": problem.data,
        "test": beside.data if beside else [],
        "steps_per_set": int(problem.steps.sum()),
        "versions": versions(),
    }


def _searched(problem: CarProblem, rivals: Sequence[Contender]) -> dict[Contender, CarProblem]:
    """What each contender minimizes: on drives that all of them share, in the box of its own scale."""
    interval = usual_interval(problem.sensors)
    spaces = {rival.scale: car_space(rival.config, interval) for rival in rivals}
    return {rival: replace(problem, config=rival.config, space=spaces[rival.scale]) for rival in rivals}


@dataclass(frozen=True)
class _Run:
    """A contender with one of the seeds."""

    rival: Contender
    seed: int


@dataclass(frozen=True)
class _Job:
    """The runs of a comparison."""

    problems: Mapping[Contender, CarProblem]
    held_out: CarProblem | None
    folder: Path
    lock: threading.Lock

    def run(self, asked: _Run, tell: Tell) -> Outcome:
        """One tuning and its held-out scores, or what is known of it from before."""
        folder = self.folder / "runs" / f"{asked.rival.folder}-{asked.seed:03d}"
        file = folder / "run.json"
        if not file.exists():
            fresh, start = not folder.exists(), time.thread_time()
            problem = self.problems[asked.rival]
            config = problem.config.model_copy(update={"seed": asked.seed})
            kept = tuning_folder(folder, problem, config, resume=True)
            tuning = tune_problem(problem, config, folder=kept, progress=lambda _: tell(0), diagnose=False)
            outcome = _outcome(tuning, self.held_out)
            if fresh:  # of a run that was interrupted only the last part is known
                self._note(asked, time.thread_time() - start)
            outcome.write(file)
        return Outcome.read(file)

    @property
    def times(self) -> Path:
        """Of the runs that nobody interrupted; none, perhaps."""
        return self.folder / "times.csv"

    def _note(self, run: _Run, seconds: float) -> None:
        line = f'"{run.rival.name}",{run.rival.scale},{run.seed},{seconds:.3f}\n'
        with self.lock:
            write_whole(self.times, self.times.read_text() + line)


def _outcome(tuning: Tuning, held_out: CarProblem | None) -> Outcome:
    """A tuning's costs, and its scores on drives that it never saw."""
    cost = rmse = heading = None
    if held_out:
        scores = held_out.replays.scores([tuning.parameters])
        cost = float(held_out.objective.costs(scores, tuning.config.worst)[0])
        rmse, heading = _mean(scores.position_rmse[0]), _mean(np.degrees(scores.heading_rmse[0]))
    evaluations, steps, best = _history(tuning)
    return Outcome(
        cost=tuning.cost,
        held_out_cost=cost,
        held_out_rmse=rmse,
        held_out_heading=heading,
        touched=tuple(touched.parameter for touched in tuning.touched_bounds),
        evaluations=sum(trial.evaluations for trial in tuning.trials),
        failures=sum(trial.failures for trial in tuning.trials),
        history_evaluations=tuple(evaluations),
        history_steps=tuple(steps),
        history_best=tuple(best),
    )


def _history(tuning: Tuning) -> tuple[list[int], list[int], list[float]]:
    """Evaluations and steps spent, and the lowest cost so far, after each generation of one trial after another."""
    evaluations, steps, best = list[int](), list[int](), list[Array]()
    spent = 0
    for trial in tuning.trials:
        before = steps[-1] if steps else 0
        counts = np.minimum(tuning.config.particles * np.arange(1, len(trial.best) + 1), trial.evaluations)
        evaluations += (spent + counts).tolist()
        steps += (before + trial.steps).tolist()
        best.append(trial.best)
        spent += trial.evaluations
    return evaluations, steps, np.minimum.accumulate(np.concatenate(best)).tolist()


def _mean(values: Array) -> float | None:
    return float(np.mean(values)) if np.isfinite(values).all() else None
