"""The charts of a tuning."""

from dataclasses import replace

import numpy as np

from sigmaswarm.reports.style import BLUE, ORANGE
from sigmaswarm.reports.views.charts import Axis, Chart, Curve, Look
from sigmaswarm.tuning.record import History


def convergence_chart(history: History, best_trial: int, objective: str) -> Chart:
    """Best cost so far and median cost of each generation (the paper's Fig. 2); the best trial's is drawn strong.

    The scale is logarithmic where it can be: a likelihood's cost may be negative.
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
