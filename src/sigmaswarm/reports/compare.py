"""Table and figure of a comparison of optimizers."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.experiments.comparison import MEASURES, MIN_SEEDS, Comparison
from sigmaswarm.files import staged_files, write_atomically
from sigmaswarm.reports.figures import Chart, band, curve, figure_of, name_rows, save
from sigmaswarm.reports.style import NO_LINE, Look, many_styles
from sigmaswarm.tables import Cell, Column, Table


def save_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    with staged_files(folder) as new:
        table = new / "comparison.md"
        write_atomically(table, comparison_table(comparison).to_markdown())
        figure = save(comparison_figure(comparison), new / "comparison.png")
        written = [table, *comparison.write(new), figure]
    return [folder / file.name for file in written]


def comparison_table(comparison: Comparison) -> Table:
    """Tabulate each optimizer's medians with confidence intervals, its worst runs and its significance tests."""
    # With the objective truth-rmse, the cost is the RMSE.
    same = all(c.config.objective == "truth-rmse" for c in comparison.contenders)
    shown = [m for m in comparison.measures if not (same and m == "held_out_cost")]
    tested = comparison.seeds >= MIN_SEEDS
    digits = "{:.4g}".format
    columns = [Column("optimizer"), Column("scale")]
    for measure in shown:
        columns += [Column(MEASURES[measure], number=digits), Column("95%", number=digits, joined=True)]
        columns += [
            Column("worst", number=digits),
            Column("p", number=lambda p: "< 0.001" if p < 0.001 else f"{p:.3f}"),
        ]
    columns += [Column("steps", number="{:.0%}".format), Column("touched bounds")]
    rows: list[tuple[Cell, ...]] = []
    for row in comparison.frame.iter_rows(named=True):
        cells: list[Cell] = [f"`{row['optimizer']}`", row["scale"]]
        for m in shown:
            cells += [row[f"{m}_median"], (row[f"{m}_low"], row[f"{m}_high"]), row[f"{m}_worst"]]
            cells.append(row[f"{m}_p"] if tested else None)
        rows.append((*cells, row["steps_share"], str(row["touched_bounds"]).replace(" ", ", ") or "-"))
    alone = comparison.fixes_alone_rmse
    rival = ""
    if alone:
        rival = f" A filter that uses only the fixes, without the IMU, has a held-out RMSE of {alone:.4g} m."
    few = "" if tested else f"\n\nThere are too few seeds for the tests, which need {MIN_SEEDS} or more."
    note = (
        f"{comparison.seeds} seeds, {comparison.budget} evaluations per run. Values: median [95% interval of the "
        f"median] and worst run. p: paired Wilcoxon test against {comparison.contenders[0].label}, with Holm's "
        "correction over the rows. Steps: number of filter steps; 100%: the whole budget on all drives. Touched "
        "bounds: number of runs in which a parameter ended at a bound. "
        f"Training drives: {', '.join(comparison.drives)}. "
        f"Held-out drives: {', '.join(comparison.test) or 'none'}.{rival}{few}"
    )
    return Table("", tuple(columns), tuple(rows), note=note)


def comparison_figure(comparison: Comparison) -> Figure:
    """Draw the lowest training cost so far against the number of evaluations, and the final cost of every run.

    The first chart shows the median and the quartiles over the seeds. If there are held-out drives, the cost of a run
    is its cost on these drives.
    """
    last = "held_out_cost" if "held_out_cost" in comparison.measures else "cost"
    contenders = comparison.contenders
    looks = many_styles(len(contenders), 1.6)

    def costs_over_budget(ax: Axes) -> None:
        for i, (contender, look) in enumerate(zip(contenders, looks, strict=True)):
            rows = comparison.curves.filter(optimizer=contender.name, scale=contender.scale)
            spent = rows["full_evaluations"].to_numpy()
            # just after the last evaluation
            end = comparison.budget * (comparison.frame["steps_share"][i] + 0.01)
            costs = (rows[name].to_numpy() for name in ("median", "quartile_1", "quartile_3"))
            middle, low, high = (np.where(np.isfinite(c) & (spent <= end), c, np.nan) for c in costs)
            band(ax, spent, low, high, Look(look.color, opacity=0.12))
            curve(ax, spent, middle, look, contender.label)
        ax.set(xlabel="evaluations on all training drives", ylabel="lowest training cost so far")
        ax.set_ylim(*_frame(comparison))

    def runs(ax: Axes) -> None:
        for i, (contender, look) in enumerate(zip(contenders, looks, strict=True)):
            values = comparison.values(contender.label, last)
            values = values[np.isfinite(values)]
            ring = Look(look.color, 0.0, NO_LINE, "o", 4.0, 0.7).line
            ax.plot(values, np.full(len(values), i), **ring, mfc="none", mec=look.color)
            if len(values):
                curve(ax, [float(np.median(values))], [i], Look(look.color, 2.0, NO_LINE, "|", 16.0))
        ax.set_xlabel(MEASURES[last])
        name_rows(ax, [c.label for c in contenders])

    charts = (
        Chart(f"Median and quartiles of {comparison.seeds} seeds", costs_over_budget),
        Chart("All runs and their medians", runs),
    )
    return figure_of(*charts, size=(12, max(4.2, 1.6 + 0.28 * len(contenders))), legend="below")


def _frame(comparison: Comparison) -> tuple[float | None, float | None]:
    """Return the limits of the cost axis: the lowest cost and the cost at a tenth of the budget, with margins."""
    medians = comparison.curves["median"].to_numpy().reshape(len(comparison.contenders), -1)
    finite = medians[np.isfinite(medians)]
    if not len(finite):
        return None, None
    early = medians[:, medians.shape[1] // 10]
    early = early[np.isfinite(early)]
    low, high = float(finite.min()), float(np.median(early)) if len(early) else float(finite.max())
    margin = 0.05 * (high - low) or 0.05 * abs(low)
    return low - margin, high + margin
