"""HTML page of a study: the paper's tables with the study's results, and all methods under both protocols."""

from collections.abc import Iterable, Iterator
from itertools import product
from math import inf
from pathlib import Path

from sigmaswarm.experiments.study.config import MAIN_METHOD, PROTOCOL_LABELS
from sigmaswarm.experiments.study.record import Results, StudyRecord
from sigmaswarm.reports import study_tables as tables
from sigmaswarm.reports.figures import Chart
from sigmaswarm.reports.page import KeyFigure, Report, Section, TrackView
from sigmaswarm.reports.study_charts import convergence_chart, curve_charts, means_chart, quantile_chart
from sigmaswarm.reports.study_tables import DRIFT, ERRORS, HEADING, POSITION, comparison
from sigmaswarm.reports.style import STUDY_STYLES
from sigmaswarm.wording import describe_change

COMPARED_METHODS = ("ukf-datasheet", "ukf-defaults", "raw-gps")
CONSISTENT_NIS = 2.0  # mean NIS of a consistent filter
NIS_LIMITS = (1.0, 4.0)  # a mean NIS outside of these bounds shows wrong covariances, for any number of fixes
MAX_COST_RATIO = 1.2  # highest / lowest cost of the trials, above which the page warns
CONDITION_VARIANTS = (
    ("untuned", "raw-gps"),
    ("untuned", "ukf-defaults"),
    ("untuned", "ukf-datasheet"),
    ("paper", MAIN_METHOD),
    ("honest", MAIN_METHOD),
    ("honest", "pso-ekf"),
    ("honest", "pso-planar8"),
)


def study_report(folder: Path) -> Report:
    record = StudyRecord.read(folder)
    results = record.results
    return Report(
        title=f"Study: {results.config.trials} trials on {results.drives.count} drives",
        lead=(
            *(_result(results, p) for p in reversed(results.protocols)),
            tables.objectives_compared(results),
        ),
        figures=_figures(results),
        remarks=tuple(remark for protocol in results.protocols for remark in _remarks(results, protocol)),
        sections=tuple(_sections(record)),
        config=results.config.model_dump(mode="json"),
        versions=record.versions,
        command="sigmaswarm study --out again --config study.toml",
        command_note="study.toml is in the folder of the study.",
    )


def _sections(record: StudyRecord) -> Iterator[Section]:
    results = record.results
    yield _tables(results)
    yield _intervals(results)
    yield _quantiles(record)
    if record.tracks:
        yield _tracks(record)
    yield _comparisons(results)
    if rivals := tuple(tables.rivals_tables(results, record.rival_times).values()):
        text = "In each trial, the networks are trained for the trial's tuned filter, on the trial's training drives."
        notes = dict.fromkeys(table.note for table in rivals)
        yield Section("Rivals", (text, *notes), rivals, curve_charts(results))
    conditions = tables.conditions_table(results, POSITION, CONDITION_VARIANTS)
    if len(conditions.rows) > 2:
        text = "The folder tables/ of the study contains other measures and methods."
        yield Section("Conditions", (text,), (conditions,))
    yield _convergence(results)
    yield Section("Search results", (), (tables.optimum_table(results), tables.trials_table(results)))
    if record.live:
        times = tables.runtime_table(results, record.live)
        yield Section("Run time", (times.note,), (times,))


def _result(results: Results, protocol: str) -> str:
    summary = results.summary(protocol, MAIN_METHOD, POSITION)
    start = f"With the objective {results.protocols[protocol].objective}, {results.label(MAIN_METHOD)}"
    if summary is None or summary.mean is None:
        return f"{start} failed on held-out drives."
    low, high = summary.bootstrap_interval
    known = low is not None and high is not None
    interval = f" (95% interval for new drives {low:.3g} to {high:.3g})" if known else ""
    against: list[str] = []
    for c in (comparison(results, protocol, POSITION, rival) for rival in COMPARED_METHODS):
        if c is not None:
            change = (
                "no comparison with"
                if c.improvement is None
                else describe_change(c.improvement, "less", "MORE")
            )
            against.append(f"{change} {results.label(c.against)}")
    rmse = f"has a position RMSE of {summary.mean:.3g} m{interval} on held-out drives"
    return f"{start} {rmse}{': ' if against else ''}{'; '.join(against)}."


def _figures(results: Results) -> tuple[KeyFigure, ...]:
    shown = [(p, POSITION, "position RMSE", "m", "table_2", "rmse_m") for p in reversed(results.protocols)]
    shown += [("honest", HEADING, "heading error", "deg", "table_3", "heading_deg")]
    shown += [("honest", DRIFT, "drift over 5 s", "m", "table_3", "outage_drift_m")]
    figures: list[KeyFigure] = []
    for protocol, measure, what, unit, table, key in shown:
        summary = results.summary(protocol, MAIN_METHOD, measure)
        if summary is not None and summary.mean is not None:
            theirs = results.paper.get(table, {}).get(MAIN_METHOD, {}).get(key)
            note = f"the paper: {theirs:.3g} {unit}" if theirs is not None else ""
            title = f"{what}, {PROTOCOL_LABELS.get(protocol, protocol)}"
            figures.append((title, f"{summary.mean:.3g} {unit}", note))
    return (*figures, ("drives", str(results.drives.count), f"{results.drives.strata} conditions"))


def _remarks(results: Results, protocol: str) -> Iterable[str]:
    main = results.label(MAIN_METHOD, protocol)
    mine = [t for t in results.tunings if (t.protocol, t.method) == (protocol, MAIN_METHOD)]
    if touching := sum(bool(t.touched_bounds) for t in mine):
        yield (
            f"{main}: in {touching} of {len(mine)} tuning runs, a parameter ended at a bound, "
            "so the optimum may be outside of the search space"
        )
    costs = [t.cost for t in mine]
    if costs and max(costs) > MAX_COST_RATIO * min(costs):
        yield (
            f"{main}: the training costs of the tuning runs range from {min(costs):.3g} to {max(costs):.3g} m; "
            "tune several times and use the best result"
        )
    nis = results.summary(protocol, MAIN_METHOD, "nis")
    if nis is not None and nis.mean is not None and not NIS_LIMITS[0] < nis.mean < NIS_LIMITS[1]:
        wrong = "overconfident" if nis.mean > NIS_LIMITS[1] else "underconfident"
        yield (
            f"{main}: the filter is {wrong}, since its mean NIS is {nis.mean:.3g} instead of 2; "
            "do not rely on its covariances"
        )
    unsure = [
        results.label(c.against)
        for c in results.comparisons
        if (c.protocol, c.measure) == (protocol, POSITION) and c.holm_p > 0.05
    ]
    if unsure:
        yield (
            f"{main}: the position RMSE may differ only by chance (p above 0.05) from that of these methods: "
            f"{'; '.join(unsure)}"
        )


def _tables(results: Results) -> Section:
    theirs = results.paper.get("table_1", {}).get(MAIN_METHOD, {}).get("improvement_percent")
    improvements = [f"{theirs:.0f}% in the paper"] if theirs else []
    improvements += [
        f"{c.improvement:.0f}% relative to {results.label(rival)} ({PROTOCOL_LABELS.get(protocol, protocol)})"
        for protocol in reversed(results.protocols)
        for rival in ("ukf-defaults", "ukf-datasheet")
        if (c := comparison(results, protocol, POSITION, rival)) and c.improvement is not None
    ]
    text = (
        "Values of the paper and of this study: means over trials, each on its held-out drives. The paper's RMSE is "
        "that of the updated estimates relative to the GPS fixes, so a filter that copies the fixes has an RMSE of 0.",
        f"Reduction of the PSO-UKF's position RMSE relative to a manually tuned UKF (the paper's equation 5): "
        f"{'; '.join(improvements)}.",
    )
    shown = (tables.table_1(results), tables.table_2(results), tables.table_3(results))
    return Section("The paper's tables", text, shown)


def _known(charts: Iterable[Chart | None]) -> tuple[Chart, ...]:
    return tuple(chart for chart in charts if chart)


def _intervals(results: Results) -> Section:
    charts = [means_chart(results, measure) for measure in ERRORS]
    charts += [means_chart(results, "nis", inf, mark=CONSISTENT_NIS)]
    text = (
        "The interval over trials (mean +- 1.96 SD / sqrt(n), as in the paper) shows only the variation from the "
        "optimizer and the random split of the drives. It contains the mean over new drives in only 45 to 91% of "
        "simulated studies. The bootstrap interval over drives and trials contains this mean in 94 to 95% of full "
        "studies, and in 85 to 95% of small studies.",
        "An arrow means that the mean is beyond the scale.",
    )
    return Section("Intervals of the means", text, charts=_known(charts))


def _quantiles(record: StudyRecord) -> Section:
    results, quantiles = record.results, record.quantiles
    charts = [quantile_chart(results, quantiles, measure) for measure in ERRORS]
    charts += [quantile_chart(results, quantiles, "nis", mark=CONSISTENT_NIS)]
    text = (
        "Each drive has one value, the mean over its trials. Box: quartiles. Whiskers: 5 to 95% of the drives.",
        "The mean NIS of a consistent filter is 2. A filter with a larger value is overconfident, a filter with a "
        "smaller value underconfident. Tuning by position errors alone does not determine the scale of the "
        "covariances.",
    )
    shown = (tables.consistency_table(results),)
    return Section("Spread over drives, and consistency", text, shown, _known(charts))


def _tracks(record: StudyRecord) -> Section:
    results, labels = record.results, dict[str, str]()
    for series in STUDY_STYLES:
        protocol, _, method = series.partition("-")
        variant = (method, protocol) if protocol in results.protocols else (series.replace("_", "-"),)
        labels[series] = results.label(*variant)
    text = (
        "The tracks are from held-out drives of the trial in which the PSO-UKF tuned with truth has the lowest "
        "training cost."
    )
    view = TrackView(record.tracks, labels, STUDY_STYLES, f"honest-{MAIN_METHOD}")
    return Section("Tracks and errors over time", (text,), tracks=view)


def _comparisons(results: Results) -> Section:
    text = (
        f"{results.label(MAIN_METHOD)} compared with every other method, drive by drive. Improvement (equation 5 of "
        "the paper): the relative reduction of the mean error, with a bootstrap interval over drives.",
        "p: Wilcoxon's signed-rank test, with Holm's correction over the methods. The rank-biserial correlation is the "
        "effect size: 1 if the PSO-UKF is better on every drive, -1 if it is worse on every drive.",
    )
    pairs = product(reversed(results.protocols), ERRORS)
    comparisons = (tables.comparison_table(results, *pair) for pair in pairs)
    return Section("Comparisons", text, tuple(table for table in comparisons if table.rows))


def _convergence(results: Results) -> Section:
    theirs = results.paper["figure_2"]["stable_generation"]
    text = (
        "Lowest training cost so far: median and middle 80% of the trials. The diamond marks the generation from which "
        f"the median stays within 1% of its last value. In the paper's figure 2, this generation is {theirs}."
    )
    charts = _known(convergence_chart(results, protocol) for protocol in results.protocols)
    return Section("Convergence", (text,), (tables.convergence_table(results),), charts)
