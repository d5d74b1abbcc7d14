"""Compare the optimizers with each other and with other implementations on test functions.

    python benchmarks/optimizers.py [--seeds 20] [--budget 3000] [--only "each other"|rivals]

Needs the dependency group test. Takes some minutes. `compare_optimizers.py` compares the optimizers on filters.
"""

import argparse
import sys
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy.stats import mannwhitneyu

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles.landscapes import HIGH, LANDSCAPES, LOW, ellipsoid_at_bounds
from oracles.rival_optimizers import RIVALS
from sigmaswarm.tuning.optimizers import OPTIMIZERS, create_optimizer

POPULATION = 30
POLISH = 300
PACKAGES = ("numpy", "scipy", "cma", "cmaes", "pymoo")
Cost = Callable[[np.ndarray], np.ndarray]


def found(name: str, cost: Cost, low, high, budget: int, seeds: int, polish: int = 0) -> np.ndarray:
    """Return the lowest cost of each seed, (seeds,)."""
    costs = []
    for seed in range(seeds):
        rng = np.random.default_rng(1000 + seed)  # other random numbers than those of the rivals
        optimizer = create_optimizer(
            name, low, high, population=POPULATION, budget=budget, rng=rng, polish=polish
        )
        while len(points := optimizer.ask()):
            optimizer.tell(cost(points))
        costs.append(optimizer.global_cost)
    return np.array(costs)


def median(costs: np.ndarray) -> str:
    return f"{np.median(np.log10(np.maximum(costs, 1e-99))):.2f}"


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def against_rivals(budget: int, seeds: int) -> str:
    rows = []
    theirs = {}
    for name, rivals in RIVALS.items():
        for rival, search in rivals.items():
            cells = []
            for landscape, cost in LANDSCAPES.items():
                key = (search, landscape)
                if key not in theirs:
                    theirs[key] = [search(cost, POPULATION, budget, seed) for seed in range(seeds)]
                ours = found(name, cost, LOW, HIGH, budget, seeds)
                worse = mannwhitneyu(ours, theirs[key], alternative="greater").pvalue
                cells.append(f"{median(ours)} / {median(theirs[key])} ({worse:.2f})")
            rows.append([f"`{name}`", rival, *cells])
            print(rows[-1], flush=True)
    return table(["optimizer", "rival", *LANDSCAPES], rows)


def against_each_other(budget: int, seeds: int) -> str:
    landscapes = {**LANDSCAPES, "ellipsoid at bounds": ellipsoid_at_bounds}
    rows = []
    for name in OPTIMIZERS:
        cells = [
            " / ".join(median(found(name, cost, LOW, HIGH, budget, seeds, polish)) for polish in (0, POLISH))
            for cost in landscapes.values()
        ]
        rows.append([f"`{name}`", *cells])
        print(rows[-1], flush=True)
    return table(["optimizer", *landscapes], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--budget", type=int, default=3000)
    parser.add_argument("--only", choices=["each other", "rivals"])
    options = parser.parse_args()
    versions = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
    note = f"{options.seeds} seeds, {options.budget} evaluations, {POPULATION} a batch; {versions}."
    sections = {
        "each other": lambda: against_each_other(options.budget, options.seeds),
        "rivals": lambda: f"{against_rivals(options.budget, options.seeds)}\n\n{note}",
    }
    for section, text in sections.items():
        if options.only in (None, section):
            print(text())


if __name__ == "__main__":
    main()
