"""The tables and figures of a study, as files."""

from pathlib import Path

from matplotlib.figure import Figure

from sigmaswarm.experiments.study.config import MAIN
from sigmaswarm.experiments.study.study import Study
from sigmaswarm.files import make_folder, staged_files, write_whole
from sigmaswarm.reports import study_charts as charts
from sigmaswarm.reports import study_tables as views
from sigmaswarm.reports.figures import figure_of, save_both


def save_study(study: Study, folder: Path) -> list[Path]:
    """Write the tables of a study, each as Markdown, LaTeX and CSV, and its figures, each as PNG and SVG."""
    record = study.record
    found = views.study_tables(study.results) | {"runtime": views.runtime_table(record.results, record.live)}
    if record.results.rivals is not None:
        found["runtime-rivals"] = views.rivals_table(record.results, record.rival_times)
    written: list[Path] = []
    with staged_files(folder) as new:
        tables, figures = make_folder(new / "tables"), make_folder(new / "figures")
        for name, table in found.items():
            texts = {"md": table.to_markdown(), "tex": table.to_latex(), "csv": table.to_csv()}
            for ending, text in texts.items():
                written.append(tables / f"{name}.{ending}")
                write_whole(written[-1], text)
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
        ``convergence`` (the paper's Fig. 2), ``trajectory`` (its Fig. 3), ``boxes`` (errors over drives), ``errors``
        (over time) and ``nis``; with rivals ``learning-curve``. No global state of pyplot is touched.
    """
    results, spreads, picture = study.results, study.record.spreads, study.picture
    courses = [
        charts.convergence_chart(results, protocol, [MAIN], log=False) for protocol in results.protocols
    ]
    boxes = [charts.spread_chart(results, spreads, measure, all_rows=True) for measure in views.ERRORS]
    curves = charts.curve_charts(results)
    return {
        "convergence": figure_of(*(c for c in courses if c), size=(10, 4)),
        "trajectory": figure_of(charts.trajectory_chart(picture), size=(6.4, 5.6)),
        "boxes": figure_of(*(c for c in boxes if c), size=(12, 4.6), sharey=True),
        "errors": figure_of(*charts.error_charts(picture), size=(11, 7), columns=2, sharex=True),
        "nis": figure_of(*charts.nis_charts(picture), size=(11, 3.4), sharey=True),
        **({"learning-curve": figure_of(*curves, size=(11, 7), columns=2)} if curves else {}),
    }
