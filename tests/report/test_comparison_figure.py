"""The figure of a comparison: a curve and a row of runs for each optimizer, and the same bytes each time."""

from pathlib import Path

import numpy as np

from sigmaswarm.experiments.compare import compare
from sigmaswarm.reports.compare import comparison_figure, save_comparison
from support import make_drive

DRIVES = [make_drive(duration=15.0, seed=s, name=f"d{s}") for s in range(3)]


def test_the_figure_shows_every_optimizer_and_run(tmp_path: Path):
    found = compare(
        DRIVES[:2],
        validation=DRIVES[2:],
        optimizers=("pso", "pso:racing=true"),
        seeds=2,
        particles=6,
        generations=4,
    )
    course, end = comparison_figure(found).axes
    full, raced = course.get_lines()
    assert [full.get_label(), raced.get_label()] == ["pso, log10", "pso:racing=true, log10"]
    last = found.curves["median"].to_list()[99]
    assert full.get_ydata()[-1] == last == np.median(found.values("pso, log10", "cost"))
    shown = raced.get_xdata()[np.isfinite(raced.get_ydata())]
    assert shown[-1] <= 24 * (found.frame["steps_share"][1] + 0.02) < 24  # it ends when its steps are used up
    shares = [run.history_steps[-1] for run in found.runs["pso:racing=true, log10"]]
    assert found.frame["steps_share"][1] == np.mean(shares) / (24 * found.steps_per_set)
    dots = [line.get_xdata().tolist() for line in end.get_lines()[::2]]
    assert dots == [found.values(c.label, "held_out_cost").tolist() for c in found.contenders]
    files = save_comparison(found, tmp_path)
    before = [file.read_bytes() for file in files]
    assert [file.read_bytes() for file in save_comparison(found, tmp_path)] == before
