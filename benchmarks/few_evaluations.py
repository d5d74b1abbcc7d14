"""Compare Bayesian optimization with the other optimizers for equal evaluations and for equal processor time.

    python benchmarks/few_evaluations.py [--drives ../shared/drives] [--seeds 5]

Needs the extra bo. Takes some minutes, nearly all of them in Bayesian optimization itself. Times are processor times of
one thread, including the filters but not the reading of drives.
"""

import argparse
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compare_optimizers import colorado
from sigmaswarm import Drive, SigmaswarmWarning, simulate
from sigmaswarm.datasets.dataset import make_datasets
from sigmaswarm.tuning.config import TuneConfig, validated_config
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.problem import CarProblem, car_problem

RIVALS = ("de", "cma-es", "pso", "sobol")
FEW, BATCH = 100, 10
"""Number of evaluations, in total and per generation."""
MOST, USUAL = 30_000, 30
"""Largest number of evaluations of the other optimizers in the given time, and their usual number per generation."""
MARKS = (25, 50, FEW)


@dataclass
class Run:
    """One search: evaluations, time (s) and lowest cost after each batch, time in filters (s), and best point."""

    evaluations: list[int]
    seconds: list[float]
    best: list[float]
    filters: float
    point: np.ndarray

    def after(self, evaluations: int) -> float:
        return self.best[np.searchsorted(self.evaluations, evaluations, side="right") - 1]


def simulated() -> tuple[list[Drive], list[Drive]]:
    """Return a town drive of a minute for training, and three held-out drives."""
    drives = [simulate("urban", run=run, duration=60, gps="white-1m") for run in range(4)]
    return drives[:1], drives[1:]


def search(problem: CarProblem, name: str, seed: int, population: int, budget: int, until: float) -> Run:
    """Search until the budget of evaluations or of time is used."""
    start, inside = time.thread_time(), 0.0
    options: dict[str, Any] = {"population": population, "budget": budget}
    optimizer = create_optimizer(
        name, problem.space.low, problem.space.high, rng=np.random.default_rng(seed), **options
    )
    evaluations, seconds, best = [0], [0.0], [np.inf]
    while seconds[-1] < until and len(points := optimizer.ask()):
        before = time.thread_time()
        costs = problem.costs(points, None)
        inside += time.thread_time() - before
        optimizer.tell(costs)
        evaluations.append(evaluations[-1] + len(points))
        seconds.append(time.thread_time() - start)
        best.append(optimizer.global_cost)
    return Run(evaluations, seconds, best, inside, optimizer.global_best)


def rows(train: list[Drive], test: list[Drive], seeds: int) -> Iterator[list[str]]:
    asked = {"model": "planar8", "objective": "truth-rmse"}
    problem = car_problem(make_datasets(train, ())[0], validated_config(TuneConfig, asked))
    held_out = problem.with_data(make_datasets(test, ())[0])
    search(problem, "sobol", 0, 16, 16, np.inf)  # loads modules and compiled code
    search(problem, "bo", 0, 8, 9, np.inf)

    def kept(runs: list[Run]) -> str:
        scores = held_out.scorer.scores([problem.parameters(run.point) for run in runs])
        return spread(np.mean(scores.position_rmse, axis=1))

    few = {
        name: [search(problem, name, seed, BATCH, FEW, np.inf) for seed in range(seeds)]
        for name in ("bo", *RIVALS)
    }
    until = float(np.median([run.seconds[-1] for run in few["bo"]]))
    for name, runs in few.items():
        took = np.median([run.seconds[-1] for run in runs])
        own = np.median([run.seconds[-1] - run.filters for run in runs])
        long = runs if name == "bo" else [search(problem, name, s, USUAL, MOST, until) for s in range(seeds)]
        yield [
            f"`{name}`",
            *(spread([run.after(n) for run in runs]) for n in MARKS),
            kept(runs),
            f"{took:.3g}",
            f"{own:.3g}",
            f"{np.median([run.evaluations[-1] for run in long]):.0f}",
            f"{np.median([run.seconds[-1] for run in long]):.3g}",
            spread([run.best[-1] for run in long]),
            kept(long),
        ]


def spread(values: Any) -> str:
    """Format median and worst value."""
    return f"{np.median(values):.3f}; {np.max(values):.3f}"


HEAD = [
    "optimizer",
    *(f"cost after {n} evaluations" for n in MARKS),
    f"held-out RMSE after {FEW}, m",
    "processor seconds",
    "of these the optimizer's",
    "in the time of `bo`: evaluations",
    "processor seconds",
    "cost",
    "held-out RMSE, m",
]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", type=Path, default=Path("../shared/drives"))
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    cases = {"simulated": simulated}
    if options.drives.is_dir():
        cases["colorado-1"] = lambda: colorado(options.drives)
    for case, load in cases.items():
        print(case, *HEAD, sep=" | ")
        for row in rows(*load(), options.seeds):
            print(case, *row, sep=" | ", flush=True)


if __name__ == "__main__":
    main()
