"""Page of an evaluation: scores of the tuned filter and of other methods."""

import shlex
from collections.abc import Collection, Sequence
from pathlib import Path

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.record_files import load_record
from sigmaswarm.reports.evaluation import method_bars, swarm_charts
from sigmaswarm.reports.page import KeyFigure, Report, Section, TrackView
from sigmaswarm.reports.style import LABELS, STYLES
from sigmaswarm.reports.tuning import (
    convergence_section,
    data_section,
    parameters_section,
    read_tuning,
    shown_config,
)
from sigmaswarm.scoring.methods import (
    AGAINST,
    BANK,
    BASELINE,
    FIXES,
    OPTIONAL_METHODS,
    SMOOTHED,
    method_names,
)
from sigmaswarm.scoring.records import (
    EVALUATION_FILE,
    SCORES_FILE,
    EvaluationRecord,
    ScoresRecord,
    verify_checksums,
)
from sigmaswarm.scoring.tracks import TRACKS_FILE, Tracks, load_tracks
from sigmaswarm.scoring.view import (
    EvaluationView,
    explained_consistency,
    explained_radius,
    explained_scores,
    with_training,
)
from sigmaswarm.tuning.record import NOT_VALIDATED_TEXTS, TuningRecord
from sigmaswarm.wording import as_sentence, sort_remarks

# Verdicts on the consistency that the page shows as warnings.
WARNING_VERDICTS = ("optimistic", "pessimistic", "alike", "lasting", "correlated", "unknown")
BANK_TEXT = (
    "A filter bank has sixteen filters with different parameters. The weight of a filter in the estimate depends on "
    "how well this filter predicted the fixes of the last minute. While the vehicle moves, the filters with the lowest "
    "weights are replaced every 10 s by the result of a search over the last minute and by randomly changed copies "
    "of good filters. If the parameters move far from the tuned values, the vehicle, its sensors or its surroundings "
    "probably differ from those of the training drives. One decade is a factor of ten in a variance."
)


def read_evaluation(folder: Path) -> Report:
    record, history = read_tuning(folder)
    view, drives = read_view(folder, record), load_tracks(folder / TRACKS_FILE)
    if not list(view.scores.drives) == [d.name for d in view.setup.data] == [t.name for t in drives]:
        raise InputError(
            f"{folder}: scores.json, evaluation.json and tracks.npz contain different drives; "
            "repeat `sigmaswarm evaluate`"
        )
    return evaluation_report(view, drives, record, history)


def evaluation_report(
    view: EvaluationView, drives: Sequence[Tracks], record: TuningRecord, history: pl.DataFrame | None = None
) -> Report:
    """Return the page of an evaluation of the filter in ``record``, with the convergence of its tuning."""
    scores, setup, nees = view.scores, view.setup, not view.without_truth
    absent = {AGAINST, FIXES, *OPTIONAL_METHODS} - {*scores.mean}
    labels = LABELS | dict(view.names)
    tracks = TrackView(drives, {m: labels[m] for m in STYLES if m not in absent}, STYLES, "tuned")
    swarm = tuple(chart for drive in drives for chart in swarm_charts(drive))
    also = [method for method in (AGAINST, *OPTIONAL_METHODS) if method in scores.mean]
    command, note = evaluate_command(list(scores.drives), setup, also=also)
    verdicts = view.verdicts()
    remarks = [*view.warnings(), *view.findings()]
    remarks += [verdicts[kind] for kind in WARNING_VERDICTS if kind in verdicts]
    remarks += map(as_sentence, record.unconfirmed_drifts(view.outage_lengths()))
    of_tuning = record.result.remarks if record.result else ()
    remarks += [as_sentence(remark) for remark in of_tuning if remark not in NOT_VALIDATED_TEXTS]
    return Report(
        title=f"Evaluation of {record.called}",
        lead=(view.result(), *(view.coverage() if view.without_truth else ()), record.purpose),
        figures=_figures(view),
        remarks=tuple(sort_remarks(remarks)),
        sections=(
            Section("Tracks and errors over time" if nees else "Tracks over time", tracks=tracks),
            _comparison(view),
            *((Section("Filter bank", (BANK_TEXT,), charts=swarm),) if swarm else ()),
            Section("Consistency", (explained_consistency(nees),), (view.consistency_table(),)),
            *(
                (Section("Position radius", (explained_radius(),), (view.radius_table(),)),)
                if scores.radius
                else ()
            ),
            parameters_section(record),
            *convergence_section(record, history),
            data_section("Drives of the evaluation", setup.data),
            *((data_section("Training drives", record.data),) if record.data else ()),
        ),
        config=shown_config(record.config)
        | {"outage_length_s": setup.outage_length_s, "evaluation_outage_seed": setup.outage_seed},
        versions=setup.versions,
        command=command,
        command_note=note,
    )


def read_view(folder: Path, file: TuningRecord) -> EvaluationView:
    """Read the scores and the setup of an evaluation of the tuning in ``file``."""
    scores = load_record(ScoresRecord, folder / SCORES_FILE)
    setup = load_record(EvaluationRecord, folder / EVALUATION_FILE)
    verify_checksums(folder, setup)
    kind, model = str(file.filter.get("kind", "ukf")), str(file.filter.get("model", "planar5"))
    names = method_names(kind, model, also=scores.mean, against=setup.against and setup.against.called)
    data = [with_training(drive, file.data) for drive in setup.data]
    return EvaluationView(scores, setup.model_copy(update={"data": data}), names)


def _figures(view: EvaluationView) -> tuple[KeyFigure, ...]:
    figures: list[KeyFigure] = []
    for name, measure in view.measures.items():
        rival = AGAINST if AGAINST in view.scores.mean else view.best_baseline(name) or BASELINE
        tuned, other = view.scores.mean_of("tuned", name), view.scores.mean_of(rival, name)
        if tuned is not None:
            note = "" if other is None else f"{view.names[rival]}: {other:.3g} {measure.unit}"
            figures.append((measure.title, f"{tuned:.3g} {measure.unit}", note))
    if known := [c.mean_nis for c in view.scores.consistency.values() if c]:
        nis = sum(known) / len(known)
        figures.append(("mean NIS", f"{nis:.3g}", "2 if the filter is consistent"))
    return tuple(figures)


def _comparison(view: EvaluationView) -> Section:
    tables = [view.mean_table()] if len(view.scores.drives) > 1 else []
    tables += [view.drive_table(), *([view.drift_table()] if view.scores.drifts else [])]
    coverage = () if view.without_truth else view.coverage()
    text = (*coverage, explained_scores(view), *view.missing_scores(), *view.drifts(), *view.explanations())
    return Section("Comparison", text, tuple(tables), method_bars(view))


def evaluate_command(
    drives: Sequence[str], setup: EvaluationRecord, *, also: Collection[str]
) -> tuple[str, str]:
    words = ["sigmaswarm", "evaluate", "tuning.toml", *drives, "--out", "again"]
    words += ["--outage-length", f"{setup.outage_length_s:g}", "--outage-seed", str(setup.outage_seed)]
    words += ["--as-recorded"] if setup.as_recorded else []
    options = {AGAINST: ["--against", "against.toml"], SMOOTHED: ["--smooth"], BANK: ["--bank"]}
    words += [word for method in also for word in options.get(method, ())]  # networks need no option
    there = "tuning.toml and against.toml are" if AGAINST in also else "tuning.toml is"
    paths = "Replace the names of the drives by the paths of their folders."
    return shlex.join(words), f"{there} in the folder of the evaluation. {paths}"
