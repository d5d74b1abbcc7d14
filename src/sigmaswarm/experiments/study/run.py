"""`run_study`: every trial of every tuned method, then the scores of all methods on the held-out drives.

The folder of a study holds

    study.toml           what was asked for; a resumed study must ask for the same
    trials/              a folder for each protocol and tuned method (`tuning/store.py` says what is in it)
    results.json         see `record.py`
    scores.csv           one row per protocol, trial, method, held-out drive and measure
    learned/             with rivals, a folder for each network and trial, and for each point of a learning curve, as
                         `sigmaswarm learn` makes it
    elsewhere/           with rivals, scores.csv of drives of other sensors, and of another car
    tracks.npz           tracks of a few drives that the best trial held back
    best/                a parameter file of the best trial of each tuning
    timings.json         how long it took and how fast the filters are: it alone, with the tables of it,
                         differs between two runs; with rivals each tuning and training has one, too
"""

import warnings
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.experiments.forked import forked
from sigmaswarm.experiments.grid import Tell, run_grid
from sigmaswarm.experiments.study.config import MAIN, StudyConfig, read_config
from sigmaswarm.experiments.study.design import Design, Task, kind, make_design
from sigmaswarm.experiments.study.elsewhere import designs_elsewhere
from sigmaswarm.experiments.study.folder import StudyRecord
from sigmaswarm.experiments.study.network_scores import scores_of_curve
from sigmaswarm.experiments.study.networks import (
    epochs_of,
    require_rivals,
    train_all,
    trainings,
)
from sigmaswarm.experiments.study.record import Results, Variant
from sigmaswarm.experiments.study.results import results_of
from sigmaswarm.experiments.study.rivals import rival_results
from sigmaswarm.experiments.study.scores import score_all
from sigmaswarm.experiments.study.spread import spreads_of
from sigmaswarm.experiments.study.timings import Stopwatch, kept_time, rival_times, write_timings
from sigmaswarm.experiments.study.tracks import follow
from sigmaswarm.files import held_folder, make_folder, write_whole
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.scoring.jobs import cores
from sigmaswarm.scoring.tracks import Picture, save_tracks
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.objectives import objective_named
from sigmaswarm.tuning.problem import CarProblem, car_space, usual_interval
from sigmaswarm.tuning.search import Search, Trial
from sigmaswarm.tuning.space import SearchSpace
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client


RACED = 0.2
"""What racing leaves of a tuning's time, about: who begins first depends on it, nothing else."""


@dataclass(frozen=True)
class StudyProgress:
    """How far a study is.

    Attributes
    ----------
    done, total : generations of the swarm, over all tunings, and epochs of all trainings of networks
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
    record : StudyRecord
        As it is read back from the folder.
    picture : Picture
        Of a drive that the trial held back whose honest PSO-UKF has the lowest training cost.
    """

    folder: Path
    design: Design
    trials: dict[Task, Trial]
    parameters: dict[Task, FilterParameters]
    best: dict[str, FilterParameters]
    record: StudyRecord
    picture: Picture

    @property
    def results(self) -> Results:
        """What results.json holds."""
        return self.record.results

    def best_of(self, protocol: str, method: str, drive: int) -> tuple[str, FilterParameters]:
        """Name and parameters of the best tuning that stands for a drive, given by its index."""
        name = kind(protocol, method, self.design.group_of(drive))
        return name, self.best[name]


def shown_trial(trials: Mapping[Task, Trial]) -> int:
    """The trial whose filters are drawn, on drives that it held back: the honest PSO-UKF's lowest training cost."""
    cost: dict[int, float] = {}
    for task, trial in trials.items():
        if (task.protocol, task.method) == ("honest", MAIN):
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
    """Run a study, or go on with one, and write its results.

    Parameters
    ----------
    config : StudyConfig
    out : path
        The study's folder.
    resume : bool
        Go on with what ``out`` holds. The result has the same bits as that of an uninterrupted study.
    executor : concurrent.futures.Executor, optional
        Runs the tunings side by side; by default forks of this process do, where it can be forked, else threads.
    workers : int, optional
        So many of these; as many as the machine has cores by default. The result does not depend on it.
    cluster : distributed.Client, optional
        Of a Dask cluster, whose workers make or read the drives, hold them, and do the work; the threads here only
        ask. Nor does the result depend on it. Not with rivals: networks are trained here.
    progress : callable, optional
        Called with a `StudyProgress` after every generation of every tuning.

    Raises
    ------
    InputError
        If the configuration, the folder or the drives can't be used.
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    if config.rivals:
        require_rivals()
        if cluster is not None:
            raise InputError(
                "rivals = True: networks are trained on drives that are here; leave the cluster out"
            )
    watch = Stopwatch()
    with held_folder(Path(out)) as folder, ExitStack() as stack:
        _open_folder(folder, config, resume)
        if config.rivals:  # bo silences it, but a compiler in another thread may undo that
            stack.enter_context(warnings.catch_warnings())
            warnings.filterwarnings("ignore", "The optimal value found for dimension")
        # Python's own number of threads is larger, and they would wait for each other
        crew = workers or cores()
        pool = executor or stack.enter_context(ThreadPoolExecutor(crew if cluster is None else workers))
        design = make_design(config, pool, cluster)
        elsewhere = designs_elsewhere(design, pool)
        spaces, lessons = _spaces(design), trainings(design)
        tell = _telling(design, sum(map(epochs_of, lessons)), progress)
        alone = executor is not None or cluster is not None or config.rivals  # JAX bears no fork
        trials = _tune_all(design, spaces, folder, pool, tell, forks=0 if alone or crew == 1 else crew)
        watch.lap("tuning")
        boxes = {task: spaces[task.protocol, task.method] for task in trials}
        points = {task: boxes[task].decode(trial.point[np.newaxis])[0] for task, trial in trials.items()}
        touched = {task: boxes[task].touched(trial.point) for task, trial in trials.items()}
        networks = train_all(design, lessons, points, folder, tell)
        taught = {training.task: found for training, found in networks.items() if training.minutes is None}
        if networks:
            watch.lap("training")
        scores = score_all(design, points, pool, taught)
        away = {place: score_all(other, points, pool, taught) for place, other in elsewhere.items()}
        rivals = None
        if config.rivals:
            curve = scores_of_curve(design, networks, pool)
            rivals = rival_results(trials, taught, scores, away, curve)
        results = results_of(design, trials, points, touched, scores, rivals)
        tracks, picture = follow(design, points, shown_trial(trials))
        scores.write(folder)
        for place, table in away.items():
            table.write(make_folder(folder / "elsewhere" / place.replace(" ", "-")))
        results.write(folder)
        save_tracks(tracks, folder / "tracks.npz")
        watch.lap("scoring")
        times = rival_times(folder, design, points, taught) if config.rivals else {}
        live = write_timings(folder, design, watch, times)
        record = StudyRecord(results, spreads_of(scores.to_frame()), live, times, tracks, versions())
        best = _write_best(folder, trials, points)
    return Study(folder, design, trials, points, best, record, picture)


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
    write_whole(file, config.to_toml())


def _spaces(design: Design) -> dict[Variant, SearchSpace]:
    """The box of every tuned variant, for the drives' usual interval between two IMU samples."""
    interval = usual_interval(design.drives)
    return {
        (protocol, method): car_space(design.tune_config(method, protocol), interval)
        for method, protocols in design.config.tuned_methods.items()
        for protocol in protocols
    }


def _telling(
    design: Design, epochs: int, progress: Callable[[StudyProgress], None] | None
) -> Callable[[int, Task], None]:
    """What tells how much is done of all generations of all tunings, and of so many epochs after them."""
    total = len(list(design.tasks)) * design.config.generations + epochs

    def told(done: int, task: Task) -> None:
        if progress:
            progress(StudyProgress(done, total, task))

    return told


def _tune_all(
    design: Design,
    spaces: Mapping[Variant, SearchSpace],
    out: Path,
    pool: Executor,
    progress: Callable[[int, Task], None],
    *,
    forks: int,
) -> dict[Task, Trial]:
    """Every tuning of the study, on the drives of its group that its trial trains on; in forks, if there are any."""
    configs = {(p, m): design.tune_config(m, p) for p, m in spaces}
    needs = {variant: objective_named(config.objective).needs_outages for variant, config in configs.items()}
    replays = {outages: design.replays(outages=outages) for outages in set(needs.values())}
    folders = _result_folders(design, out)
    splits = [set(design.split(trial)[0]) for trial in range(design.config.trials)]

    def one(task: Task, tell: Tell) -> Trial:
        variant = task.protocol, task.method
        config, held = configs[variant], replays[needs[variant]]
        train = [i for i in design.members(task.group) if i in splits[task.trial]]
        problem = CarProblem(config, spaces[variant], [], held.subset(train))
        search = Search(config, problem, None, folders[task.folder], lambda told: tell(told.generation))
        folder = folders[task.folder]
        timed = design.config.rivals and folder.finished(task.trial) is None
        file = folder.path / f"trial-{task.trial:03d}" / "timings.json"
        with kept_time(file) if timed else nullcontext():
            trial = search.trial(task.trial)
        if not np.isfinite(trial.cost):
            raise InputError(
                f"{task.folder}: no parameter set gave a finite cost in trial {task.trial}; "
                "look for NaN or wildly wrong values in the drives"
            )
        return trial

    def told(done: int, _: int, task: Task) -> None:
        progress(done, task)

    def effort(task: Task) -> float:
        variant = task.protocol, task.method
        return _effort(configs[variant], needs[variant])

    tasks, rounds = list(design.tasks), design.config.generations
    if forks:
        for variant, config in configs.items():  # compiled and loaded here, once for all
            problem = CarProblem(config, spaces[variant], [], replays[needs[variant]])
            problem.each(problem.space.low[np.newaxis], [0], None)
    with forked(one, forks) as run:
        return run_grid(tasks, run, pool, rounds=rounds, effort=effort, progress=told)


def _effort(config: TuneConfig, outages: bool) -> float:
    """About how long a tuning takes beside others on as many drives: of passes, of a step, of what racing leaves."""
    passes, step = 1 + outages, len(MODELS[config.model].states) ** 1.5
    return passes * step * (RACED if config.racing else 1.0) * config.particles * config.generations


def _result_folders(design: Design, out: Path) -> dict[str, ResultFolder]:
    """A folder for the trials of each method under each protocol, which remembers on what they ran."""
    data = {"fingerprint": design.fingerprint(), "drives": len(design.drives)}
    folders: dict[str, ResultFolder] = {}
    for task in design.tasks:
        if task.folder not in folders:
            asked: dict[str, Any] = {
                **design.tune_config(task.method, task.protocol).model_dump(mode="json"),
                "group": task.group,
                "train_fraction": design.config.train_fraction,
                "drives": data,
                "versions": versions(),
            }
            folders[task.folder] = ResultFolder(out / "trials" / task.folder, asked, resume=True)
    return folders
