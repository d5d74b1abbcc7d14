"""The table and the charts of a comparison of optimizers."""

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.experiments.comparison import COMPARED, FEWEST_SEEDS, Comparison
from sigmaswarm.reports.style import DASHES, MANY
from sigmaswarm.reports.views.charts import Axis, Band, Chart, Curve, Look, Mark, Points
from sigmaswarm.tables import Cell, Column, Table


def comparison_table(comparison: Comparison) -> Table:
    """Tabulate medians with intervals, the worst run and tests; one row for each contender."""
    shown = _shown(comparison)
    digits = "{:.4g}".format
    columns = [Column("optimizer"), Column("scale")]
    for measure in shown:
        columns += [Column(COMPARED[measure], number=digits), Column("95%", number=digits, joined=True)]
        columns += [Column("worst", number=digits), Column("p", number=_probability)]
    columns += [Column("steps", number="{:.0%}".format), Column("touched bounds")]
    rows = [_row(comparison, row, shown) for row in comparison.frame.iter_rows(named=True)]
    return Table("", tuple(columns), tuple(rows), note=_note(comparison))


def _shown(comparison: Comparison) -> list[str]:
    """Return the measures of the table: not the held-out cost where it is the RMSE."""
    same = all(c.config.objective == "truth-rmse" for c in comparison.contenders)
    return [m for m in comparison.measures if not (same and m == "held_out_cost")]


def _row(comparison: Comparison, row: dict[str, Cell], shown: list[str]) -> tuple[Cell, ...]:
    cells: list[Cell] = [f"`{row['optimizer']}`", row["scale"]]
    for measure in shown:
        middle, low, high, worst, p = (
            row[f"{measure}_{part}"] for part in ("median", "low", "high", "worst", "p")
        )
        tested = comparison.seeds >= FEWEST_SEEDS
        cells += [middle, (low, high), worst, p if tested else None]  # pyright: ignore
    return *cells, row["steps_share"], str(row["touched_bounds"]).replace(" ", ", ") or "-"


def _probability(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def _note(comparison: Comparison) -> str:
    """Explain the figures of the table."""
    return (
        f"{comparison.seeds} seeds, {comparison.budget} evaluations each. Median [95% interval of the median], worst "
        f"run, and p: paired Wilcoxon test against {comparison.contenders[0].label}, corrected after Holm over the "
        "rows. Steps: filter steps spent, of what the budget takes on all drives. Touched bounds: in how many runs a "
        f"parameter ended at a bound. Trained on {', '.join(comparison.drives)}; "
        f"held out: {', '.join(comparison.test) or 'none'}."
        + (
            ""
            if comparison.seeds >= FEWEST_SEEDS
            else f"\n\nToo few seeds for a test: {FEWEST_SEEDS} or more."
        )
    )


def comparison_charts(comparison: Comparison) -> tuple[Chart, Chart]:
    """Draw cost against evaluations, with quartiles, and the last cost of every run."""
    last = "held_out_cost" if "held_out_cost" in comparison.measures else "cost"
    looks = [
        Look(MANY[i % len(MANY)], 1.6, DASHES[i // len(MANY) % len(DASHES)])
        for i in range(len(comparison.contenders))
    ]
    runs: list[Mark] = []
    courses: list[Mark] = []
    for i, (contender, look) in enumerate(zip(comparison.contenders, looks, strict=True)):
        spent, middle, low, high = _course(comparison, i)
        courses.append(Band(spent, low, high, Look(look.color, opacity=0.12)))
        courses.append(Curve(spent, middle, look, contender.label))
        values = comparison.values(contender.label, last)
        values = values[np.isfinite(values)]
        runs.append(Points(values, np.full(len(values), i), Look(look.color, 0.0, "none", "ring", 4.0, 0.7)))
        if len(values):
            runs.append(Points([float(np.median(values))], [i], Look(look.color, 2.0, "none", "tick", 16.0)))
    return (
        Chart(
            f"Median and quartiles of {comparison.seeds} seeds",
            tuple(courses),
            Axis("evaluations on all training drives"),
            Axis("training cost, lowest so far", range=_frame(comparison)),
        ),
        Chart(
            "Every run, and the medians",
            tuple(runs),
            Axis(COMPARED[last]),
            Axis(categories=tuple(c.label for c in comparison.contenders)),
        ),
    )


def _course(comparison: Comparison, i: int) -> list[NDArray[np.float64]]:
    """Return evaluations, median and quartiles of a contender; NaN beyond its last evaluation."""
    contender, share = comparison.contenders[i], comparison.frame["steps_share"][i]
    rows = comparison.curves.filter(
        (pl.col("optimizer") == contender.name) & (pl.col("scale") == contender.scale)
    )
    names = ("full_evaluations", "median", "quartile_1", "quartile_3")
    spent, *costs = (rows[name].to_numpy() for name in names)
    over = spent > comparison.budget * (share + 0.01)
    return [spent, *(np.where(np.isfinite(cost) & ~over, cost, np.nan) for cost in costs)]


def _frame(comparison: Comparison) -> tuple[float | None, float | None]:
    """Return a range from the lowest cost to the median of the contenders at a tenth of the budget."""
    medians = comparison.curves["median"].to_numpy().reshape(len(comparison.contenders), -1)
    finite = medians[np.isfinite(medians)]
    if not len(finite):
        return None, None
    early = medians[:, medians.shape[1] // 10]
    early = early[np.isfinite(early)]
    low, high = float(finite.min()), float(np.median(early)) if len(early) else float(finite.max())
    margin = 0.05 * (high - low) or 0.05 * abs(low)
    return low - margin, high + margin
