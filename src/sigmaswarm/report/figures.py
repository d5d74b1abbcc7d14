"""The pictures of a tuning and of an evaluation, as PNG files; all they show is said in `views/`."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from sigmaswarm.report.draw.png import figure_of, new_figure, save
from sigmaswarm.report.style import LABELS
from sigmaswarm.report.views.evaluation import consistency_charts, error_charts, method_bars, track_charts
from sigmaswarm.report.views.tuning import convergence_chart
from sigmaswarm.scoring.evaluation import Evaluated, Evaluation, method_names
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


def save_evaluation_figures(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write the figures of an evaluation into its folder; their paths."""
    labels = LABELS | dict(evaluation.names)
    written = [save(comparison(evaluation), folder / "comparison.png")]
    for name, found in evaluation.drives.items():
        stem = name.replace("/", "-")
        figures = {
            "track": found.picture and tracks(found.picture, labels),
            "consistency": consistency(name, found),
            "error": found.picture and errors(found.picture, labels),
        }
        written += [save(f, folder / f"{stem}-{kind}.png") for kind, f in figures.items() if f]
    return written


def convergence(tuning: Tuning) -> Figure:
    """Best cost so far and median cost of the generations (the paper's Fig. 2)."""
    chart = convergence_chart(History.of(tuning), tuning.best_trial, tuning.config.objective)
    return figure_of(chart, size=(6.4, 4.0))


def tracks(picture: Picture, labels: Mapping[str, str]) -> Figure:
    """The whole track, and a close-up where the car turns most (the paper's Fig. 3)."""
    return figure_of(*track_charts(picture, labels), size=(11, 5.4), legend="below")


def errors(picture: Picture, labels: Mapping[str, str]) -> Figure | None:
    """Position and heading error over time; None without truth."""
    charts = error_charts(picture, labels)
    return figure_of(*charts, size=(9, 6), columns=1, legend="below", sharex=True) if charts else None


def comparison(evaluation: Evaluation) -> Figure:
    """Bars of the mean scores of each method, where there are any: without truth no errors."""
    charts = [
        replace(chart, title=chart.x.title, x=replace(chart.x, title=""))
        for chart in method_bars(evaluation.record, evaluation.names)
    ]
    if charts:
        return figure_of(*charts, size=(11 if len(charts) > 1 else 6.4, 3.4))
    figure, (ax,) = new_figure(6.4, 3.4)
    ax.set_axis_off()
    ax.text(0.5, 0.5, "nothing can be compared: no truth, and no outage fits", ha="center")
    return figure


def consistency(name: str, found: Evaluated) -> Figure | None:
    """What the tuned filter's innovations say; None where it failed or saw too few fixes."""
    charts = consistency_charts(name, found)
    return figure_of(*charts, size=(11, 3.4)) if charts else None
