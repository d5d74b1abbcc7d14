"""The page of a tuning: its cost, its parameters with their ranges, its convergence and its drives."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sigmaswarm.drives.fingerprint import START_RULE, DriveRecord
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import MODELS
from sigmaswarm.records import load_record
from sigmaswarm.reports.page import Figure, Report, Section
from sigmaswarm.reports.pages.commands import tune_command
from sigmaswarm.reports.tuning import convergence_chart
from sigmaswarm.tables import Cell, Column, Table
from sigmaswarm.tuning.config import SWARM
from sigmaswarm.tuning.record import FILE, HISTORY_FILE, End, History, TuningRecord
from sigmaswarm.tuning.sensitivity import NOISE_SCALE
from sigmaswarm.wording import counted

MEANINGS = {
    "latency": (
        "age of the fixes' positions with the best predictions of this filter; the doctor's clock offset is another "
        "estimate of it, from turns and accelerations alone"
    ),
    "rear_axle": "distance from the rear axle forward to the IMU; negative: the IMU is behind it",
}
"""Explanations of parameters whose name and unit do not suffice."""


def tuning_report(folder: Path) -> Report:
    """Read the folder of a `sigmaswarm tune`."""
    file = load_record(TuningRecord, folder / FILE)
    result = file.result
    if result is None:
        raise InputError(f"{folder / FILE}: has no [result] table; give the folder of a `sigmaswarm tune`")
    figures = [Figure("cost", f"{result.cost:.4g}", f"{result.objective}, training drives")]
    if result.validation_cost is not None and result.validation_gap is not None:
        figures.append(
            Figure("cost on held-out drives", f"{result.validation_cost:.4g}", _gap(result.validation_gap))
        )
    figures.append(Figure("candidates tried", f"{result.evaluations}", f"{result.failures} of them failed"))
    command, note = tune_command(file.config, [d.name for d in file.data], result.validation_drives)
    return Report(
        title=f"Tuning of {filter_name(file)}",
        lead=(what_was_tuned(file), _held_out(file)),
        figures=tuple(figures),
        remarks=remarks(file),
        sections=(
            parameters_section(file),
            *convergence_section(file, folder),
            data_section("Drives", file.data),
        ),
        config=shown_config(file.config),
        versions=file.versions,
        command=command,
        command_note=note,
    )


def filter_name(file: TuningRecord) -> str:
    """Model and kind, for a title."""
    model = file.config.get("model", file.filter.get("model", "a filter"))
    if isinstance(model, dict):
        return str(model.get("name", "a model of your own"))  # pyright: ignore
    return f"{model} ({file.config.get('kind', file.filter.get('kind', 'ukf'))})"


def what_was_tuned(file: TuningRecord) -> str:
    """The filter, the drives and the objective, in a sentence."""
    if file.result is None:
        return f"The filter is {filter_name(file)}; its file does not say how it was tuned."
    length = sum(d.duration_s or 0 for d in file.data)
    on = counted(len(file.data), "drive") + (f" ({length / 60:.1f} min)" if length else "")
    meaning = f": {file.result.objective_meaning}" if file.result.objective_meaning else ""
    return f"{filter_name(file)} was tuned on {on} for {file.result.objective}{meaning}."


def _held_out(file: TuningRecord) -> str:
    result = file.result
    if result is None or result.validation_cost is None or result.validation_gap is None:
        return "Its scores on other drives are not known yet: run sigmaswarm evaluate."
    n = len(result.validation_drives)
    return (
        f"On {counted(n, 'drive')} that the search did not use its cost is {result.validation_cost:.4g}, "
        f"{_gap(result.validation_gap)}; on the training drives it is {result.cost:.4g}."
    )


def _gap(gap: float) -> str:
    return f"{abs(gap):.1%} {'worse' if gap > 0 else 'better'} than on the training drives"


def remarks(file: TuningRecord) -> tuple[str, ...]:
    """Return the warnings of the tuning."""
    r = file.result
    return () if r is None else tuple(r.remarks)


SIGMA_POINTS = {"alpha", "beta", "kappa"}
"""An extended filter has none."""


def parameters_section(file: TuningRecord) -> Section:
    """Every parameter with its unit, its range, and a remark."""
    ranges = file.within_1_percent_of_the_cost
    touched = {bound.parameter: bound.place for bound in (file.result.touched_bounds if file.result else ())}
    rows: list[tuple[Cell, ...]] = []
    for name, value, unit, density in _parameters(file):
        if file.filter.get("kind") == "ekf" and name in SIGMA_POINTS:
            continue
        searched = _searched_as(name, ranges, file)
        low, high = ranges.get(searched, (None, None))
        free = (low, high) == ("-", "-")
        found = "no effect within the bounds" if free else touched.get(_searched_as(name, touched, file), "")
        remark = "; ".join(said for said in (MEANINGS.get(name, ""), found) if said)
        rows.append((name, value, unit, _end(low), _end(high), density, remark))
    if NOISE_SCALE in ranges:
        low, high = ranges[NOISE_SCALE]
        rows.append((NOISE_SCALE, 1.0, "", _end(low), _end(high), "", "together, one factor"))
    titles = ("parameter", "value", "unit", "from", "to", "density", "remark")
    text = (
        (
            "From and to: the values at which the cost is 1% higher, all other parameters unchanged; at the bound: "
            "it is less than 1% higher at the bound of the search.",
        )
        if ranges
        else ()
    )
    return Section("Parameters", text, (Table("", tuple(map(Column, titles)), tuple(rows)),))


def _end(end: End | None) -> Cell:
    return "at the bound" if end == "-" else end


_SCALARS_OF: dict[str, tuple[str, ...]] = {
    "measurement_noise": ("r_x", "r_y"),
    "bias_std": ("accel_bias_std", "gyro_bias_std"),
}
"""Names in the search of the entries of a list; those of process_noise are q and the state."""


def _searched_as(name: str, known: Collection[str], file: TuningRecord) -> str:
    """Return the name in the search, where some share one: q_x and q_y are q_xy, q_roll is q_tilt."""
    model = MODELS.get(str(file.filter.get("model")))
    shared = {f"q_{state.name}": f"q_{state.shared}" for state in (model.states if model else ())}
    return name if name in known else (shared | {"r_x": "r_xy", "r_y": "r_xy"}).get(name, name)


def _parameters(file: TuningRecord) -> Iterator[tuple[str, Cell, str, str]]:
    """Name in the search, value, unit and density of every number of the filter."""
    states = file.units.get("states", [])
    for field, value in file.filter.items():
        unit = file.units.get(field, "")
        if not isinstance(value, list):
            yield field, value, unit if isinstance(unit, str) else "", ""
            continue
        names = [f"q_{s}" for s in states] if field == "process_noise" else _SCALARS_OF.get(field, ())
        for i, entry in enumerate(value):
            name = names[i] if i < len(names) else f"{field}[{i}]"
            one = unit if isinstance(unit, str) else unit[i] if i < len(unit) else ""
            yield (
                name,
                entry,
                one,
                file.densities.get(name.removeprefix("q_"), "") if name.startswith("q_") else "",
            )


def convergence_section(file: TuningRecord, folder: Path) -> tuple[Section, ...]:
    """Best and median cost over generations, every trial; nothing where the folder has no history."""
    path = folder / HISTORY_FILE
    if not path.exists() or file.result is None:
        return ()
    chart = convergence_chart(History.load(path), file.result.best_trial, file.result.objective)
    costs = file.result.trial_costs
    text = (f"The best of {len(costs)} trials is drawn bold.",) if len(costs) > 1 else ()
    rows = tuple((float(i), cost) for i, cost in enumerate(costs))
    table = Table(
        "Cost of each trial", (Column("trial"), Column("cost")), rows, frozenset({file.result.best_trial})
    )
    return (
        Section(
            "Convergence",
            text,
            (table,) if len(costs) > 1 else (),
            (replace(chart, title="Cost over generations"),),
        ),
    )


def data_section(title: str, data: Sequence[DriveRecord]) -> Section:
    """The drives; for evaluated ones whether they were held out, where that is known."""
    known = any(d.seen_s is not None for d in data)
    columns = [
        Column("drive"),
        Column("length", "s"),
        Column("IMU samples"),
        Column("fixes"),
        Column("truth"),
    ]
    started = any(d.scored_from_s is not None for d in data)
    columns += [Column("scored from", "s")] if started else []
    columns += [Column("held out")] if known else []
    rows: list[tuple[Cell, ...]] = []
    for d in data:
        truth = "" if d.has_truth is None else "yes" if d.has_truth else "no"
        row: tuple[Cell, ...] = (d.name, d.duration_s, d.imu_samples, d.fixes, truth)
        row = (*row, d.scored_from_s) if started else row
        held_out = f"no: tuned on {d.seen_s:.0f} s of it" if d.seen_s else None if d.seen_s is None else "yes"
        rows.append((*row, held_out) if known else row)
    text = f"Filters start, and scores with them, at {START_RULE}."
    return Section(title, (text,) if started else (), (Table("", tuple(columns), tuple(rows)),))


def shown_config(config: dict[str, Any]) -> dict[str, Any]:
    """Return the configuration that the search used, without the coefficients of other optimizers.

    A model of the user's own is shown by its name and fingerprint.
    """
    if config.get("optimizer", "pso") != "pso":  # tunings from before there was a choice are of pso
        config = {key: value for key, value in config.items() if key not in SWARM}
    model = config.get("model")
    if isinstance(model, dict):
        return config | {"model": {k: model[k] for k in ("name", "sha256") if k in model}}
    return config
