"""The pictures of a tuning, as PNG files; all they show is said in `views/`."""

from pathlib import Path

from matplotlib.figure import Figure

from sigmaswarm.reports.evaluation import tracks
from sigmaswarm.reports.figures import figure_of, save
from sigmaswarm.reports.style import LABELS
from sigmaswarm.reports.views.tuning import convergence_chart
from sigmaswarm.scoring.measures import method_names
from sigmaswarm.scoring.tracks import Picture
from sigmaswarm.tuning.record import HISTORY_FILE, History
from sigmaswarm.tuning.result import Tuning


def save_tuning_figures(tuning: Tuning, track: Picture, folder: Path) -> list[Path]:
    """Write convergence.csv and the figures of a tuning into its folder; the pictures' paths.

    ``track`` is of a training drive: `scoring.tracks.picture_of`.
    """
    History.of(tuning).save(folder / HISTORY_FILE)
    labels = LABELS | method_names(tuning.parameters.kind, tuning.parameters.model)
    return [
        save(convergence(tuning), folder / "convergence.png"),
        save(tracks(track, labels), folder / "training-track.png"),
    ]


def convergence(tuning: Tuning) -> Figure:
    """Best cost so far and median cost of the generations (the paper's Fig. 2)."""
    chart = convergence_chart(History.of(tuning), tuning.best_trial, tuning.config.objective)
    return figure_of(chart, size=(6.4, 4.0))
