"""The page of a study: the paper's tables next to ours, and every method under both protocols."""

from math import inf

from sigmaswarm.experiments.study.config import MAIN
from sigmaswarm.experiments.study.record import PairedComparison, Results, StudyRecord
from sigmaswarm.reports.page import Figure, Line, Report, Section, TrackView
from sigmaswarm.reports.style import STUDY_LOOKS
from sigmaswarm.reports.views.study_charts import convergence_chart, means_chart, spread_chart
from sigmaswarm.reports.views.study_rivals import curve_charts, rivals_tables
from sigmaswarm.reports.views.study_tables import (
    DRIFT,
    ERRORS,
    HEADING,
    POSITION,
    comparison,
    comparison_table,
    conditions_table,
    consistency_table,
    convergence_table,
    objectives_compared,
    optimum_table,
    runtime_table,
    table_1,
    table_2,
    table_3,
    trials_table,
)

RIVALS = ("ukf-datasheet", "ukf-defaults", "raw-gps")
CONSISTENT = 2.0
"""Mean NIS of a position with a consistent filter."""
BEYOND_CHANCE = (1.0, 4.0)
"""Mean NIS outside these bounds means wrong covariances, whatever the number of fixes."""
UNLUCKY = 1.2
"""Ratio to the lowest cost above which a trial's search was unlucky."""
IN_CONDITIONS = (
    ("untuned", "raw-gps"),
    ("untuned", "ukf-defaults"),
    ("untuned", "ukf-datasheet"),
    ("paper", MAIN),
    ("honest", MAIN),
    ("honest", "pso-ekf"),
    ("honest", "pso-planar8"),
)
"""Protocols and methods in the table of conditions."""
SHOWN = ("truth", "honest-pso-ukf", "paper-pso-ukf", "raw_gps")
"""Series whose tracks are visible when the page opens."""


def study_report(record: StudyRecord) -> Report:
    """Return the page of a study."""
    results = record.results
    return Report(
        title=f"Study: {results.config.trials} trials on {results.drives.count} drives",
        lead=(*(_result(results, p) for p in reversed(results.protocols)), objectives_compared(results)),
        figures=_figures(results),
        remarks=_remarks(results),
        sections=(
            _tables(results),
            _intervals(results),
            _spread(record),
            *_tracks(record),
            _comparisons(results),
            *_rivals(record),
            *_conditions(results),
            _convergence(results),
            Section("What the search found", (), (optimum_table(results), trials_table(results))),
            *_run_times(record),
        ),
        config=results.config.model_dump(mode="json"),
        versions=record.versions,
        command="sigmaswarm study --out again --config study.toml",
        command_note="study.toml is the one in this page's folder.",
    )


# ---- the summary ----


def _result(results: Results, protocol: str) -> str:
    """Summarize the result under a protocol in a sentence."""
    found, objective = results.summary(protocol, MAIN, POSITION), results.protocols[protocol].objective
    start = f"Tuned for {objective} (the {protocol} protocol), {results.label(MAIN)}"
    if found is None or found.mean is None:
        return f"{start} failed on held-out drives."
    low, high = found.bootstrap_interval
    interval = (
        "" if low is None or high is None else f" (95% interval for new drives {low:.3g} to {high:.3g})"
    )
    where = f"has a position RMSE of {found.mean:.3g} m{interval} on held-out drives"
    against = [
        _against(results, c) for rival in RIVALS if (c := comparison(results, protocol, POSITION, rival))
    ]
    return f"{start} {where}{': ' if against else ''}{'; '.join(against)}."


def _against(results: Results, c: PairedComparison) -> str:
    if c.improvement is None:
        return f"no comparison with {results.label(c.against)}"
    return f"{abs(c.improvement):.0f}% {'less' if c.improvement >= 0 else 'MORE'} than {results.label(c.against)}"


def _figures(results: Results) -> tuple[Figure, ...]:
    """Return the main figures, with the paper's in their notes."""
    paper = {
        POSITION: ("table_2", "rmse_m"),
        HEADING: ("table_3", "heading_deg"),
        DRIFT: ("table_3", "outage_drift_m"),
    }
    shown = [(p, POSITION, "position RMSE", "m") for p in reversed(results.protocols)]
    shown += [("honest", HEADING, "heading error", "deg"), ("honest", DRIFT, "drift over 5 s", "m")]
    figures: list[Figure] = []
    for protocol, measure, what, unit in shown:
        found = results.summary(protocol, MAIN, measure)
        if found is not None and found.mean is not None:
            table, key = paper[measure]
            theirs = results.paper.get(table, {}).get(MAIN, {}).get(key)
            note = f"the paper: {theirs:.3g} {unit}" if theirs is not None else ""
            figures.append(Figure(f"{what}, {protocol}", f"{found.mean:.3g} {unit}", note))
    return (*figures, Figure("drives", str(results.drives.count), f"{results.drives.strata} conditions"))


def _remarks(results: Results) -> tuple[str, ...]:
    remarks: list[str] = []
    for protocol in results.protocols:
        mine = [t for t in results.tunings if (t.protocol, t.method) == (protocol, MAIN)]
        touching = sum(bool(t.touched_bounds) for t in mine)
        if touching:
            remarks.append(
                f"{protocol}: {touching} of {len(mine)} tunings of {results.label(MAIN)} ended at a bound: "
                "their optimum may lie outside the search space"
            )
        costs = [t.cost for t in mine]
        if costs and max(costs) > UNLUCKY * min(costs):
            remarks.append(
                f"{protocol}: the tunings of {results.label(MAIN)} differ: their training costs are "
                f"{min(costs):.3g} to {max(costs):.3g} m; tune several times and take the best"
            )
        nis = results.summary(protocol, MAIN, "nis")
        if nis is not None and nis.mean is not None and not BEYOND_CHANCE[0] < nis.mean < BEYOND_CHANCE[1]:
            wrong = "overconfident" if nis.mean > BEYOND_CHANCE[1] else "underconfident"
            remarks.append(
                f"{protocol}: {results.label(MAIN)} is {wrong}: its mean NIS is {nis.mean:.3g}, "
                "that of a consistent filter 2; do not rely on its covariances"
            )
        unsure = [
            results.label(c.against)
            for c in results.comparisons
            if (c.protocol, c.measure) == (protocol, POSITION) and c.holm_p > 0.05
        ]
        if unsure:
            remarks.append(
                f"{protocol}: the difference in position from {'; '.join(unsure)} may be chance (p over 0.05)"
            )
    return tuple(remarks)


# ---- the evidence ----


def _tables(results: Results) -> Section:
    text = (
        "The paper's figures next to ours: means over trials, each on its held-out drives. The paper's RMSE is against "
        "the GPS fixes after the update; a filter that copies them has 0.",
        f"Improvement over the UKF by hand (equation 5): {_improvements(results)}.",
    )
    return Section("The paper's tables", text, (table_1(results), table_2(results), table_3(results)))


def _intervals(results: Results) -> Section:
    charts = [means_chart(results, measure) for measure in (POSITION, HEADING, DRIFT)]
    charts.append(means_chart(results, "nis", inf, mark=CONSISTENT))
    text = (
        "The interval over trials (mean +- 1.96 SD / sqrt(n), as in the paper) is the uncertainty by swarm and split; "
        "it covers the mean of new drives only about half of the time. The bootstrap over drives and trials covers it "
        "95% of the time in a study of full size, 85 to 95% in small ones.",
        "An arrow: the mean lies beyond the scale.",
    )
    return Section("Intervals of the means", text, charts=tuple(c for c in charts if c))


def _run_times(record: StudyRecord) -> tuple[Section, ...]:
    if not record.live:
        return ()
    table = runtime_table(record.results, record.live)
    return (Section("Run time", (table.note,), (table,)),)


def _improvements(results: Results) -> str:
    ours = [
        f"{c.improvement:.0f}% over {results.label(rival)} ({protocol})"
        for protocol in reversed(results.protocols)
        for rival in ("ukf-defaults", "ukf-datasheet")
        if (c := comparison(results, protocol, POSITION, rival)) and c.improvement is not None
    ]
    theirs = results.paper.get("table_1", {}).get(MAIN, {}).get("improvement_percent")
    return "; ".join([*([f"the paper {theirs:.0f}%"] if theirs else []), *ours])


def _spread(record: StudyRecord) -> Section:
    results, spreads = record.results, record.spreads
    charts = [spread_chart(results, spreads, measure) for measure in (POSITION, HEADING, DRIFT)]
    charts.append(spread_chart(results, spreads, "nis", mark=CONSISTENT))
    text = (
        "One value a drive, the mean over its trials. Box: quartiles; whiskers: 5 to 95% of drives.",
        "The mean NIS of a consistent filter is 2; above 2 it is overconfident, below underconfident. Position errors "
        "alone do not determine the scale of the covariances.",
    )
    title = "Spread over drives, and consistency"
    return Section(title, text, (consistency_table(results),), tuple(c for c in charts if c))


def _tracks(record: StudyRecord) -> tuple[Section, ...]:
    if not record.tracks:
        return ()
    results = record.results
    lines = tuple(Line(s, _series_label(results, s), look, s in SHOWN) for s, look in STUDY_LOOKS.items())
    text = ("Held-out drives of the trial with the lowest training cost, and the filters tuned in it.",)
    view = TrackView(tuple(record.tracks), lines, f"honest-{MAIN}")
    return (Section("Tracks and errors over time", text, tracks=view),)


def _series_label(results: Results, series: str) -> str:
    protocol, _, method = series.partition("-")
    return (
        results.label(method, protocol)
        if protocol in results.protocols
        else results.label(series.replace("_", "-"))
    )


def _comparisons(results: Results) -> Section:
    text = (
        f"{results.label(MAIN)} against every other method, drive by drive. Improvement (equation 5): how much less "
        "its mean error is; its interval is by bootstrap over drives.",
        "p: Wilcoxon's signed-rank test, with Holm's correction over the methods. Rank-biserial correlation is the "
        "effect size: 1 is better on every drive, -1 worse on every drive.",
    )
    tables = [
        comparison_table(results, p, measure) for p in reversed(results.protocols) for measure in ERRORS
    ]
    return Section("Comparisons", text, tuple(table for table in tables if table.rows))


def _rivals(record: StudyRecord) -> tuple[Section, ...]:
    """Show data, times and drift of rivals, their scores elsewhere, and learning curves."""
    results = record.results
    if results.rivals is None:
        return ()
    tables = tuple(rivals_tables(results, record.rival_times).values())
    text = ("Networks are trained in each trial, for the filter tuned in it, on its training drives.",)
    notes = dict.fromkeys(table.note for table in tables)
    return (Section("Rivals", (*text, *notes), tables, curve_charts(results)),)


def _conditions(results: Results) -> tuple[Section, ...]:
    table = conditions_table(results, POSITION, IN_CONDITIONS)
    text = ("Other measures and methods are in tables/ of this page's folder.",)
    return (Section("Conditions", text, (table,)),) if len(table.rows) > 2 else ()


def _convergence(results: Results) -> Section:
    theirs = results.paper["figure_2"]["stable_generation"]
    text = (
        "The median over trials, and where 80% of them lie. The diamond marks the generation after which the median "
        f"stays within 1% of its last value. In the paper's figure 2 the cost settles at generation {theirs}.",
    )
    charts = [convergence_chart(results, protocol) for protocol in results.protocols]
    return Section("Convergence", text, (convergence_table(results),), tuple(c for c in charts if c))
