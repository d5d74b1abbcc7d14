"""Charts of a study (means with intervals, spread over drives, convergence, one drive), and the files of a study."""

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.experiments.study.config import ALL, MAIN_METHOD, NO_PROTOCOL, PROTOCOL_LABELS
from sigmaswarm.experiments.study.record import Convergence, CurvePoint, Results, ScoreQuantiles
from sigmaswarm.experiments.study.study import Study
from sigmaswarm.files import make_folder, staged_files, write_atomically
from sigmaswarm.reports import study_tables as tables
from sigmaswarm.reports.figures import (
    Chart,
    as_map,
    band,
    curve,
    figure_of,
    hover_id,
    logarithmic,
    name_rows,
    save_both,
    short_number,
)
from sigmaswarm.reports.study_tables import ELSEWHERE_MEASURES, curve_points
from sigmaswarm.reports.style import CHARCOAL, GREEN, MIST, NO_LINE, ORANGE, SLATE, STUDY_STYLES, STYLES, Look
from sigmaswarm.scoring.consistency import GATE_95
from sigmaswarm.scoring.tracks import CLOSE_UP_SIZE, NIS, Columns, Picture

PROTOCOL_COLORS = {
    NO_PROTOCOL: SLATE,
    "paper": STUDY_STYLES["paper-pso-ukf"].color,
    "honest": STUDY_STYLES["honest-pso-ukf"].color,
}
# Ratio of the end of the scale to the lowest mean; with a longer scale, good methods could not be distinguished.
SCALE_RATIO = 12
DRAWN_FILTERS: dict[str, tuple[str, Look]] = {
    "ukf-defaults": ("UKF, manual: defaults", Look(ORANGE, 1.0, "--")),
    f"paper-{MAIN_METHOD}": ("PSO-UKF (tuned with the fixes)", STUDY_STYLES[f"paper-{MAIN_METHOD}"]),
    f"honest-{MAIN_METHOD}": ("PSO-UKF (tuned with truth)", STUDY_STYLES[f"honest-{MAIN_METHOD}"]),
}
MARK_STYLE = Look(SLATE, 1.0, "--")


def means_chart(
    results: Results, measure: str, reach: float = SCALE_RATIO, mark: float | None = None
) -> Chart | None:
    """Draw the mean of every method with two intervals, on a logarithmic scale up to ``reach`` times the lowest mean.

    A mean beyond the scale is drawn as an arrow with a number and without intervals. ``mark`` is a value that a line
    marks.
    """
    rows = [(row, row.mean) for row in results.means(measure) if row.mean]
    if not rows:
        return None
    means = [mean for _, mean in rows]
    least, most = min(means) / 3, min(min(means) * reach, 2 * max(means))
    names = [results.label(row.method, row.protocol) for row, _ in rows]

    def draw(ax: Axes) -> None:
        if mark is not None:
            ax.axvline(mark, **MARK_STYLE.line)
        for name, width, opacity, label in (
            ("trial_interval", 7.0, 0.4, "95% over trials, as in the paper"),
            ("bootstrap_interval", 1.5, 1.0, "95% for new drives (bootstrap)"),
        ):
            ends = np.array([getattr(row, name) for row, _ in rows], np.float64)
            ends = ends.clip([least, -inf], [inf, most])
            ends[np.isnan(ends).any(axis=1) | (np.array(means) > most)] = np.nan
            ax.hlines(range(len(rows)), *ends.T, color=SLATE, lw=width, alpha=opacity, label=label)
        for i, (row, mean) in enumerate(rows):
            beyond, x = mean > most, min(mean, most)
            look = Look(PROTOCOL_COLORS[row.protocol], 1.2, NO_LINE, ">" if beyond else "o", 6.75)
            hover = (
                f"{names[i]}: {mean:.3g}\n95% for new drives: {_ends(row.bootstrap_interval)}"
                f"\n95% over trials: {_ends(row.trial_interval)}"
            )
            ax.plot(x, i, **look.line, gid=hover_id(hover))
            if beyond:
                place: dict[str, Any] = {"xytext": (-6, 0), "textcoords": "offset points", "ha": "right"}
                ax.annotate(short_number(mean), (x, i), va="center", fontsize=8, **place)
        logarithmic(ax.xaxis)
        ax.set_xlim(least, 1.15 * most)
        name_rows(ax, names)

    return Chart(results.measures[measure], draw, rows=len(rows), broad=True)


def _ends(interval: tuple[float | None, float | None]) -> str:
    low, high = interval
    return "–" if low is None or high is None else f"{low:.3g} to {high:.3g}"


def quantile_chart(
    results: Results,
    quantiles: Sequence[ScoreQuantiles],
    measure: str,
    mark: float | None = None,
    *,
    all_rows: bool = False,
) -> Chart | None:
    """Draw box plots over drives (box: quartiles; whiskers: 5th and 95th percentiles) with a logarithmic axis.

    If ``all_rows`` is True, methods without this measure have empty rows.
    """
    rows = [s for s in quantiles if s.measure == measure and s.high > 0]
    if not rows:
        return None
    names = list(
        dict.fromkeys(results.label(s.method, s.protocol) for s in (quantiles if all_rows else rows))
    )

    def draw(ax: Axes) -> None:
        if mark is not None:
            ax.axvline(mark, **MARK_STYLE.line)
        for protocol in dict.fromkeys(s.protocol for s in rows):
            own = [s for s in rows if s.protocol == protocol]
            boxes = [
                {"whislo": s.low, "q1": s.first, "med": s.median, "q3": s.third, "whishi": s.high}
                for s in own
            ]
            ax.bxp(
                boxes,
                positions=[names.index(results.label(s.method, protocol)) for s in own],
                orientation="horizontal",
                widths=0.5,
                showfliers=False,
                patch_artist=True,
                medianprops={"color": "k"},
                boxprops={"facecolor": PROTOCOL_COLORS[protocol], "alpha": 0.6},
                manage_ticks=False,
            )
        logarithmic(ax.xaxis)
        name_rows(ax, names)

    failed = sum(s.failed for s in rows)
    note = f" (without {failed} values of failed filters)" if failed else ""
    return Chart(f"{results.measures[measure]}{note}", draw, rows=len(names), broad=True)


def convergence_chart(
    results: Results, protocol: str, methods: Sequence[str] = (), *, log: bool = True
) -> Chart | None:
    """Draw the lowest cost so far over the generations (the paper's Fig. 2), for all or some methods."""
    shown = [c for c in results.convergence if c.protocol == protocol and c.method in (methods or [c.method])]
    if any(c.group != ALL for c in shown):  # with one line per condition, there is room for one method only
        shown = [c for c in shown if c.method == shown[0].method]
    if not shown:
        return None

    def draw(ax: Axes) -> None:
        for course in shown:
            _draw_course(ax, results, course, alone=len(shown) == 1)
        ax.set(xlabel="generation", ylabel=f"cost: {results.protocols[protocol].objective}, m")
        if log:
            logarithmic(ax.yaxis)
        else:
            ax.set_ylim(0, None)

    return Chart(f"Cost over generations, {PROTOCOL_LABELS.get(protocol, protocol)}", draw)


def _draw_course(ax: Axes, results: Results, course: Convergence, *, alone: bool) -> None:
    """Draw the median and the middle 80% of the trials, and mark the generation `Convergence.stable`."""
    key = f"{course.protocol}-{course.method}"
    color = STUDY_STYLES[key].color if key in STUDY_STYLES else GREEN
    whole, settles = course.group == ALL, course.stable
    quantiles = course.low, course.median, course.high
    low, middle, high = ([inf if v is None else v for v in values] for values in quantiles)
    x, theirs = range(1, len(middle) + 1), results.paper["figure_2"]["stable_generation"]
    if whole:
        spread = "10th to 90th percentile of the trials" if alone else ""
        band(ax, x, low, high, Look(color, opacity=0.15), spread)
    name = "median" if alone else results.label(course.method) if whole else course.group
    curve(ax, x, middle, Look(color, 2.0), name)
    diamond = Look(color, 1.2, NO_LINE, "D", 6.75).line
    label = f"from generation {settles} within 1% of the last value (paper: {theirs})" if alone else ""
    hover = hover_id(f"from generation {settles} onward within 1% of the last value")
    ax.plot(settles, middle[settles - 1], **diamond, gid=hover, label=label)


def curve_charts(results: Results) -> tuple[Chart, ...]:
    rivals = results.rivals
    if rivals is None:
        return ()

    def chart(measure: str, points: Sequence[Sequence[CurvePoint]]) -> Chart:
        def draw(ax: Axes) -> None:
            for own in points:
                x, look = [p.minutes for p in own], STYLES[own[0].method]
                mean, low, high = np.array([(p.mean, *p.interval) for p in own], np.float64).T
                band(ax, x, low, high, Look(look.color, opacity=0.15))
                curve(ax, x, mean, Look(look.color, 2.0, look.style, "o"), results.label(own[0].method))
            ax.set(xlabel="minutes of training data; 0: filter without network", ylim=(0.0, None))

        return Chart(results.measures[measure], draw, broad=True)

    charts: list[Chart] = []
    methods = dict.fromkeys(point.method for point in rivals.curve)
    for measure in ELSEWHERE_MEASURES:
        curves = [curve_points(rivals, method, measure) for method in methods]
        known = [[p for p in points if p.mean is not None] for points in curves]
        if points := [own for own in known if own]:
            charts.append(chart(measure, points))
    return tuple(charts)


def trajectory_chart(picture: Picture) -> Chart:
    def draw(ax: Axes) -> None:
        named = {"raw_gps": ("GPS", STYLES["raw_gps"]), **DRAWN_FILTERS, "truth": ("truth", STYLES["truth"])}
        for series, (name, look) in named.items():
            curve(ax, picture.close[series]["x"], picture.close[series]["y"], look, name)
        (x, y), half = picture.turn, CLOSE_UP_SIZE / 2
        as_map(ax, (x - half, x + half), (y - half, y + half))

    return Chart(f"{picture.whole.name}: the sharpest turn", draw)


def error_charts(picture: Picture) -> tuple[Chart, ...]:

    def chart(title: str, columns: Columns, look: Look, what: str, *, last: bool) -> Chart:
        def draw(ax: Axes) -> None:
            signed = what == "heading"
            time, error, sigma = columns["time"], columns[f"{what}_error"], columns[f"{what}_3sigma"]
            band(ax, time, -sigma if signed else np.zeros(len(time)), sigma, Look(MIST))
            curve(ax, time, error, look)
            known = np.abs(error[np.isfinite(error)])
            # The error sets the scale, since the band may be wide.
            reach = 1.5 * float(known.max()) + 1e-3 if len(known) else 1.5
            ax.set(xlabel="time, s" if last else "", ylabel=f"{what}, {'deg' if signed else 'm'}")
            ax.set_ylim(-reach if signed else 0.0, reach)

        return Chart(title, draw)

    charts: list[Chart] = []
    for series, (name, look) in DRAWN_FILTERS.items():
        columns, last = picture.whole.series[series], series == list(DRAWN_FILTERS)[-1]
        title = "" if charts else f"{picture.whole.name}: errors and 3 sigma"
        charts.append(chart(name, columns, look, "position", last=last))
        charts.append(chart(title, columns, look, "heading", last=last))
    return tuple(charts)


def nis_charts(picture: Picture) -> tuple[Chart, ...]:

    def chart(name: str, look: Look, columns: Columns) -> Chart:
        def draw(ax: Axes) -> None:
            curve(ax, columns["time"], columns["nis"], Look(look.color, 0.0, NO_LINE, ".", 3.0))
            ax.axhline(GATE_95, **Look(CHARCOAL, 1.0, "--").line)
            ax.set(xlabel="time, s", ylabel="NIS (consistent: mean 2)")
            logarithmic(ax.yaxis)

        nis = columns["nis"]
        inside = float(np.mean(nis < GATE_95))
        return Chart(f"{name}\nmean {np.mean(nis):.2f}, {inside:.0%} inside the 95% gate", draw)

    tracks = picture.whole.series  # without NIS of a failed filter
    return tuple(chart(*of, tracks[key + NIS]) for key, of in DRAWN_FILTERS.items() if key + NIS in tracks)


def save_study(study: Study, folder: Path) -> list[Path]:
    """Write the tables of a study as Markdown, LaTeX and CSV, and its figures as PNG and SVG. Return the paths."""
    record = study.record
    tables_by_name = tables.study_tables(study.results)
    tables_by_name["runtime"] = tables.runtime_table(record.results, record.live)
    if record.results.rivals is not None:
        tables_by_name["runtime-rivals"] = tables.rivals_table(record.results, record.rival_times)
    written: list[Path] = []
    with staged_files(folder) as new:
        texts_in, figures = make_folder(new / "tables"), make_folder(new / "figures")
        for name, table in tables_by_name.items():
            texts = {"md": table.to_markdown(), "tex": table.to_latex(), "csv": table.to_csv()}
            for ending, text in texts.items():
                written.append(texts_in / f"{name}.{ending}")
                write_atomically(written[-1], text)
        for name, figure in study_figures(study).items():
            written += save_both(figure, figures / name)
    return [folder / file.relative_to(new) for file in written]


def study_figures(study: Study) -> dict[str, Figure]:
    """Draw all figures of a study.

    Parameters
    ----------
    study : Study

    Returns
    -------
    dict of str to matplotlib.figure.Figure
        ``convergence`` (the paper's Fig. 2), ``trajectory`` (the paper's Fig. 3), ``boxes`` (errors over drives),
        ``errors`` (over time) and ``nis``. With rivals also ``learning-curve``.
    """
    results, quantiles, picture = study.results, study.record.quantiles, study.picture
    courses = [convergence_chart(results, name, [MAIN_METHOD], log=False) for name in results.protocols]
    boxes = [quantile_chart(results, quantiles, measure, all_rows=True) for measure in tables.ERRORS]
    curves = curve_charts(results)
    return {
        "convergence": figure_of(*(c for c in courses if c), size=(10, 4)),
        "trajectory": figure_of(trajectory_chart(picture), size=(6.4, 5.6)),
        "boxes": figure_of(*(c for c in boxes if c), size=(12, 4.6), sharey=True),
        "errors": figure_of(*error_charts(picture), size=(11, 7), columns=2, sharex=True),
        "nis": figure_of(*nis_charts(picture), size=(11, 3.4), sharey=True),
        **({"learning-curve": figure_of(*curves, size=(11, 7), columns=2)} if curves else {}),
    }
