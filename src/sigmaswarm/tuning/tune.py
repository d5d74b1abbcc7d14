"""`tune`: search the filter parameters that serve a set of drives best."""

import hashlib
import platform
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numba
import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

import sigmaswarm
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.filters.parameters import FilterKind, FilterParameters, ModelName, units
from sigmaswarm.scoring.batch import Replayer
from sigmaswarm.tuning.batch import check_drives, check_scored
from sigmaswarm.tuning.objectives import OBJECTIVES, Objective, objective_named
from sigmaswarm.tuning.optimizers.pso import ACCELERATION, INERTIA, ParticleSwarm
from sigmaswarm.tuning.space import Option, Scale, SearchSpace, search_space
from sigmaswarm.tuning.store import ResultFolder, load_checkpoint, save_checkpoint, unreadable, write_whole


class TuneConfig(BaseModel):
    """What a tuning is asked for; saved with every result. Defaults are the paper's where it gives them."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    objective: str = "truth-rmse"
    scale: Scale = "log10"
    particles: int = Field(default=30, ge=2)
    generations: int = Field(default=50, ge=1)
    trials: int = Field(default=1, ge=1)
    seed: int = Field(default=0, ge=0)
    model: ModelName = "planar5"
    kind: FilterKind = "ukf"
    use: tuple[Option, ...] = ()
    """What the filter uses beside position fixes: velocity, lateral, standstill, gate, latency."""
    inertia: float = INERTIA
    cognitive: float = ACCELERATION
    social: float = ACCELERATION
    zero_velocity_at_bounds: bool = False
    patience: int | None = Field(default=None, ge=1)
    """Stop a trial after that many generations without a better cost; None: never."""
    outage_seed: int = Field(default=0, ge=0)


@dataclass(frozen=True)
class Progress:
    """How far a tuning is, told after every generation."""

    trial: int
    generation: int
    done: int
    total: int
    best_cost: float


@dataclass(frozen=True, eq=False)
class Trial:
    """One run of the optimizer.

    Attributes
    ----------
    cost : float
        Of the best point.
    point : ndarray, shape (d,)
        The best point, in search coordinates.
    best : ndarray, shape (generations,)
        Lowest cost so far after each generation.
    median : ndarray, shape (generations,)
        Median cost of each generation's particles.
    evaluations, failures : int
        Parameter sets tried, and how many of them failed or could not be scored.
    """

    cost: float
    point: Array
    best: Array
    median: Array
    evaluations: int
    failures: int


@dataclass(frozen=True, eq=False)
class Tuning:
    """What `tune` found.

    Attributes
    ----------
    parameters : FilterParameters
        Of the best trial.
    cost : float
        Its objective on the training drives.
    touched_bounds : list of str
        Which parameters ended on a bound of the box: the optimum may lie outside it.
    trials : tuple of Trial
    best_trial : int
    config : TuneConfig
    data : list of dict
        Name, length and fingerprint of each drive.
    """

    parameters: FilterParameters
    cost: float
    touched_bounds: list[str]
    trials: tuple[Trial, ...]
    best_trial: int
    config: TuneConfig
    data: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])

    def to_dict(self) -> dict[str, Any]:
        """Plain types, as tuning.toml holds them."""
        objective = OBJECTIVES[self.config.objective]
        return {
            "filter": self.parameters.to_dict(),
            "units": units(self.parameters),
            "result": {
                "cost": self.cost,
                "objective": objective.name,
                "objective_meaning": objective.summary,
                "touched_bounds": self.touched_bounds,
                "best_trial": self.best_trial,
                "trial_costs": [trial.cost for trial in self.trials],
                "evaluations": sum(trial.evaluations for trial in self.trials),
                "failures": sum(trial.failures for trial in self.trials),
            },
            "config": self.config.model_dump(mode="json", exclude_none=True),
            "versions": versions(),
            "data": self.data,
        }

    def save(self, path: str | Path) -> None:
        """Write a tuning.toml, which `FilterParameters.load` reads."""
        write_whole(Path(path), tomli_w.dumps(self.to_dict()).encode())


def tune(
    drives: Sequence[Drive] | Drive,
    *,
    out: str | Path | None = None,
    resume: bool = False,
    executor: Executor | None = None,
    progress: Callable[[Progress], None] | None = None,
    **config: Any,
) -> Tuning:
    """Tune a filter on drives with particle swarm optimization.

    Parameters
    ----------
    drives : Drive or sequence of Drive
        The training drives. Keep others back for `evaluate`.
    out : path, optional
        A folder for results; every generation is saved in it, so that a killed run can be resumed.
    resume : bool
        Go on with what ``out`` holds. The result has the same bits as that of an uninterrupted run.
    executor : concurrent.futures.Executor, optional
        Shares the work; threads on all cores by default. The result's bits do not depend on it.
    progress : callable, optional
        Called with a `Progress` after every generation.
    **config
        The fields of `TuneConfig`: objective, scale, particles, generations, trials, seed, model, ...

    Raises
    ------
    InputError
        If an option or the folder can't be used, the objective needs truth that a drive does not have, or no
        parameter set gave a finite cost.
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    drives = [drives] if isinstance(drives, Drive) else list(drives)
    settings = validated_config(config)
    objective = objective_named(settings.objective)
    check_drives(drives, objective)
    if objective.warning:
        warnings.warn(objective.warning, SigmaswarmWarning, stacklevel=2)
    _check_columns(drives, settings)
    data = [_described(drive) for drive in drives]
    interval = float(np.median([drive.nominal_interval for drive in drives]))
    space = search_space(settings.model, settings.scale, interval, kind=settings.kind, use=settings.use)
    replayer = Replayer(drives, outages=objective.needs_outages, outage_seed=settings.outage_seed)
    check_scored(replayer, objective)
    folder = None
    if out is not None:  # made only once nothing is left that the user could have got wrong
        asked = {**settings.model_dump(mode="json"), "data": data, "versions": versions()}
        folder = ResultFolder(Path(out), asked, resume=resume)
    with ExitStack() as stack:
        pool = executor or stack.enter_context(ThreadPoolExecutor())
        search = _Search(settings, objective, space, replayer, pool, folder, progress)
        trials = tuple(search.trial(i) for i in range(settings.trials))
    tuning = _chosen(trials, space, settings, data)
    if folder is not None:
        tuning.save(folder.path / "tuning.toml")
    return tuning


def _check_columns(drives: Sequence[Drive], config: TuneConfig) -> None:
    lacking = [d.name for d in drives if d.gps.speed is None or d.gps.course is None]
    if "velocity" in config.use and lacking:
        raise InputError(
            f"{lacking[0]}: its gps.csv has no speed and course, which --use velocity needs; leave velocity out"
        )


def validated_config(config: dict[str, Any]) -> TuneConfig:
    """The configuration of a tuning, or an `InputError` that names the option."""
    try:
        return TuneConfig(**config)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        message = first["msg"].replace("Input should", "should")
        raise InputError(f"{name} = {first['input']!r}: {message}") from None


def versions() -> dict[str, str]:
    """What the result depends on, beside the data."""
    return {
        "sigmaswarm": sigmaswarm.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }


@dataclass(frozen=True, eq=False)
class _Search:
    """Everything that the trials of one tuning share."""

    config: TuneConfig
    objective: Objective
    space: SearchSpace
    replayer: Replayer
    executor: Executor
    folder: ResultFolder | None
    progress: Callable[[Progress], None] | None

    def trial(self, number: int) -> Trial:
        """Run, resume or look up one trial."""
        done = self.folder.finished(number) if self.folder else None
        if done:
            result, history = done
            return Trial(
                result["cost"], history["point"], history["best"], history["median"], *result["counts"]
            )
        swarm = self._swarm(number)
        best, median, failures = self._resumed(number, swarm)
        while len(best) < self.config.generations and not self._stalled(best):
            costs = self._costs(swarm.ask())
            swarm.tell(costs)
            best.append(swarm.global_cost)
            median.append(float(np.median(costs)))
            failures += int(np.isinf(costs).sum())
            self._save(number, swarm, best, median, failures)
            self._report(number, best)
        counts = (len(best) * self.config.particles, failures)
        trial = Trial(swarm.global_cost, swarm.global_best, np.array(best), np.array(median), *counts)
        if self.folder:
            history = {"point": trial.point, "best": trial.best, "median": trial.median}
            self.folder.finish(number, {"cost": trial.cost, "counts": list(counts)}, history)
        return trial

    def _swarm(self, number: int) -> ParticleSwarm:
        c = self.config
        rng = np.random.default_rng(np.random.SeedSequence(c.seed, spawn_key=(number,)))
        return ParticleSwarm(
            self.space.low,
            self.space.high,
            c.particles,
            rng,
            inertia=c.inertia,
            cognitive=c.cognitive,
            social=c.social,
            zero_velocity_at_bounds=c.zero_velocity_at_bounds,
        )

    def _costs(self, points: Array) -> Array:
        return self.objective.costs(self.replayer.scores(self.space.decode(points), self.executor))

    def _stalled(self, best: list[float]) -> bool:
        patience = self.config.patience
        return patience is not None and len(best) > patience and best[-1] >= best[-1 - patience]

    def _save(
        self, number: int, swarm: ParticleSwarm, best: list[float], median: list[float], failures: int
    ) -> None:
        if not self.folder:
            return
        state = swarm.state()
        notes = {"rng": state.pop("rng"), "failures": failures}
        save_checkpoint(self.folder.checkpoint(number), state | {"best": best, "median": median}, notes)

    def _resumed(self, number: int, swarm: ParticleSwarm) -> tuple[list[float], list[float], int]:
        """Put the swarm where its checkpoint left it; the history so far."""
        checkpoint = self.folder.checkpoint(number) if self.folder else None
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if checkpoint is None or saved is None:
            return [], [], 0
        arrays, notes = saved
        try:
            swarm.restore(arrays | {"rng": notes["rng"]})
            return arrays["best"].tolist(), arrays["median"].tolist(), int(notes["failures"])
        except (KeyError, TypeError, ValueError):
            raise unreadable(checkpoint) from None

    def _report(self, number: int, best: list[float]) -> None:
        if self.progress:
            per_trial = self.config.generations
            done = number * per_trial + len(best)
            self.progress(Progress(number, len(best), done, self.config.trials * per_trial, best[-1]))


def _chosen(
    trials: tuple[Trial, ...], space: SearchSpace, config: TuneConfig, data: list[dict[str, Any]]
) -> Tuning:
    best = int(np.argmin([trial.cost for trial in trials]))
    if not np.isfinite(trials[best].cost):
        raise InputError(
            "no parameter set gave a finite cost: every filter failed on at least one drive; "
            "look for NaN or wildly wrong values in the drives"
        )
    point = trials[best].point
    parameters = space.decode(point[np.newaxis])[0]
    return Tuning(parameters, trials[best].cost, space.touched(point), trials, best, config, data)


def _described(drive: Drive) -> dict[str, Any]:
    """What identifies a drive: its name, size, and a fingerprint of its numbers."""
    return {
        "name": drive.name,
        "duration_s": round(drive.duration, 3),
        "imu_samples": len(drive.imu),
        "fixes": len(drive.gps),
        "has_truth": drive.truth is not None,
        "sha256": fingerprint(drive),
    }


def fingerprint(drive: Drive) -> str:
    """A hash of all numbers of a drive, whatever it is called."""
    digest = hashlib.sha256()
    if drive.lever_arm.any():
        digest.update(b"lever arm" + drive.lever_arm.tobytes())
    for table in (drive.imu, drive.gps, drive.truth):
        for name, column in sorted(vars(table).items()) if table is not None else ():
            if column is not None:
                digest.update(name.encode() + column.tobytes())
    return digest.hexdigest()
