"""Compare optimizers with the same budget on the same drives, over many seeds.

The folder of a comparison contains

    config.json       configuration and data, which must be the same for a resumed comparison
    runs/NAME-SEED/   folder of each tuning, in the format of `tune`, with run.json after its end
    times.csv         processor time of each run; the only file that differs between two identical comparisons
"""

import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Unpack, get_args

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.datasets.dataset import Dataset, Drives, make_datasets
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.sensors import log_properties
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.experiments.comparison import Comparison, Contender, Outcome
from sigmaswarm.experiments.grid import Report, run_grid
from sigmaswarm.files import locked_folder, write_atomically, write_json
from sigmaswarm.filters.fixes_alone import FixesAlone, MotionNoise
from sigmaswarm.filters.run import estimate_of
from sigmaswarm.scoring.batch import cores
from sigmaswarm.scoring.score import score_estimate
from sigmaswarm.scoring.targets import tracking_pass
from sigmaswarm.tuning.config import SEEDS, CompareOptions, OptimizerName, TuneConfig, validated_config
from sigmaswarm.tuning.defaults import default_filter_options, objective_for
from sigmaswarm.tuning.problem import CarProblem, car_problem, car_space
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.tuning.tune import check_disjoint, tune_problem, tuning_folder
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    from distributed import Client

# Options in which contenders may differ, in addition to optimizer and scale.
CONTENDER_OPTIONS = (
    *("particles", "generations", "trials", "polish", "racing"),
    *("inertia", "cognitive", "social", "zero_velocity_at_bounds"),
)
# Options of `tune` that a comparison rejects, with the reasons.
REJECTED_OPTIONS = {
    **{name: f"varies in a comparison; use {name}s instead" for name in ("seed", "optimizer", "scale")},
    **dict.fromkeys(
        ("prior", "inflation", "margin"),
        "is not an option of a comparison, which uses costs without prior and inflation; remove this option",
    ),
}


class GridOptions(CompareOptions, total=False):
    optimizers: Sequence[str]
    scales: Sequence[str]
    seeds: int
    workers: int | None


def compare(
    drives: Drives,
    *,
    validation: Drives = (),
    out: str | Path | None = None,
    resume: bool = False,
    cluster: "Client | None" = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Unpack[GridOptions],
) -> Comparison:
    """Compare optimizers with the same budget of evaluations on the same drives.

    Parameters
    ----------
    drives, validation : Drive or sequence of Drive
        Training drives, and held-out drives on which the results are tested.
    out : path, optional
        Folder for all runs, so that a stopped comparison can be resumed.
    resume : bool
        Continue the comparison in ``out``. Except for the times, the result is the same as without interruption.
    cluster : distributed.Client, optional
        Dask cluster whose workers read the drives and run the filters. Drives may then be paths or URLs, and
        ``workers`` is the number of simultaneous tuning runs. The result does not depend on the cluster.
    progress : callable, optional
        Called with the number of finished runs and the number of all runs.
    optimizers : sequence of str
        Names, optionally with settings: ``pso:polish=300``, ``pso:particles=10,trials=3``. All optimizers must have the
        same budget: particles x generations x trials. The statistical tests compare the first optimizer with each of
        the others. The default is pso, ga, ga-pso, de, cma-es and random.
    scales : sequence of str
        log10 (the default), linear or both.
    seeds : int
        Number of runs of each optimizer, with seeds 0, 1, ...; 20 by default.
    workers : int, optional
        Number of threads; by default the number of cores. The result does not depend on this number.
    **options
        Options of every tuning (see `CompareOptions`): objective, model, particles, generations, ...

    Raises
    ------
    InputError
        If an option, optimizer, drive or folder is invalid.
    """
    workers = options.pop("workers", None) or (cores() if cluster is None else None)
    grid = _grid(options, *make_datasets(drives, validation, cluster=cluster))
    with (
        TemporaryDirectory() as scratch,
        locked_folder(Path(scratch if out is None else out)) as folder,
        ThreadPoolExecutor(workers) as pool,
    ):
        return grid.run(folder, pool, resume or out is None, progress)


@dataclass(frozen=True, eq=False)
class _Grid:
    rivals: Sequence[Contender]
    seeds: int
    problem: CarProblem
    test: CarProblem | None

    def run(
        self, out: Path, pool: Executor, resume: bool, progress: Callable[[int, int], None] | None
    ) -> Comparison:
        steps_per_set = int(self.problem.steps.sum())
        config = {
            "compared": {c.label: c.config.model_dump(mode="json", exclude={"seed"}) for c in self.rivals},
            "seeds": self.seeds,
            "data": self.problem.data,
            "test": self.test.data if self.test else [],
            "steps_per_set": steps_per_set,
            "versions": versions(),
        }
        ResultFolder(out, config, resume=resume)
        outcomes = run_grid(
            [(rival, seed) for seed in range(self.seeds) for rival in self.rivals],
            self._runner(out),
            pool,
            progress=lambda done, total, _: progress(done, total) if progress else None,
        )
        fixes_alone = None
        if self.test:
            alone = partial(_rmse_alone, noise=self.problem.fixes_alone())
            fixes_alone = _mean(np.array(self.test.scorer.map_prepared(alone)))
        return Comparison(
            contenders=tuple(self.rivals),
            runs={c.label: tuple(outcomes[c, seed] for seed in range(self.seeds)) for c in self.rivals},
            budget=self.rivals[0].budget,
            steps_per_set=steps_per_set,
            drives=tuple(drive["name"] for drive in self.problem.data),
            test=tuple(drive["name"] for drive in self.test.data) if self.test else (),
            fixes_alone_rmse=fixes_alone,
        )

    def _runner(self, out: Path) -> Callable[[tuple[Contender, int], Report], Outcome]:
        lock, times = threading.Lock(), out / "times.csv"
        spaces = {rival.scale: car_space(rival.config, self.problem.sensors) for rival in self.rivals}
        if not times.exists():
            write_atomically(times, "optimizer,scale,seed,cpu_seconds\n")

        def run(task: tuple[Contender, int], report: Report) -> Outcome:
            rival, seed = task
            folder = out / "runs" / f"{rival.folder}-{seed:03d}"
            if not (folder / "run.json").exists():
                fresh, start = not folder.exists(), time.thread_time()
                config = rival.config.model_copy(update={"seed": seed})
                problem = replace(self.problem, config=config, space=spaces[rival.scale])
                opened = tuning_folder(folder, problem, resume=True)
                tuning = tune_problem(problem, folder=opened, progress=lambda _: report(0), diagnose=False)
                outcome = _outcome(tuning, self.test)
                if fresh:  # the time of an interrupted run is unknown
                    line = f'"{rival.name}",{rival.scale},{seed},{time.thread_time() - start:.3f}\n'
                    with lock:
                        write_atomically(times, times.read_text() + line)
                write_json(folder / "run.json", asdict(outcome))
            return Outcome.read(folder / "run.json")

        return run


def _grid(options: GridOptions, training: Dataset, held_out: Dataset) -> _Grid:
    seeds = options.get("seeds", SEEDS)
    if seeds < 1:
        raise InputError(f"seeds = {seeds} is too small; choose 1 or more")
    for name in set(REJECTED_OPTIONS).intersection(options):
        raise InputError(f"{name} {REJECTED_OPTIONS[name]}")
    rivals = _contenders(options, [*training.map(log_properties), *held_out.map(log_properties)])
    problem = car_problem(
        training, rivals[0].config, branched=False
    )  # so that comparisons of 0.3.0 can be resumed
    test = problem.with_data(held_out) if len(held_out) else None
    if test:
        check_disjoint(problem, test)
    if problem.objective.warning:
        warnings.warn(problem.objective.warning, SigmaswarmWarning, stacklevel=3)
    return _Grid(rivals, seeds, problem, test)


def _contenders(options: GridOptions, drives: Sequence[Any]) -> list[Contender]:
    """Create a contender for every optimizer and scale. All must have the same budget."""
    given: dict[str, Any] = {**options}
    given.pop("seeds", None)
    names = given.pop("optimizers", ("pso", "ga", "ga-pso", "de", "cma-es", "random"))
    scales = given.pop("scales", ("log10",))
    shared, _ = default_filter_options(given, drives)
    objective = objective_for(drives, given.get("objective", "auto"), shared["model"], shared["use"])
    shared |= {"objective": objective, "prior": 0.0, "inflation": 0.0}
    if not names or not scales:
        raise InputError("nothing to compare: name at least one optimizer and one scale")
    contenders = [_contender(name, scale, shared) for scale in scales for name in names]
    if len({c.label for c in contenders}) < len(contenders):
        raise InputError("an optimizer or scale is named twice; name each only once")
    first = contenders[0]
    for other in contenders:
        if other.budget != first.budget:
            raise InputError(
                f"{other.name} has {other.budget} evaluations (particles x generations x trials), "
                f"but {first.name} has {first.budget}; choose settings with the same number for all optimizers"
            )
    return contenders


def _contender(name: str, scale: str, shared: Mapping[str, Any]) -> Contender:
    optimizer, _, settings = name.partition(":")
    if optimizer not in (known := get_args(OptimizerName)):
        raise InputError(f"no optimizer is called {optimizer!r}; choose from {', '.join(known)}")
    own: dict[str, Any] = {}
    for setting in settings.split(",") if settings else []:
        key, _, value = setting.partition("=")
        if key not in CONTENDER_OPTIONS or not value:
            raise InputError(
                f"{name}: {setting!r} is not a setting; write NAME=VALUE after the colon, where NAME is one "
                f"of {', '.join(CONTENDER_OPTIONS)}"
            )
        own[key] = value
    config = validated_config(TuneConfig, {**shared, "optimizer": optimizer, "scale": scale, **own})
    return Contender(name, scale, config)


def _outcome(tuning: Tuning, test: CarProblem | None) -> Outcome:
    cost = rmse = heading = None
    if test:
        scores = test.scorer.scores([tuning.parameters])
        cost = float(test.objective.costs(scores, tuning.config.worst)[0])
        rmse, heading = _mean(scores.position_rmse[0]), _mean(np.degrees(scores.heading_rmse[0]))
    spent, evaluations, steps = 0, list[int](), list[int]()
    for trial in tuning.trials:
        counts = np.minimum(tuning.config.particles * np.arange(1, len(trial.best) + 1), trial.evaluations)
        evaluations += (spent + counts).tolist()
        steps += ((steps[-1] if steps else 0) + trial.steps).tolist()
        spent += trial.evaluations
    return Outcome(
        cost=tuning.cost,
        held_out_cost=cost,
        held_out_rmse=rmse,
        held_out_heading=heading,
        touched=tuple(touched.parameter for touched in tuning.touched_bounds),
        evaluations=spent,
        failures=sum(trial.failures for trial in tuning.trials),
        history_evaluations=tuple(evaluations),
        history_steps=tuple(steps),
        history_best=tuple(np.minimum.accumulate(np.concatenate([t.best for t in tuning.trials])).tolist()),
    )


def _rmse_alone(ready: PreparedDrive, noise: MotionNoise) -> float:
    whole = estimate_of(FixesAlone(tracking_pass(ready), noise), recover=False)
    return score_estimate(ready.drive, whole).position_rmse


def _mean(values: Array) -> float | None:
    return float(np.mean(values)) if np.isfinite(values).all() else None
