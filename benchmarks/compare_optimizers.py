"""Which optimizer, and which way to spend its budget: `compare` on simulated and real drives, for docs/optimizers.md.

    python benchmarks/compare_optimizers.py OUT [--drives ../shared/drives] [--seeds 20] [--only "KITTI, truth-rmse"]

Every comparison is kept in a folder of OUT and resumed if it is there; the page is written from all that are done.
"""

import argparse
import warnings
from collections.abc import Iterator
from pathlib import Path

from sigmaswarm import Comparison, Drive, SigmaswarmWarning, compare, read_drive, simulate, split_time
from sigmaswarm.experiments.comparison import COMPARED
from sigmaswarm.reports.compare import comparison_table, save_comparison

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


def simulated() -> tuple[list[Drive], list[Drive]]:
    """Six drives of a minute in a town, and three more that are held out."""
    drives = [simulate("urban", run=run, duration=60, gps="white-1m") for run in range(9)]
    return drives[:6], drives[6:]


def kitti(folder: Path) -> tuple[list[Drive], list[Drive]]:
    drives = [read_drive(folder / name) for name in KITTI]
    return drives[:4], drives[4:]


def kitti_turned(folder: Path) -> tuple[list[Drive], list[Drive]]:
    """Another split: two drives of one day are held out."""
    drives = [read_drive(folder / name) for name in KITTI]
    return drives[2:], drives[:2]


def colorado(folder: Path) -> tuple[list[Drive], list[Drive]]:
    train, test = split_time(read_drive(folder / "colorado-1"))
    return [train], [test]


def cases(folder: Path) -> dict:
    """Where the drives come from, the objective, who takes part, at which scales."""
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


def table(found: dict[str, Comparison], objective: str) -> str:
    """One row a contender; for each model what it reached in training, and on held-out drives."""
    measures = ["cost", "held_out_rmse", "held_out_heading"]
    if objective != "truth-rmse":
        measures[1:] = ["held_out_cost", "held_out_rmse"]
    titles = ["optimizer", "scale", *(f"{model}: {COMPARED[m]}" for model in found for m in measures)]
    lines = [titles, ["---"] * len(titles)]
    for rows in zip(*(comparison.frame.to_dicts() for comparison in found.values()), strict=True):
        cells = [cell(row, m) for row in rows for m in measures]
        lines.append([f"`{rows[0]['optimizer']}`", rows[0]["scale"], *cells])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cell(row: dict, measure: str) -> str:
    """Median; worst run; a star where it differs from the first row's (p < 0.05 after Holm)."""
    p = row[f"{measure}_p"]
    digits = 2 if measure == "held_out_heading" else 3
    star = " \\*" if p is not None and p < 0.05 else ""
    return f"{row[f'{measure}_median']:.{digits}f}; {row[f'{measure}_worst']:.{digits}f}{star}"


def raced(found: dict[str, Comparison]) -> str:
    """What racing costs and saves, against the same optimizer without it."""
    lines = [["model", "optimizer", "filter steps", "held-out RMSE: median", "worst run"], ["---"] * 5]
    for model, comparison in found.items():
        rows = {row["optimizer"]: row for row in comparison.frame.to_dicts()}
        for name, row in rows.items():
            plain = rows.get(name.removesuffix(":racing=true"))
            if plain is None or plain is row:
                continue
            changes = (
                row[f"held_out_rmse_{k}"] / plain[f"held_out_rmse_{k}"] - 1 for k in ("median", "worst")
            )
            lines.append([model, f"`{name}`", f"{row['steps_share']:.0%}", *(f"{c:+.1%}" for c in changes)])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) if len(lines) > 2 else ""


def write(section: str, text: str) -> None:
    begin, end = f"<!-- written by benchmarks/compare_optimizers.py: {section} -->", "<!-- end -->"
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
    parser.add_argument("--write", action="store_true", help="write docs/optimizers.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    for case, setting in cases(options.drives).items():
        if options.only and case not in options.only:
            continue
        found = dict(comparisons(case, setting, options.out, options.seeds))
        if options.write:
            parts = [table(found, setting[1]), f"{options.seeds} seeds.", raced(found)]
            write(case, "\n\n".join(part for part in parts if part))


if __name__ == "__main__":
    main()
