"""The chart and the pictures of a tuning."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sigmaswarm.reports.evaluation import tracks
from sigmaswarm.reports.figures import figure_of, save
from sigmaswarm.reports.style import BLUE, LABELS, ORANGE
from sigmaswarm.reports.views.charts import Axis, Chart, Curve, Look
from sigmaswarm.scoring.measures import method_names
from sigmaswarm.scoring.tracks import Picture
from sigmaswarm.tuning.record import HISTORY_FILE, History
from sigmaswarm.tuning.result import Tuning


def convergence_chart(history: History, best_trial: int, objective: str) -> Chart:
    """Best cost so far and median cost of each generation (the paper's Fig. 2); the best trial is bold.

    The scale is logarithmic if all costs are positive; a likelihood's may be negative.
    """
    curves: list[Curve] = []
    for trial in history.trials:
        best = trial.trial == best_trial
        for costs, name, look in (
            (trial.best, "best so far", Look(BLUE, 2.0 if best else 1.0)),
            (trial.median, "median of the generation", Look(ORANGE, 1.0, "dash")),
        ):
            shown = look if best else replace(look, opacity=0.35)
            curves.append(Curve(trial.generation, costs, shown, name if best else ""))
    costs = np.concatenate([np.asarray(curve.y, np.float64) for curve in curves])
    scale = "log" if np.all(costs[np.isfinite(costs)] > 0) else "linear"
    n = len(history.trials)
    title = f"Convergence, {n} trials (the best one bold)" if n > 1 else "Convergence"
    return Chart(title, tuple(curves), Axis("generation"), Axis(f"cost: {objective}", scale, plain=True))


def save_tuning_figures(tuning: Tuning, track: Picture, folder: Path) -> list[Path]:
    """Write convergence.csv and the figures of a tuning into its folder; the pictures' paths.

    ``track`` is of a training drive: `scoring.tracks.picture_of`.
    """
    save_history(tuning, folder)
    labels = LABELS | method_names(tuning.parameters.kind, tuning.parameters.model)
    return [
        save(convergence(tuning), folder / "convergence.png"),
        save(tracks(track, labels), folder / "training-track.png"),
    ]


def save_history(tuning: Tuning, folder: Path) -> None:
    """Write convergence.csv into the folder of a tuning."""
    History.of(tuning.trials).save(folder / HISTORY_FILE)


def convergence(tuning: Tuning) -> Figure:
    """Best cost so far and median cost of the generations (the paper's Fig. 2)."""
    chart = convergence_chart(History.of(tuning.trials), tuning.best_trial, tuning.config.objective)
    return figure_of(chart, size=(6.4, 4.0))
