"""The page of an evaluation: what the tuning is worth on drives, against others, raw GPS and IMU only."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.errors import InputError
from sigmaswarm.records import load_record
from sigmaswarm.reports.page import Figure, Line, Report, Section, TrackView
from sigmaswarm.reports.pages.commands import evaluate_command
from sigmaswarm.reports.pages.tuning import (
    convergence_section,
    data_section,
    filter_name,
    parameters_section,
    remarks,
    shown_config,
    what_was_tuned,
)
from sigmaswarm.reports.style import LABELS, LOOKS
from sigmaswarm.reports.views.evaluation import method_bars, swarm_charts
from sigmaswarm.scoring.consistency import FORECASTS, verdicts
from sigmaswarm.scoring.drifts import OWN, UNTUNED
from sigmaswarm.scoring.measures import ALSO, HOW_AGAINST, HOW_UNTUNED, Measure, measures, method_names
from sigmaswarm.scoring.records import ASKED_FILE, SCORES_FILE, EvaluationRecord, ScoresRecord
from sigmaswarm.scoring.remarks import (
    how_far,
    partly_scored,
    restarted,
    said_of_drives,
    worse_than_raw,
    worse_than_untuned,
)
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH
from sigmaswarm.scoring.tracks import TRACKS_FILE, Tracks, load_tracks
from sigmaswarm.tables import Cell, Column, Table
from sigmaswarm.tuning.record import FILE, TuningRecord
from sigmaswarm.tuning.result import NOT_VALIDATED
from sigmaswarm.wording import in_order

LINES = ("truth", *ALSO, "tuned", OWN, UNTUNED, "imu_only", "raw_gps")
"""The series of the tracks, the first one on top."""
NO_TRUTH = (
    "{} has no truth, so no errors of position and heading can be told. What can: how far each filter drifts while "
    "fixes are hidden from it, measured against those fixes (whose own errors are in these figures, too), and whether "
    "its forecasts miss the fixes by as much as it says (NIS)."
)
SHOWN = ("truth", "tuned", *ALSO, OWN, UNTUNED, "raw_gps")
"""Those that are shown from the start."""


def evaluation_report(folder: Path) -> Report:
    """Read the folder of a `sigmaswarm evaluate --out`."""
    scores = load_record(ScoresRecord, folder / SCORES_FILE)
    asked = load_record(EvaluationRecord, folder / ASKED_FILE)
    file = load_record(TuningRecord, folder / FILE)
    also = [method for method in (OWN, *ALSO) if method in scores.mean]
    other = asked.against and (asked.against.kind, asked.against.model)
    names = method_names(*_kind_and_model(file), also=also, against=other)
    left_out = {OWN, *ALSO} - {*also}
    lines = tuple(
        Line(m, (LABELS | names)[m], LOOKS[m], shown=m in SHOWN) for m in LINES if m not in left_out
    )
    tracks = TrackView(tuple(load_tracks(folder / TRACKS_FILE)), lines, "tuned")
    if list(scores.drives) != [d.name for d in asked.data] or list(scores.drives) != [
        t.name for t in tracks.drives
    ]:
        raise InputError(
            f"{folder}: scores.json, evaluation.json and tracks.npz are not of the same drives; "
            "repeat `sigmaswarm evaluate`"
        )
    data = tuple(_with_what_was_seen(drive, file.data) for drive in asked.data)
    blind = all(d.has_truth is False for d in asked.data)
    without = (
        (NO_TRUTH.format("None of the drives" if len(asked.data) > 1 else "The drive"),) if blind else ()
    )
    without += tuple(f"{said}." for said in how_far(scores, asked.data))
    shown = measures(asked.outage_length_s)
    command, note = evaluate_command(list(scores.drives), asked.outage_length_s, asked.outage_seed, also=also)
    return Report(
        title=f"Evaluation of {filter_name(file)}",
        lead=(_result(scores, data, asked.outage_length_s, names), *without, what_was_tuned(file)),
        figures=_figures(scores, shown, names),
        remarks=tuple(
            in_order(
                [
                    *_remarks(scores, data, shown),
                    *(remark for remark in remarks(file) if remark != NOT_VALIDATED),
                ]
            )
        ),
        sections=(
            _comparison(scores, names, shown, asked.outage_length_s),
            Section("Tracks over time" if blind else "Tracks and errors over time", tracks=tracks),
            *_swarm(tracks.drives),
            _consistency(scores),
            parameters_section(file),
            *convergence_section(file, folder),
            data_section("Drives of the evaluation", data),
            *((data_section("Drives of the tuning", file.data),) if file.data else ()),
        ),
        config=shown_config(file.config)
        | {"outage_length_s": asked.outage_length_s, "evaluation_outage_seed": asked.outage_seed},
        versions=asked.versions,
        command=command,
        command_note=note,
    )


def _kind_and_model(file: TuningRecord) -> tuple[str, str]:
    return str(file.filter.get("kind", "ukf")), str(file.filter.get("model", "planar5"))


def _with_what_was_seen(drive: DriveRecord, tuned_on: Sequence[DriveRecord]) -> DriveRecord:
    """The drive as it is, or, where nobody said what the tuning saw, as one of the training drives if it is one.

    If it is none, it may still hold a part of one: that is not said to be held out.
    """
    same = [one.name for one in tuned_on if one.sha256 == drive.sha256 and one.sha256]
    if drive.seen_s is not None or not same:
        return drive
    return drive.model_copy(update={"seen_s": drive.duration_s or 0.0, "seen_in": same})


def _remarks(scores: ScoresRecord, data: Sequence[DriveRecord], shown: Mapping[str, Measure]) -> list[str]:
    said = (
        ["the filter was tuned on some of what it is evaluated on: that flatters it"]
        if any(drive.seen_s for drive in data)
        else []
    )
    if len(data) == 1 and data[0].duration_s:
        said.append(
            f"all figures are of one drive of {data[0].duration_s:.0f} s: another road or day may give others"
        )
    told = verdicts([c and c.summary for c in scores.consistency.values()])
    said += [
        *worse_than_raw(scores),
        *worse_than_untuned(scores, shown),
        *restarted(scores),
        *partly_scored(data),
    ]
    return said + [
        told[kind]
        for kind in ("optimistic", "pessimistic", "alike", "lasting", "correlated", "unknown")
        if kind in told
    ]


def _result(
    scores: ScoresRecord, data: Sequence[DriveRecord], outage_length: float, names: Mapping[str, str]
) -> str:
    """The result in a sentence: position where truth is known, else the drift over outages."""
    drives = said_of_drives(data)
    for measure, what in (
        ("position_rmse_m", "is {} m (RMS) from the truth"),
        ("outage_drift_m", f"drifts {{}} m (RMS) over an outage of {outage_length:g} s"),
    ):
        tuned = scores.mean_of("tuned", measure)
        if tuned is not None:
            others = {m: other for m in (OWN, "raw_gps", UNTUNED) if (other := scores.mean_of(m, measure))}
            sheet = others.pop(UNTUNED, None)
            against = [_against(tuned, other, names[m]) for m, other in others.items()]
            spread = scores.drift_said(measure)
            said = f"On {drives} the tuned filter {what.format(f'{tuned:.3g}')}{f' ({spread})' if spread else ''}"
            said = f"{said}: {', and '.join(against)}." if against else f"{said}."
            if sheet is None or OWN in others:
                return said
            # a share of what nobody tuned would flatter
            return f"{said} The {names[UNTUNED]}, which nobody tuned, has {sheet:.3g} m."
    return f"On {drives} nothing can be said of the tuned filter: it failed, or there is no truth."


def _against(tuned: float, other: float, name: str) -> str:
    change = 100 * (other - tuned) / other
    return f"{abs(change):.0f}% {'less' if change >= 0 else 'MORE'} than {name} ({other:.3g} m)"


def _rival(scores: ScoresRecord, measure: str) -> str | None:
    """What a tuning has to beat: the user's own filter, else the same by data sheet; None where it can't be scored."""
    if OWN in scores.mean:
        return OWN
    return None if scores.mean_of(UNTUNED, measure) is None else UNTUNED


def _figures(
    scores: ScoresRecord, shown: Mapping[str, Measure], names: Mapping[str, str]
) -> tuple[Figure, ...]:
    figures: list[Figure] = []
    for name, measure in shown.items():
        tuned, rival = scores.mean_of("tuned", name), _rival(scores, name)
        if tuned is None:
            continue
        other = scores.mean_of(rival, name) if rival else None
        note = f"{names[rival]}: {other:.3g} {measure.unit}" if rival and other is not None else ""
        if spread := scores.drift_said(name):
            note = f"{spread}; {note}" if note else spread
        figures.append(Figure(measure.title, f"{tuned:.3g} {measure.unit}", note))
    known = [c for c in scores.consistency.values() if c]
    if known:
        nis = sum(c.mean_nis for c in known) / len(known)
        figures.append(
            Figure("mean NIS", f"{nis:.3g}", "2 where forecasts miss the fixes by as much as the filter says")
        )
    return tuple(figures)


def _comparison(
    scores: ScoresRecord, names: Mapping[str, str], shown: Mapping[str, Measure], outage_length: float
) -> Section:
    """Of what can be told: without truth there is neither a column of errors nor a row of raw GPS."""
    methods, told = scores.told(names, shown)
    columns = (
        Column("drive"),
        Column("method"),
        *(Column(shown[m].title, shown[m].unit) for m in told),
    )
    each = [
        (drive, names[m], *(found[m].get(t) for t in told))
        for drive, found in scores.drives.items()
        for m in methods
        if m in found
    ]
    mean = [("mean", names[m], *(scores.mean_of(m, t) for t in told)) for m in methods if m in scores.mean]
    tables = [_scores("Each drive", columns, each, names)]
    if len(scores.drives) > 1:
        tables.insert(0, _scores("Mean over drives", columns, mean, names))
    rmse = (
        " RMSE: root of the mean square error. Half of the position errors lie below the 50% column, 19 of 20 below "
        "the 95% column."
        if "position_rmse_m" in told
        else ""
    )
    outages = (
        " Each method is run again with the fixes hidden, by as many placements of the outages as the drive has room "
        "for, eight at most; a drift is the RMS over all of them, at the end of each."
        if scores.drifts
        else ""
    )
    if outages and "position_rmse_m" not in told:
        outages += " Without truth it is against the hidden fixes, and has their own errors in it."
    text = (
        f"Lower is better. Outages last {outage_length:g} s, and {LONG_OUTAGE_LENGTH:g} s.{outages}{rmse} IMU only "
        "takes no fix after the drive's start, so its drift is what has gathered since then.",
        *([f"{HOW_UNTUNED}."] if UNTUNED in scores.mean else []),
        *([] if OWN in scores.mean else [f"{HOW_AGAINST}."]),
    )
    if scores.drifts:
        tables.append(_drifts(scores, names, shown))
    return Section("Comparison", text, tuple(tables), method_bars(scores, names, shown))


def _drifts(scores: ScoresRecord, names: Mapping[str, str], shown: Mapping[str, Measure]) -> Table:
    """Each drift with the number of its outages, and the least and greatest that a single placement would say."""
    known = [m for m in shown if any(m in of for of in scores.drifts.values())]
    columns = [Column("drive"), Column("method")]
    for m in known:
        columns += [Column("outages"), Column(shown[m].title, "m"), Column("a single placement", "m")]
    rows: list[tuple[Cell, ...]] = []
    for drive, of in scores.drifts.items():
        for method, name in names.items():
            cells: list[Cell] = []
            for m in known:
                one = of.get(m)
                value = scores.drives[drive].get(method, {}).get(m)
                cells += [one and float(one.outages), value, one and one.spread(method)]
            if method != "raw_gps":
                rows.append((drive, name, *cells))
    return _scores("Drifts: how many outages, and what chance makes of them", tuple(columns), rows, names)


def _scores(
    caption: str, columns: tuple[Column, ...], rows: Sequence[tuple[Cell, ...]], names: Mapping[str, str]
) -> Table:
    strong = frozenset(i for i, row in enumerate(rows) if row[1] == names["tuned"])
    return Table(caption, columns, tuple(rows), strong)


def _swarm(drives: Sequence[Tracks]) -> tuple[Section, ...]:
    charts = tuple(chart for drive in drives for chart in swarm_charts(drive))
    text = (
        "Sixteen filters of one tuning, differently tuned, foretell each fix; how well they did in the last minute "
        "is what they count in the estimate. Every 10 s while the car drives, those that count least give way to "
        "what a search over the last minute finds. Where it moves far from its tuning, the vehicle, its sensors or "
        "its surroundings are not those that the filter was tuned for: one decade is a factor of ten in a variance.",
    )
    return (Section("The swarm", text, charts=charts),) if charts else ()


def _consistency(scores: ScoresRecord) -> Section:
    nees = any(
        c and c.mean_nees is not None for c in scores.consistency.values()
    )  # only where truth is known
    titles = ("drive", "fixes", "mean NIS", "consistent from", "to")
    columns = [*map(Column, titles), Column("inside 95% gate", "%"), *([Column("mean NEES")] if nees else [])]
    columns += [Column("correlation to the next fix"), Column("p of whiteness")]
    rows: list[tuple[Cell, ...]] = []
    for drive, c in scores.consistency.items():
        if c is None:
            rows.append((drive, *([None] * (len(columns) - 1))))
            continue
        inside = 100 * c.share_inside_95_gate
        known = (c.mean_nees,) if nees else ()
        rows.append(
            (drive, c.n_fixes, c.mean_nis, *c.nis_band_95, inside, *known, c.autocorrelation[0], c.white_p)
        )
    text = (
        f"Do the tuned filter's {'forecasts and errors' if nees else 'forecasts'} come out as its covariances say? "
        f"{'NIS (of forecasts of the fixes) and NEES (of errors) average' if nees else 'NIS averages'} 2 where they "
        f"do; above 2 it is too sure of itself, below too careful.{'' if nees else f' Beware: {FORECASTS}.'} "
        "Innovations of a consistent filter are white: no correlation from fix to fix. p is how often white ones would "
        "look as correlated as these (Ljung and Box's test over ten fixes). Where it is below 0.01, each error is "
        "partly that of the fix before, as of most real receivers, and averages out less than the filter believes.",
    )
    return Section("Consistency", text, (Table("", tuple(columns), tuple(rows)),))
