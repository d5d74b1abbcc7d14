"""Compare optimizers and ways to spend their budget on simulated and real drives, for docs/optimizers.md.

    python benchmarks/compare_optimizers.py OUT [--drives ../shared/drives] [--seeds 20] [--only "KITTI, truth-rmse"]

Every comparison is saved in a folder of OUT, with all measures, and resumed if the folder exists. The tables are
printed if all cases are run.

    python benchmarks/compare_optimizers.py OUT --budgets

writes the table of training costs at three budgets. Every run is a line of OUT/budgets.jsonl; runs in this file are not
repeated. The command takes about half an hour on one core.
"""

import argparse
import json
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from sigmaswarm import Comparison, Drive, SigmaswarmWarning, compare, read_drive, simulate, split_time
from sigmaswarm.drives.sensors import log_properties
from sigmaswarm.drives.split import clip
from sigmaswarm.experiments.comparison import MEASURES
from sigmaswarm.reports.compare import comparison_table, save_comparison
from sigmaswarm.tuning.config import TuneConfig, validated_config
from sigmaswarm.tuning.defaults import complete_config, default_filter_options
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.problem import CarProblem, car_problem

PAGE = Path(__file__).parents[1] / "docs" / "optimizers.md"
BASE = ("pso", "de", "cma-es", "ga", "ga-pso", "sobol")
FEW = (*BASE, "pso:polish=300", "de:polish=300", "cma-es:particles=15,generations=100", "pso:racing=true")
WAYS = (
    *FEW,
    "pso:particles=15,generations=100",
    "pso:particles=15,generations=20,trials=5",
    "de:racing=true",
    "cma-es:racing=true",
    "random",
    "nelder-mead",
)
KITTI = ("kitti-09-26-0022", "kitti-09-26-0101", "kitti-09-30-0033", "kitti-09-30-0034", "kitti-09-30-0018")
MODELS = ("planar5", "planar8")
BOTH = ("log10", "linear")
HELD_OUT = {
    "simulated, scales",
    "KITTI, truth-rmse",
    "KITTI turned, truth-rmse",
    "colorado-1, truth-rmse",
    "colorado-1, innovation-nll",
}
"""Cases in the two tables of the held-out RMSE, one per scale of the variances."""


def simulated() -> tuple[list[Drive], list[Drive]]:
    """Return six town drives of a minute for training, and three held-out drives."""
    drives = [simulate("urban", run=run, duration=60, gps="white-1m") for run in range(9)]
    return drives[:6], drives[6:]


def kitti(folder: Path) -> tuple[list[Drive], list[Drive]]:
    drives = [read_drive(folder / name) for name in KITTI]
    return drives[:4], drives[4:]


def kitti_turned(folder: Path) -> tuple[list[Drive], list[Drive]]:
    """Return another split, in which two drives of one day are held out."""
    drives = [read_drive(folder / name) for name in KITTI]
    return drives[2:], drives[:2]


def colorado(folder: Path) -> tuple[list[Drive], list[Drive]]:
    train, test = split_time(read_drive(folder / "colorado-1"))
    return [train], [test]


def cases(folder: Path) -> dict:
    """Return the settings of each case: function that returns the drives, objective, optimizers, and scales."""
    rmse, nll = "truth-rmse", "innovation-nll"
    real = folder.is_dir()
    return {
        "simulated, truth-rmse": (simulated, rmse, WAYS, ("log10",)),
        "simulated, innovation-nll": (simulated, nll, FEW, ("log10",)),
        "simulated, innovation-nll, raced": (simulated, nll, ("de", "de:racing=true"), ("log10",)),
        "simulated, scales": (simulated, rmse, BASE, BOTH),
        **({"KITTI, truth-rmse": (lambda: kitti(folder), rmse, BASE, BOTH)} if real else {}),
        **({"KITTI turned, truth-rmse": (lambda: kitti_turned(folder), rmse, BASE, BOTH)} if real else {}),
        **({"colorado-1, truth-rmse": (lambda: colorado(folder), rmse, BASE, BOTH)} if real else {}),
        **({"colorado-1, innovation-nll": (lambda: colorado(folder), nll, BASE, BOTH)} if real else {}),
    }


def comparisons(case: str, setting, out: Path, seeds: int) -> Iterator[tuple[str, Comparison]]:
    load, objective, optimizers, scales = setting
    drives, test = load()
    for model in MODELS:
        folder = out / f"{case.replace(', ', '-')}-{model}"
        found = compare(
            drives,
            validation=test,
            optimizers=optimizers,
            scales=scales,
            seeds=seeds,
            objective=objective,
            model=model,
            use=(),
            out=folder,
            resume=True,
        )
        save_comparison(found, folder)
        print(f"{folder}\n{comparison_table(found).to_markdown()}", flush=True)
        yield model, found


BUDGETS = (300, 1500, 6000)
AT_BUDGETS = ("pso", "de", "de-qpso", "cma-es")
NEAR = 1.02
"""A run is good if its cost is below this factor times the lowest cost of all runs on its task."""


def tasks(folder: Path) -> dict[str, list[Drive]]:
    """Return parts of real drives and a simulated drive, which are short to save time; "blind" drives have no truth."""

    def first(name: str, seconds: float) -> Drive:
        drive = read_drive(folder / name)
        return clip(drive, drive.imu.time[0], drive.imu.time[0] + seconds)

    cars = {"colorado": first("colorado-1", 100), "kingston": first("kingston-1", 900)}
    return {
        "KITTI": [first("kitti-09-26-0022", 40), first("kitti-09-30-0034", 40)],
        "simulated": [simulate("urban", run=0, duration=60, gps="white-1m")],
        **{name: [drive] for name, drive in cars.items()},
        **{f"{name}, blind": [replace(drive, truth=None)] for name, drive in cars.items()},
    }


def default_problem(drives: Sequence[Drive]) -> CarProblem:
    """Set up the default filter and objective of `tune`."""
    sensors = [log_properties(drive) for drive in drives]
    options, _ = default_filter_options({}, sensors)
    return car_problem(drives, complete_config(validated_config(TuneConfig, options), sensors))


def lowest_cost(problem: CarProblem, name: str, budget: int, seed: int) -> float:
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    low, high = problem.space.low, problem.space.high
    optimizer = create_optimizer(name, low, high, population=30, budget=budget, rng=rng)
    while len(points := optimizer.ask()):
        optimizer.tell(problem.costs(points, None))
    return optimizer.global_cost


def run_budgets(folder: Path, file: Path, seeds: int) -> dict[tuple[str, str, int, int], float]:
    """Run all searches that the file does not contain; return the costs by task, optimizer, budget and seed."""
    file.parent.mkdir(exist_ok=True)
    lines = file.read_text().splitlines() if file.exists() else []
    costs = {tuple(key): cost for *key, cost in map(json.loads, lines)}
    problems = {task: default_problem(drives) for task, drives in tasks(folder).items()}
    for budget, seed, task, name in product(BUDGETS, range(seeds), problems, AT_BUDGETS):
        key = (task, name, budget, seed)
        if key not in costs:
            costs[key] = lowest_cost(problems[task], name, budget, seed)
            with file.open("a") as out:
                out.write(json.dumps([*key, costs[key]]) + "\n")
            print(*key, costs[key], flush=True)
    return costs


def budget_table(costs: Mapping[tuple[str, str, int, int], float], seeds: int) -> str:
    """Tabulate the fraction of good runs, and the mean over the tasks of the median relative cost, with intervals."""
    names = sorted({task for task, *_ in costs})
    best = {task: min(cost for key, cost in costs.items() if key[0] == task) for task in names}
    draws = np.random.default_rng(0).integers(seeds, size=(2000, len(names), seeds))
    rows = []
    for name in AT_BUDGETS:
        row = [f"`{name}`"]
        for budget in BUDGETS:
            each = [[costs[task, name, budget, s] / best[task] for s in range(seeds)] for task in names]
            again = np.take_along_axis(np.array(each)[np.newaxis], draws, axis=2)
            shares, medians = (again < NEAR).mean(axis=(1, 2)), np.median(again, axis=2).mean(axis=1)
            share, median = np.less(each, NEAR).mean(), np.median(each, axis=1).mean()
            ends = [*np.quantile(shares, [0.025, 0.975]), *np.quantile(medians, [0.025, 0.975])]
            row += [
                f"{share:.0%} [{ends[0]:.0%}, {ends[1]:.0%}]",
                f"{median:.3f} [{ends[2]:.3f}, {ends[3]:.3f}]",
            ]
        rows.append(row)
    heads = [f"{budget}: {what}" for budget in BUDGETS for what in ("within 2%", "median")]
    return markdown(["optimizer", *heads], rows)


Found = dict[str, dict[str, Comparison]]
"""Comparisons by case and model."""


def held_out(found: Found, scale: str) -> str:
    """Tabulate the RMSE on held-out drives, m, by optimizer for one scale; stars: different from pso with log10."""
    columns = {
        f"{case.removesuffix(', truth-rmse').removesuffix(', scales')}, {model}": {
            row["optimizer"]: cell(row, "held_out_rmse")
            for row in comparison.frame.to_dicts()
            if row["scale"] == scale
        }
        for case, comparisons in found.items()
        for model, comparison in comparisons.items()
        if case in HELD_OUT
    }
    return markdown(
        ["optimizer", *columns], ([f"`{name}`", *(c[name] for c in columns.values())] for name in BASE)
    )


def ways(found: dict[str, Comparison]) -> str:
    """Tabulate the training cost and the held-out RMSE of each way to use a budget, for each model."""
    measures = ("cost", "held_out_rmse")
    titles = ["optimizer", *(f"{model}: {MEASURES[m]}" for model in found for m in measures)]
    rows = zip(*(comparison.frame.to_dicts() for comparison in found.values()), strict=True)
    rows = (
        row for row in rows if row[0]["optimizer"] not in BASE[3:]
    )  # these are in the table of held-out drives
    return markdown(
        titles, ([f"`{row[0]['optimizer']}`", *(cell(r, m) for r in row for m in measures)] for row in rows)
    )


def markdown(titles: list[str], rows: Iterable[list[str]]) -> str:
    return "\n".join("| " + " | ".join(line) + " |" for line in (titles, ["---"] * len(titles), *rows))


def cell(row: dict, measure: str) -> str:
    """Format median and worst run; a star marks a significant difference from the first row (p < 0.05 after Holm)."""
    p = row[f"{measure}_p"]
    star = " \\*" if p is not None and p < 0.05 else ""
    return f"{row[f'{measure}_median']:.3f}; {row[f'{measure}_worst']:.3f}{star}"


def raced(found: Found) -> str:
    """Tabulate the effects of racing on filter steps and RMSE, relative to the same optimizer without racing."""
    rows = []
    for case, model in ((case, model) for case, comparisons in found.items() for model in comparisons):
        by_name = {
            row["optimizer"]: row for row in found[case][model].frame.to_dicts() if row["scale"] == "log10"
        }
        for name, row in by_name.items():
            plain = by_name.get(name.removesuffix(":racing=true"))
            if plain is None or plain is row:
                continue
            changes = (
                row[f"held_out_rmse_{k}"] / plain[f"held_out_rmse_{k}"] - 1 for k in ("median", "worst")
            )
            objective = case.split(", ")[1]
            cells = (f"{row['steps_share']:.0%}", *(f"{c:+.1%}" for c in changes))
            rows.append([objective, model, f"`{name.removesuffix(':racing=true')}`", *cells])
    return markdown(
        ["objective", "model", "optimizer", "filter steps", "held-out RMSE: median", "worst run"], rows
    )


def write(text: str) -> None:
    begin, end = "<!-- written by benchmarks/compare_optimizers.py -->", "<!-- end -->"
    before, rest = PAGE.read_text().split(begin)
    after = rest.split(end, 1)[1]
    PAGE.write_text(f"{before}{begin}\n\n{text}\n\n{end}{after}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--drives", type=Path, default=Path("../shared/drives"))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--budgets", action="store_true", help="training costs at three budgets")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    if options.budgets:
        costs = run_budgets(options.drives, options.out / "budgets.jsonl", options.seeds)
        write(budget_table(costs, options.seeds))
        return
    settings = cases(options.drives)
    chosen = {case: settings[case] for case in options.only or settings}
    found = {
        case: dict(comparisons(case, setting, options.out, options.seeds)) for case, setting in chosen.items()
    }
    if settings.keys() <= chosen.keys() >= HELD_OUT:
        scales = (held_out(found, scale) for scale in BOTH)
        print(*scales, ways(found["simulated, truth-rmse"]), raced(found), sep="\n\n")


if __name__ == "__main__":
    main()
