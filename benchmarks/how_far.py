"""The position error that a filter estimates without truth, compared with the error against truth.

    python benchmarks/how_far.py ../shared/drives --seeds 3

Filters are tuned without truth and tested on other drives or parts, as in `defaults.py`. Prints Markdown: the smallest
and the largest value over seeds and test drives, and the number of tests in which `evaluate` reports an unknown error.
"""

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

from defaults import cases
from sigmaswarm import SigmaswarmWarning, evaluate, tune
from sigmaswarm.scoring.remarks import describe_position


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drives", type=Path)
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    warnings.simplefilter("ignore", SigmaswarmWarning)
    print("| tested on | estimated, m | true RMSE, m | estimated / true | unknown |")
    print("|---" * 5 + "|")
    for name, parts in cases(options.drives).items():
        if ">" in name or "outliers" in name:
            continue
        training, test = parts()
        blind = [replace(drive, truth=None) for drive in training]
        rows = [row for seed in range(options.seeds) for row in words(blind, test, seed)]
        own, true, ratio = (
            [f"{f(column):.2g}" for f in (min, max)] for column in list(zip(*rows, strict=True))[:3]
        )
        told = " | ".join(" to ".join(dict.fromkeys(ends)) for ends in (own, true, ratio))
        print(f"| {name} | {told} | {sum(row[3] for row in rows)} of {len(rows)} |", flush=True)


def words(training, test, seed: int):
    """Yield, for each test drive, estimated and true error (m), their ratio, and True if the error is unknown."""
    found = evaluate(test, tune(training, seed=seed).parameters)
    for name, consistency in found.record.consistency.items():
        true = found.value(name, "tuned", "position_rmse_m")
        assert consistency and consistency.own_sigma and true
        unknown = describe_position(consistency).startswith("unknown")
        yield consistency.own_sigma, true, consistency.own_sigma / true, unknown


if __name__ == "__main__":
    main()
