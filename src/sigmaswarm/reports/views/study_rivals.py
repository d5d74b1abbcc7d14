"""The rivals of a study: what each took and drifts, what it is worth elsewhere, and learning curves."""

from collections.abc import Mapping
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
    figures,
    paired_cells,
    paired_columns,
    study_table,
)
from sigmaswarm.tables import Cell, Column, Table

LENGTHS = {DRIFT: "5 s", **{measure: f"{length:g} s" for measure, length in LONG_OUTAGES.items()}}
"""Of the outages, by measure."""
LONG = "outage_drift_30_s_m"
AWAY = {
    POSITION: "position, m",
    HEADING: "heading, deg",
    DRIFT: "drift over 5 s, m",
    LONG: "drift over 30 s, m",
}
"""What is told of drives elsewhere, and of learning curves."""
EFFORT = (
    "Labelled: driving whose truth the tuning looked at. Learned: driving that a network learned from, without truth, "
    "beside its filter. Numbers: how many tuning and training set. Drifts with the 95% interval for new drives "
    "(bootstrap over drives and trials), of outages placed once in each drive; - where none of that length fits."
)
KEPT = "Not told: what a network leaves as it is, as positions while fixes come."
TIMES = (
    "Training in processor seconds a trial, a network's without its filter's; a sample: us of an IMU sample where the "
    "filter runs over a whole drive, from Python."
)


def rivals_tables(results: Results) -> dict[str, Table]:
    """The tables that are kept in files, by the files' names; none of a study without rivals."""
    if results.rivals is None:
        return {}
    places = dict.fromkeys(row.place for row in results.rivals.elsewhere)
    return {
        "rivals": rivals_table(results, {}),
        "rivals-gains": gains_table(results),
        **{f"elsewhere-{k}": elsewhere_table(results, place) for k, place in enumerate(places, 1)},
        "learning-curve": curve_table(results),
    }


def rivals_table(results: Results, times: Mapping[str, Mapping[str, float]]) -> Table:
    """What each tuned or trained method took, and its drift; with ``times``, which no two runs share, as well."""
    rivals = _rivals(results)
    columns = [
        Column("method"),
        *(figures(title, 0) for title in ("labelled, s", "learned, s", "numbers")),
    ]
    if times:
        columns += [figures("training, s", 1), figures("a sample, us", 2)]
    for length in LENGTHS.values():
        columns += [figures(f"drift over {length}, m"), figures("95%", joined=True)]
    rows: list[tuple[Cell, ...]] = []
    for effort in rivals.efforts:
        row: list[Cell] = [results.label(effort.method, effort.protocol)]
        row += [effort.labelled_s, effort.learned_s, effort.numbers]
        if times:
            own = times.get(f"{effort.protocol}-{effort.method}", {})
            row += [own.get("training_s"), own.get("sample_us")]
        for measure in LENGTHS:
            found = results.summary(effort.protocol, effort.method, measure)
            row += [found and found.mean, found and found.bootstrap_interval]
        rows.append(tuple(row))
    note = f"{EFFORT} {TIMES}" if times else f"{EFFORT} Times are in runtime-rivals.md."
    return study_table("Rivals: what they take, and their drift over outages", columns, rows, results, note)


def gains_table(results: Results) -> Table:
    """Each network against the filter that it stands beside, drive by drive."""
    columns = [Column("network"), Column("measure"), figures("difference"), *paired_columns("Wilcoxon p")]
    rows = [
        (results.label(c.method), results.measures[c.measure], *paired_cells(c))
        for c in _rivals(results).gains
    ]
    caption = f"Networks against {results.label(BESIDE, 'honest')} without them"
    return Table(caption, tuple(columns), tuple(rows), note=f"{PAIRED.format('network')} {KEPT}")


def elsewhere_table(results: Results, place: str) -> Table:
    """Every method of a study on drives that are not of its sensors or its car."""
    own = [row for row in _rivals(results).elsewhere if row.place == place]
    by = {(row.protocol, row.method, row.measure): row for row in own}
    columns = [Column("method")]
    for title in AWAY.values():
        columns += [figures(title), figures("95%", joined=True)]
    rows: list[tuple[Cell, ...]] = []
    for protocol, method in dict.fromkeys((row.protocol, row.method) for row in own):
        row: list[Cell] = [results.label(method, protocol)]
        for measure in AWAY:
            found = by.get((protocol, method, measure))
            row += [found and found.mean, found and found.bootstrap_interval]
        rows.append(tuple(row))
    drives = max((row.n_drives for row in own), default=0)
    note = (
        "The filters and networks of all trials, as they were tuned and trained at home; 95% intervals for new drives "
        f"(bootstrap over drives and trials). Drives: {drives}."
    )
    return study_table(f"Elsewhere: {place}", columns, rows, results, note)


def curve_table(results: Results) -> Table:
    """Errors over minutes that a network learned from."""
    columns = [Column("method"), Column("minutes", printed=lambda value: f"{value:.3g}")]
    for title in AWAY.values():
        columns += [figures(title), figures("95%", joined=True)]
    rows: list[tuple[Cell, ...]] = []
    for method, minutes in dict.fromkeys((p.method, p.minutes) for p in _rivals(results).curve):
        row: list[Cell] = [results.label(method), minutes]
        for measure in AWAY:
            point = next((p for p in _curve(results, method, measure) if p.minutes == minutes), None)
            row += [point and point.mean, point and point.interval]
        rows.append(tuple(row))
    note = (
        "Of the first trial, on the drives that it held back; 0 minutes: its filter alone. 95% intervals by bootstrap "
        "over drives, which says nothing of what another training would give."
    )
    return study_table("Learning curves", columns, rows, results, note)


def curve_charts(results: Results) -> tuple[Chart, ...]:
    """The same as lines, a chart a measure; none where nothing is known of one."""
    if results.rivals is None:
        return ()
    methods = dict.fromkeys(point.method for point in results.rivals.curve)
    charts: list[Chart] = []
    for measure in AWAY:
        marks = [mark for method in methods for mark in _course(results, method, measure)]
        if marks:
            x = Axis("minutes learned from; 0: the filter alone")
            y = Axis(range=(0.0, None))
            charts.append(Chart(results.measures[measure], tuple(marks), x, y, broad=True))
    return tuple(charts)


def _course(results: Results, method: str, measure: str) -> list[Mark]:
    """A network's means, and their intervals."""
    points = [p for p in _curve(results, method, measure) if p.mean is not None]
    if not points:
        return []
    x = [p.minutes for p in points]
    mean = [_number(p.mean) for p in points]
    low, high = ([_number(p.interval[end]) for p in points] for end in (0, 1))
    color = LOOKS[method].color
    line = Curve(x, mean, Look(color, 2.0, LOOKS[method].dash, "circle"), results.label(method))
    return [Band(x, low, high, Look(color, opacity=0.15)), line]


def _number(figure: float | None) -> float:
    """For a chart, which leaves a gap where it is infinite."""
    return inf if figure is None else figure


def _curve(results: Results, method: str, measure: str) -> list[CurvePoint]:
    return [p for p in _rivals(results).curve if (p.method, p.measure) == (method, measure) and p.n_drives]


def _rivals(results: Results) -> RivalResults:
    return results.rivals or RivalResults(efforts=[], gains=[], elsewhere=[], curve=[])
