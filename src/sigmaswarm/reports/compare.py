"""The table and the picture of a comparison of optimizers, as files; all they say is said in `views/`."""

from pathlib import Path

from matplotlib.figure import Figure

from sigmaswarm.experiments.compare.record import Comparison
from sigmaswarm.files import write_whole
from sigmaswarm.reports.figures import figure_of, save
from sigmaswarm.reports.views import compare as views
from sigmaswarm.tables import Table


def save_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write the tables and the figure of a comparison into its folder; the paths of all files."""
    table = folder / "comparison.md"
    write_whole(table, comparison_table(comparison).to_markdown())
    frames = comparison.write(folder)
    return [table, *frames, save(comparison_figure(comparison), folder / "comparison.png")]


def comparison_table(comparison: Comparison) -> Table:
    """One row for each optimizer: medians with intervals, worst runs and tests; to_markdown() and others print it."""
    return views.comparison_table(comparison)


def comparison_figure(comparison: Comparison) -> Figure:
    """Cost against evaluations, with quartiles, and every run's last cost beside its held-out one."""
    height = max(4.2, 1.6 + 0.28 * len(comparison.contenders))
    return figure_of(*views.comparison_charts(comparison), size=(12, height), legend="below")
