"""Results of a comparison of optimizers, and their statistics."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.experiments.statistics import holm, median_interval, signed_rank
from sigmaswarm.files import write_atomically
from sigmaswarm.record_files import load_record
from sigmaswarm.tuning.config import TuneConfig

MIN_SEEDS = 6
"""Smallest number of seeds for a two-sided signed-rank test at 5%. The lowest p of this test is 2^(1 - seeds)."""

MEASURES = {
    "cost": "training cost",
    "held_out_cost": "held-out cost",
    "held_out_rmse": "held-out RMSE, m",
    "held_out_heading": "held-out heading error, deg",
}


@dataclass(frozen=True)
class Contender:
    """One row of a comparison: an optimizer with its settings, such as ``pso:polish=300``, and a search scale."""

    name: str
    scale: str
    config: TuneConfig

    @property
    def budget(self) -> int:
        """Largest number of evaluations in a tuning run."""
        return self.config.particles * self.config.generations * self.config.trials

    @property
    def label(self) -> str:
        return f"{self.name}, {self.scale}"

    @property
    def folder(self) -> str:
        return f"{self.name}-{self.scale}".replace(":", "-").replace(",", "-").replace("=", "")


@dataclass(frozen=True)
class Outcome:
    """Outcome of one tuning run of a comparison: the content of run.json.

    Attributes
    ----------
    cost : float
        Cost on the training drives.
    held_out_cost, held_out_rmse, held_out_heading : float or None
        Objective, mean position RMSE (m) and mean heading error (deg) on the held-out drives. None if there are no
        held-out drives, if the drives have no truth, or if the filter failed.
    touched : tuple of str
        Parameters at a bound.
    evaluations, failures : int
        Number of evaluated parameter sets, and number of those that failed.
    history_evaluations, history_steps : tuple of int
        Total numbers of evaluations and of filter steps after each generation.
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

    @classmethod
    def read(cls, file: Path) -> "Outcome":
        remedy = "delete it to redo this run"
        record = load_record(cls, file, remedy, missing="repeat the comparison")
        if not 0 < len(record.history_evaluations) == len(record.history_steps) == len(record.history_best):
            raise InputError(f"{file}: the histories differ in length; {remedy}")
        return record


@dataclass(frozen=True, eq=False)
class Comparison:
    """The result of `compare`.

    Attributes
    ----------
    contenders : tuple of Contender
        The first contender is the reference of the statistical tests.
    runs : mapping of a contender's label to tuple of Outcome
        One outcome for each seed.
    budget : int
        Largest number of evaluations in each run.
    steps_per_set : int
        Number of filter steps in one evaluation on all training drives.
    drives, test : tuple of str
        Names of the training and of the held-out drives.
    fixes_alone_rmse : float or None
        Mean position RMSE (m) of a filter that uses only the fixes, on the held-out drives. Its noise parameters are
        fitted to the training drives.
    """

    contenders: tuple[Contender, ...]
    runs: Mapping[str, tuple[Outcome, ...]]
    budget: int
    steps_per_set: int
    drives: tuple[str, ...]
    test: tuple[str, ...]
    fixes_alone_rmse: float | None = None

    @property
    def seeds(self) -> int:
        """Number of runs of each contender."""
        return len(self.runs[self.contenders[0].label])

    def values(self, label: str, measure: str) -> Array:
        """Return a measure in every run, shape (seeds,), with ``inf`` instead of None."""
        values = [getattr(run, measure) for run in self.runs[label]]
        return np.array([np.inf if v is None else v for v in values], dtype=np.float64)

    @cached_property
    def measures(self) -> tuple[str, ...]:
        """Measures with a value in at least one run."""
        all_runs = [run for runs in self.runs.values() for run in runs]
        return tuple(m for m in MEASURES if any(getattr(run, m) is not None for run in all_runs))

    @cached_property
    def frame(self) -> pl.DataFrame:
        """Table with one row for each contender: medians with 95% intervals, worst runs, tests against the first row.

        Columns that end in ``_p`` are p-values of two-sided Wilcoxon tests over the seeds, with Holm's correction over
        the contenders.
        """
        rows = [self._row(contender) for contender in self.contenders]
        for measure in self.measures:
            reference, *others = (self.values(c.label, measure) for c in self.contenders)
            corrected = holm([signed_rank(other, reference) for other in others])
            for row, p in zip(rows, [None, *corrected], strict=True):
                row[f"{measure}_p"] = p
        return pl.DataFrame(rows, infer_schema_length=None)

    def _row(self, contender: Contender) -> dict[str, Any]:
        runs = self.runs[contender.label]
        row: dict[str, Any] = {"optimizer": contender.name, "scale": contender.scale, "seeds": len(runs)}
        for measure in self.measures:
            values = self.values(contender.label, measure)
            figures = (float(np.median(values)), *median_interval(values), float(values.max()))
            names = (f"{measure}_{figure}" for figure in ("median", "low", "high", "worst"))
            row |= dict(zip(names, figures, strict=True))
        touched = Counter(name for run in runs for name in run.touched)
        full = self.budget * self.steps_per_set
        return row | {
            "evaluations": float(np.mean([run.evaluations for run in runs])),
            "steps_share": float(np.mean([run.history_steps[-1] for run in runs])) / full,
            "failures": sum(run.failures for run in runs),
            "touched_bounds": " ".join(f"{name}:{count}" for name, count in sorted(touched.items())),
        }

    @cached_property
    def runs_frame(self) -> pl.DataFrame:
        """Table with one row for each run."""
        rows = [
            {
                **{"optimizer": c.name, "scale": c.scale, "seed": seed},
                **{name: getattr(run, name) for name in (*MEASURES, "evaluations", "failures")},
                "filter_steps": run.history_steps[-1],
                "touched_bounds": " ".join(run.touched),
            }
            for c in self.contenders
            for seed, run in enumerate(self.runs[c.label])
        ]
        return pl.DataFrame(rows, schema_overrides=dict.fromkeys(MEASURES, pl.Float64))

    @cached_property
    def curves(self) -> pl.DataFrame:
        """Table of the lowest cost so far after 1%, 2%, ... of the budget: median and quartiles over the seeds.

        The column ``full_evaluations`` counts evaluations on all drives. The cost is ``inf`` until the first generation
        ends.
        """
        grid = self.budget * np.arange(1, 101) / 100
        frames: list[pl.DataFrame] = []
        for contender in self.contenders:
            reached: list[Array] = []
            for run in self.runs[contender.label]:
                spent = np.array(run.history_steps) / self.steps_per_set
                at = np.searchsorted(spent, grid * (1 + 1e-12), side="right")
                reached.append(np.array([np.inf, *run.history_best])[at])
            # inf can't be interpolated
            low, high = np.quantile(reached, [0.25, 0.75], axis=0, method="nearest")
            columns = {
                **{"optimizer": contender.name, "scale": contender.scale, "full_evaluations": grid},
                **{"median": np.median(reached, axis=0), "quartile_1": low, "quartile_3": high},
            }
            frames.append(pl.DataFrame(columns))
        return pl.concat(frames)

    def write(self, folder: Path) -> list[Path]:
        """Write comparison.csv, runs.csv and curves.csv. Return their paths."""
        frames = {"comparison.csv": self.frame, "runs.csv": self.runs_frame, "curves.csv": self.curves}
        for name, frame in frames.items():
            write_atomically(folder / name, frame.write_csv())
        return [folder / name for name in frames]
