"""The tables of a study: the paper's with ours beside, comparisons, conditions, and what the search found."""

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from statistics import median
from typing import Any

from sigmaswarm.experiments.study.config import ALL, MAIN, NETWORKS, SEARCHED_RIVALS, TUNED_METHODS, UNTUNED
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
ROWS: tuple[tuple[str, str, str | None], ...] = (
    (UNTUNED, "imu-only", "imu-only"),
    (UNTUNED, "raw-gps", None),
    (UNTUNED, "ekf-defaults", "ekf"),
    (UNTUNED, "ekf-datasheet", "ekf"),
    (UNTUNED, "adaptive-ukf-defaults", "adaptive-ukf"),
    (UNTUNED, "adaptive-ukf-datasheet", "adaptive-ukf"),
    (UNTUNED, "ukf-defaults", "ukf"),
    (UNTUNED, "ukf-datasheet", "ukf"),
    (UNTUNED, "ukf-paper", None),
    ("paper", MAIN, MAIN),
    ("honest", MAIN, MAIN),
    *(("honest", method, None) for method in (*TUNED_METHODS, *SEARCHED_RIVALS, *NETWORKS) if method != MAIN),
)
"""Protocol and method of each row that a study may have, and which of the paper's rows it stands beside."""
LIVE_NAMES = {"EKF": "ekf", "adaptive UKF": "adaptive-ukf", "UKF": "ukf"}
"""Names of the paper's rows in the timings of the live filters."""
NEW_DRIVES = "95% for new drives"
PAIRED = (
    "One value a drive, the mean over the trials that held it back, of drives on which neither ever failed; 95% "
    "intervals by bootstrap over drives; negative differences and positive improvements are in favor of the {}."
)
INTERVALS = (
    "The interval over trials (as in the paper) says what optimizer and split leave open; it covers the mean of "
    "new drives only about half of the time. The other two are made for those: in a study of full size the "
    "bootstrap covers it 95% of the time (in small ones 85 to 95%), the corrected t as often or more, as it is too "
    "wide where the optimizer's luck varies much."
)


def decimals(digits: int, value: float) -> str:
    """So many of them below 100, none above: as the paper prints its figures."""
    return f"{value:.{digits}f}" if abs(value) < 100 else f"{value:,.0f}"


def figures(title: str, digits: int = 2, **more: Any) -> Column:
    """A column of figures, printed as the paper prints its own."""
    return Column(title, printed=partial(decimals, digits), **more)


def _digits(title: str, digits: int) -> Column:
    return Column(title, printed=lambda value: f"{value:.{digits}g}")


def study_table(
    caption: str,
    columns: Sequence[Column],
    rows: Sequence[tuple[Cell, ...]],
    results: Results,
    note: str = "",
) -> Table:
    """The main method's rows are those that matter most."""
    main = {results.label(MAIN, protocol) for protocol in results.protocols}
    strong = frozenset(i for i, row in enumerate(rows) if row[0] in main)
    return Table(caption, tuple(columns), tuple(rows), strong, note)


def study_tables(results: Results) -> dict[str, Table]:
    """All tables that are kept in files, but that of the run time, which no two runs share; by the files' names."""
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
    """The paper's Table I: RMSE of IMU only, UKF and PSO-UKF, against the GPS and against truth."""
    paper = results.paper["table_1"]
    rows = [
        (
            results.label(method, protocol),
            paper.get(beside, {}).get("rmse_m"),
            *(_mean(results.summary(protocol, method, m)) for m in ("gps_rmse_m", POSITION)),
        )
        for protocol, method, beside in _rows(results)
        if beside in paper or method == "raw-gps"
    ]
    titles = ("paper", "ours, against the GPS (eq. 4)", "ours, against truth")
    note = "Mean over trials on held-out drives. The paper's RMSE is against the GPS that the filter has absorbed."
    return study_table("Table I. RMSE, m", [Column("method"), *map(figures, titles)], rows, results, note)


def table_2(results: Results) -> Table:
    """The paper's Table II: RMSE with its spread over trials and three intervals."""
    titles = (
        "mean",
        "SD",
        "mean +- 1.96 SD / sqrt(n)",
        "for new drives: corrected t",
        "for new drives: bootstrap",
    )
    columns = [
        Column("method"),
        figures("paper"),
        figures("95%", joined=True),
        *map(figures, titles),
    ]
    rows: list[tuple[Cell, ...]] = []
    for protocol, method, beside in _rows(results):
        found, theirs = results.summary(protocol, method, POSITION), results.paper["table_2"].get(beside, {})
        if found is not None:
            low_high = theirs.get("interval_m")
            intervals = (found.trial_interval, found.corrected_t_interval, found.bootstrap_interval)
            said = (theirs.get("rmse_m"), low_high and tuple(low_high), found.mean, found.sd, *intervals)
            rows.append((results.label(method, protocol), *said))
    caption = "Table II. Position RMSE against truth, m, on held-out drives"
    return study_table(caption, columns, rows, results, INTERVALS)


def table_3(results: Results) -> Table:
    """The paper's Table III without the run time."""
    columns = [Column("method")]
    for what in ("heading", "drift"):
        columns += [
            figures(f"{what}: paper"),
            figures(f"{what}: ours"),
            figures(NEW_DRIVES, joined=True),
        ]
    rows: list[tuple[Cell, ...]] = []
    for protocol, method, beside in _rows(results):
        row: list[Cell] = [results.label(method, protocol)]
        for measure, key in ((HEADING, "heading_deg"), (DRIFT, "outage_drift_m")):
            found = results.summary(protocol, method, measure)
            theirs = results.paper["table_3"].get(beside, {}).get(key)
            row += [theirs, _mean(found), found and found.bootstrap_interval]
        rows.append(tuple(row))
    caption = "Table III. Heading error, deg, and drift over a 5 s outage, m"
    note = (
        "In brackets the 95% interval for new drives (bootstrap over drives and trials). "
        "Run times are in runtime.md."
    )
    return study_table(caption, columns, rows, results, note)


def runtime_table(results: Results, live: Mapping[str, Mapping[str, float]]) -> Table:
    """The last column of the paper's Table III: an update through the live filter."""
    rows = [
        (
            name,
            results.paper["table_3"].get(LIVE_NAMES.get(name), {}).get("update_ms"),
            times.get("predict_ms"),
            times.get("predict_and_update_ms"),
        )
        for name, times in live.items()
    ]
    ours = ("ours, an IMU sample", "ours, an IMU sample that absorbs a fix")
    columns = (Column("filter"), figures("paper"), *(figures(title, 4) for title in ours))
    note = (
        "Medians over one drive through the live filter, called from Python, on the machine that ran the study. A "
        "tuned filter costs what a manual one costs. The paper's limit for real time is "
        f"{results.paper['real_time_limit_ms']:g} ms."
    )
    return Table("Table III, run time: ms per update", columns, tuple(rows), note=note)


def _rows(results: Results) -> list[tuple[str, str, str | None]]:
    """The rows of a study's methods."""
    return [row for row in ROWS if row[1] in results.methods]


def _mean(found: VariantSummary | None) -> float | None:
    return found.mean if found else None


def consistency_table(results: Results) -> Table:
    """Mean NIS of every filter."""
    titles = ("method", "mean NIS", "SD over trials", NEW_DRIVES)
    rows = [
        (results.label(r.method, r.protocol), r.mean, r.sd, r.bootstrap_interval)
        for r in results.means("nis")
    ]
    return study_table("", list(map(Column, titles)), rows, results)


def comparison_table(results: Results, protocol: str, measure: str) -> Table:
    """The PSO-UKF of a protocol against every other method, drive by drive."""
    columns = (
        Column("against"),
        figures(f"difference, {'deg' if measure == HEADING else 'm'}"),
        *paired_columns("Wilcoxon p (Holm)"),
    )
    rows = tuple(
        (results.label(c.against), *paired_cells(c))
        for c in results.comparisons
        if (c.protocol, c.measure) == (protocol, measure)
    )
    caption = (
        f"{results.label(MAIN)} under the protocol {protocol} against each other method: {ERRORS[measure]}"
    )
    return Table(caption, columns, rows, note=PAIRED.format("PSO-UKF"))


def paired_columns(p: str) -> list[Column]:
    """What `paired_cells` fills, behind the column of the difference."""
    return [
        figures("95%", joined=True),
        figures("improvement (eq. 5), %"),
        figures("95%", joined=True),
        _digits(p, 2),
        figures("rank-biserial"),
        figures("drives", 0),
    ]


def paired_cells(c: PairedComparison) -> tuple[Cell, ...]:
    """The difference, and what `paired_columns` names."""
    return (
        c.mean_difference,
        c.interval,
        c.improvement,
        c.improvement_interval,
        c.holm_p,
        c.rank_biserial,
        c.n_drives,
    )


def conditions_table(results: Results, measure: str, variants: Sequence[Variant] = ()) -> Table:
    """A measure in each condition, of all variants or of some."""
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
    """All trials of each tuning: by protocol, method and group."""
    kinds: dict[tuple[str, str, str], list[TrialTuning]] = {}
    for tuned in results.tunings:
        kinds.setdefault((tuned.protocol, tuned.method, tuned.group), []).append(tuned)
    return kinds


def _by_group(
    caption: str, columns: Sequence[Column], rows: Sequence[tuple[Cell, ...]], results: Results
) -> Table:
    """Leaves out the second column, the group of drives, where all drives are one group."""
    if all(row[1] in (ALL, "") for row in rows):
        columns, rows = [columns[0], *columns[2:]], [(row[0], *row[2:]) for row in rows]
    return study_table(caption, columns, rows, results)


def convergence_table(results: Results) -> Table:
    """The generation where the median over trials settles."""
    columns = [
        *map(Column, ("method", "drives", "settles at generation")),
        Column("median cost at the end", "m"),
    ]
    rows = [
        (results.label(c.method, c.protocol), c.group, c.stable, c.median[-1]) for c in results.convergence
    ]
    return _by_group("", columns, rows, results)


def trials_table(results: Results) -> Table:
    """Costs of the trials, how they differ, and the bounds that they touch."""
    costs = ("lowest cost", "median cost", "highest cost")
    columns = [*map(Column, ("method", "drives", "trials")), *(Column(title, "m") for title in costs)]
    columns += map(Column, ("evaluations", "failures", "bounds touched, in how many trials"))
    rows: list[tuple[Cell, ...]] = []
    for (protocol, method, group), own in _kinds(results).items():
        each = [t.cost for t in own]
        touched = Counter(bound.parameter for t in own for bound in t.touched_bounds)
        said = ", ".join(f"{name} {n}" for name, n in touched.most_common()) or "none"
        sums = (sum(t.evaluations for t in own), sum(t.failures for t in own))
        figures = (len(own), min(each), median(each), max(each), *sums, said)
        rows.append((results.label(method, protocol), group, *figures))
    return _by_group("All trials, on their training drives", columns, rows, results)


def optimum_table(results: Results, methods: Sequence[str] = ()) -> Table:
    """The parameters of the best trial of each tuning, or of those of some methods, beside the paper's."""
    o: dict[str, Any] = results.paper["table_1"]["optimum"]
    figures = (o["alpha"], o["beta"], o["kappa"])
    rows: list[tuple[Cell, ...]] = [("paper", "", *figures, f"{o['q']:g}", f"{o['r']:g}", None)]
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
