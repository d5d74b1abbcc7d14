"""`compare`: several optimizers with the same budget on the same drives, over many seeds.

A folder of a comparison holds

    config.json       what was asked for and on which data; a resumed comparison must ask for the same
    runs/NAME-SEED/   the folder of each tuning, as `tune` writes it, and run.json once it is done
    times.csv         CPU seconds of each run: the only file that differs from one time to the next
"""

import json
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array, Drive, listed
from sigmaswarm.errors import InputError
from sigmaswarm.files import write_json, write_whole
from sigmaswarm.tuning.batch import run_batch
from sigmaswarm.tuning.contenders import Contender, budget, contenders
from sigmaswarm.tuning.problem import CarProblem
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.tuning.summary import Comparison, Run
from sigmaswarm.tuning.tune import objective_for, tune
from sigmaswarm.versions import versions


def compare(
    drives: Sequence[Drive] | Drive,
    *,
    optimizers: Sequence[str] = ("pso", "ga", "ga-pso", "de", "cma-es", "random"),
    scales: Sequence[str] = ("log10",),
    seeds: int = 20,
    test: Sequence[Drive] | Drive = (),
    out: str | Path | None = None,
    resume: bool = False,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **config: Any,
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
    test : Drive or sequence of Drive
        Held-out drives: what the filters are worth on them.
    out : path, optional
        A folder for all runs; a killed comparison can be resumed.
    resume : bool
        Go on with what ``out`` holds; the result is the same as without the interruption, but for the times.
    workers : int, optional
        Threads; as many as cores by default. The result does not depend on it.
    progress : callable, optional
        Called with the number of runs done, and of all, after every run.
    **config
        What `tune` is asked for otherwise: objective, model, particles, generations, ...

    Raises
    ------
    InputError
        If an option, optimizer, drive or folder can't be used.
    """
    drives, held_out = listed(drives), listed(test)
    if seeds < 1:
        raise InputError(f"seeds = {seeds}: at least 1 is needed")
    for name in ("seed", "optimizer", "scale"):
        if name in config:
            raise InputError(f"{name}: is what is compared; use {name}s instead")
    objective = objective_for([*drives, *held_out], config.get("objective", "auto"))
    rivals = contenders(optimizers, scales, config | {"objective": objective})
    asked = _asked(rivals, seeds, drives, held_out)
    with TemporaryDirectory() as scratch:
        folder = ResultFolder(Path(scratch if out is None else out), asked, resume=resume or out is None)
        job = _Job(drives, held_out, folder.path, threading.Lock())
        pairs = [(rival, seed) for seed in range(seeds) for rival in rivals]
        with ThreadPoolExecutor(workers) as pool:
            futures = [pool.submit(job.run, rival, seed) for rival, seed in pairs]
            try:
                for done, future in enumerate(futures, 1):
                    future.result()
                    if progress:
                        progress(done, len(futures))
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise
        runs = {
            (rival.label, seed): future.result() for (rival, seed), future in zip(pairs, futures, strict=True)
        }
    return Comparison(
        contenders=tuple(rivals),
        runs={r.label: tuple(runs[r.label, seed] for seed in range(seeds)) for r in rivals},
        budget=budget(rivals[0].config),
        steps_per_set=asked["steps_per_set"],
        drives=tuple(drive.name for drive in drives),
        test=tuple(drive.name for drive in held_out),
    )


def _asked(
    rivals: Sequence[Contender], seeds: int, drives: Sequence[Drive], held_out: Sequence[Drive]
) -> dict[str, Any]:
    """What is compared on what; all that the user could have got wrong is found here, before any work is done."""
    problem = CarProblem(drives, rivals[0].config)
    beside = problem.on(held_out).data if held_out else []
    return {
        "compared": {rival.label: rival.config.model_dump(mode="json", exclude={"seed"}) for rival in rivals},
        "seeds": seeds,
        "data": problem.data,
        "test": beside,
        "steps_per_set": int(problem.steps.sum()),
        "versions": versions(),
    }


class _Here(Executor):
    """Runs everything at once in the thread that asks: the threads are busy with whole tunings."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@dataclass(frozen=True)
class _Job:
    """The runs of a comparison."""

    drives: Sequence[Drive]
    held_out: Sequence[Drive]
    folder: Path
    lock: threading.Lock

    def run(self, rival: Contender, seed: int) -> Run:
        """One tuning and its held-out scores, or what is known of it from before."""
        folder = self.folder / "runs" / f"{rival.folder}-{seed:03d}"
        if (folder / "run.json").exists():
            return _read(folder / "run.json")
        fresh, start = not folder.exists(), time.thread_time()
        config: dict[str, Any] = rival.config.model_dump() | {"seed": seed}
        tuning = tune(self.drives, out=folder, resume=True, executor=_Here(), **config)  # pyright: ignore
        found = _judged(tuning, self.held_out)
        if fresh:  # of a run that was interrupted only the last part is known
            self._note(rival, seed, time.thread_time() - start)
        write_json(folder / "run.json", found.to_dict())
        return _read(folder / "run.json")

    def _note(self, rival: Contender, seed: int, seconds: float) -> None:
        file = self.folder / "times.csv"
        with self.lock:
            known = file.read_text() if file.exists() else "optimizer,scale,seed,cpu_seconds\n"
            write_whole(file, known + f'"{rival.name}",{rival.scale},{seed},{seconds:.3f}\n')


def _judged(tuning: Tuning, held_out: Sequence[Drive]) -> Run:
    """A tuning's costs, and its scores on drives that it never saw."""
    cost = rmse = heading = None
    if held_out:
        c = tuning.config
        batch = run_batch(
            held_out,
            [tuning.parameters],
            objective=c.objective,
            worst=c.worst,
            outage_seed=getattr(c, "outage_seed", 0),
            executor=_Here(),
        )
        cost = float(batch.costs[0])
        rmse = _mean([score.position_rmse for score in batch.scores[0]])
        heading = _mean([float(np.degrees(score.heading_rmse)) for score in batch.scores[0]])
    evaluations, steps, best = _history(tuning)
    return Run(
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


def _mean(values: list[float]) -> float | None:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if len(known) == len(values) else None


def _read(file: Path) -> Run:
    try:
        return Run.from_dict(json.loads(file.read_text()))
    except (OSError, ValueError, TypeError, KeyError):
        raise InputError(f"{file}: not a readable result; delete it to redo this run") from None
