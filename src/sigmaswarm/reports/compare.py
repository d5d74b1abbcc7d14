"""The table and the figure of a comparison of optimizers, as files."""

from pathlib import Path

from matplotlib.figure import Figure

from sigmaswarm.experiments.comparison import Comparison
from sigmaswarm.files import write_whole
from sigmaswarm.reports.figures import figure_of, save
from sigmaswarm.reports.views import compare as views
from sigmaswarm.tables import Table


def save_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write the tables and the figure of a comparison into its folder; return the paths."""
    table = folder / "comparison.md"
    write_whole(table, comparison_table(comparison).to_markdown())
    frames = comparison.write(folder)
    return [table, *frames, save(comparison_figure(comparison), folder / "comparison.png")]


def comparison_table(comparison: Comparison) -> Table:
    """Tabulate each optimizer: medians with intervals, worst runs and tests; print it with to_markdown() and others."""
    return views.comparison_table(comparison)


def comparison_figure(comparison: Comparison) -> Figure:
    """Draw cost against evaluations, with quartiles, and the last cost of every run."""
    height = max(4.2, 1.6 + 0.28 * len(comparison.contenders))
    return figure_of(*views.comparison_charts(comparison), size=(12, height), legend="below")
