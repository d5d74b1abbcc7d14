"""The tables of a study's page: the paper's with ours beside, comparisons, conditions, and what the search found."""

from collections import Counter
from collections.abc import Mapping
from statistics import median
from typing import Any

from sigmaswarm.report.page.study_schema import EVERYWHERE, UNTUNED, StudyFile, Summary, Tuned
from sigmaswarm.report.views.record import Cell, Column, Table
from sigmaswarm.study.tables import LIVE_NAMES, ROWS

TUNED, POSITION, HEADING, DRIFT = "pso-ukf", "position_rmse_m", "heading_rmse_deg", "outage_drift_m"
ERRORS = {POSITION: "position RMSE", HEADING: "heading error", DRIFT: "outage drift"}
TRIALS, DRIVES = "95% over trials, as in the paper", "95% for new drives"
IN_CONDITIONS = (
    (UNTUNED, "raw-gps"),
    (UNTUNED, "ukf-defaults"),
    (UNTUNED, "ukf-datasheet"),
    ("paper", TUNED),
    ("honest", TUNED),
    ("honest", "pso-ekf"),
    ("honest", "pso-planar8"),
)
"""Protocols and methods that have room in the table of conditions."""


def _table(caption: str, columns: list[Column], rows: list[tuple[Cell, ...]], file: StudyFile) -> Table:
    """The tuned filter's rows are those that matter most."""
    tuned = {file.label(TUNED, protocol) for protocol in file.protocols}
    return Table(
        caption, tuple(columns), tuple(rows), frozenset(i for i, r in enumerate(rows) if r[0] in tuned)
    )


def paper_tables(file: StudyFile) -> tuple[Table, ...]:
    """Tables I to III, without the run time."""
    return (_table_1(file), _table_2(file), _table_3(file))


def _table_1(file: StudyFile) -> Table:
    paper = file.paper.get("table_1", {})
    columns = [Column("method"), Column("paper", "m"), Column("ours, against the GPS (equation 4)", "m")]
    rows: list[tuple[Cell, ...]] = []
    for protocol, method, beside in ROWS:
        if beside in paper or method == "raw-gps":
            ours = (_mean(file.mean((protocol, method), m)) for m in ("gps_rmse_m", POSITION))
            rows.append((file.label(method, protocol), paper.get(beside, {}).get("rmse_m"), *ours))
    return _table("Table I. RMSE", [*columns, Column("ours, against truth", "m")], rows, file)


def _table_2(file: StudyFile) -> Table:
    paper = file.paper.get("table_2", {})
    titles = ("method", "paper", "paper's 95%", "ours", "SD over trials", TRIALS)
    rows: list[tuple[Cell, ...]] = []
    for protocol, method, beside in ROWS:
        found, theirs = file.mean((protocol, method), POSITION), paper.get(beside, {})
        if found is not None:
            said = theirs.get("interval_m")
            intervals = (found.trial_interval, found.corrected_t_interval, found.bootstrap_interval)
            row = (theirs.get("rmse_m"), tuple(said) if said else None, found.mean, found.sd, *intervals)
            rows.append((file.label(method, protocol), *row))
    columns = [*map(Column, titles), Column(f"{DRIVES}: corrected t"), Column(f"{DRIVES}: bootstrap")]
    return _table("Table II. Position RMSE against truth, m", columns, rows, file)


def _table_3(file: StudyFile) -> Table:
    paper = file.paper.get("table_3", {})
    columns = [Column("method")]
    for what, unit in (("heading", "deg"), ("drift", "m")):
        columns += [Column(f"{what}, paper", unit), Column(f"{what}, ours", unit), Column(DRIVES)]
    rows: list[tuple[Cell, ...]] = []
    for protocol, method, beside in ROWS:
        row: list[Cell] = []
        for measure, key in ((HEADING, "heading_deg"), (DRIFT, "outage_drift_m")):
            found = file.mean((protocol, method), measure)
            row += [paper.get(beside, {}).get(key), _mean(found), found and found.bootstrap_interval]
        if any(cell is not None for cell in row):
            rows.append((file.label(method, protocol), *row))
    return _table("Table III. Heading error, and drift over a 5 s outage", columns, rows, file)


def run_times_table(file: StudyFile, live: Mapping[str, Mapping[str, float]]) -> Table:
    """The last column of the paper's Table III."""
    titles = ("filter", "paper", "ours, an IMU sample", "ours, an IMU sample that absorbs a fix")
    rows: list[tuple[Cell, ...]] = []
    for name, times in live.items():
        theirs = file.paper.get("table_3", {}).get(LIVE_NAMES.get(name), {}).get("update_ms")
        rows.append((name, theirs, times.get("predict_ms"), times.get("predict_and_update_ms")))
    columns = [Column("filter"), *(Column(title, "ms") for title in titles[1:])]
    return Table("Table III. Run time of an update", tuple(columns), tuple(rows))


def _mean(found: Summary | None) -> float | None:
    return found.mean if found else None


def consistency_table(file: StudyFile) -> Table:
    """Mean NIS of every filter."""
    columns = [*map(Column, ("method", "mean NIS", "SD over trials", DRIVES))]
    found = file.means("nis")
    rows: list[tuple[Cell, ...]] = [
        (file.label(r.method, r.protocol), r.mean, r.sd, r.bootstrap_interval) for r in found
    ]
    return _table("", columns, rows, file)


def comparison_tables(file: StudyFile) -> tuple[Table, ...]:
    """The tuned filter against every other method: a table for each protocol and measure."""
    titles = ("against", "improvement", "95% interval", "p (Holm)", "effect size", "drives")
    columns = tuple(Column(title, "%" if title == "improvement" else "") for title in titles)
    tables: list[Table] = []
    for protocol in reversed(file.protocols):
        for measure, name in ERRORS.items():
            rows = tuple(
                (
                    file.label(c.against),
                    c.improvement,
                    c.improvement_interval,
                    c.holm_p,
                    c.rank_biserial,
                    c.n_drives,
                )
                for c in file.comparisons
                if (c.protocol, c.measure) == (protocol, measure)
            )
            if rows:
                tables.append(Table(f"{file.label(TUNED, protocol)}: {name}", columns, rows))
    return tuple(tables)


def conditions_table(file: StudyFile) -> Table | None:
    """Position RMSE in each condition; None where there is only one."""
    found = {
        (r.maneuver, r.environment, r.protocol, r.method): r.mean
        for r in file.summary
        if r.measure == POSITION
    }
    places = [p for p in dict.fromkeys(key[:2] for key in found) if EVERYWHERE not in p]
    if len(places) < 2:
        return None
    cells = [cell for cell in IN_CONDITIONS if file.mean(cell, POSITION)]
    columns = [Column("maneuver"), Column("environment"), *(Column(file.label(m, p)) for p, m in cells)]
    rows = [(*place, *(found.get((*place, *cell)) for cell in cells)) for place in places]
    return Table("Position RMSE against truth, m", tuple(columns), tuple(rows))


def _kinds(file: StudyFile) -> dict[tuple[str, str, str], list[Tuned]]:
    """All trials of each tuning: by protocol, method and group."""
    kinds: dict[tuple[str, str, str], list[Tuned]] = {}
    for tuned in file.tunings:
        kinds.setdefault((tuned.protocol, tuned.method, tuned.group), []).append(tuned)
    return kinds


def _by_group(caption: str, columns: list[Column], rows: list[tuple[Cell, ...]], file: StudyFile) -> Table:
    """Leaves out the second column, the group of drives, where all drives are one group."""
    if all(row[1] in (EVERYWHERE, "") for row in rows):
        columns, rows = [columns[0], *columns[2:]], [(row[0], *row[2:]) for row in rows]
    return _table(caption, columns, rows, file)


def convergence_table(file: StudyFile) -> Table:
    """Where the median over trials settles."""
    titles = ("method", "drives", "settles at generation", "median cost at the end")
    columns = [*map(Column, titles[:3]), Column(titles[3], "m")]
    rows: list[tuple[Cell, ...]] = [
        (file.label(b.method, b.protocol), b.group, b.stable, b.median[-1]) for b in file.convergence
    ]
    return _by_group("", columns, rows, file)


def trials_table(file: StudyFile) -> Table:
    """How the costs of the trials differ, and which bounds they touch."""
    titles = (
        "method",
        "drives",
        "trials",
        "lowest cost",
        "median cost",
        "highest cost",
        "evaluations",
        "failures",
    )
    columns = [Column(t, "m" if "cost" in t else "") for t in titles]
    columns.append(Column("bounds touched, in how many trials"))
    rows: list[tuple[Cell, ...]] = []
    for (protocol, method, group), own in _kinds(file).items():
        costs = [t.cost for t in own]
        touched = Counter(bound.split()[0] for t in own for bound in t.touched_bounds)
        said = ", ".join(f"{name} {n}" for name, n in touched.most_common()) or "none"
        sums = (sum(t.evaluations for t in own), sum(t.failures for t in own))
        figures = (len(own), min(costs), median(costs), max(costs), *sums, said)
        rows.append((file.label(method, protocol), group, *figures))
    return _by_group("All trials, on their training drives", columns, rows, file)


def optimum_table(file: StudyFile) -> Table:
    """The parameters of the best trial of each tuning, beside the paper's."""
    titles = (
        "method",
        "drives",
        "alpha",
        "beta",
        "kappa",
        "Q per IMU step, in the order of the states",
        "R",
        "cost",
    )
    o: dict[str, Any] = file.paper.get("table_1", {}).get("optimum", {})
    rows: list[tuple[Cell, ...]] = []
    if o:
        rows.append(
            ("the paper's", "", o["alpha"], o["beta"], o["kappa"], f"{o['q']:g}", f"{o['r']:g}", None)
        )
    for (protocol, method, group), own in _kinds(file).items():
        best = min(own, key=lambda t: t.cost)
        p = best.parameters
        q, r = (" ".join(f"{v:.2g}" for v in p[key]) for key in ("process_noise", "measurement_noise"))
        rows.append((file.label(method, protocol), group, p["alpha"], p["beta"], p["kappa"], q, r, best.cost))
    columns = [*map(Column, titles[:-1]), Column(titles[-1], "m")]
    return _by_group("Best trial", columns, rows, file)
