"""Page and pictures of a tuning: cost, parameters with ranges, convergence and drives."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.drives.fingerprint import START_RULE, DriveRecord
from sigmaswarm.errors import InputError
from sigmaswarm.files import write_atomically
from sigmaswarm.reports.evaluation import tracks
from sigmaswarm.reports.figures import Chart, curve, figure_of, logarithmic, save
from sigmaswarm.reports.page import Report, Section
from sigmaswarm.reports.style import BLUE, LABELS, ORANGE, Look
from sigmaswarm.scoring.methods import method_names
from sigmaswarm.scoring.tracks import Picture
from sigmaswarm.tables import Cell, Column, Table
from sigmaswarm.tuning.config import RENAMED, SWARM, TuneConfig, option_words
from sigmaswarm.tuning.record import FILE, HISTORY_FILE, RANGES, TuningRecord, history_of, load_history
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.wording import as_sentence

# Options that the command of a page contains even if they have their default values.
STATED_OPTIONS = (
    *("objective", "particles", "generations", "trials", "seed"),
    *("model", "kind", "use", "prior", "inflation"),
)
TUNE_DEFAULTS = {name: field.default for name, field in TuneConfig.model_fields.items()}


def save_tuning_figures(tuning: Tuning, track: Picture, folder: Path) -> list[Path]:
    """Write convergence.csv and the figures of a tuning into its folder. Return the paths of the pictures.

    ``track`` is a track on a training drive (`scoring.tracks.first_track`).
    """
    write_atomically(folder / HISTORY_FILE, history_of(tuning.trials).write_csv())
    labels = LABELS | method_names(tuning.parameters.kind, tuning.parameters.model)
    figures = {"convergence": convergence(tuning), "training-track": tracks(track, labels)}
    return [save(figure, folder / f"{name}.png") for name, figure in figures.items()]


def convergence(tuning: Tuning) -> Figure:
    chart = _convergence_chart(history_of(tuning.trials), tuning.best_trial, tuning.config.objective)
    return figure_of(chart, size=(6.4, 4.0))


def _convergence_chart(history: pl.DataFrame, best_trial: int, objective: str) -> Chart:
    """Draw the lowest cost so far and the median cost of each generation, with the best trial in bold.

    The scale is logarithmic if all costs are positive; the cost of a likelihood may be negative.
    """

    def draw(ax: Axes) -> None:
        for (number,), rows in history.group_by("trial", maintain_order=True):
            best = number == best_trial
            for costs, name, look in (
                ("best_cost", "best so far", Look(BLUE, 2.0 if best else 1.0)),
                ("median_cost", "median of the generation", Look(ORANGE, 1.0, "--")),
            ):
                shown = look if best else replace(look, opacity=0.35)
                curve(ax, rows["generation"], rows[costs], shown, name if best else "")
        costs = history["best_cost", "median_cost"].to_numpy()
        if np.all(costs[np.isfinite(costs)] > 0):
            logarithmic(ax.yaxis)
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter("{x:g}")
        ax.set(xlabel="generation", ylabel=f"cost: {objective}")

    n = history["trial"].n_unique()
    return Chart(f"Convergence, {n} trials (the best trial in bold)" if n > 1 else "Convergence", draw)


def tuning_report(record: TuningRecord, history: pl.DataFrame | None = None) -> Report:
    """Return the page of a tuning. ``history`` is the table of convergence.csv."""
    result = record.result
    if result is None:
        raise InputError("the tuning has no [result] table; specify a folder that `sigmaswarm tune` wrote")
    figures = [("cost", f"{result.cost:.4g}", f"{result.objective}, training drives")]
    if result.validation_cost is not None:
        figures.append(("cost on held-out drives", f"{result.validation_cost:.4g}", record.gap))
    figures.append(("parameter sets tried", f"{result.evaluations}", f"{result.failures} of them failed"))
    held_out = record.validation or "to measure the errors on other drives, run sigmaswarm evaluate"
    command, note = tune_command(record.config, [d.name for d in record.data], result.validation_drives)
    return Report(
        title=f"Tuning of {record.called}",
        lead=(
            record.purpose,
            *(f"{line[0].upper()}{line[1:]}." for line in (held_out, *record.larger_drifts)),
        ),
        figures=tuple(figures),
        remarks=tuple(map(as_sentence, result.remarks)),
        sections=(
            parameters_section(record),
            *([Section("Drifts without fixes", tables=(record.drifts,))] if record.drifts else []),
            *convergence_section(record, history),
            data_section("Drives", record.data),
        ),
        config=shown_config(record.config),
        versions=record.versions,
        command=command,
        command_note=note,
    )


def parameters_section(record: TuningRecord) -> Section:
    ranges = record.within_1_percent_of_the_cost
    return Section("Parameters", (RANGES,) if ranges else (), (record.parameters(),))


def read_tuning(folder: Path) -> tuple[TuningRecord, pl.DataFrame | None]:
    """Read tuning.toml and, if it exists, convergence.csv of a folder. Raises `InputError` if they do not match."""
    record, path = TuningRecord.read(folder), folder / HISTORY_FILE
    if not path.exists() or record.result is None:
        return record, None
    history = load_history(path)
    last = history.group_by("trial", maintain_order=True).last()
    if not np.array_equal(last["best_cost"], record.result.trial_costs):
        raise InputError(
            f"{path}: does not belong to the {FILE} in this folder; delete {HISTORY_FILE}, or restore the original "
            f"{HISTORY_FILE}"
        )
    return record, history


def convergence_section(record: TuningRecord, history: pl.DataFrame | None) -> tuple[Section, ...]:
    """Show the cost over generations of every trial, if the history is known."""
    if history is None or record.result is None:
        return ()
    best, costs = record.result.best_trial, record.result.trial_costs
    chart = _convergence_chart(history, best, record.result.objective)
    charts = (replace(chart, title="Cost over generations"),)
    if len(costs) == 1:
        return (Section("Convergence", charts=charts),)
    rows = tuple((float(i), cost) for i, cost in enumerate(costs))
    table = Table("Cost of each trial", (Column("trial"), Column("cost")), rows, frozenset({best}))
    text = f"The best of {len(costs)} trials is drawn in bold."
    return (Section("Convergence", (text,), (table,), charts),)


def data_section(title: str, data: Sequence[DriveRecord]) -> Section:
    """List the drives; for an evaluation, also state whether the tuning used them."""

    def held_out(drive: DriveRecord) -> Cell:
        if drive.seen_s:
            return f"no: the tuning used {drive.seen_s:.0f} s of the drive"
        return None if drive.seen_s is None else "yes"

    columns: dict[Column, list[Cell]] = {
        Column("drive"): [d.name for d in data],
        Column("length", "s"): [d.duration_s for d in data],
        Column("IMU samples"): [d.imu_samples for d in data],
        Column("fixes"): [d.fixes for d in data],
        Column("truth"): ["" if d.has_truth is None else "yes" if d.has_truth else "no" for d in data],
    }
    started = any(d.scored_from_s is not None for d in data)
    if started:
        columns[Column("scored from", "s")] = [d.scored_from_s for d in data]
    if any(d.seen_s is not None for d in data):
        columns[Column("held out")] = [held_out(d) for d in data]
    text = f"Filters and scores start at {START_RULE}."
    table = Table("", tuple(columns), tuple(zip(*columns.values(), strict=True)))
    return Section(title, (text,) if started else (), (table,))


def shown_config(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration of the search, without the coefficients of pso for other optimizers.

    The entry of a custom model contains only the name and the fingerprint of the model.
    """
    if config.get("optimizer", "pso") != "pso":  # old files of pso lack this key
        config = {key: value for key, value in config.items() if key not in SWARM}
    model = config.get("model")
    if isinstance(model, dict):
        return config | {"model": {k: model[k] for k in ("name", "sha256") if k in model}}
    return config


def tune_command(
    config: Mapping[str, Any], drives: Sequence[str], validation: Sequence[str]
) -> tuple[str, str]:
    """Return the command of a tuning run and a note. The command is empty for a custom model."""
    if isinstance(config.get("model"), dict):
        return "", "The tuning has a custom model: repeat it in Python with sigmaswarm.tune."
    config = {RENAMED.get(name, name): value for name, value in config.items()}
    config = {"prior": 0.0, "inflation": 0.0} | config  # older versions had neither
    words = ["sigmaswarm", "tune", *drives, "--out", "again"]
    for name in (*STATED_OPTIONS, *(name for name in TUNE_DEFAULTS if name not in STATED_OPTIONS)):
        value = config.get(name)
        if value is None or (name not in STATED_OPTIONS and value == TUNE_DEFAULTS[name]):
            continue
        words += option_words(name, value)
    words += ["--validation", *validation] if validation else []
    return shlex.join(words), "Replace the names of the drives by the paths of their folders."
