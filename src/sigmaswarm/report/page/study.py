"""The page of a study: the paper's tables with ours beside, and every method under both protocols."""

from math import inf
from pathlib import Path

from sigmaswarm.records import load_record as load
from sigmaswarm.report.page.study_charts import convergence_charts, means_chart, spread_chart
from sigmaswarm.report.page.study_schema import (
    Comparison,
    Spread,
    StudyFile,
    Summary,
    TuningConfig,
    read_spreads,
    read_timings,
)
from sigmaswarm.report.page.study_tables import (
    DRIFT,
    HEADING,
    POSITION,
    TUNED,
    comparison_tables,
    conditions_table,
    consistency_table,
    convergence_table,
    optimum_table,
    paper_tables,
    run_times_table,
    trials_table,
)
from sigmaswarm.report.style import STUDY_LOOKS
from sigmaswarm.report.views.record import Figure, Line, Report, Section, TrackView
from sigmaswarm.scoring.tracks import load_tracks

RIVALS = ("ukf-datasheet", "ukf-defaults", "raw-gps")
CONSISTENT = 2.0
"""Mean NIS of a position where a filter knows its own errors."""
BEYOND_CHANCE = (1.0, 4.0)
"""Mean NIS outside these says that a filter's covariances are off, whatever the number of fixes."""
UNLUCKY = 1.2
"""Times the lowest cost: above it a trial's search was unlucky."""
RUN_TIMES = (
    "Medians of one call of the live filter, from Python, on the machine that ran the study. A tuned filter "
    "costs what a manual one costs. The paper's limit for real time is {} ms."
)
SHOWN = ("truth", "honest-pso-ukf", "paper-pso-ukf", "raw_gps")
"""The series whose tracks are drawn from the start."""


def study_report(folder: Path) -> Report:
    """Read the folder of a `sigmaswarm study`."""
    file, spreads = load(StudyFile, folder / "results.json"), read_spreads(folder)
    trials = file.config.get("trials", len({t.trial for t in file.tunings}))
    return Report(
        title=f"Study: {trials} trials on {file.drives.count} drives",
        lead=tuple(_result(file, protocol) for protocol in reversed(file.protocols)),
        figures=_figures(file),
        remarks=_remarks(file),
        sections=(
            _results(file),
            _intervals(file),
            _spread(file, spreads),
            *_tracks(file, folder),
            _comparisons(file),
            *_conditions(file),
            _convergence(file),
            Section("What the search found", (), (optimum_table(file), trials_table(file))),
            *_run_times(file, folder),
        ),
        config=file.config,
        versions=_versions(folder),
        command="sigmaswarm study again --config study.toml",
        command_note="study.toml is the one in this page's folder.",
    )


def _versions(folder: Path) -> dict[str, str]:
    """As the first of the tunings keeps them."""
    configs = sorted(folder.glob("trials/*/config.json"))
    return load(TuningConfig, configs[0]).versions if configs else {}


# ---- the summary ----


def _result(file: StudyFile, protocol: str) -> str:
    """What tuning is worth under a protocol, in a sentence."""
    asked = file.protocols[protocol]
    found = file.mean((protocol, TUNED), POSITION)
    name = file.label(TUNED)
    start = f"Tuned for {asked.get('objective', '?')} (the {protocol} protocol), {name}"
    if found is None or found.mean is None:
        return f"{start} failed on drives that it did not see."
    where = f"is {found.mean:.3g} m{_said(found)} from the truth on drives that it did not see"
    against = [_against(file, c) for rival in RIVALS if (c := _comparison(file, protocol, rival))]
    return f"{start} {where}{': ' if against else ''}{'; '.join(against)}."


def _comparison(file: StudyFile, protocol: str, rival: str) -> Comparison | None:
    """Of the positions."""
    wanted = (protocol, POSITION, rival)
    return next((c for c in file.comparisons if (c.protocol, c.measure, c.against) == wanted), None)


def _against(file: StudyFile, c: Comparison) -> str:
    if c.improvement is None:
        return f"not to be compared with {file.label(c.against)}"
    return (
        f"{abs(c.improvement):.0f}% {'less' if c.improvement >= 0 else 'MORE'} than {file.label(c.against)}"
    )


def _said(found: Summary) -> str:
    low, high = found.bootstrap_interval or (None, None)
    return "" if low is None or high is None else f" (95% interval for new drives {low:.3g} to {high:.3g})"


def _figures(file: StudyFile) -> tuple[Figure, ...]:
    """What the paper says stands in the notes."""
    paper = {
        POSITION: ("table_2", "rmse_m"),
        HEADING: ("table_3", "heading_deg"),
        DRIFT: ("table_3", "outage_drift_m"),
    }
    asked = [(p, POSITION, "position RMSE", "m") for p in reversed(file.protocols)]
    asked += [("honest", HEADING, "heading error", "deg"), ("honest", DRIFT, "drift over 5 s", "m")]
    figures: list[Figure] = []
    for protocol, measure, what, unit in asked:
        found = file.mean((protocol, TUNED), measure)
        if found is not None and found.mean is not None:
            table, key = paper[measure]
            theirs = file.paper.get(table, {}).get(TUNED, {}).get(key)
            note = f"the paper: {theirs:.3g} {unit}" if theirs is not None else ""
            figures.append(Figure(f"{what}, {protocol}", f"{found.mean:.3g} {unit}", note))
    return (*figures, Figure("drives", str(file.drives.count), f"{file.drives.strata} conditions"))


def _remarks(file: StudyFile) -> tuple[str, ...]:
    said: list[str] = []
    for protocol in file.protocols:
        mine = [t for t in file.tunings if (t.protocol, t.method) == (protocol, TUNED)]
        touching = sum(bool(t.touched_bounds) for t in mine)
        if touching:
            said.append(
                f"{protocol}: {touching} of {len(mine)} tunings of {file.label(TUNED)} ended on a bound: "
                "their optimum may lie outside the box"
            )
        costs = [t.cost for t in mine]
        if costs and max(costs) > UNLUCKY * min(costs):
            said.append(
                f"{protocol}: luck matters: on their training drives the tunings of {file.label(TUNED)} cost from "
                f"{min(costs):.3g} to {max(costs):.3g} m; tune several times and take the best"
            )
        nis = file.mean((protocol, TUNED), "nis")
        if nis is not None and nis.mean is not None and not BEYOND_CHANCE[0] < nis.mean < BEYOND_CHANCE[1]:
            wrong = "too sure of itself" if nis.mean > BEYOND_CHANCE[1] else "too careful"
            said.append(
                f"{protocol}: {file.label(TUNED)} is {wrong}: its mean NIS is {nis.mean:.3g}, and 2 would be right; "
                "do not rely on its covariances"
            )
        unsure = [
            file.label(c.against)
            for c in file.comparisons
            if (c.protocol, c.measure) == (protocol, POSITION) and (c.holm_p is None or c.holm_p > 0.05)
        ]
        if unsure:
            said.append(
                f"{protocol}: the difference in position from {'; '.join(unsure)} may be chance (p over 0.05)"
            )
    return tuple(said)


# ---- the evidence ----


def _results(file: StudyFile) -> Section:
    text = (
        "The paper's figures, and ours beside: means over trials, each on the drives that it held back. The paper's "
        "RMSE is against the GPS fixes that the filter has just absorbed; a filter that copies them has 0.",
        f"Improvement over the UKF by hand (equation 5): {_improvements(file)}.",
    )
    return Section("The paper's tables", text, paper_tables(file))


def _intervals(file: StudyFile) -> Section:
    """Of the means."""
    charts = [means_chart(file, measure) for measure in (POSITION, HEADING, DRIFT)]
    charts.append(means_chart(file, "nis", inf, mark=CONSISTENT))
    text = (
        "The interval over trials (mean +- 1.96 SD / sqrt(n), as in the paper) says what swarm and split leave open; "
        "it covers the mean of new drives only about half of the time. The bootstrap over drives and trials covers it "
        "95% of the time in a study of full size, 85 to 95% in small ones.",
        "An arrow: the mean lies beyond the scale.",
    )
    return Section("How sure the means are", text, charts=tuple(c for c in charts if c))


def _run_times(file: StudyFile, folder: Path) -> tuple[Section, ...]:
    live = read_timings(folder)
    text = (RUN_TIMES.format(f"{file.paper.get('real_time_limit_ms', 0):g}"),)
    return (Section("Run time", text, (run_times_table(file, live),)),) if live else ()


def _improvements(file: StudyFile) -> str:
    said = [
        f"{c.improvement:.0f}% over {file.label(rival)} ({protocol})"
        for protocol in reversed(file.protocols)
        for rival in ("ukf-defaults", "ukf-datasheet")
        if (c := _comparison(file, protocol, rival)) and c.improvement is not None
    ]
    theirs = file.paper.get("table_1", {}).get(TUNED, {}).get("improvement_percent")
    return "; ".join([*([f"the paper {theirs:.0f}%"] if theirs else []), *said])


def _spread(file: StudyFile, spreads: list[Spread]) -> Section:
    charts = [spread_chart(file, spreads, measure) for measure in (POSITION, HEADING, DRIFT)]
    charts.append(spread_chart(file, spreads, "nis", mark=CONSISTENT))
    text = (
        "One value a drive, the mean over the trials that held it back. Box: quartiles; whiskers: 5 to 95% of drives.",
        "NIS: does a filter know its own errors? Its mean is 2 where it does; above 2 it is too sure of itself, below "
        "too careful. Position alone leaves the covariances' scale open.",
    )
    return Section(
        "Spread over drives, and consistency", text, (consistency_table(file),), tuple(c for c in charts if c)
    )


def _tracks(file: StudyFile, folder: Path) -> tuple[Section, ...]:
    path = folder / "tracks.npz"
    if not path.exists():
        return ()
    lines = tuple(Line(s, _series_label(file, s), look, s in SHOWN) for s, look in STUDY_LOOKS.items())
    text = (
        "Drives that the trial with the lowest training cost held back, and the filters that it tuned on the others.",
    )
    view = TrackView(tuple(load_tracks(path)), lines, f"honest-{TUNED}")
    return (Section("Tracks and errors over time", text, tracks=view),)


def _series_label(file: StudyFile, series: str) -> str:
    protocol, _, method = series.partition("-")
    return (
        file.label(method, protocol) if protocol in file.protocols else file.label(series.replace("_", "-"))
    )


def _comparisons(file: StudyFile) -> Section:
    text = (
        f"{file.label(TUNED)} against every other method, drive by drive. Improvement (equation 5): how much less its "
        "mean error is; its interval is by bootstrap over drives.",
        "p: Wilcoxon's signed-rank test, with Holm's correction over the methods. Effect size: the rank-biserial "
        "correlation; 1 is better on every drive, -1 worse on every drive.",
    )
    return Section("Comparisons", text, comparison_tables(file))


def _conditions(file: StudyFile) -> tuple[Section, ...]:
    table = conditions_table(file)
    text = ("The other measures and methods stand in tables/ of this page's folder.",)
    return (Section("Conditions", text, (table,)),) if table else ()


def _convergence(file: StudyFile) -> Section:
    theirs = file.paper.get("figure_2", {}).get("stable_generation")
    text = (
        "The median over trials, and where 80% of them lie. The diamond: from this generation on the median stays "
        f"within 1% of its last value. In the paper's figure 2 the cost settles at generation {theirs}.",
    )
    return Section("Convergence", text, (convergence_table(file),), convergence_charts(file))
