"""`run_study`: every trial of every tuned method, then the scores of all methods on the held-out drives.

The folder of a study holds

    study.toml           what was asked for; a resumed study must ask for the same
    trials/              a folder for each protocol and tuned method (`tuning/store.py` says what is in it)
    results.json         see `results.py`
    scores.csv           one row per protocol, trial, method, held-out drive and measure
    tables/              Markdown, LaTeX, CSV; runtime.* is of timings.json
    best/                a parameter file of the best trial of each tuning
    timings.json         how long it took and how fast the filters are: it and tables/runtime.*
                         alone differ between two runs
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.files import make_folder, write_whole
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.batch import Replayer
from sigmaswarm.study.config import ProtocolName, StudyConfig, read_config
from sigmaswarm.study.design import ALL, Design, Task, make_design
from sigmaswarm.study.results import Results, write_results
from sigmaswarm.study.scores import score_all
from sigmaswarm.study.tables import write_tables
from sigmaswarm.study.timings import Clock, write_timings
from sigmaswarm.tuning.objectives import Objective, mean_cost, objective_named
from sigmaswarm.tuning.search import Progress, Search, Trial
from sigmaswarm.tuning.space import SearchSpace, search_space
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions


@dataclass(frozen=True)
class StudyProgress:
    """How far a study is.

    Attributes
    ----------
    done, total : generations of the swarm, over all tunings
    task : Task that told
    """

    done: int
    total: int
    task: Task


@dataclass(frozen=True, eq=False)
class Study:
    """A finished study.

    Attributes
    ----------
    folder : Path
    design : Design
    trials : mapping of Task to Trial
    parameters : mapping of Task to FilterParameters
    best : mapping of str to FilterParameters
        Of the best trial of each of the folders in trials/, also saved as best/<name>.toml.
    results : Results
    """

    folder: Path
    design: Design
    trials: dict[Task, Trial]
    parameters: dict[Task, FilterParameters]
    best: dict[str, FilterParameters]
    results: Results

    @property
    def shown_trial(self) -> int:
        """The trial whose filters are drawn, on drives that it held back: the honest PSO-UKF's lowest training cost."""
        cost: dict[int, float] = {}
        for task, trial in self.trials.items():
            if (task.protocol, task.method) == ("honest", "pso-ukf"):
                cost[task.trial] = cost.get(task.trial, 0.0) + trial.cost
        return min(cost, key=cost.__getitem__)

    def drawn(self, protocol: ProtocolName, method: str, drive: int) -> FilterParameters:
        """The shown trial's parameters for a drive, given by its index."""
        return self.parameters[Task(protocol, method, self.design.group_of(drive), self.shown_trial)]

    def best_of(self, protocol: str, method: str, drive: int) -> tuple[str, FilterParameters]:
        """Name and parameters of the best tuning that stands for a drive, given by its index."""
        group = self.design.group_of(drive)
        name = f"{protocol}-{method}" + ("" if group == ALL else f"-{group}")
        return name, self.best[name]


@dataclass(frozen=True, eq=False)
class _Training:
    """What one tuning minimizes, on drives that all tunings share."""

    space: SearchSpace
    objective: Objective
    replayer: Replayer

    @property
    def steps(self) -> NDArray[np.int64]:
        """Filter steps that one parameter set costs on each drive, shape (m,)."""
        return self.replayer.steps

    def costs(self, points: Array, executor: Executor | None) -> Array:
        """Costs, shape (n,), of points in search coordinates, shape (n, d)."""
        return self.mean(self.each(points, range(len(self.replayer.drives)), executor))

    def each(self, points: Array, drives: Sequence[int], executor: Executor | None) -> Array:
        """The costs on some of the drives, shape (n, len(drives))."""
        scores = self.replayer.subset(drives).scores(self.space.decode(points), executor)
        return self.objective.each(scores)

    def mean(self, each: Array) -> Array:
        """The costs, shape (n,), of the costs on each drive that was tried, shape (n, k)."""
        return mean_cost(each)


class _Counter:
    """Adds up what the tunings tell from their threads, and stops them where the study was interrupted."""

    def __init__(self, total: int, tell: Callable[[StudyProgress], None] | None) -> None:
        self._lock, self._done, self._total, self._tell = threading.Lock(), 0, total, tell
        self.stopped = threading.Event()

    def of(self, task: Task, generations: int) -> Callable[[int], None]:
        """The function that one tuning tells its generation, from 1 on; those before the first it tells are done."""
        told = 0

        def tell(generation: int) -> None:
            nonlocal told
            if self.stopped.is_set():
                raise InterruptedError("the study was interrupted")
            with self._lock:
                self._done += generation - told
                told = generation
                if self._tell:
                    self._tell(StudyProgress(self._done, self._total, task))

        return tell


def run_study(
    config: StudyConfig,
    out: str | Path,
    *,
    resume: bool = False,
    executor: Executor | None = None,
    workers: int | None = None,
    progress: Callable[[StudyProgress], None] | None = None,
) -> Study:
    """Run a study, or go on with one, and write its results.

    Parameters
    ----------
    config : StudyConfig
    out : path
        The study's folder.
    resume : bool
        Go on with what ``out`` holds. The result has the same bits as that of an uninterrupted study.
    executor : concurrent.futures.Executor, optional
        Runs the tunings side by side; a pool of threads of its own by default.
    workers : int, optional
        Threads of that pool; as many as the machine has cores by default. The result does not depend on it.
    progress : callable, optional
        Called with a `StudyProgress` after every generation of every tuning.

    Raises
    ------
    InputError
        If the configuration, the folder or the drives can't be used.
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    out, clock = Path(out), Clock()
    _open_folder(out, config, resume)
    with ExitStack() as stack:
        pool = executor or stack.enter_context(ThreadPoolExecutor(workers))
        design = make_design(config, pool)
        trials = _tune_all(design, out, pool, progress)
        clock.lap("tuning")
        spaces = {task: _space(design, task) for task in trials}
        points = {task: spaces[task].decode(trial.point[np.newaxis])[0] for task, trial in trials.items()}
        scores = score_all(design, points, pool)
        touched = {task: spaces[task].touched(trial.point) for task, trial in trials.items()}
        results = write_results(out, design, trials, points, touched, scores)
    clock.lap("scoring")
    write_timings(out, design, clock)
    write_tables(out, results)
    best = _write_best(out, trials, points)
    return Study(out, design, trials, points, best, results)


def _write_best(
    out: Path, trials: dict[Task, Trial], points: dict[Task, FilterParameters]
) -> dict[str, FilterParameters]:
    """A parameter file of the best trial of each tuning, by the training cost alone."""
    best: dict[str, Task] = {}
    for task, trial in trials.items():
        if task.folder not in best or trial.cost < trials[best[task.folder]].cost:
            best[task.folder] = task
    make_folder(out / "best")
    for name, task in best.items():
        points[task].save(out / "best" / f"{name}.toml")
    return {name: points[task] for name, task in best.items()}


def _open_folder(out: Path, config: StudyConfig, resume: bool) -> None:
    file = out / "study.toml"
    if file.exists():
        if not resume:
            raise InputError(
                f"{out}: already holds a study; add --resume to go on with it, or name another folder"
            )
        saved = read_config(file)
        for name in StudyConfig.model_fields:
            if getattr(saved, name) != getattr(config, name):
                raise InputError(
                    f"{file}: was started with {name} = {getattr(saved, name)!r}, now asked for "
                    f"{getattr(config, name)!r}; repeat the first command, or name another folder"
                )
        return
    make_folder(out)
    write_whole(file, config.to_toml())


def _space(design: Design, task: Task) -> SearchSpace:
    config = design.config.tune_config(task.method, task.protocol)
    return search_space(config.model, config.scale, design.interval, kind=config.kind)


def _tune_all(
    design: Design, out: Path, pool: Executor, progress: Callable[[StudyProgress], None] | None
) -> dict[Task, Trial]:
    """Every tuning of the study: run, resumed or looked up; side by side, each on one worker."""
    tasks, generations = list(design.tasks), design.config.generations
    replayer = Replayer(design.drives, outages=False)
    folders = _result_folders(design, out)
    counter = _Counter(len(tasks) * generations, progress)
    splits = [set(design.split(trial)[0]) for trial in range(design.config.trials)]

    def one(task: Task) -> Trial:
        config = design.config.tune_config(task.method, task.protocol)
        train = [i for i in design.members(task.group) if i in splits[task.trial]]
        training = _Training(_space(design, task), objective_named(config.objective), replayer.subset(train))
        tell = counter.of(task, generations)

        def told(progress: Progress) -> None:
            tell(progress.generation)

        trial = Search(config, training, None, folders[task.folder], told).trial(task.trial)
        tell(generations)
        if not np.isfinite(trial.cost):
            raise InputError(
                f"{task.folder}: no parameter set gave a finite cost in trial {task.trial}; "
                "look for NaN or wildly wrong values in the drives"
            )
        return trial

    futures = [pool.submit(one, task) for task in tasks]
    try:
        return {task: future.result() for task, future in zip(tasks, futures, strict=True)}
    except BaseException:
        counter.stopped.set()
        for future in futures:
            future.cancel()
        raise


def _result_folders(design: Design, out: Path) -> dict[str, ResultFolder]:
    """A folder for the trials of each method under each protocol, which remembers on what they ran."""
    data = {"fingerprint": design.fingerprint(), "drives": len(design.drives)}
    folders: dict[str, ResultFolder] = {}
    for task in design.tasks:
        if task.folder not in folders:
            asked: dict[str, Any] = {
                **design.config.tune_config(task.method, task.protocol).model_dump(mode="json"),
                "group": task.group,
                "train_fraction": design.config.train_fraction,
                "drives": data,
                "versions": versions(),
            }
            folders[task.folder] = ResultFolder(out / "trials" / task.folder, asked, resume=True)
    return folders
