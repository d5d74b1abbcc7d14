"""The tables of a study: as Markdown, LaTeX and CSV, each from the same rows."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from sigmaswarm.files import make_folder, write_whole
from sigmaswarm.study.config import TUNED
from sigmaswarm.study.design import ALL
from sigmaswarm.study.paper import PAPER_RESULTS
from sigmaswarm.study.results import Results
from sigmaswarm.study.scores import LABELS, UNTUNED

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
    ("paper", "pso-ukf", "pso-ukf"),
    ("honest", "pso-ukf", "pso-ukf"),
    *(("honest", method, None) for method in TUNED if method != "pso-ukf"),
)
"""Protocol and method of each row, and which of the paper's rows it stands beside."""
LIVE_NAMES = {"EKF": "ekf", "adaptive UKF": "adaptive-ukf", "UKF": "ukf"}
"""What the paper's rows are called in the timings of the live filters."""


@dataclass(frozen=True, repr=False)
class Table:
    """A table of texts.

    Attributes
    ----------
    name : of its files
    title : str
    header : tuple of str
    rows : tuple of tuple of str
    note : what has to be known to read it
    """

    name: str
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def to_markdown(self) -> str:
        """For README-like pages."""
        lines = [f"**{self.title}**", "", *(_bar(row) for row in (self.header,))]
        lines += [_bar(["---", *["---:"] * (len(self.header) - 1)]), *(_bar(row) for row in self.rows)]
        return "\n".join([*lines, *(["", self.note] if self.note else [])]) + "\n"

    def __repr__(self) -> str:
        return self.to_markdown()

    def _repr_markdown_(self) -> str:
        """What a notebook shows."""
        return self.to_markdown()

    def to_latex(self) -> str:
        """A booktabs table."""
        body = " \\\\\n".join(" & ".join(map(_escaped, row)) for row in self.rows)
        return (
            f"% {self.note}\n\\begin{{table}}\n\\caption{{{_escaped(self.title)}}}\n"
            f"\\begin{{tabular}}{{l{'r' * (len(self.header) - 1)}}}\n\\toprule\n"
            f"{' & '.join(map(_escaped, self.header))} \\\\\n\\midrule\n{body} \\\\\n\\bottomrule\n"
            "\\end{tabular}\n\\end{table}\n"
        )

    def to_csv(self) -> str:
        """For spreadsheets."""
        return pl.DataFrame(list(self.rows), schema=list(self.header), orient="row").write_csv()


def study_tables(results: Results) -> list[Table]:
    """All tables of a study but that of the run time, which no two runs share.

    Parameters
    ----------
    results : Results
        ``study.results``.

    Returns
    -------
    list of Table
        With their names: ``table-1`` to ``table-3`` beside the paper's, ``comparison-honest`` and ``comparison-paper``,
        three of the conditions, ``optimum``. Each has to_markdown(), to_latex() and to_csv(); a notebook shows it as
        it is.
    """
    return [
        table_1(results),
        table_2(results),
        table_3(results),
        comparison_table(results, "honest"),
        comparison_table(results, "paper"),
        *(condition_table(results, m) for m in ("position_rmse_m", "heading_rmse_deg", "outage_drift_m")),
        optimum_table(results),
    ]


def write_tables(out: Path, results: Results) -> None:
    """Write each table three times into OUT/tables; the run time's from timings.json."""
    folder = out / "tables"
    make_folder(folder)
    timings = json.loads((out / "timings.json").read_text())
    for table in [*study_tables(results), runtime_table(timings)]:
        for ending, text in (("md", table.to_markdown()), ("tex", table.to_latex()), ("csv", table.to_csv())):
            write_whole(folder / f"{table.name}.{ending}", text)


def table_texts(results: Results) -> list[str]:
    """What the command prints."""
    return [table.to_markdown() for table in (table_1(results), table_2(results), table_3(results))]


def table_1(results: Results) -> Table:
    """The paper's Table I: RMSE of IMU only, UKF and PSO-UKF, against the GPS and against truth."""
    paper = PAPER_RESULTS["table_1"]
    rows: list[tuple[str, ...]] = []
    for protocol, method, beside in ROWS:
        if beside in paper or method == "raw-gps":
            theirs = _number(paper[beside]["rmse_m"]) if beside else "-"
            ours = [_mean(results, protocol, method, m) for m in ("gps_rmse_m", "position_rmse_m")]
            rows.append((_label(protocol, method), theirs, *ours))
    return Table(
        "table-1",
        "Table I. RMSE, m",
        ("method", "paper", "ours, against the GPS (eq. 4)", "ours, against truth"),
        tuple(rows),
        "Mean over trials on held-out drives. The paper's RMSE is against the GPS that the filter has absorbed.",
    )


def table_2(results: Results) -> Table:
    """RMSE with its spread over trials and three intervals."""
    paper = PAPER_RESULTS["table_2"]
    rows: list[tuple[str, ...]] = []
    for protocol, method, beside in ROWS:
        row = results.summary(protocol, method, "position_rmse_m")
        if row is None:
            continue
        theirs = paper.get(beside)
        said = f"{_number(theirs['rmse_m'])} {_interval(theirs['interval_m'])}" if theirs else "-"
        keys = ("trial_interval", "corrected_t_interval", "bootstrap_interval")
        figures = [_number(row["mean"]), _number(row["sd"]), *(_interval(row[key]) for key in keys)]
        rows.append((_label(protocol, method), said, *figures))
    return Table(
        "table-2",
        "Table II. Position RMSE against truth, m, on held-out drives",
        (
            "method",
            "paper [95%]",
            "mean",
            "SD",
            "mean +- 1.96 SD / sqrt(n)",
            "for new drives: corrected t",
            "for new drives: bootstrap",
        ),
        tuple(rows),
        "The interval over trials (as in the paper) says what optimizer and split leave open; it covers the mean of "
        "new drives only about half of the time. The other two are made for those: in a study of full size the "
        "bootstrap covers it 95% of the time (in small ones 85 to 95%), the corrected t as often or more, as it is too "
        "wide where the optimizer's luck varies much.",
    )


def table_3(results: Results) -> Table:
    """The paper's Table III without the run time."""
    paper = PAPER_RESULTS["table_3"]
    rows: list[tuple[str, ...]] = []
    for protocol, method, beside in ROWS:
        theirs = paper.get(beside)
        pairs: list[str] = []
        for measure, key in (("heading_rmse_deg", "heading_deg"), ("outage_drift_m", "outage_drift_m")):
            row = results.summary(protocol, method, measure)
            ours = "-" if row is None else f"{_number(row['mean'])} {_interval(row['bootstrap_interval'])}"
            pairs += [_number(theirs[key]) if theirs else "-", ours]
        rows.append((_label(protocol, method), *pairs))
    return Table(
        "table-3",
        "Table III. Heading error, deg, and drift over a 5 s outage, m",
        ("method", "heading: paper", "heading: ours", "drift: paper", "drift: ours"),
        tuple(rows),
        "In brackets the 95% interval for new drives (bootstrap over drives and trials). Run times are in runtime.md.",
    )


def comparison_table(results: Results, protocol: str) -> Table:
    """The PSO-UKF against every other method, drive by drive."""
    rows = [
        (
            LABELS[row["against"]],
            f"{_number(row['mean_difference'])} {_interval(row['interval'])}",
            f"{_number(row['improvement'])} {_interval(row['improvement_interval'])}",
            "-" if row["holm_p"] is None else f"{row['holm_p']:.2g}",
            _number(row["rank_biserial"]),
            str(row["n_drives"]),
        )
        for row in results.content["comparisons"]
        if (row["protocol"], row["measure"]) == (protocol, "position_rmse_m")
    ]
    return Table(
        f"comparison-{protocol}",
        f"PSO-UKF under the protocol {protocol} against each other method: position RMSE against truth",
        (
            "against",
            "difference, m",
            "improvement (eq. 5), %",
            "Wilcoxon p (Holm)",
            "rank-biserial",
            "drives",
        ),
        tuple(rows),
        "One value a drive, the mean over the trials that held it back, of drives on which neither ever failed; 95% "
        "intervals by bootstrap over drives; "
        "negative differences and positive improvements are in favor of the PSO-UKF.",
    )


def condition_table(results: Results, measure: str) -> Table:
    """A measure in each condition."""
    places = dict.fromkeys((row["maneuver"], row["environment"]) for row in results.content["summary"])
    cells = [(p, m) for p, m, _ in ROWS if results.summary(p, m, measure)]
    index = {
        (r["protocol"], r["method"], r["maneuver"], r["environment"]): r["mean"]
        for r in results.content["summary"]
        if r["measure"] == measure
    }
    rows = [
        (
            "all" if place == (ALL, ALL) else " ".join(place),
            *(_number(index.get((*cell, *place))) for cell in cells),
        )
        for place in places
    ]
    name = measure.rsplit("_", 1)[0].replace("_", "-")
    title = f"{results.content['measures'][measure]}, in each condition"
    return Table(f"conditions-{name}", title, ("condition", *(_label(*cell) for cell in cells)), tuple(rows))


def optimum_table(results: Results) -> Table:
    """The parameters that the best trial of the PSO-UKF found under each protocol, beside the paper's."""
    o = PAPER_RESULTS["table_1"]["optimum"]
    rows = [("paper", *(f"{o[k]:g}" for k in ("alpha", "beta", "kappa")), f"{o['q']:g}", f"{o['r']:g}", "-")]
    for protocol in ("paper", "honest"):
        own = [t for t in results.content["tunings"] if (t["protocol"], t["method"]) == (protocol, "pso-ukf")]
        best = min(own, key=lambda t: t["cost"])
        p = best["parameters"]
        q, r = (" ".join(f"{v:.2g}" for v in p[k]) for k in ("process_noise", "measurement_noise"))
        figures = (f"{p['alpha']:.2g}", f"{p['beta']:.2g}", f"{p['kappa']:.2g}")
        rows.append((f"ours, {protocol}", *figures, q, r, f"{best['cost']:.3g}"))
    return Table(
        "optimum",
        "What the PSO found, best trial",
        ("protocol", "alpha", "beta", "kappa", "Q per step: x, y, vx, vy, theta", "R", "cost, m"),
        tuple(rows),
    )


def runtime_table(timings: dict[str, Any]) -> Table:
    """ms per update, through the live filter, beside the paper's."""
    rows: list[tuple[str, ...]] = []
    for label, times in timings["live_filter"].items():
        theirs = PAPER_RESULTS["table_3"].get(LIVE_NAMES.get(label))
        said = f"{theirs['update_ms']:.2f}" if theirs else "-"
        rows.append((label, said, f"{times['predict_ms']:.4f}", f"{times['predict_and_update_ms']:.4f}"))
    return Table(
        "runtime",
        "Table III, run time: ms per update",
        ("filter", "paper", "ours, an IMU sample", "ours, an IMU sample that absorbs a fix"),
        tuple(rows),
        "Medians over one drive through the live filter, called from Python, on the machine that ran the study. A "
        "tuned filter costs what a manual one costs. The paper's limit for real time is "
        f"{PAPER_RESULTS['real_time_limit_ms']:g} ms.",
    )


def _label(protocol: str, method: str) -> str:
    return LABELS[method] if protocol == UNTUNED else f"{LABELS[method]} ({protocol})"


def _mean(results: Results, protocol: str, method: str, measure: str) -> str:
    row = results.summary(protocol, method, measure)
    return _number(row["mean"]) if row else "-"


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if abs(value) < 100 else f"{value:,.0f}"


def _interval(pair: Sequence[float | None]) -> str:
    return f"[{_number(pair[0])}, {_number(pair[1])}]"


def _bar(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escaped(text: str) -> str:
    for plain in ("&", "%", "_", "#"):
        text = text.replace(plain, f"\\{plain}")
    return text.replace("+-", "$\\pm$")
