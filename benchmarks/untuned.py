"""The scores of the baseline that is compared with every tuning: it needs no training.

    python benchmarks/untuned.py ../shared/drives

Of the model and parts that `tune` takes for a case, on the test drives of `defaults.py`, watched for being lost, as in
`evaluate`. Prints Markdown, means over a case's test drives.
"""

import argparse
import warnings
from pathlib import Path

import numpy as np

from defaults import cases
from sigmaswarm import FilterParameters, SigmaswarmWarning, evaluate
from sigmaswarm.drives.suggestion import suggest_filter
from sigmaswarm.scoring.methods import BASELINE
from sigmaswarm.tuning.space import search_space

MEASURES = ("position_rmse_m", "heading_rmse_deg", "outage_drift_m", "long_outage_drift_m")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    print("| tested on | baseline | position RMSE, m | heading, deg | 5 s drift, m | 30 s drift, m |")
    print("|---" * 6 + "|")
    for name, parts in cases(options.drives).items():
        if ">" in name or "outliers" in name:  # a stranger's drives: what was tuned plays no part here
            continue
        training, test = parts()
        taken = suggest_filter([*training, *test])
        found = evaluate(test, some_filter(taken.model, taken.use))
        cells = (found.mean(BASELINE, m) for m in MEASURES)
        told = " | ".join("-" if v is None else f"{v:.2f}" for v in cells)
        print(f"| {name} | {taken.model} + {', '.join(taken.use[2:])} | {told} |", flush=True)


def some_filter(model: str, use: tuple[str, ...]) -> FilterParameters:
    """Any filter of a model and its parts: only these count."""
    space = search_space(model, "log10", kind="ekf" if model == "tilted12" else "ukf", use=use)
    return space.decode(np.atleast_2d((space.low + space.high) / 2))[0]


if __name__ == "__main__":
    main()
