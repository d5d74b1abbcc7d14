"""Tables of a study: its results next to those of the paper, comparisons, conditions, search results and rivals."""

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import chain
from statistics import median
from typing import Any

from sigmaswarm.experiments.study.config import (
    ALL,
    LONG_OUTAGES,
    MAIN_METHOD,
    METHODS,
    NETWORK_FILTER,
    NO_PROTOCOL,
)
from sigmaswarm.experiments.study.record import (
    CurvePoint,
    PairedComparison,
    Results,
    RivalResults,
    Times,
    TrialTuning,
    Variant,
    VariantSummary,
)
from sigmaswarm.tables import Cell, Column, Table

POSITION, HEADING, DRIFT = "position_rmse_m", "heading_rmse_deg", "outage_drift_m"
ERRORS = {POSITION: "position RMSE against truth", HEADING: "heading error", DRIFT: "outage drift"}
# Protocol, method and the corresponding row of the paper, for each row of a table.
ROWS = [
    (p, name, method.paper) for name, method in METHODS.items() for p in method.protocols or (NO_PROTOCOL,)
]
LIVE_NAMES = {"EKF": "ekf", "adaptive UKF": "adaptive-ukf", "UKF": "ukf"}
MANUAL_METHOD = "ukf-datasheet"  # manually tuned filter of equation 5
OUTAGE_LENGTHS = {DRIFT: "5 s", **{measure: f"{length:g} s" for measure, length in LONG_OUTAGES.items()}}
ELSEWHERE_MEASURES = {
    POSITION: "position, m",
    HEADING: "heading, deg",
    DRIFT: "drift over 5 s, m",
    "outage_drift_30_s_m": "drift over 30 s, m",
}
NEW_DRIVES = "95% for new drives"
PAIRED_NOTE = (
    "Each drive has one value, the mean over its trials. Drives on which one of the two methods failed are left out. "
    "95% intervals: bootstrap over drives. Negative differences and positive improvements favor the {}."
)
INTERVALS_NOTE = (
    "The interval over trials (as in the paper) shows only the variation from the optimizer and the random split of "
    "the drives. It contains the mean over new drives in only 45 to 91% of simulated studies. The other two intervals "
    "are for new drives. The bootstrap interval contains this mean in 94 to 95% of full studies, and in 85 to 95% of "
    "small studies. The interval of the corrected t-test contains this mean at least as often as the bootstrap "
    "interval; if the results of the optimizer vary widely, the interval of the t-test is too wide."
)
EFFORT_NOTE = (
    "Labeled: driving time with truth, for tuning. Learned: driving time without truth, for training a "
    "network. Numbers: number of free parameters of tuning and training. Drifts: mean over drives of the RMS over the "
    "outages, with the 95% interval for new drives (bootstrap over drives and trials); -: no drive is long enough."
)
TIMES_NOTE = (
    "Training: mean processor time of a trial (for a network, excluding the tuning of its filter). Per sample: "
    "processor time of a run over a whole drive, called from Python, divided by the number of IMU samples."
)
Row = tuple[Cell, ...]


def _figures(title: str, digits: int = 2, **more: Any) -> Column:
    """Make a column of numbers in the format of the paper. Numbers of 100 or more have no decimals."""

    def printed(value: float) -> str:
        return f"{value:.{digits}f}" if abs(value) < 100 else f"{value:,.0f}"

    return Column(title, printed=printed, **more)


def _digits(title: str, digits: int) -> Column:
    return Column(title, printed=lambda value: f"{value:.{digits}g}")


def _with_intervals(titles: Iterable[str], interval: str = "95%") -> list[Column]:
    return [column for title in titles for column in (_figures(title), _figures(interval, joined=True))]


def _mean_cells(summary: VariantSummary | None) -> Row:
    return (summary.mean, summary.bootstrap_interval) if summary else (None, None)


def _table(
    caption: str, columns: Sequence[Column], rows: Sequence[Row], results: Results, note: str = ""
) -> Table:
    """Make a table that emphasizes the rows of the main method."""
    main = {results.label(MAIN_METHOD, protocol) for protocol in results.protocols}
    strong = frozenset(i for i, row in enumerate(rows) if row[0] in main)
    return Table(caption, tuple(columns), tuple(rows), strong, note)


# Beginnings of the names of tables that `sigmaswarm study` writes to files but does not print.
FILE_ONLY_TABLES = ("comparison-", "conditions-", "trials")


def study_tables(results: Results) -> dict[str, Table]:
    """Return all tables of a study except the run times, which differ between runs.

    Parameters
    ----------
    results : Results
        ``study.results``.

    Returns
    -------
    dict of str to Table
        ``table-1`` to ``table-3`` (with the numbers of the paper), ``comparison-honest`` and ``comparison-paper``,
        three tables ``conditions-...``, ``optimum``, and ``trials``. With rivals also ``rivals``, ``rivals-gains``,
        ``elsewhere-1`` and so on, and ``learning-curve``. Each table has to_markdown(), to_latex() and to_csv();
        notebooks display it.
    """
    return {
        "table-1": table_1(results),
        "table-2": table_2(results),
        "table-3": table_3(results),
        **{f"comparison-{p}": comparison_table(results, p, POSITION) for p in reversed(results.protocols)},
        "conditions-position-rmse": conditions_table(results, POSITION),
        "conditions-heading-rmse": conditions_table(results, HEADING),
        "conditions-outage-drift": conditions_table(results, DRIFT),
        "optimum": optimum_table(results, [MAIN_METHOD]),
        "trials": trials_table(results),
        **rivals_tables(results),
    }


def _rows(results: Results) -> list[tuple[str, str, str | None]]:
    return [row for row in ROWS if row[1] in results.methods]


def table_1(results: Results) -> Table:
    """Tabulate the paper's Table I: RMSE of IMU only, raw GPS, UKF and PSO-UKF, relative to GPS and truth."""
    paper = results.paper["table_1"]
    rows: list[Row] = []
    for protocol, method, paper_row in _rows(results):
        if paper_row not in paper and method != "raw-gps":
            continue
        theirs = paper.get(paper_row, {})
        copied, true = (_mean_cells(results.summary(protocol, method, m)) for m in ("gps_rmse_m", POSITION))
        over = comparison(results, protocol, POSITION, MANUAL_METHOD) if method == MAIN_METHOD else None
        own = (over.improvement, over.improvement_interval) if over else (None, None)
        stated = (theirs.get("rmse_m"), copied[0], *true, theirs.get("improvement_percent"), *own)
        rows.append((results.label(method, protocol), *stated))
    columns = [Column("method"), _figures("paper"), _figures("ours, against the GPS (eq. 4)")]
    columns += _with_intervals(["ours, against truth"])
    columns += [_figures("improvement (eq. 5), %: paper"), *_with_intervals(["ours"])]
    note = (
        "Mean over trials on held-out drives, with the 95% interval for new drives. The paper's RMSE compares "
        "the updated estimates with the GPS. Our improvement (equation 5) is computed from the errors against "
        f'truth, relative to the method "{results.label(MANUAL_METHOD)}".'
    )
    return _table("Table I. RMSE, m", columns, rows, results, note)


def table_2(results: Results) -> Table:
    """Tabulate the paper's Table II: RMSE with its SD over trials and three confidence intervals."""
    new = "for new drives:"
    titles = ("mean", "SD", "mean +- 1.96 SD / sqrt(n)", f"{new} corrected t", f"{new} bootstrap")
    columns = [Column("method"), *_with_intervals(["paper"]), *map(_figures, titles)]
    rows: list[Row] = []
    for protocol, method, paper_row in _rows(results):
        theirs = results.paper["table_2"].get(paper_row, {})
        if summary := results.summary(protocol, method, POSITION):
            low_high = theirs.get("interval_m")
            paper = theirs.get("rmse_m"), low_high and tuple(low_high)
            intervals = (summary.trial_interval, summary.corrected_t_interval, summary.bootstrap_interval)
            rows.append((results.label(method, protocol), *paper, summary.mean, summary.sd, *intervals))
    caption = "Table II. Position RMSE against truth, m, on held-out drives"
    return _table(caption, columns, rows, results, INTERVALS_NOTE)


def table_3(results: Results) -> Table:
    """Tabulate the paper's Table III without the run time."""
    columns = [Column("method")]
    for what in ("heading", "drift"):
        columns += [_figures(f"{what}: paper"), *_with_intervals([f"{what}: ours"], NEW_DRIVES)]
    rows: list[Row] = []
    for protocol, method, paper_row in _rows(results):
        row: list[Cell] = [results.label(method, protocol)]
        for measure, key in ((HEADING, "heading_deg"), (DRIFT, "outage_drift_m")):
            theirs = results.paper["table_3"].get(paper_row, {}).get(key)
            row += [theirs, *_mean_cells(results.summary(protocol, method, measure))]
        rows.append(tuple(row))
    caption = "Table III. Heading error, deg, and drift over a 5 s outage, m"
    note = (
        "In brackets: 95% interval for new drives (bootstrap over drives and trials). "
        "Another table lists the run times."
    )
    return _table(caption, columns, rows, results, note)


def runtime_table(results: Results, live: Times) -> Table:
    """Tabulate processing times of the live filters: the last column of the paper's Table III."""
    paper = results.paper["table_3"]
    rows: list[Row] = []
    for name, times in live.items():
        theirs = paper.get(LIVE_NAMES.get(name), {}).get("update_ms")
        row: list[Cell] = [name, theirs]
        for call in ("predict", "predict_and_update"):
            low, high = times.get(f"{call}_low_ms"), times.get(f"{call}_high_ms")  # since 0.4.0
            row += [times.get(f"{call}_ms"), None if low is None or high is None else (low, high)]
        rows.append(tuple(row))
    columns = [Column("filter"), _figures("paper")]
    for title in ("ours, per IMU sample", "ours, per IMU sample with a fix"):
        columns += [_figures(title, 4), _figures("95% of the calls", 4, joined=True)]
    note = (
        "Median times of calls of the live filter from Python, measured over one drive on the machine that ran the "
        "study. In brackets: range of 95% of the calls. Tuning does not change these times. The paper's limit for "
        f"real time is {results.paper['real_time_limit_ms']:g} ms."
    )
    return Table("Table III, run time: ms per update", tuple(columns), tuple(rows), note=note)


def comparison(results: Results, protocol: str, measure: str, against: str) -> PairedComparison | None:
    wanted = (protocol, measure, against)
    return next((c for c in results.comparisons if (c.protocol, c.measure, c.against) == wanted), None)


def objectives_compared(results: Results) -> str:
    summaries = (
        results.summary("paper", MAIN_METHOD, "gps_rmse_m"),
        results.summary("paper", MAIN_METHOD, POSITION),
        results.summary(NO_PROTOCOL, "raw-gps", POSITION),
        results.summary("honest", MAIN_METHOD, POSITION),
    )
    if None in (means := [each and each.mean for each in summaries]):
        return ""
    return (
        "The study has two objectives, since the paper's objective compares the estimate with the GPS fix that the "
        "filter has just used: a filter that copies the fixes has the lowest cost. Tuned for the paper's objective, "
        "the PSO-UKF has an RMSE of {:.2f} m relative to the fixes, but of {:.2f} m relative to the truth. The RMSE of "
        "the fixes is {:.2f} m. Tuned with truth by the same optimizer, the PSO-UKF has an RMSE of {:.2f} m relative "
        "to the truth."
    ).format(*means)


def consistency_table(results: Results) -> Table:
    nis = results.means("nis")
    rows = [(results.label(r.method, r.protocol), r.mean, r.sd, r.bootstrap_interval) for r in nis]
    titles = ("method", "mean NIS", "SD over trials", NEW_DRIVES)
    return _table("", list(map(Column, titles)), rows, results)


def comparison_table(results: Results, protocol: str, measure: str) -> Table:
    unit = "deg" if measure == HEADING else "m"
    columns = (Column("against"), *_paired_columns(f"difference, {unit}", "Wilcoxon p (Holm)"))
    rows = tuple(
        (results.label(c.against), *_paired_cells(c))
        for c in results.comparisons
        if (c.protocol, c.measure) == (protocol, measure)
    )
    methods = f"{results.label(MAIN_METHOD)} under the protocol {protocol}, compared with every other method"
    caption = f"{methods}: {ERRORS[measure]}"
    return Table(caption, columns, rows, note=PAIRED_NOTE.format("PSO-UKF"))


def _paired_columns(difference: str, p: str) -> list[Column]:
    intervals = _with_intervals([difference, "improvement (eq. 5), %"])
    return [*intervals, _digits(p, 2), _figures("rank-biserial"), _figures("drives", 0)]


def _paired_cells(c: PairedComparison) -> Row:
    improvement = (c.improvement, c.improvement_interval)
    return (c.mean_difference, c.interval, *improvement, c.holm_p, c.rank_biserial, c.n_drives)


def conditions_table(results: Results, measure: str, variants: Sequence[Variant] = ()) -> Table:
    found = {
        (r.maneuver, r.environment, r.protocol, r.method): r.mean
        for r in results.summaries
        if r.measure == measure
    }
    shown = [v for v in variants or [row[:2] for row in ROWS] if (ALL, ALL, *v) in found]
    rows = [
        (ALL if place == (ALL, ALL) else " ".join(place), *(found.get((*place, *v)) for v in shown))
        for place in dict.fromkeys((r.maneuver, r.environment) for r in results.summaries)
    ]
    columns = Column("condition"), *(_figures(results.label(m, protocol)) for protocol, m in shown)
    return Table(f"{results.measures[measure]}, in each condition", columns, tuple(rows))


def _trials(results: Results) -> dict[tuple[str, str, str], list[TrialTuning]]:
    trials: dict[tuple[str, str, str], list[TrialTuning]] = {}
    for tuned in results.tunings:
        trials.setdefault((tuned.protocol, tuned.method, tuned.group), []).append(tuned)
    return trials


def _by_group(caption: str, columns: Sequence[Column], rows: Sequence[Row], results: Results) -> Table:
    if all(row[1] in (ALL, "") for row in rows):
        columns, rows = [columns[0], *columns[2:]], [(row[0], *row[2:]) for row in rows]
    return _table(caption, columns, rows, results)


def convergence_table(results: Results) -> Table:
    """Tabulate the generation from which the median cost over trials stays within 1% of the last median."""
    columns = [Column("method"), Column("drives"), Column("settles at generation")]
    courses = results.convergence
    rows = [(results.label(c.method, c.protocol), c.group, c.stable, c.median[-1]) for c in courses]
    return _by_group("", [*columns, Column("median cost at the end", "m")], rows, results)


def trials_table(results: Results) -> Table:
    costs = ("lowest cost", "median cost", "highest cost")
    columns = [*map(Column, ("method", "drives", "trials")), *(Column(title, "m") for title in costs)]
    columns += map(Column, ("evaluations", "failures", "touched bounds, number of trials"))
    rows: list[Row] = []
    for (protocol, method, group), own in _trials(results).items():
        each = [t.cost for t in own]
        touched = Counter(bound.parameter for t in own for bound in t.touched_bounds)
        counts = ", ".join(f"{name} {n}" for name, n in touched.most_common()) or "none"
        sums = (sum(t.evaluations for t in own), sum(t.failures for t in own))
        numbers = (len(own), min(each), median(each), max(each), *sums, counts)
        rows.append((results.label(method, protocol), group, *numbers))
    return _by_group("All trials, on their training drives", columns, rows, results)


def optimum_table(results: Results, methods: Sequence[str] = ()) -> Table:
    sigma = ("alpha", "beta", "kappa")
    o: dict[str, Any] = results.paper["table_1"]["optimum"]
    rows: list[Row] = [("paper", "", *(o[key] for key in sigma), f"{o['q']:g}", f"{o['r']:g}", None)]
    for (protocol, method, group), own in _trials(results).items():
        if not methods or method in methods:
            best = min(own, key=lambda t: t.cost)
            p = best.parameters
            q, r = (" ".join(f"{v:.2g}" for v in p[key]) for key in ("process_noise", "measurement_noise"))
            scaling = (p[key] for key in sigma)
            rows.append((results.label(method, protocol), group, *scaling, q, r, best.cost))
    columns = [Column("method"), Column("drives"), *(_digits(name, 2) for name in sigma)]
    columns += [Column("Q per step: x, y, vx, vy, theta, then biases"), Column("R"), _digits("cost, m", 3)]
    return _by_group("Parameters of the best trial", columns, rows, results)


def rivals_tables(results: Results, times: Times | None = None) -> dict[str, Table]:
    if results.rivals is None:
        return {}
    places = dict.fromkeys(row.place for row in results.rivals.elsewhere)
    return {
        "rivals": rivals_table(results, times or {}),
        "rivals-gains": _gains_table(results, results.rivals),
        **{
            f"elsewhere-{k}": _elsewhere_table(results, results.rivals, place)
            for k, place in enumerate(places, 1)
        },
        "learning-curve": _curve_table(results, results.rivals),
    }


def rivals_table(results: Results, times: Times) -> Table:
    """Tabulate training data, number of free parameters, drift and processor ``times`` of tuned and trained methods."""
    columns = [Column("method"), *(_figures(title, 0) for title in ("labeled, s", "learned, s", "numbers"))]
    columns += [_figures("training, s", 1), _figures("per sample, us", 2)] if times else []
    columns += _with_intervals(f"drift over {length}, m" for length in OUTAGE_LENGTHS.values())
    rows: list[Row] = []
    for e in results.rivals.efforts if results.rivals else ():
        took = times.get(f"{e.protocol}-{e.method}", {})
        row = [results.label(e.method, e.protocol), e.labelled_s, e.learned_s, e.numbers]
        row += [took.get("training_s"), took.get("sample_us")] if times else []
        drifts = (_mean_cells(results.summary(e.protocol, e.method, m)) for m in OUTAGE_LENGTHS)
        rows.append((*row, *chain(*drifts)))
    note = f"{EFFORT_NOTE} {TIMES_NOTE if times else 'Times are in runtime-rivals.md.'}"
    return _table("Rivals: training data, parameters, and drift over outages", columns, rows, results, note)


def _gains_table(results: Results, rivals: RivalResults) -> Table:
    columns = (Column("network"), Column("measure"), *_paired_columns("difference", "Wilcoxon p"))
    gains = rivals.gains
    rows = tuple((results.label(c.method), results.measures[c.measure], *_paired_cells(c)) for c in gains)
    caption = f"Networks compared with {results.label(NETWORK_FILTER, 'honest')} without a network"
    kept = (
        "Measures that a network does not change are omitted, such as the position error while fixes arrive"
    )
    return Table(caption, columns, rows, note=f"{PAIRED_NOTE.format('network')} {kept}.")


def _elsewhere_table(results: Results, rivals: RivalResults, place: str) -> Table:
    there = [row for row in rivals.elsewhere if row.place == place]
    by_method = {(row.protocol, row.method, row.measure): row for row in there}
    rows: list[Row] = []
    for protocol, method in dict.fromkeys((row.protocol, row.method) for row in there):
        cells = (_mean_cells(by_method.get((protocol, method, m))) for m in ELSEWHERE_MEASURES)
        rows.append((results.label(method, protocol), *chain(*cells)))
    note = (
        "The filters and networks of all trials were tuned and trained on the drives of the study. 95% intervals "
        "for new drives: bootstrap over drives and trials. Number of drives: "
        f"{max(row.n_drives for row in there)}."
    )
    columns = [Column("method"), *_with_intervals(ELSEWHERE_MEASURES.values())]
    return _table(f"Other drives: {place}", columns, rows, results, note)


def curve_points(rivals: RivalResults, method: str, measure: str) -> list[CurvePoint]:
    return [p for p in rivals.curve if (p.method, p.measure) == (method, measure) and p.n_drives]


def _curve_table(results: Results, rivals: RivalResults) -> Table:
    columns = [Column("method"), _digits("minutes", 3), *_with_intervals(ELSEWHERE_MEASURES.values())]
    rows: list[Row] = []
    for method, minutes in dict.fromkeys((p.method, p.minutes) for p in rivals.curve):
        row: list[Cell] = [results.label(method), minutes]
        for measure in ELSEWHERE_MEASURES:
            point = next((p for p in curve_points(rivals, method, measure) if p.minutes == minutes), None)
            row += [point.mean, point.interval] if point else [None, None]
        rows.append(tuple(row))
    note = (
        "Results of the first trial on its held-out drives. Rows with 0 minutes: the filter without a network. The 95% "
        "intervals are computed by bootstrap over drives, and do not contain the variation between training runs."
    )
    return _table("Learning curves", columns, rows, results, note)
