"""Compare optimizers with the same budget on the same drives, over many seeds.

A folder of a comparison holds

    config.json       configuration and data; a resumed comparison must have the same
    runs/NAME-SEED/   the folder of each tuning, as `tune` writes it, and run.json once it has ended
    times.csv         processor time of each run: the only file that differs between two comparisons
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
from sigmaswarm.experiments.comparison import Comparison, Contender, Outcome
from sigmaswarm.experiments.grid import Report, run_grid
from sigmaswarm.files import held_folder, write_whole
from sigmaswarm.scoring.jobs import cores
from sigmaswarm.tuning.config import TuneConfig, validated_config
from sigmaswarm.tuning.defaults import objective_for, with_filter
from sigmaswarm.tuning.optimizers import OPTIMIZERS
from sigmaswarm.tuning.options import SEEDS, CompareOptions
from sigmaswarm.tuning.problem import CarProblem, car_problem, car_space
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.tuning.tune import check_apart, tune_problem, tuning_folder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

    from sigmaswarm.datasets.dataset import Dataset
    from sigmaswarm.drives.reader import Location


OWN = (
    *("particles", "generations", "trials", "polish", "racing"),
    *("inertia", "cognitive", "social", "zero_velocity_at_bounds"),
)
"""Options in which contenders may differ, besides optimizer and scale."""


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
        Names, with their own settings: ``pso:polish=300``, ``pso:particles=10,trials=3``. All must have the same
        budget: particles x generations x trials. The first is the reference of the tests.
    scales : sequence of str
        log10, linear or both.
    seeds : int
        Runs of each, with seeds 0, 1, ...
    validation : Drive or sequence of Drive
        Held-out drives.
    out : path, optional
        Folder of all runs; a killed comparison can be resumed.
    resume : bool
        Continue with the content of ``out``; the result is the same as without interruption, but for the times.
    workers : int, optional
        Threads; as many as cores by default. The result does not depend on it.
    cluster : distributed.Client, optional
        A Dask cluster whose workers read the drives, given as paths or URLs too, and do the work; ``workers`` is
        then the number of tunings at a time. The result does not depend on it.
    progress : callable, optional
        Called with the numbers of finished runs and of all runs.
    **config
        `CompareOptions`, other options of `tune`: objective, model, particles, generations, ...

    Raises
    ------
    InputError
        If an option, optimizer, drive or folder can't be used.
    """
    _check_options(seeds, config)
    training, held_out = datasets_of(drives, validation, cluster=cluster)
    trained, tested = training.map(sensors_of), held_out.map(sensors_of)
    everywhere = [*trained, *tested]
    shared, _ = with_filter({**config}, everywhere)
    shared |= {
        "objective": objective_for(
            everywhere, config.get("objective", "auto"), shared["model"], shared["use"]
        )
    }
    rivals = contenders(optimizers, scales, {**shared, "prior": 0.0, "inflation": 0.0})
    problem = car_problem(training, rivals[0].config)
    test = problem.on(held_out) if len(held_out) else None
    if test:
        check_apart(problem, test)
    if problem.objective.warning:
        warnings.warn(problem.objective.warning, SigmaswarmWarning, stacklevel=2)
    steps_per_set = int(problem.steps.sum())
    asked = {
        "compared": {rival.label: rival.config.model_dump(mode="json", exclude={"seed"}) for rival in rivals},
        "seeds": seeds,
        "data": problem.data,
        "test": test.data if test else [],
        "steps_per_set": steps_per_set,
        "versions": versions(),
    }
    runs = [(rival, seed) for seed in range(seeds) for rival in rivals]
    with (
        TemporaryDirectory() as scratch,
        held_folder(Path(scratch if out is None else out)) as place,
        ThreadPoolExecutor(workers or (cores() if cluster is None else None)) as pool,
    ):
        folder = ResultFolder(place, asked, resume=resume or out is None)
        job = _Job(_problems(problem, rivals), test, folder.path, threading.Lock())
        if not job.times.exists():
            write_whole(job.times, "optimizer,scale,seed,cpu_seconds\n")

        def show(done: int, total: int, _: object) -> None:
            if progress:
                progress(done, total)

        outcomes = run_grid(runs, job.run, pool, progress=show)
    return Comparison(
        contenders=tuple(rivals),
        runs={rival.label: tuple(outcomes[rival, seed] for seed in range(seeds)) for rival in rivals},
        budget=rivals[0].budget,
        steps_per_set=steps_per_set,
        drives=tuple(drive.name for drive in trained),
        test=tuple(drive.name for drive in tested),
    )


def _check_options(seeds: int, config: Mapping[str, Any]) -> None:
    if seeds < 1:
        raise InputError(f"seeds = {seeds}: at least 1 is needed")
    for name in ("seed", "optimizer", "scale"):
        if name in config:
            raise InputError(f"{name}: is compared; use {name}s instead")
    for name in ("prior", "inflation", "margin"):
        if name in config:
            raise InputError(f"{name}: guards a tuning; a comparison compares plain costs, so leave it out")


def _problems(problem: CarProblem, rivals: Sequence[Contender]) -> dict[Contender, CarProblem]:
    """Return the problem of each contender: shared drives, and the search space of its scale."""
    spaces = {rival.scale: car_space(rival.config, problem.sensors) for rival in rivals}
    return {rival: replace(problem, config=rival.config, space=spaces[rival.scale]) for rival in rivals}


@dataclass(frozen=True)
class _Job:
    """The runs of a comparison."""

    problems: Mapping[Contender, CarProblem]
    test: CarProblem | None
    folder: Path
    lock: threading.Lock

    @property
    def times(self) -> Path:
        """The file of the processor times, of uninterrupted runs alone."""
        return self.folder / "times.csv"

    def run(self, task: tuple[Contender, int], report: Report) -> Outcome:
        """Run a contender with a seed, or read its outcome."""
        rival, seed = task
        folder = self.folder / "runs" / f"{rival.folder}-{seed:03d}"
        file = folder / "run.json"
        if not file.exists():
            fresh, start = not folder.exists(), time.thread_time()
            problem = self.problems[rival]
            config = problem.config.model_copy(update={"seed": seed})
            opened = tuning_folder(folder, problem, config, resume=True)
            tuning = tune_problem(
                problem, config, folder=opened, progress=lambda _: report(0), diagnose=False
            )
            outcome = _outcome(tuning, self.test)
            if fresh:
                line = f'"{rival.name}",{rival.scale},{seed},{time.thread_time() - start:.3f}\n'
                with self.lock:
                    write_whole(self.times, self.times.read_text() + line)
            outcome.write(file)
        return Outcome.read(file)


def _outcome(tuning: Tuning, test: CarProblem | None) -> Outcome:
    """Return a tuning's costs, and its scores on held-out drives."""
    cost = rmse = heading = None
    if test:
        scores = test.replays.scores([tuning.parameters])
        cost = float(test.objective.costs(scores, tuning.config.worst)[0])
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
    """Return evaluations and steps spent, and the lowest cost so far, after each generation of all trials."""
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


def contenders(names: Sequence[str], scales: Sequence[str], shared: dict[str, Any]) -> list[Contender]:
    """Combine every optimizer with every scale, all with the same budget of evaluations.

    Raises
    ------
    InputError
        If a name or setting is unknown or repeated, or has another budget than the first.
    """
    if not names or not scales:
        raise InputError("nothing to compare: name at least one optimizer and one scale")
    found = [_contender(name, scale, shared) for scale in scales for name in names]
    if len({c.label for c in found}) < len(found):
        raise InputError("an optimizer or scale is named twice; name each of them once")
    first = found[0]
    for other in found:
        if other.budget != first.budget:
            raise InputError(
                f"{other.name} has {other.budget} evaluations (particles x generations x trials), "
                f"{first.name} has {first.budget}; give all of them the same"
            )
    return found


def _contender(name: str, scale: str, shared: dict[str, Any]) -> Contender:
    optimizer, _, settings = name.partition(":")
    if optimizer not in OPTIMIZERS:
        raise InputError(f"no optimizer is called {optimizer!r}; choose from {', '.join(OPTIMIZERS)}")
    own: dict[str, Any] = {}
    for setting in settings.split(",") if settings else []:
        key, _, value = setting.partition("=")
        if key not in OWN or not value:
            raise InputError(
                f"{name}: {setting!r} is no setting; write NAME=VALUE after the colon, with a name of {', '.join(OWN)}"
            )
        own[key] = value
    config = validated_config(TuneConfig, {**shared, "optimizer": optimizer, "scale": scale, **own})
    return Contender(name, scale, config)
