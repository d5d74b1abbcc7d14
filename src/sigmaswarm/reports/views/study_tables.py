"""The tables of a study: the paper's next to ours, comparisons, conditions, and results of the search."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from statistics import median
from typing import Any

from sigmaswarm.experiments.study.config import ALL, MAIN, METHODS, UNTUNED
from sigmaswarm.experiments.study.record import (
    PairedComparison,
    Results,
    TrialTuning,
    Variant,
    VariantSummary,
)
from sigmaswarm.tables import Cell, Column, Table

POSITION, HEADING, DRIFT = "position_rmse_m", "heading_rmse_deg", "outage_drift_m"
ERRORS = {POSITION: "position RMSE against truth", HEADING: "heading error", DRIFT: "outage drift"}
ROWS = [
    (protocol, method, row.paper)
    for method, row in METHODS.items()
    for protocol in row.protocols or (UNTUNED,)
]
"""Protocol and method of each row of a study, and the paper's row next to it."""
LIVE_NAMES = {"EKF": "ekf", "adaptive UKF": "adaptive-ukf", "UKF": "ukf"}
"""The paper's rows of the timed filters."""
MANUAL = "ukf-datasheet"
"""The manually tuned filter of equation 5."""
NEW_DRIVES = "95% for new drives"
PAIRED = (
    "One value a drive, the mean over its trials, of drives on which neither failed; 95% "
    "intervals by bootstrap over drives; negative differences and positive improvements are in favor of the {}."
)
INTERVALS = (
    "The interval over trials (as in the paper) is the uncertainty by optimizer and split; it covers the mean of new "
    "drives only about half of the time. The other two are intervals for new drives: in a study of full size the "
    "bootstrap covers the mean 95% of the time (in small ones 85 to 95%), the corrected t as often or more; it is too "
    "wide where the optimizer varies much."
)
Row = tuple[Cell, ...]


def _decimals(digits: int, value: float) -> str:
    """Print a figure as the paper does: with decimals below 100 only."""
    return f"{value:.{digits}f}" if abs(value) < 100 else f"{value:,.0f}"


def figures(title: str, digits: int = 2, **more: Any) -> Column:
    """Make a column of figures, printed as in the paper."""
    return Column(title, printed=partial(_decimals, digits), **more)


def _digits(title: str, digits: int) -> Column:
    return Column(title, printed=lambda value: f"{value:.{digits}g}")


def with_intervals(titles: Iterable[str]) -> list[Column]:
    """Return a column of figures and one of their intervals for each title."""
    return [column for title in titles for column in (figures(title), figures("95%", joined=True))]


def mean_cells(found: VariantSummary | None) -> Row:
    """Return the cells of a mean and its interval for new drives."""
    return (found.mean, found.bootstrap_interval) if found else (None, None)


def study_table(
    caption: str, columns: Sequence[Column], rows: Sequence[Row], results: Results, note: str = ""
) -> Table:
    """Make a table whose rows of the main method are emphasized."""
    main = {results.label(MAIN, protocol) for protocol in results.protocols}
    strong = frozenset(i for i, row in enumerate(rows) if row[0] in main)
    return Table(caption, tuple(columns), tuple(rows), strong, note)


def study_tables(results: Results) -> dict[str, Table]:
    """Return all tables but those of run times, which differ between runs, by the names of their files."""
    return {
        "table-1": table_1(results),
        "table-2": table_2(results),
        "table-3": table_3(results),
        **{f"comparison-{p}": comparison_table(results, p, POSITION) for p in reversed(results.protocols)},
        "conditions-position-rmse": conditions_table(results, POSITION),
        "conditions-heading-rmse": conditions_table(results, HEADING),
        "conditions-outage-drift": conditions_table(results, DRIFT),
        "optimum": optimum_table(results, [MAIN]),
    }


def table_1(results: Results) -> Table:
    """Tabulate the paper's Table I: RMSE of IMU only, UKF and PSO-UKF, against the GPS and against truth."""
    paper = results.paper["table_1"]
    rows: list[Row] = []
    for protocol, method, paper_row in _rows(results):
        if paper_row not in paper and method != "raw-gps":
            continue
        theirs = paper.get(paper_row, {})
        copied, true = (mean_cells(results.summary(protocol, method, m)) for m in ("gps_rmse_m", POSITION))
        over = comparison(results, protocol, POSITION, MANUAL) if method == MAIN else None
        ours = (over.improvement, over.improvement_interval) if over else (None, None)
        said = (theirs.get("rmse_m"), copied[0], *true, theirs.get("improvement_percent"), *ours)
        rows.append((results.label(method, protocol), *said))
    columns = [Column("method"), figures("paper"), figures("ours, against the GPS (eq. 4)")]
    columns += with_intervals(["ours, against truth"])
    columns += [figures("improvement (eq. 5), %: paper"), *with_intervals(["ours"])]
    note = (
        "Mean over trials on held-out drives, with the 95% interval for new drives. The paper's RMSE is against the "
        f"GPS after the update. Ours of equation 5 is against truth, over {results.label(MANUAL)}."
    )
    return study_table("Table I. RMSE, m", columns, rows, results, note)


def table_2(results: Results) -> Table:
    """Tabulate the paper's Table II: RMSE with its spread over trials and three intervals."""
    titles = (
        "mean",
        "SD",
        "mean +- 1.96 SD / sqrt(n)",
        "for new drives: corrected t",
        "for new drives: bootstrap",
    )
    columns = [Column("method"), *with_intervals(["paper"]), *map(figures, titles)]
    rows: list[Row] = []
    for protocol, method, paper_row in _rows(results):
        found, theirs = (
            results.summary(protocol, method, POSITION),
            results.paper["table_2"].get(paper_row, {}),
        )
        if found is not None:
            low_high = theirs.get("interval_m")
            intervals = (found.trial_interval, found.corrected_t_interval, found.bootstrap_interval)
            said = (theirs.get("rmse_m"), low_high and tuple(low_high), found.mean, found.sd, *intervals)
            rows.append((results.label(method, protocol), *said))
    caption = "Table II. Position RMSE against truth, m, on held-out drives"
    return study_table(caption, columns, rows, results, INTERVALS)


def table_3(results: Results) -> Table:
    """Tabulate the paper's Table III without the run time."""
    columns = [Column("method")]
    for what in ("heading", "drift"):
        columns += [
            figures(f"{what}: paper"),
            figures(f"{what}: ours"),
            figures(NEW_DRIVES, joined=True),
        ]
    rows: list[Row] = []
    for protocol, method, paper_row in _rows(results):
        row: list[Cell] = [results.label(method, protocol)]
        for measure, key in ((HEADING, "heading_deg"), (DRIFT, "outage_drift_m")):
            found = results.summary(protocol, method, measure)
            theirs = results.paper["table_3"].get(paper_row, {}).get(key)
            row += [theirs, *mean_cells(found)]
        rows.append(tuple(row))
    caption = "Table III. Heading error, deg, and drift over a 5 s outage, m"
    note = (
        "In brackets the 95% interval for new drives (bootstrap over drives and trials). "
        "Run times are in a table of their own."
    )
    return study_table(caption, columns, rows, results, note)


def runtime_table(results: Results, live: Mapping[str, Mapping[str, float]]) -> Table:
    """Tabulate the last column of the paper's Table III: an update of the live filter."""
    rows = [
        (
            name,
            results.paper["table_3"].get(LIVE_NAMES.get(name), {}).get("update_ms"),
            times.get("predict_ms"),
            times.get("predict_and_update_ms"),
        )
        for name, times in live.items()
    ]
    ours = ("ours, an IMU sample", "ours, an IMU sample with a fix")
    columns = (Column("filter"), figures("paper"), *(figures(title, 4) for title in ours))
    note = (
        "Medians over one drive of the live filter, called from Python, on the machine that ran the study. Tuning does "
        "not change them. The paper's limit for real time is "
        f"{results.paper['real_time_limit_ms']:g} ms."
    )
    return Table("Table III, run time: ms per update", columns, tuple(rows), note=note)


def _rows(results: Results) -> list[tuple[str, str, str | None]]:
    """Return the rows of a study's methods."""
    return [row for row in ROWS if row[1] in results.methods]


def comparison(results: Results, protocol: str, measure: str, against: str) -> PairedComparison | None:
    """Return the comparison of the PSO-UKF of a protocol with another method, if the study has it."""
    wanted = (protocol, measure, against)
    return next((c for c in results.comparisons if (c.protocol, c.measure, c.against) == wanted), None)


def objectives_compared(results: Results) -> str:
    """Explain by the study's figures why the paper's objective misleads."""
    paper, honest = results.summary("paper", MAIN, POSITION), results.summary("honest", MAIN, POSITION)
    fixes, gps = results.summary(UNTUNED, "raw-gps", POSITION), results.summary("paper", MAIN, "gps_rmse_m")
    if None in (means := [found and found.mean for found in (gps, paper, fixes, honest)]):
        return ""
    return (
        "Why there are two objectives: the paper's compares the estimate with the GPS fix that the filter has just "
        "used, so the filter that copies the fixes wins. Its PSO-UKF is {:.2f} m from the fixes but {:.2f} m from the "
        "truth, where the fixes themselves are {:.2f} m from it; tuned against truth by the same swarm it has {:.2f} m."
    ).format(*means)


def consistency_table(results: Results) -> Table:
    """Tabulate the mean NIS of every filter."""
    titles = ("method", "mean NIS", "SD over trials", NEW_DRIVES)
    rows = [
        (results.label(r.method, r.protocol), r.mean, r.sd, r.bootstrap_interval)
        for r in results.means("nis")
    ]
    return study_table("", list(map(Column, titles)), rows, results)


def comparison_table(results: Results, protocol: str, measure: str) -> Table:
    """Compare the PSO-UKF of a protocol with every other method, drive by drive."""
    unit = "deg" if measure == HEADING else "m"
    columns = (Column("against"), *paired_columns(f"difference, {unit}", "Wilcoxon p (Holm)"))
    rows = tuple(
        (results.label(c.against), *paired_cells(c))
        for c in results.comparisons
        if (c.protocol, c.measure) == (protocol, measure)
    )
    caption = (
        f"{results.label(MAIN)} under the protocol {protocol} against each other method: {ERRORS[measure]}"
    )
    return Table(caption, columns, rows, note=PAIRED.format("PSO-UKF"))


def paired_columns(difference: str, p: str) -> list[Column]:
    """Make the columns of `paired_cells`."""
    intervals = with_intervals([difference, "improvement (eq. 5), %"])
    return [*intervals, _digits(p, 2), figures("rank-biserial"), figures("drives", 0)]


def paired_cells(c: PairedComparison) -> Row:
    """Return the cells of a paired comparison."""
    improvement = (c.improvement, c.improvement_interval)
    return (c.mean_difference, c.interval, *improvement, c.holm_p, c.rank_biserial, c.n_drives)


def conditions_table(results: Results, measure: str, variants: Sequence[Variant] = ()) -> Table:
    """Tabulate a measure in each condition, of all variants or of some."""
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
    columns = [
        Column("condition"),
        *(figures(results.label(method, protocol)) for protocol, method in shown),
    ]
    return Table(f"{results.measures[measure]}, in each condition", tuple(columns), tuple(rows))


def _kinds(results: Results) -> dict[tuple[str, str, str], list[TrialTuning]]:
    """Group the trials by protocol, method and group."""
    kinds: dict[tuple[str, str, str], list[TrialTuning]] = {}
    for tuned in results.tunings:
        kinds.setdefault((tuned.protocol, tuned.method, tuned.group), []).append(tuned)
    return kinds


def _by_group(
    caption: str, columns: Sequence[Column], rows: Sequence[tuple[Cell, ...]], results: Results
) -> Table:
    """Omit the second column, the group of drives, where there is only one group."""
    if all(row[1] in (ALL, "") for row in rows):
        columns, rows = [columns[0], *columns[2:]], [(row[0], *row[2:]) for row in rows]
    return study_table(caption, columns, rows, results)


def convergence_table(results: Results) -> Table:
    """Tabulate the generation at which the median over trials settles."""
    columns = [
        *map(Column, ("method", "drives", "settles at generation")),
        Column("median cost at the end", "m"),
    ]
    rows = [
        (results.label(c.method, c.protocol), c.group, c.stable, c.median[-1]) for c in results.convergence
    ]
    return _by_group("", columns, rows, results)


def trials_table(results: Results) -> Table:
    """Tabulate the costs of the trials and the bounds that they touch."""
    costs = ("lowest cost", "median cost", "highest cost")
    columns = [*map(Column, ("method", "drives", "trials")), *(Column(title, "m") for title in costs)]
    columns += map(Column, ("evaluations", "failures", "bounds touched, in how many trials"))
    rows: list[Row] = []
    for (protocol, method, group), own in _kinds(results).items():
        each = [t.cost for t in own]
        touched = Counter(bound.parameter for t in own for bound in t.touched_bounds)
        said = ", ".join(f"{name} {n}" for name, n in touched.most_common()) or "none"
        sums = (sum(t.evaluations for t in own), sum(t.failures for t in own))
        figures = (len(own), min(each), median(each), max(each), *sums, said)
        rows.append((results.label(method, protocol), group, *figures))
    return _by_group("All trials, on their training drives", columns, rows, results)


def optimum_table(results: Results, methods: Sequence[str] = ()) -> Table:
    """Tabulate the parameters of the best trial of each tuning, or of some methods, and the paper's."""
    o: dict[str, Any] = results.paper["table_1"]["optimum"]
    figures = (o["alpha"], o["beta"], o["kappa"])
    rows: list[Row] = [("paper", "", *figures, f"{o['q']:g}", f"{o['r']:g}", None)]
    for (protocol, method, group), own in _kinds(results).items():
        if methods and method not in methods:
            continue
        best = min(own, key=lambda t: t.cost)
        p = best.parameters
        q, r = (" ".join(f"{v:.2g}" for v in p[key]) for key in ("process_noise", "measurement_noise"))
        rows.append(
            (results.label(method, protocol), group, p["alpha"], p["beta"], p["kappa"], q, r, best.cost)
        )
    columns = [*map(Column, ("method", "drives")), *(_digits(name, 2) for name in ("alpha", "beta", "kappa"))]
    columns += [Column("Q per step: x, y, vx, vy, theta, then biases"), Column("R"), _digits("cost, m", 3)]
    return _by_group("What the PSO found, best trial", columns, rows, results)
