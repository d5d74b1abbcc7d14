"""The page of a study: every method under both protocols, over many trials, with its intervals."""

from pathlib import Path

from sigmaswarm.report.page.record import Cell, Column, Figure, Report, Section, Table
from sigmaswarm.report.page.schema import load
from sigmaswarm.report.page.study_charts import convergence_charts, means_chart
from sigmaswarm.report.page.study_schema import (
    EVERYWHERE,
    UNKNOWN,
    Comparison,
    StudyFile,
    Summary,
    TuningConfig,
)

BANDS = "The median over trials, and where 80% of them lie."
TUNED, POSITION = "pso-ukf", "position_rmse_m"
RIVALS = ("ukf-datasheet", "ukf-defaults", "raw-gps")


def study_report(folder: Path) -> Report:
    """Read the folder of a `sigmaswarm study`."""
    file = load(StudyFile, folder / "results.json")
    trials = file.config.get("trials", len({t.trial for t in file.tunings}))
    return Report(
        title=f"Study: {trials} trials on {file.drives.count} drives",
        lead=tuple(_result(file, protocol) for protocol in reversed(file.protocols)),
        figures=_figures(file),
        remarks=_remarks(file),
        sections=(
            _means(file),
            _comparisons(file),
            _conditions(file),
            Section("Convergence", (BANDS,), charts=convergence_charts(file)),
            _tunings(file),
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


def _of(file: StudyFile, protocol: str, method: str, measure: str) -> Summary | None:
    return next((r for r in file.means(measure) if (r.protocol, r.method) == (protocol, method)), None)


def _result(file: StudyFile, protocol: str) -> str:
    """What tuning is worth under a protocol, in a sentence."""
    asked = file.protocols[protocol]
    found = _of(file, protocol, TUNED, POSITION)
    name = file.label(TUNED)
    start = f"Tuned for {asked.get('objective', '?')} (the {protocol} protocol), {name}"
    if found is None or found.mean is None:
        return f"{start} failed on drives that it did not see."
    low, high = found.drive_interval or UNKNOWN
    where = f"is {found.mean:.3g} m{_range(low, high)} from the truth on drives that it did not see"
    against = [
        _against(file, c)
        for rival in RIVALS
        for c in file.comparisons
        if (c.protocol, c.measure, c.against) == (protocol, POSITION, rival)
    ]
    return f"{start} {where}{': ' if against else ''}{'; '.join(against)}."


def _against(file: StudyFile, c: Comparison) -> str:
    if c.improvement is None:
        return f"not to be compared with {file.label(c.against)}"
    return (
        f"{abs(c.improvement):.0f}% {'less' if c.improvement >= 0 else 'MORE'} than {file.label(c.against)}"
    )


def _range(low: float | None, high: float | None) -> str:
    return "" if low is None or high is None else f" (95% interval {low:.3g} to {high:.3g})"


def _figures(file: StudyFile) -> tuple[Figure, ...]:
    figures: list[Figure] = []
    for protocol in reversed(file.protocols):
        found = _of(file, protocol, TUNED, POSITION)
        if found is not None and found.mean is not None:
            sd = "" if found.sd is None else f"SD over trials {found.sd:.2g} m"
            figures.append(Figure(f"position RMSE, {protocol}", f"{found.mean:.3g} m", sd))
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


def _means(file: StudyFile) -> Section:
    titles = ("protocol", "method", "mean", "SD over trials", "from", "to", "drives")
    tables: list[Table] = []
    for measure, meaning in file.measures.items():
        rows = file.means(measure)
        cells: list[tuple[Cell, ...]] = [
            (r.protocol, file.label(r.method), r.mean, r.sd, *(r.drive_interval or UNKNOWN), r.n_drives)
            for r in rows
        ]
        strong = frozenset(i for i, r in enumerate(rows) if r.method == TUNED)
        tables.append(Table(meaning, tuple(map(Column, titles)), tuple(cells), strong))
    text = (
        "Means over trials, each on the drives that it held back. From and to: the 95% interval for drives that were "
        "never seen (corrected resampled t).",
    )
    charts = [means_chart(file, measure, TUNED) for measure in file.measures if measure != "nis"]
    return Section("Results", text, tuple(tables), tuple(c for c in charts if c))


def _comparisons(file: StudyFile) -> Section:
    titles = (
        "protocol",
        "measure",
        "against",
        "improvement",
        "from",
        "to",
        "p (Holm)",
        "effect size",
        "drives",
    )
    columns = [*map(Column, titles)]
    columns[3] = Column("improvement", "%")
    rows = tuple(
        (
            c.protocol,
            file.measures.get(c.measure, c.measure),
            file.label(c.against),
            c.improvement,
            *(c.improvement_interval or UNKNOWN),
            c.holm_p,
            c.rank_biserial,
            c.n_drives,
        )
        for c in file.comparisons
    )
    text = (
        f"{file.label(TUNED)} against every other method, drive by drive.",
        "p: Wilcoxon's signed-rank test, with Holm's correction over the methods. Effect size: the rank-biserial "
        "correlation; 1 is better on every drive, -1 worse on every drive.",
    )
    return Section("Comparisons", text, (Table("", tuple(columns), rows),))


def _conditions(file: StudyFile) -> Section:
    columns = (*map(Column, ("maneuver", "environment", "protocol", "method")), Column("position RMSE", "m"))
    rows = [r for r in file.summary if r.measure == POSITION and r.maneuver != EVERYWHERE]
    cells = tuple((r.maneuver, r.environment, r.protocol, file.label(r.method), r.mean) for r in rows)
    strong = frozenset(i for i, r in enumerate(rows) if r.method == TUNED)
    return Section("Conditions", (), (Table("", columns, cells, strong),))


def _tunings(file: StudyFile) -> Section:
    titles = ("protocol", "method", "group", "trial", "cost", "evaluations", "failures", "touched bounds")
    rows = tuple(
        (
            t.protocol,
            file.label(t.method),
            t.group,
            t.trial,
            t.cost,
            t.evaluations,
            t.failures,
            ", ".join(b.split()[0] for b in t.touched_bounds),
        )
        for t in file.tunings
    )
    return Section("Tunings", (), (Table("", tuple(map(Column, titles)), rows),))
