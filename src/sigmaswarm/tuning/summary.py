"""What a comparison of optimizers found, and its tables."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.drives.drive import Array
from sigmaswarm.tuning.contenders import Contender
from sigmaswarm.tuning.paired import holm, median_interval, wilcoxon

FEWEST_SEEDS = 6
"""With fewer pairs a two-sided signed-rank test can't reach 5%: its lowest p is 2^(1 - pairs)."""

MEASURES = {
    "cost": "training cost",
    "held_out_cost": "held-out cost",
    "held_out_rmse": "held-out RMSE, m",
    "held_out_heading": "held-out heading error, deg",
}
"""What is compared; lower wins."""


@dataclass(frozen=True)
class Run:
    """One tuning of a comparison.

    Attributes
    ----------
    cost : float
        The objective on the training drives.
    held_out_cost, held_out_rmse, held_out_heading : float or None
        The objective, position RMSE (m) and heading error (deg) on the held-out drives, means over them; None where
        there are none, they have no truth, or the filter failed.
    touched : tuple of str
        Parameters that ended on a bound of the box.
    evaluations, failures : int
        Parameter sets tried, and how many of them failed.
    history_evaluations, history_steps : tuple of int
        Evaluations and filter steps spent after each generation.
    history_best : tuple of float
        Lowest cost so far after each generation.
    """

    cost: float
    held_out_cost: float | None
    held_out_rmse: float | None
    held_out_heading: float | None
    touched: tuple[str, ...]
    evaluations: int
    failures: int
    history_evaluations: tuple[int, ...]
    history_steps: tuple[int, ...]
    history_best: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain types."""
        return asdict(self)

    @classmethod
    def from_dict(cls, table: dict[str, Any]) -> "Run":
        """What `to_dict` made."""
        return cls(**{name: tuple(v) if isinstance(v, list) else v for name, v in table.items()})  # pyright: ignore


@dataclass(frozen=True, eq=False)
class Comparison:
    """What `compare` found.

    Attributes
    ----------
    contenders : tuple of Contender
        The first one is the reference.
    runs : mapping of a contender's label to tuple of Run
        One run for each seed.
    budget : int
        Evaluations that each run could take.
    steps_per_set : int
        Filter steps of one evaluation on all training drives.
    drives, test : tuple of str
        Training and held-out drives.
    """

    contenders: tuple[Contender, ...]
    runs: Mapping[str, tuple[Run, ...]]
    budget: int
    steps_per_set: int
    drives: tuple[str, ...]
    test: tuple[str, ...]

    @property
    def seeds(self) -> int:
        """How many runs each contender had."""
        return len(self.runs[self.contenders[0].label])

    def values(self, label: str, measure: str) -> Array:
        """One figure of every run, shape (seeds,); ``inf`` where the filter failed."""
        found = [getattr(run, measure) for run in self.runs[label]]
        return np.array([np.inf if v is None else v for v in found], dtype=np.float64)

    @cached_property
    def measures(self) -> tuple[str, ...]:
        """The measures that are known of at least one run."""
        every = [run for runs in self.runs.values() for run in runs]
        return tuple(m for m in MEASURES if any(getattr(run, m) is not None for run in every))

    @property
    def _columns(self) -> list[str]:
        """The measures for people, who need not read the same twice where the objective is the RMSE."""
        same = all(c.config.objective == "truth-rmse" for c in self.contenders)
        return [m for m in self.measures if not (same and m == "held_out_cost")]

    @cached_property
    def frame(self) -> pl.DataFrame:
        """One row for each contender: medians with 95% intervals, worst runs, and tests against the first one.

        ``p`` is of a two-sided Wilcoxon test over the seeds, corrected after Holm over all contenders of a measure.
        """
        rows = [self._row(contender) for contender in self.contenders]
        for measure in self.measures:
            reference = self.values(self.contenders[0].label, measure)
            others = [self.values(c.label, measure) for c in self.contenders[1:]]
            corrected = holm(np.array([wilcoxon(other, reference) for other in others], dtype=np.float64))
            for row, p in zip(rows, [None, *corrected.tolist()], strict=True):
                row[f"{measure}_p"] = p
        return pl.DataFrame(rows, infer_schema_length=None)

    def _row(self, contender: Contender) -> dict[str, Any]:
        runs = self.runs[contender.label]
        row: dict[str, Any] = {"optimizer": contender.name, "scale": contender.scale, "seeds": len(runs)}
        for measure in self.measures:
            values = self.values(contender.label, measure)
            low, high = median_interval(values)
            row |= {f"{measure}_median": float(np.median(values)), f"{measure}_low": low}
            row |= {f"{measure}_high": high, f"{measure}_worst": float(values.max())}
        row["evaluations"] = float(np.mean([run.evaluations for run in runs]))
        full = self.budget * self.steps_per_set
        row["steps_share"] = float(np.mean([run.history_steps[-1] for run in runs])) / full
        row["failures"] = sum(run.failures for run in runs)
        touched = Counter(name for run in runs for name in run.touched)
        row["touched_bounds"] = " ".join(f"{name}:{count}" for name, count in sorted(touched.items()))
        return row

    @cached_property
    def runs_frame(self) -> pl.DataFrame:
        """One row for each run."""
        rows = [
            {"optimizer": c.name, "scale": c.scale, "seed": seed}
            | {m: getattr(run, m) for m in MEASURES}
            | {
                "evaluations": run.evaluations,
                "failures": run.failures,
                "filter_steps": run.history_steps[-1],
            }
            | {"touched_bounds": " ".join(run.touched)}
            for c in self.contenders
            for seed, run in enumerate(self.runs[c.label])
        ]
        return pl.DataFrame(rows, schema_overrides=dict.fromkeys(MEASURES, pl.Float64))

    @cached_property
    def curves(self) -> pl.DataFrame:
        """Median and quartiles over the seeds of the lowest cost so far, after 1%, 2%, ... of the budget's steps.

        What is spent is counted in evaluations on all drives, so that raced ones count for what they take.
        """
        grid = self.budget * np.arange(1, 101) / 100
        rows = list[dict[str, Any]]()
        for contender in self.contenders:
            reached = np.array([self._reached(run, grid) for run in self.runs[contender.label]])
            low, high = np.quantile(
                reached, [0.25, 0.75], axis=0, method="nearest"
            )  # inf can't be interpolated
            columns = (grid, np.median(reached, axis=0), low, high)
            names = ("full_evaluations", "median", "quartile_1", "quartile_3")
            who = {"optimizer": contender.name, "scale": contender.scale}
            rows += [who | dict(zip(names, row, strict=True)) for row in np.transpose(columns).tolist()]
        return pl.DataFrame(rows)

    def _reached(self, run: Run, grid: Array) -> Array:
        """The lowest cost of a run by the time that so much is spent; ``inf`` before its first generation is over."""
        spent = np.array(run.history_steps) / self.steps_per_set
        best = np.array([np.inf, *run.history_best])
        return best[np.searchsorted(spent, grid * (1 + 1e-12), side="right")]

    def markdown(self) -> str:
        """The table for people: medians with intervals and the worst run, beside what the tests say."""
        titles = ["optimizer", "scale", *(MEASURES[m] for m in self._columns), "steps", "touched bounds"]
        lines = [titles, ["---"] * len(titles)]
        for row in self.frame.iter_rows(named=True):
            cells = [_cell(row, measure, tested=self.seeds >= FEWEST_SEEDS) for measure in self._columns]
            touched = row["touched_bounds"].replace(" ", ", ") or "-"
            lines.append(
                [f"`{row['optimizer']}`", row["scale"], *cells, f"{row['steps_share']:.0%}", touched]
            )
        return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n\n" + self._note() + "\n"

    def _note(self) -> str:
        """What the table's figures are."""
        return (
            f"{self.seeds} seeds, {self.budget} evaluations each. Median [95% interval of the median], worst run, "
            f"and p: paired Wilcoxon test against {self.contenders[0].label}, corrected after Holm over the rows. "
            "Steps: filter steps spent, of what the budget takes on all drives. Touched bounds: in how many runs a "
            f"parameter ended on a bound. Trained on {', '.join(self.drives)}; "
            f"held out: {', '.join(self.test) or 'none'}."
            + ("" if self.seeds >= FEWEST_SEEDS else f"\n\nToo few seeds for a test: {FEWEST_SEEDS} or more.")
        )


def _cell(row: dict[str, Any], measure: str, *, tested: bool) -> str:
    middle, low, high, worst, p = (
        row[f"{measure}_{part}"] for part in ("median", "low", "high", "worst", "p")
    )
    if p is None:
        said = ""
    elif not tested:
        said = ", p -"
    else:
        said = f", p {'< 0.001' if p < 0.001 else f'= {p:.3f}'}"
    return f"{middle:.4g} [{low:.4g}, {high:.4g}], {worst:.4g}{said}"
