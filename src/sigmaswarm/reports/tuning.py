"""Page and pictures of a tuning: cost, parameters with ranges, convergence and drives."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
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
from sigmaswarm.tuning.config import RENAMED, SWARM, TuneConfig
from sigmaswarm.tuning.diagnostics import drift_table, larger_drifts
from sigmaswarm.tuning.record import FILE, HISTORY_FILE, End, TuningRecord, history_of, load_history
from sigmaswarm.tuning.result import Tuning
from sigmaswarm.tuning.sensitivity import NOISE_SCALE
from sigmaswarm.tuning.space import searched_name
from sigmaswarm.wording import count_of

# Options that the command of a page contains even if they have their default values.
STATED_OPTIONS = (
    *("objective", "particles", "generations", "trials", "seed"),
    *("model", "kind", "use", "prior", "inflation"),
)
TUNE_DEFAULTS = {name: field.default for name, field in TuneConfig.model_fields.items()}
PARAMETER_MEANINGS = {
    "latency": (
        "delay with which this filter predicts the fixes best; the doctor estimates this delay as a clock offset, "
        "from turns and accelerations"
    ),
    "rear_axle": "distance of the IMU in front of the rear axle; negative: behind the rear axle",
}
SIGMA_POINTS = {"alpha", "beta", "kappa"}


def save_tuning_figures(tuning: Tuning, track: Picture, folder: Path) -> list[Path]:
    """Write convergence.csv and the figures of a tuning into its folder; return the paths of the pictures.

    ``track`` is a track on a training drive (`scoring.tracks.first_track`).
    """
    save_history(tuning, folder)
    labels = LABELS | method_names(tuning.parameters.kind, tuning.parameters.model)
    figures = {"convergence": convergence(tuning), "training-track": tracks(track, labels)}
    return [save(figure, folder / f"{name}.png") for name, figure in figures.items()]


def save_history(tuning: Tuning, folder: Path) -> None:
    write_atomically(folder / HISTORY_FILE, history_of(tuning.trials).write_csv())


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
    return Chart(f"Convergence, {n} trials (the best one in bold)" if n > 1 else "Convergence", draw)


def tuning_report(folder: Path) -> Report:
    file = TuningRecord.read(folder)
    result = file.result
    if result is None:
        raise InputError(
            f"{folder / FILE}: has no [result] table; name a folder that `sigmaswarm tune` wrote"
        )
    figures = [("cost", f"{result.cost:.4g}", f"{result.objective}, training drives")]
    held_out = "To measure the errors on other drives, run sigmaswarm evaluate."
    if (cost := result.validation_cost) is not None and (gap := result.validation_gap) is not None:
        how = f"{abs(gap):.1%} {'worse' if gap > 0 else 'better'} than on the training drives"
        figures.append(("cost on held-out drives", f"{cost:.4g}", how))
        held_out = (
            f"The cost on {count_of(len(result.validation_drives), 'drive')} that the search did not use is "
            f"{cost:.4g}, {how}. The cost on the training drives is {result.cost:.4g}."
        )
    figures.append(("candidates tried", f"{result.evaluations}", f"{result.failures} of them failed"))
    command, note = tune_command(file.config, [d.name for d in file.data], result.validation_drives)
    drifts = (drift_table(file.forecasts, [drive.duration_s or 0.0 for drive in file.data]),)
    return Report(
        title=f"Tuning of {filter_name(file)}",
        lead=(
            what_was_tuned(file),
            held_out,
            *(f"{sentence[0].upper()}{sentence[1:]}." for sentence in larger_drifts(file.forecasts)),
        ),
        figures=tuple(figures),
        remarks=tuple(result.remarks),
        sections=(
            parameters_section(file),
            *([Section("Drifts without fixes", tables=drifts)] if file.forecasts else []),
            *convergence_section(file, folder),
            data_section("Drives", file.data),
        ),
        config=shown_config(file.config),
        versions=file.versions,
        command=command,
        command_note=note,
    )


def filter_name(file: TuningRecord) -> str:
    model = file.config.get("model", file.filter.get("model", "a filter"))
    if isinstance(model, dict):
        return str(model.get("name", "a custom model"))
    return f"{model} ({file.config.get('kind', file.filter.get('kind', 'ukf'))})"


def what_was_tuned(file: TuningRecord) -> str:
    if file.result is None:
        return f"The filter is {filter_name(file)}; its file does not describe a tuning."
    length = sum(d.duration_s or 0 for d in file.data)
    on = count_of(len(file.data), "drive") + (f" ({length / 60:.1f} min)" if length else "")
    meaning = f": {file.result.objective_meaning}" if file.result.objective_meaning else ""
    return f"{filter_name(file)} was tuned on {on}. The objective is {file.result.objective}{meaning}."


def parameters_section(file: TuningRecord) -> Section:
    ranges = file.within_1_percent_of_the_cost
    touched = {bound.parameter: bound.place for bound in (file.result.touched_bounds if file.result else ())}
    rows: list[tuple[Cell, ...]] = []
    model = str(file.filter.get("model"))
    for name, value, unit, density in _parameters(file):
        if file.filter.get("kind") == "ekf" and name in SIGMA_POINTS:
            continue
        low, high = ranges.get(searched_name(name, ranges, model), (None, None))
        place = touched.get(searched_name(name, touched, model), "")
        if (low, high) == ("-", "-"):
            place = "no effect within the bounds"
        remark = "; ".join(filter(None, (PARAMETER_MEANINGS.get(name, ""), place)))
        rows.append((name, value, unit, _end(low), _end(high), density, remark))
    if NOISE_SCALE in ranges:
        ends = map(_end, ranges[NOISE_SCALE])
        rows.append((NOISE_SCALE, 1.0, "", *ends, "", "one factor on all noise variances"))
    titles = ("parameter", "value", "unit", "from", "to", "density", "remark")
    text = (
        'At the values in the columns "from" and "to", the cost is 1% higher; all other parameters are unchanged. '
        '"At the bound" means that the cost at the bound of the search is less than 1% higher.'
    )
    table = Table("", tuple(map(Column, titles)), tuple(rows))
    return Section("Parameters", (text,) if ranges else (), (table,))


def _end(end: End | None) -> Cell:
    return "at the bound" if end == "-" else end


def _parameters(file: TuningRecord) -> Iterator[tuple[str, Cell, str, str]]:
    names = {
        "process_noise": [f"q_{state}" for state in file.units.get("states", [])],
        "measurement_noise": ["r_x", "r_y"],
        "bias_std": ["accel_bias_std", "gyro_bias_std"],
    }
    for field, value in file.filter.items():
        unit = file.units.get(field, "")
        if not isinstance(value, list):
            yield field, value, unit if isinstance(unit, str) else "", ""
            continue
        for i, entry in enumerate(value):
            name = dict(enumerate(names.get(field, []))).get(i, f"{field}[{i}]")
            one = unit if isinstance(unit, str) else unit[i] if i < len(unit) else ""
            noise = name.startswith("q_")
            yield name, entry, one, file.densities.get(name.removeprefix("q_"), "") if noise else ""


def convergence_section(file: TuningRecord, folder: Path) -> tuple[Section, ...]:
    """Show the cost over generations of every trial, if the folder has a history."""
    path = folder / HISTORY_FILE
    if not path.exists() or file.result is None:
        return ()
    best, costs = file.result.best_trial, file.result.trial_costs
    history = load_history(path)
    last = history.group_by("trial", maintain_order=True).last()
    if not np.array_equal(last["best_cost"], costs):
        raise InputError(
            f"{path}: does not belong to the {FILE} in this folder; repeat the command, or restore the original file"
        )
    chart = _convergence_chart(history, best, file.result.objective)
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
    """Return the configuration of the search, with the coefficients of pso only if this is the optimizer.

    For a custom model, the result contains only name and fingerprint of the model.
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
    """Return the command of a tuning run and a note; the command is empty for a custom model."""
    if isinstance(config.get("model"), dict):
        return "", "The tuning has a custom model: repeat it in Python with sigmaswarm.tune."
    config = {RENAMED.get(name, name): value for name, value in config.items()}
    config = {"prior": 0.0, "inflation": 0.0} | config  # older versions had neither
    words = ["sigmaswarm", "tune", *drives, "--out", "again"]
    for name in (*STATED_OPTIONS, *(name for name in TUNE_DEFAULTS if name not in STATED_OPTIONS)):
        value, option = config.get(name), f"--{name.replace('_', '-')}"
        if value is None or (name not in STATED_OPTIONS and value == TUNE_DEFAULTS[name]):
            continue
        if isinstance(value, list | tuple):
            words += [option, *map(str, value)] if value else [f"{option}-nothing"]
        else:
            words += [option] if value is True else [option, str(value)]
    words += ["--validation", *validation] if validation else []
    return shlex.join(words), "Replace the names of the drives by the paths of their folders."
