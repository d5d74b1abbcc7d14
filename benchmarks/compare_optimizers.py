"""Which optimizer, and which way to spend its budget: `compare` on simulated and real drives, for docs/optimizers.md.

    python benchmarks/compare_optimizers.py OUT [--drives ../shared/drives] [--seeds 10] [--only "KITTI, truth-rmse"]

Every comparison is kept in a folder of OUT and resumed if it is there; the page is written from all that are done.
"""

import argparse
import warnings
from collections.abc import Iterator
from pathlib import Path

from sigmaswarm import Comparison, Drive, SigmaswarmWarning, compare, read_drive, simulate, split_time
from sigmaswarm.report.comparison_figure import save_comparison

PAGE = Path(__file__).parents[1] / "docs" / "optimizers.md"
BASE = ("pso", "de", "cma-es")
FEW = (*BASE, "pso:polish=300", "cma-es:particles=15,generations=100", "pso:racing=true")
WAYS = (
    *FEW,
    "pso:particles=15,generations=100",
    "pso:particles=15,generations=20,trials=5",
    "de:racing=true",
    "cma-es:racing=true",
    "random",
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
        "simulated, scales": (simulated, rmse, BASE, BOTH),
        **({"KITTI, truth-rmse": (lambda: kitti(folder), rmse, BASE, BOTH)} if real else {}),
        **({"colorado-1, truth-rmse": (lambda: colorado(folder), rmse, BASE, BOTH)} if real else {}),
        **({"colorado-1, innovation-nll": (lambda: colorado(folder), nll, BASE, BOTH)} if real else {}),
        **({"KITTI, innovation-nll": (lambda: kitti(folder), nll, BASE, BOTH)} if real else {}),
    }


def comparisons(case: str, setting, out: Path, seeds: int) -> Iterator[tuple[str, Comparison]]:
    load, objective, optimizers, scales = setting
    drives, test = load()
    for model in MODELS:
        folder = out / f"{case.replace(', ', '-')}-{model}"
        found = compare(
            drives,
            test=test,
            optimizers=optimizers,
            scales=scales,
            seeds=seeds,
            objective=objective,
            model=model,
            out=folder,
            resume=True,
        )
        save_comparison(found, folder)
        print(f"{folder}\n{found.markdown()}", flush=True)
        yield model, found


def table(found: dict[str, Comparison]) -> str:
    """One row a contender; for each model the training cost, and what the filter is worth on held-out drives."""
    titles = ["optimizer", "scale"]
    for model in found:
        titles += [f"{model}: training cost", "held-out RMSE, m", "heading, deg"]
    lines = [titles, ["---"] * len(titles)]
    frames = [comparison.frame.to_dicts() for comparison in found.values()]
    for rows in zip(*frames, strict=True):
        line = [f"`{rows[0]['optimizer']}`", rows[0]["scale"]]
        for row in rows:
            line += [cell(row, "cost"), cell(row, "held_out_rmse"), cell(row, "held_out_heading", test=False)]
        lines.append(line)
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cell(row: dict, measure: str, test: bool = True) -> str:
    """Median; worst; whether it differs from the first row's: + better, - worse (p < 0.05 after Holm)."""
    text = f"{row[f'{measure}_median']:.3f}; {row[f'{measure}_worst']:.3f}"
    p = row[f"{measure}_p"]
    return text + (" \\*" if test and p is not None and p < 0.05 else "")


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
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--write", action="store_true", help="write docs/optimizers.md")
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    for case, setting in cases(options.drives).items():
        if options.only and case not in options.only:
            continue
        text = table(dict(comparisons(case, setting, options.out, options.seeds)))
        if options.write:
            write(case, f"{text}\n\n{options.seeds} seeds.")


if __name__ == "__main__":
    main()
