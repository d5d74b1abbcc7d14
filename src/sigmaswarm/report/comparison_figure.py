"""The figure and tables of a comparison of optimizers."""

from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.files import write_whole
from sigmaswarm.report.draw.png import new_figure, save
from sigmaswarm.tuning.summary import MEASURES, Comparison

# Okabe and Ito's palette (2008), as in `style`; lines repeat it with other dashes.
COLORS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
DASHES = ("-", "--", ":", "-.")


def save_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write the tables and the figure of a comparison into its folder; the paths of all files."""
    tables: dict[str, pl.DataFrame] = {
        "comparison.csv": comparison.frame,
        "runs.csv": comparison.runs_frame,
        "curves.csv": comparison.curves,
    }
    for name, frame in tables.items():
        write_whole(folder / name, frame.write_csv())
    write_whole(folder / "comparison.md", comparison.markdown())
    picture = save(comparison_figure(comparison), folder / "comparison.png")
    return [folder / "comparison.md", *(folder / name for name in tables), picture]


def comparison_figure(comparison: Comparison) -> Figure:
    """Cost against evaluations, with quartiles, and every run's last cost beside its held-out one."""
    last = "held_out_cost" if "held_out_cost" in comparison.measures else "cost"
    figure, (course, end) = new_figure(12, max(4.2, 1.6 + 0.28 * len(comparison.contenders)), 1, 2)
    rows_of = comparison.frame.iter_rows(named=True)
    for i, (contender, row) in enumerate(zip(comparison.contenders, rows_of, strict=True)):
        rows = comparison.curves.filter(
            (pl.col("optimizer") == contender.name) & (pl.col("scale") == contender.scale)
        )
        spent, middle, low, high = (
            np.where(np.isfinite(column), column, np.nan)
            for column in (
                rows[n].to_numpy() for n in ("full_evaluations", "median", "quartile_1", "quartile_3")
            )
        )
        over = spent > comparison.budget * (row["steps_share"] + 0.01)  # raced, or with nothing left to try
        middle[over] = np.nan
        low[over] = high[over] = np.nan
        color, dash = COLORS[i % len(COLORS)], DASHES[i // len(COLORS) % len(DASHES)]
        course.fill_between(spent, low, high, color=color, alpha=0.12, lw=0)
        course.plot(spent, middle, color=color, ls=dash, lw=1.6, label=contender.label)
        _runs(end, i, comparison.values(contender.label, last), color)
    course.set(xlabel="evaluations on all training drives", ylabel="training cost, lowest so far")
    course.set_title(f"Median and quartiles of {comparison.seeds} seeds", loc="left")
    _frame_on(course, comparison)
    end.set_yticks(range(len(comparison.contenders)), [c.label for c in comparison.contenders], fontsize=8)
    end.invert_yaxis()
    end.set(xlabel=MEASURES[last])
    end.set_title("Every run, and the medians", loc="left")
    figure.legend(
        *course.get_legend_handles_labels(), frameon=False, fontsize=8, ncols=4, loc="outside lower center"
    )
    return figure


def _runs(ax: Axes, row: int, values: np.ndarray, color: str) -> None:
    finite = values[np.isfinite(values)]
    ax.plot(finite, np.full(len(finite), row), "o", ms=4, mfc="none", mec=color, alpha=0.7)
    if len(finite):
        ax.plot(np.median(finite), row, "|", ms=16, mew=2, color=color)


def _frame_on(ax: Axes, comparison: Comparison) -> None:
    """From the lowest cost to what half of the contenders reach at a tenth of the budget."""
    medians = comparison.curves["median"].to_numpy().reshape(len(comparison.contenders), -1)
    finite = medians[np.isfinite(medians)]
    if not len(finite):
        return
    early = medians[:, medians.shape[1] // 10]
    early = early[np.isfinite(early)]
    low, high = float(finite.min()), float(np.median(early)) if len(early) else float(finite.max())
    margin = 0.05 * (high - low) or 0.05 * abs(low)
    ax.set_ylim(low - margin, high + margin)
