"""The folder of an evaluation: its records, its pictures, and the tuning, so that its page needs nothing else."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from sigmaswarm.drives.overlap import SEEN_FILE
from sigmaswarm.errors import InputError
from sigmaswarm.files import staged_files, write_whole
from sigmaswarm.learned.folder import Learned
from sigmaswarm.reports.figures import figure_of, new_figure, save
from sigmaswarm.reports.style import LABELS
from sigmaswarm.reports.views.evaluation import consistency_charts, error_charts, method_bars, track_charts
from sigmaswarm.scoring.evaluation import Evaluated, Evaluation
from sigmaswarm.scoring.records import seal
from sigmaswarm.scoring.tracks import Picture
from sigmaswarm.tuning.record import FILE, HISTORY_FILE
from sigmaswarm.wording import names_shown


def save_evaluation(
    evaluation: Evaluation, folder: Path, tuning: Path | None = None, network: Learned | None = None
) -> list[Path]:
    """Write the records and pictures of an evaluation; return the paths of all files.

    Parameters
    ----------
    evaluation : Evaluation
    folder : Path
        Created if missing.
    tuning : Path, optional
        The tuning.toml that was evaluated, or the folder that holds it; copied.
    network : Learned, optional
        The network that was evaluated; copied.
    """
    with staged_files(folder) as new:
        written = [*evaluation.save(new), *save_evaluation_figures(evaluation, new)]
        if tuning is not None:
            written += copy_tuning(tuning, new)
        if network is not None:
            written += network.save(new)
        seal(new)
    return [folder / file.relative_to(new) for file in written]


def copy_tuning(tuning: Path, folder: Path) -> list[Path]:
    """Copy a tuning.toml or that of a folder, its history and its fingerprints; return the paths of the copies."""
    file = tuning / FILE if tuning.is_dir() else tuning
    written: list[Path] = []
    sources = {FILE: file} | {name: file.parent / name for name in (HISTORY_FILE, SEEN_FILE)}
    for name, source in sources.items():
        if source.is_file():
            write_whole(folder / name, source.read_bytes())
            written.append(folder / name)
    return written


def save_evaluation_figures(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Write the figures of an evaluation into its folder; return their paths."""
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


def track_figure(evaluation: Evaluation, drive: str) -> Figure:
    """Draw the tracks of all methods on one drive."""
    found = evaluation.drives.get(drive)
    if found is None or found.picture is None:
        raise InputError(f"no track of {drive!r}; there are {names_shown(evaluation.drives)}")
    return tracks(found.picture, LABELS | dict(evaluation.names))


def tracks(picture: Picture, labels: Mapping[str, str]) -> Figure:
    """The whole track, and a close-up where the car turns most (the paper's Fig. 3)."""
    return figure_of(*track_charts(picture, labels), size=(11, 5.4), legend="below")


def errors(picture: Picture, labels: Mapping[str, str]) -> Figure | None:
    """Position and heading error over time; None without truth."""
    charts = error_charts(picture, labels)
    return figure_of(*charts, size=(9, 6), columns=1, legend="below", sharex=True) if charts else None


def comparison(evaluation: Evaluation) -> Figure:
    """Bars of the mean scores of each method, where there are any."""
    charts = [
        replace(chart, title=chart.x.title, x=replace(chart.x, title=""))
        for chart in method_bars(evaluation.record, evaluation.names, evaluation.measures)
    ]
    if charts:
        columns = min(len(charts), 3)
        rows = -(-len(charts) // columns)
        return figure_of(*charts, size=(11 if columns > 1 else 6.4, 3.4 * rows), columns=columns)
    figure, (ax,) = new_figure(6.4, 3.4)
    ax.set_axis_off()
    ax.text(0.5, 0.5, "nothing can be compared: no truth, and no outage fits", ha="center")
    return figure


def consistency(name: str, found: Evaluated) -> Figure | None:
    """Consistency of the tuned filter; None where it failed or had too few fixes."""
    charts = consistency_charts(name, found)
    return figure_of(*charts, size=(11, 3.4)) if charts else None
