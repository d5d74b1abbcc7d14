"""Print the scores of the baseline, with which every tuning is compared.

    python benchmarks/untuned.py ../shared/drives

The baseline has the default model and options of `tune` for a case and, as in `evaluate`, a divergence monitor. The
test drives are those of `defaults.py`. Prints Markdown: means over the test drives of a case.
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
        if ">" in name or "outliers" in name:  # the baseline does not depend on the training drives
            continue
        training, test = parts()
        taken = suggest_filter([*training, *test])
        found = evaluate(test, some_filter(taken.model, taken.use))
        cells = (found.mean(BASELINE, m) for m in MEASURES)
        told = " | ".join("-" if v is None else f"{v:.2f}" for v in cells)
        print(f"| {name} | {taken.model} + {', '.join(taken.use[2:])} | {told} |", flush=True)


def some_filter(model: str, use: tuple[str, ...]) -> FilterParameters:
    """Return a filter with a model and options; its other parameters have no effect."""
    space = search_space(model, "log10", kind="ekf" if model == "tilted12" else "ukf", use=use)
    return space.decode(np.atleast_2d((space.low + space.high) / 2))[0]


if __name__ == "__main__":
    main()
