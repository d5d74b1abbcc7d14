"""The rivals of a study: data, processor times and drift of each, scores elsewhere, and learning curves."""

from collections.abc import Mapping, Sequence
from math import inf

from sigmaswarm.experiments.study.config import BESIDE, LONG_OUTAGES
from sigmaswarm.experiments.study.record import CurvePoint, Results, RivalResults
from sigmaswarm.reports.style import LOOKS
from sigmaswarm.reports.views.charts import Axis, Band, Chart, Curve, Look, Mark
from sigmaswarm.reports.views.study_tables import (
    DRIFT,
    HEADING,
    PAIRED,
    POSITION,
    Row,
    figures,
    mean_cells,
    paired_cells,
    paired_columns,
    study_table,
    with_intervals,
)
from sigmaswarm.tables import Cell, Column, Table

LENGTHS = {DRIFT: "5 s", **{measure: f"{length:g} s" for measure, length in LONG_OUTAGES.items()}}
"""Lengths of the outages, by measure."""
LONG = "outage_drift_30_s_m"
AWAY = {
    POSITION: "position, m",
    HEADING: "heading, deg",
    DRIFT: "drift over 5 s, m",
    LONG: "drift over 30 s, m",
}
"""The measures of drives elsewhere and of learning curves."""
EFFORT = (
    "Labelled: driving with truth that the tuning used. Learned: driving that a network learned from, without truth. "
    "Numbers: free numbers of tuning and training. Drifts with the 95% interval for new drives (bootstrap over drives "
    "and trials), of outages placed once in each drive; - where no drive has room for one."
)
KEPT = "Measures that a network does not change, as positions with fixes, are omitted."
TIMES = (
    "Training: processor time of a trial, a network's without its filter's. A sample: processor time of an IMU sample "
    "when the filter runs over a whole drive, called from Python."
)


def rivals_tables(
    results: Results, times: Mapping[str, Mapping[str, float]] | None = None
) -> dict[str, Table]:
    """Return the tables of a study with rivals, by the names of their files."""
    if results.rivals is None:
        return {}
    places = dict.fromkeys(row.place for row in results.rivals.elsewhere)
    return {
        "rivals": rivals_table(results, times or {}),
        "rivals-gains": _gains_table(results, results.rivals),
        **{f"elsewhere-{k}": _elsewhere_table(results, place) for k, place in enumerate(places, 1)},
        "learning-curve": _curve_table(results, results.rivals),
    }


def rivals_table(results: Results, times: Mapping[str, Mapping[str, float]]) -> Table:
    """Tabulate data, free numbers and drift of each tuned or trained method, and processor ``times`` if given."""
    columns = [Column("method"), *(figures(title, 0) for title in ("labelled, s", "learned, s", "numbers"))]
    if times:
        columns += [figures("training, s", 1), figures("a sample, us", 2)]
    columns += with_intervals(f"drift over {length}, m" for length in LENGTHS.values())
    rows: list[Row] = []
    for effort in results.rivals.efforts if results.rivals else ():
        variant = (effort.protocol, effort.method)
        took = times.get("-".join(variant), {})
        row = [
            results.label(effort.method, effort.protocol),
            effort.labelled_s,
            effort.learned_s,
            effort.numbers,
        ]
        row += [took.get("training_s"), took.get("sample_us")] if times else []
        rows.append((*row, *(cell for m in LENGTHS for cell in mean_cells(results.summary(*variant, m)))))
    note = f"{EFFORT} {TIMES}" if times else f"{EFFORT} Times are in runtime-rivals.md."
    return study_table("Rivals: data, numbers, and drift over outages", columns, rows, results, note)


def _gains_table(results: Results, rivals: RivalResults) -> Table:
    """Tabulate each network against the filter that it helps, drive by drive."""
    columns = [Column("network"), Column("measure"), *paired_columns("difference", "Wilcoxon p")]
    rows = [(results.label(c.method), results.measures[c.measure], *paired_cells(c)) for c in rivals.gains]
    caption = f"Networks against {results.label(BESIDE, 'honest')} without them"
    return Table(caption, tuple(columns), tuple(rows), note=f"{PAIRED.format('network')} {KEPT}")


def _elsewhere_table(results: Results, place: str) -> Table:
    """Tabulate every method on drives of other sensors or of another car."""
    own = [row for row in results.rivals.elsewhere if row.place == place] if results.rivals else []
    by = {(row.protocol, row.method, row.measure): row for row in own}
    columns = [Column("method"), *with_intervals(AWAY.values())]
    rows = [
        (
            results.label(method, protocol),
            *(cell for m in AWAY for cell in mean_cells(by.get((protocol, method, m)))),
        )
        for protocol, method in dict.fromkeys((row.protocol, row.method) for row in own)
    ]
    drives = max((row.n_drives for row in own), default=0)
    note = (
        "The filters and networks of all trials, tuned and trained on the study's own drives; 95% intervals for new "
        f"drives (bootstrap over drives and trials). Drives: {drives}."
    )
    return study_table(f"Elsewhere: {place}", columns, rows, results, note)


def curve_points(rivals: RivalResults, method: str, measure: str) -> list[CurvePoint]:
    """Return the known points of a learning curve."""
    return [p for p in rivals.curve if (p.method, p.measure) == (method, measure) and p.n_drives]


def _curve_table(results: Results, rivals: RivalResults) -> Table:
    """Tabulate errors over the minutes that a network learned from."""
    columns = [Column("method"), Column("minutes", printed=lambda value: f"{value:.3g}")]
    columns += with_intervals(AWAY.values())
    rows: list[Row] = []
    for method, minutes in dict.fromkeys((p.method, p.minutes) for p in rivals.curve):
        row: list[Cell] = [results.label(method), minutes]
        for measure in AWAY:
            point = next((p for p in curve_points(rivals, method, measure) if p.minutes == minutes), None)
            row += [point.mean, point.interval] if point else [None, None]
        rows.append(tuple(row))
    note = (
        "Of the first trial, on its held-out drives; 0 minutes: the filter alone. 95% intervals by bootstrap over "
        "drives; they do not include the variation between trainings."
    )
    return study_table("Learning curves", columns, rows, results, note)


def curve_charts(results: Results) -> tuple[Chart, ...]:
    """Draw the learning curves, a chart for each measure with values."""
    rivals = results.rivals
    if rivals is None:
        return ()
    methods = dict.fromkeys(point.method for point in rivals.curve)
    charts: list[Chart] = []
    for measure in AWAY:
        marks = [
            mark
            for method in methods
            for mark in _learning_curve(results, curve_points(rivals, method, measure))
        ]
        if marks:
            x = Axis("minutes learned from; 0: the filter alone")
            y = Axis(range=(0.0, None))
            charts.append(Chart(results.measures[measure], tuple(marks), x, y, broad=True))
    return tuple(charts)


def _learning_curve(results: Results, points: Sequence[CurvePoint]) -> list[Mark]:
    """Draw the means of a network's learning curve, and their intervals; a gap where one is infinite."""
    points = [p for p in points if p.mean is not None]
    if not points:
        return []
    x, method = [p.minutes for p in points], points[0].method
    mean, low, high = (
        [inf if value is None else value for value in values]
        for values in zip(*((p.mean, *p.interval) for p in points), strict=True)
    )
    look = LOOKS[method]
    line = Curve(x, mean, Look(look.color, 2.0, look.dash, "circle"), results.label(method))
    return [Band(x, low, high, Look(look.color, opacity=0.15)), line]
