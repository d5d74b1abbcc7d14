"""Run a study: tune every method in every trial, then score all methods on the test drives.

The folder of a study contains

    study.toml           configuration, which must be the same for a resumed study
    trials/              a folder for each protocol, tuned method and group, in the format of a tuning
    results.json         see `record.py`
    scores.csv           one row per protocol, trial, method, test drive and measure
    learned/             only with rivals: a folder in the format of `sigmaswarm learn` for each network of a trial and
                         for each point of a learning curve
    elsewhere/           only with rivals: scores.csv of drives with other sensors, and of drives with another car
    tracks.npz           tracks of a few test drives of the best trial
    best/                parameter file of the best trial of each tuning
    timings.json         durations of the study and of filters; with rivals, the folder of each tuning run and training
                         run also has such a file; only these files and the tables of durations differ between two runs
"""

import sys
import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.experiments.grid import Report, run_grid
from sigmaswarm.experiments.study.config import MAIN_METHOD, ProtocolName, StudyConfig, read_config
from sigmaswarm.experiments.study.design import Design, Filters, Task, Trials, designs_elsewhere, make_design
from sigmaswarm.experiments.study.networks import train_all, trainings
from sigmaswarm.experiments.study.record import Results, StudyRecord, quantiles_of
from sigmaswarm.experiments.study.results import results_of, rival_results
from sigmaswarm.experiments.study.scores import record_tracks, score_all, score_networks
from sigmaswarm.experiments.study.timings import Stopwatch, rival_times, stored_time, write_timings
from sigmaswarm.files import locked_folder, make_folder, staged_files, write_atomically
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.learned.fitting import double_precision
from sigmaswarm.scoring.batch import cores
from sigmaswarm.scoring.tracks import Picture, save_tracks
from sigmaswarm.tuning.config import require_packages
from sigmaswarm.tuning.objectives import parse_objective
from sigmaswarm.tuning.problem import CarProblem, car_space
from sigmaswarm.tuning.search import Trial, TrialRunner
from sigmaswarm.tuning.space import SearchSpace
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client


@dataclass(frozen=True)
class StudyProgress:
    """Progress of a study: ``done`` and ``total`` generations and epochs, and the task that advanced."""

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
        Parameters of the best trial of each tuning, by folder in trials/.
    record : StudyRecord
        Content of the folder.
    picture : Picture
        Data of a static plot of the tracks on a test drive.
    """

    folder: Path
    design: Design
    trials: Trials
    parameters: Filters
    best: dict[str, FilterParameters]
    record: StudyRecord
    picture: Picture

    @property
    def results(self) -> Results:
        return self.record.results


def shown_trial(trials: Trials) -> int:
    """Return the trial to plot: its PSO-UKFs tuned with truth have the lowest training cost, summed over all groups."""
    cost: dict[int, float] = {}
    for task, trial in trials.items():
        if task.variant == ("honest", MAIN_METHOD):
            cost[task.trial] = cost.get(task.trial, 0.0) + trial.cost
    return min(cost, key=cost.__getitem__)


def run_study(
    config: StudyConfig,
    out: str | Path,
    *,
    resume: bool = False,
    executor: Executor | None = None,
    workers: int | None = None,
    cluster: "Client | None" = None,
    progress: Callable[[StudyProgress], None] | None = None,
) -> Study:
    """Run or resume a study, and write its results.

    Parameters
    ----------
    config : StudyConfig
    out : path
        The study's folder.
    resume : bool
        Continue the study in ``out``. The result is the same as without interruption.
    executor : concurrent.futures.Executor, optional
        Performs the tuning runs; by default forked processes on Linux, otherwise threads.
    workers : int, optional
        Number of processes or threads; by default the number of cores. The result does not depend on this number.
    cluster : distributed.Client, optional
        Dask cluster whose workers simulate or read the drives and run the filters. On processors of one type, the
        result is the same as without a cluster. Not available with rivals, since networks are trained locally.
    progress : callable, optional
        Called with a `StudyProgress` as tuning and training runs advance.

    Raises
    ------
    InputError
        If the configuration, the folder or a drive is invalid.
    AlignmentError
        If no filter can start on a drive, for example because the vehicle is too slow.
    """
    if config.rivals:
        with double_precision():  # raises if JAX is missing
            require_packages("bo")
        if cluster is not None:
            raise InputError("rivals = True: networks are trained on local drives; omit the cluster")
    watch = Stopwatch()
    with locked_folder(Path(out)) as folder, ExitStack() as stack:
        _open_folder(folder, config, resume)
        if config.rivals:  # bo ignores this warning, but another thread may reset the warning filters
            stack.enter_context(warnings.catch_warnings())
            warnings.filterwarnings("ignore", "The optimal value found for dimension")
        # By default, Python starts more threads than cores, which would wait for each other.
        crew = workers or cores()
        pool = executor or stack.enter_context(ThreadPoolExecutor(crew if cluster is None else workers))
        # JAX, which rivals need, does not work in forked processes.
        forks = sys.platform == "linux" and crew > 1 and executor is cluster is None and not config.rivals
        design = make_design(config, pool, cluster)
        return _run(folder, design, pool, crew if forks else 0, progress or (lambda _: None), watch)


def _open_folder(out: Path, config: StudyConfig, resume: bool) -> None:
    file = out / "study.toml"
    if not file.exists():
        write_atomically(file, config.to_toml())
        return
    if not resume:
        raise InputError(
            f"{out}: already contains a study; add --resume to continue it, or specify another folder"
        )
    saved = read_config(file)
    for name in StudyConfig.model_fields:
        if getattr(saved, name) != getattr(config, name):
            raise InputError(
                f"{file}: the study was started with {name} = {getattr(saved, name)!r}, but this command has "
                f"{getattr(config, name)!r}; repeat the first command, or specify another folder"
            )


def _run(
    folder: Path,
    design: Design,
    pool: Executor,
    processes: int,
    progress: Callable[[StudyProgress], None],
    watch: Stopwatch,
) -> Study:
    elsewhere = designs_elsewhere(design, pool)
    spaces = {variant: car_space(config, design.drives) for variant, config in design.configs.items()}
    total = len(list(design.tasks)) * design.config.generations + sum(t.epochs for t in trainings(design))

    def report(done: int, task: Task) -> None:
        progress(StudyProgress(done, total, task))

    trials = _tune_all(design, spaces, folder, pool, report, processes)
    watch.lap("tuning")
    points = {task: spaces[task.variant].decode(trial.point[np.newaxis])[0] for task, trial in trials.items()}
    networks = train_all(design, points, folder, report)
    if networks:
        watch.lap("training")
    whole = {t.task: network for t, network in networks.items() if t.minutes is None}
    scores = score_all(design, points, pool, whole)
    away = {place: score_all(other, points, pool, whole) for place, other in elsewhere.items()}
    rivals = None
    if design.config.rivals:
        less = {t: network for t, network in networks.items() if t.minutes is not None}
        curve = score_networks(design, [*less.values()], [design.split(0)[1]] * len(less), pool)
        rivals = rival_results(trials, whole, less, scores, away, curve)
    touched = {task: spaces[task.variant].touched(trial.point) for task, trial in trials.items()}
    results = results_of(trials, points, touched, scores, rivals)
    tracks, picture = record_tracks(design, points, shown_trial(trials))
    with staged_files(folder) as new:
        scores.write(new)
        for place, table in away.items():
            table.write(make_folder(new / "elsewhere" / place.replace(" ", "-")))
        results.write(new)
        save_tracks(tracks, new / "tracks.npz")
    watch.lap("scoring")
    times = rival_times(folder, design, points, whole) if design.config.rivals else {}
    live = write_timings(folder, design, watch, times)
    record = StudyRecord(results, quantiles_of(scores.to_frame()), live, times, tracks, versions())
    return Study(folder, design, trials, points, _write_best(folder, trials, points), record, picture)


def _write_best(out: Path, trials: Trials, points: Filters) -> dict[str, FilterParameters]:
    best: dict[str, Task] = {}
    for task, trial in trials.items():
        if task.folder not in best or trial.cost < trials[best[task.folder]].cost:
            best[task.folder] = task
    make_folder(out / "best")
    for name, task in best.items():
        points[task].save(out / "best" / f"{name}.toml")
    return {name: points[task] for name, task in best.items()}


def _tune_all(
    design: Design,
    spaces: Mapping[tuple[ProtocolName, str], SearchSpace],
    out: Path,
    pool: Executor,
    progress: Callable[[int, Task], None],
    processes: int,
) -> Trials:
    configs = design.configs
    outages = {v: parse_objective(config.objective).needs_outages for v, config in configs.items()}
    scorers = {needed: design.scorer(outages=needed) for needed in set(outages.values())}
    problems = {v: CarProblem(configs[v], spaces[v], [], scorers[outages[v]]) for v in configs}
    folders = _result_folders(design, out)
    splits = [set(design.split(trial)[0]) for trial in range(design.config.trials)]

    def one(task: Task, report: Report) -> Trial:
        train = [i for i in design.members(task.group) if i in splits[task.trial]]
        folder, config, problem = folders[task.folder], configs[task.variant], problems[task.variant]
        own = CarProblem(config, problem.space, [], problem.scorer.subset(train))
        search = TrialRunner(own, None, folder, lambda now: report(now.generation))
        timed = design.config.rivals and folder.finished(task.trial) is None
        file = folder.path / f"trial-{task.trial:03d}" / "timings.json"
        with stored_time(file) if timed else nullcontext():
            trial = search.trial(task.trial)
        if not np.isfinite(trial.cost):
            raise InputError(
                f"{task.folder}: no parameter set gave a finite cost in trial {task.trial}; "
                "check the drives for NaN and for values in wrong units"
            )
        return trial

    def effort(task: Task) -> float:
        """Estimate the duration of a tuning run, relative to other tuning runs on the same number of drives."""
        config = configs[task.variant]
        step = len(MODELS[config.model].states) ** 1.5 * (0.2 if config.racing else 1.0)  # time per step
        return (1 + outages[task.variant]) * step * config.particles * config.generations

    if processes:
        for problem in problems.values():  # compiled and loaded once, before the processes fork
            problem.costs_by_drive(problem.space.low[np.newaxis], [0], None)
    return run_grid(
        list(design.tasks),
        one,
        pool,
        processes=processes,
        rounds=design.config.generations,
        effort=effort,
        progress=lambda done, _, task: progress(done, task),
    )


def _result_folders(design: Design, out: Path) -> dict[str, ResultFolder]:
    data = {"fingerprint": design.fingerprint(), "drives": len(design.drives)}
    folders: dict[str, ResultFolder] = {}
    for task in design.tasks:
        if task.folder not in folders:
            config = {
                **design.configs[task.variant].model_dump(mode="json"),
                "group": task.group,
                "train_fraction": design.config.train_fraction,
                "drives": data,
                "versions": versions(),
            }
            folders[task.folder] = ResultFolder(out / "trials" / task.folder, config, resume=True)
    return folders
