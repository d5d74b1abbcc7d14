"""Figures of a study: the paper's Figs. 2 and 3, the spread of the errors, errors over time, and NIS."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.prepared import prepared
from sigmaswarm.files import make_folder
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.filters.run import Estimate, run_filter, run_innovations
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.report.draw.png import look, new_figure, save_both
from sigmaswarm.report.style import LOOKS, STUDY_LOOKS
from sigmaswarm.scoring.consistency import GATE_95
from sigmaswarm.scoring.tracks import CLOSE_UP as FINE_SCALE
from sigmaswarm.scoring.tracks import sharpest_turn
from sigmaswarm.study.paper import PAPER_RESULTS
from sigmaswarm.study.run import Study
from sigmaswarm.study.scores import LABELS, UNTUNED
from sigmaswarm.study.statistics import drive_means

# Okabe and Ito's blue and orange; the lines differ in style, too.
LINES: dict[str, dict[str, Any]] = {
    "manual": {"color": "#E69F00", "lw": 1.0, "ls": "--", "label": "UKF, manual: defaults"},
    "paper": {**look(STUDY_LOOKS["paper-pso-ukf"]), "label": "PSO-UKF (paper: against the GPS)"},
    "honest": {**look(STUDY_LOOKS["honest-pso-ukf"]), "label": "PSO-UKF (honest: against truth)"},
}


def save_study_figures(study: Study, folder: Path) -> list[Path]:
    """Write all figures of a study, each as PNG and SVG; their paths."""
    make_folder(folder)
    figures = study_figures(study)
    return [path for name, figure in figures.items() for path in save_both(figure, folder / name)]


def study_figures(study: Study) -> dict[str, Figure]:
    """All figures of a study.

    Parameters
    ----------
    study : Study

    Returns
    -------
    dict of str to matplotlib.figure.Figure
        ``convergence`` (the paper's Fig. 2), ``trajectory`` (its Fig. 3), ``boxes`` (errors over drives), ``errors``
        (over time) and ``nis``. No global state of pyplot is touched.
    """
    at = turning_drive(study)
    drive = study.design.drives[at]
    sets = {
        "manual": DEFAULTS,
        "paper": study.drawn("paper", "pso-ukf", at),
        "honest": study.drawn("honest", "pso-ukf", at),
    }
    initial = initial_state(drive)
    estimates = {name: run_filter(drive, p, initial=initial) for name, p in sets.items()}
    return {
        "convergence": convergence(study),
        "trajectory": trajectory(drive, estimates),
        "boxes": boxes(study),
        "errors": errors(drive, estimates),
        "nis": nis(drive, sets),
    }


def turning_drive(study: Study) -> int:
    """Index of the drive that is drawn: the first one of the shown trial's test drives that turns, else its first."""
    _, test = study.design.split(study.shown_trial)
    turning = [i for i in test if study.design.conditions[i][0] == "turns"]
    return (turning or test)[0]


def convergence(study: Study) -> Figure:
    """Best cost after each generation: median and 10 to 90% of the trials (the paper's Fig. 2)."""
    figure, axes = new_figure(10, 4, 1, 2)
    rows = [row for row in study.results.content["convergence"] if row["method"] == "pso-ukf"]
    for ax, protocol in zip(axes, ("paper", "honest"), strict=True):
        line = LINES[protocol]
        for i, row in enumerate(r for r in rows if r["protocol"] == protocol):
            generation = np.arange(1, len(row["median"]) + 1)
            ax.fill_between(generation, row["low"], row["high"], color=line["color"], alpha=0.2, lw=0,
                            label="10 to 90% of the trials" if i == 0 else None)  # fmt: skip
            ax.plot(generation, row["median"], color=line["color"], ls=line["ls"], lw=1.8,
                    label="median" if i == 0 else None)  # fmt: skip
            ax.axvline(row["stable"], color="0.3", lw=1, ls=":",
                       label=f"within 1% from generation {row['stable']}" if i == 0 else None)  # fmt: skip
        theirs = PAPER_RESULTS["figure_2"]["stable_generation"]
        objective = study.results.content["protocols"][protocol]["objective"]
        ax.set(xlabel="generation", ylabel=f"best cost so far ({objective}), m", ylim=(0, None))
        ax.set_title(f"protocol {protocol} (paper's Fig. 2: stable within {theirs})", loc="left", fontsize=9)
        ax.legend(frameon=False, fontsize=8)
    return figure


def trajectory(drive: Drive, estimates: Mapping[str, Estimate]) -> Figure:
    """Truth, GPS, manual and tuned filters where the car turns most (the paper's Fig. 3)."""
    figure, (ax,) = new_figure(6.4, 5.6)
    x0, y0 = sharpest_turn(prepared(drive, estimates["honest"].initial))
    ax.plot(drive.gps.x, drive.gps.y, label="GPS", **look(LOOKS["raw_gps"]))
    for name, estimate in estimates.items():
        ax.plot(estimate.mean[:, 0], estimate.mean[:, 1], **LINES[name])
    if drive.truth is not None:
        ax.plot(drive.truth.x, drive.truth.y, label="truth", **look(LOOKS["truth"]))
    half = FINE_SCALE / 2
    ax.set(xlabel="east, m", ylabel="north, m", aspect="equal", adjustable="datalim")
    ax.set_xlim(x0 - half, x0 + half, auto=True)
    ax.set_ylim(y0 - half, y0 + half, auto=True)
    ax.set_title(f"{drive.name}: the sharpest turn", loc="left")
    ax.legend(frameon=False, fontsize=8)
    return figure


def boxes(study: Study) -> Figure:
    """How the errors of each method spread over the drives: quartiles, and 5 to 95%."""
    measures = ("position_rmse_m", "heading_rmse_deg", "outage_drift_m")
    figure, axes = new_figure(12, 4.6, 1, 3, sharey=True)
    cells = list(study.results.scores.values)
    for ax, measure in zip(axes, measures, strict=True):
        shown = [
            drive_means(study.results.scores.values[c].get(measure, np.full((1, 1), np.nan))) for c in cells
        ]
        data = [values[np.isfinite(values) & (values > 0)] for values in shown]
        drawn = ax.boxplot(data, orientation="horizontal", whis=(5, 95), showfliers=False, patch_artist=True,
                           medianprops={"color": "k"})  # fmt: skip
        for patch, (protocol, _) in zip(drawn["boxes"], cells, strict=True):
            patch.set_facecolor("0.85" if protocol == UNTUNED else LINES[protocol]["color"])
            patch.set_alpha(0.7)
        ax.set(xscale="log", xlabel=study.results.content["measures"][measure])
    names = [LABELS[m] + ("" if p == UNTUNED else f" ({p})") for p, m in cells]
    axes[0].set_yticks(range(1, len(cells) + 1), names, fontsize=8)
    axes[0].invert_yaxis()
    figure.suptitle("One value a drive; box: quartiles, whiskers: 5 to 95%", x=0.01, ha="left", fontsize=10)
    return figure


def errors(drive: Drive, estimates: Mapping[str, Estimate]) -> Figure:
    """Position and heading errors over time, each with the filter's own 3-sigma band."""
    figure, axes = new_figure(11, 7, len(estimates), 2, sharex=True)
    for row, (name, estimate) in enumerate(estimates.items()):
        east, heading = axes[2 * row], axes[2 * row + 1]
        wrong = _wrong(drive, estimate)
        sigma = 3 * np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
        _banded(east, estimate.time, wrong[:, 0], sigma[:, 0], name)
        _banded(heading, estimate.time, np.degrees(wrong[:, 1]), np.degrees(sigma[:, THETA]), name)
        east.set_ylabel("east, m")
        heading.set_ylabel("heading, deg")
        east.set_title(LINES[name]["label"], loc="left", fontsize=9)
    axes[-1].set_xlabel("time, s")
    axes[-2].set_xlabel("time, s")
    figure.suptitle(f"{drive.name}: errors and 3-sigma bands", x=0.01, ha="left", fontsize=10)
    return figure


def _wrong(drive: Drive, estimate: Estimate) -> Array:
    """Error east (m) and of the heading (rad), shape (n, 2)."""
    truth = drive.truth
    if truth is None:  # a study has truth
        return np.full((len(estimate.time), 2), np.nan)
    x = np.interp(estimate.time, truth.time, truth.x)
    theta = np.interp(estimate.time, truth.time, np.unwrap(truth.theta))
    return np.column_stack([estimate.mean[:, 0] - x, wrap_angle(estimate.mean[:, THETA] - theta)])


def _banded(ax: Axes, time: Array, error: Array, sigma: Array, name: str) -> None:
    line = {key: value for key, value in LINES[name].items() if key != "label"}
    ax.fill_between(time, -sigma, sigma, color="0.88", lw=0)
    ax.plot(time, error, **line)
    # The error sets the scale: a band that is far wider would hide it, one far narrower is seen.
    reach = float(np.nanmax(np.abs(error))) if np.isfinite(error).any() else 1.0
    ax.set_ylim(-1.5 * reach - 1e-3, 1.5 * reach + 1e-3)


def nis(drive: Drive, sets: Mapping[str, FilterParameters]) -> Figure:
    """NIS of each filter over time: 95% of a consistent filter's lie below the gate."""
    figure, axes = new_figure(11, 3.4, 1, len(sets), sharey=True)
    for ax, (name, parameters) in zip(axes, sets.items(), strict=True):
        innovations = run_innovations(drive, parameters)
        values = innovations.nis
        ax.plot(innovations.time, values, ".", ms=3, color=LINES[name]["color"])
        ax.axhline(GATE_95, color="0.3", lw=1, ls="--")
        inside = float(np.mean(values < GATE_95))
        ax.set(xlabel="time, s", yscale="log")
        title = f"{LINES[name]['label']}\nmean {np.mean(values):.2f}, {inside:.0%} inside the 95% gate"
        ax.set_title(title, loc="left", fontsize=8)
    axes[0].set_ylabel("NIS (consistent: mean 2)")
    return figure
