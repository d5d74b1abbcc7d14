"""Figures of a tuning and of an evaluation."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.errors import InputError
from sigmaswarm.files import make_folder, write_json, write_whole
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_innovations
from sigmaswarm.report.draw.png import look, new_figure, save
from sigmaswarm.report.style import LOOKS, labels_for
from sigmaswarm.report.tracks import errors_of, estimates, three_sigma
from sigmaswarm.scoring.consistency import GATE_95, judged
from sigmaswarm.scoring.evaluation import METHODS, Evaluation
from sigmaswarm.tuning.result import Tuning

FINE_SCALE = 50.0
"""m: side of the close-up of a track."""


def save_tuning_figures(tuning: Tuning, drives: Sequence[Drive], folder: Path) -> list[Path]:
    """Write convergence.csv and the figures of a tuning into its folder; the pictures' paths."""
    lines = ["trial,generation,best_cost,median_cost"]
    for i, trial in enumerate(tuning.trials):
        pairs = zip(trial.best, trial.median, strict=True)
        lines += [f"{i},{g},{best!r},{median!r}" for g, (best, median) in enumerate(_floats(pairs), 1)]
    write_whole(folder / "convergence.csv", "\n".join(lines) + "\n")
    pictures = [save(convergence(tuning), folder / "convergence.png")]
    pictures.append(save(tracks(drives[0], tuning.parameters), folder / "training-track.png"))
    return pictures


def _floats(pairs: "zip[tuple[np.float64, np.float64]]") -> list[tuple[float, float]]:
    return [(float(a), float(b)) for a, b in pairs]


def save_evaluation(
    evaluation: Evaluation, parameters: FilterParameters, drives: Sequence[Drive], folder: Path
) -> list[Path]:
    """Write scores.json, scores.csv and figures of an evaluation; the paths of all files."""
    make_folder(folder)
    written = [folder / "scores.json", folder / "scores.csv"]
    write_json(written[0], evaluation.to_dict())
    write_whole(written[1], evaluation.to_frame().write_csv())
    written.append(save(comparison(evaluation), folder / "comparison.png"))
    for name, drive in zip(evaluation.scores, drives, strict=True):
        stem = name.replace("/", "-")
        written.append(save(tracks(drive, parameters), folder / f"{stem}-track.png"))
        if evaluation.consistency[name]:
            written.append(save(consistency_figure(drive, parameters), folder / f"{stem}-consistency.png"))
        if drive.truth is not None:
            written.append(save(errors(drive, parameters), folder / f"{stem}-error.png"))
    return written


def convergence(tuning: Tuning) -> Figure:
    """Best cost so far and median cost of the swarm against generations (the paper's Fig. 2)."""
    figure, (ax,) = new_figure(6.4, 4.0)
    lowest = min(float(trial.best.min()) for trial in tuning.trials)
    scale = "log" if lowest > 0 else "linear"  # a likelihood may be negative
    for i, trial in enumerate(tuning.trials):
        generation = np.arange(1, len(trial.best) + 1)
        first = i == tuning.best_trial
        alpha = 1.0 if first else 0.35
        ax.plot(generation, trial.best, color="#0072B2", lw=2 if first else 1, alpha=alpha,
                label="best so far" if first else None)  # fmt: skip
        finite = np.where(np.isfinite(trial.median), trial.median, np.nan)
        ax.plot(generation, finite, color="#E69F00", lw=1, ls="--", alpha=alpha,
                label="median of the generation" if first else None)  # fmt: skip
    ax.set(xlabel="generation", ylabel=f"cost: {tuning.config.objective}", yscale=scale)
    for axis_format in (ax.yaxis.set_major_formatter, ax.yaxis.set_minor_formatter):
        axis_format("{x:g}")
    n = len(tuning.trials)
    ax.set_title(f"Convergence, {n} trials (the best one strong)" if n > 1 else "Convergence", loc="left")
    ax.legend(frameon=False)
    return figure


def tracks(drive: Drive, parameters: FilterParameters) -> Figure:
    """The whole track, and a close-up where the car turns most (the paper's Fig. 3)."""
    initial, labels = initial_state(drive), labels_for(parameters)
    believed = estimates(drive, parameters, initial)
    figure, (whole, close) = new_figure(11, 5.4, 1, 2)
    x0, y0 = place_of_sharpest_turn(drive, believed["tuned"])
    for ax in (whole, close):
        ax.plot(drive.gps.x, drive.gps.y, label=labels["raw_gps"], **look(LOOKS["raw_gps"]))
        for name, estimate in believed.items():
            ax.plot(estimate.mean[:, 0], estimate.mean[:, 1], label=labels[name], **look(LOOKS[name]))
        if drive.truth is not None:  # on top: the tuned filter's line is wider
            ax.plot(drive.truth.x, drive.truth.y, label=labels["truth"], **look(LOOKS["truth"]))
        ax.set(xlabel="east, m", ylabel="north, m", aspect="equal", adjustable="datalim")
    whole.plot(*initial.mean[:2], "k^", ms=7, label="start")
    half = FINE_SCALE / 2
    whole.plot(
        x0 + half * np.array([-1, 1, 1, -1, -1]), y0 + half * np.array([-1, -1, 1, 1, -1]), "0.4", lw=0.8
    )
    _frame_on(whole, drive)
    close.set_xlim(x0 - half, x0 + half, auto=True)  # auto: equal axes may widen one, without a warning
    close.set_ylim(y0 - half, y0 + half, auto=True)
    whole.set_title(drive.name, loc="left")
    close.set_title("close-up of the sharpest turn", loc="left")
    handles = whole.get_legend_handles_labels()
    figure.legend(*handles, frameon=False, fontsize=8, ncols=6, loc="outside lower center")
    return figure


def errors(drive: Drive, parameters: FilterParameters) -> Figure:
    """Position and heading error over time, with the tuned filter's own 3-sigma bounds."""
    believed, labels = estimates(drive, parameters, initial_state(drive)), labels_for(parameters)
    figure, (position, heading) = new_figure(9, 6, 2, 1, sharex=True)
    if drive.truth is None:
        raise InputError(f"{drive.name}: has no truth, so there is no error to draw")
    tuned = believed["tuned"]
    radius, sigma = three_sigma(tuned)
    position.plot(tuned.time, radius, color="0.6", lw=1, label=f"3 sigma of the {labels['tuned']}")
    heading.fill_between(tuned.time, -sigma, sigma, color="0.9")
    for name, estimate in believed.items():
        distance, wrong = errors_of(estimate, drive.truth)
        position.plot(estimate.time, distance, label=labels[name], **look(LOOKS[name]))
        heading.plot(estimate.time, wrong, **look(LOOKS[name]))
    # From centimetres to hundreds of metres: only a logarithmic scale shows all methods.
    position.set(ylabel="position error, m", yscale="log", ylim=(0.03, None))
    heading.set(ylabel="heading error, deg", xlabel="time, s", ylim=(-30, 30))
    position.set_title(f"{drive.name}: error against truth", loc="left")
    figure.legend(
        *position.get_legend_handles_labels(), frameon=False, fontsize=8, ncols=4, loc="outside lower left"
    )
    return figure


def comparison(evaluation: Evaluation) -> Figure:
    """Bars of the mean scores of each method, where there are any: without truth no errors; logarithmic."""
    titles = {
        "position_rmse_m": "position RMSE, m",
        "heading_rmse_deg": "heading error, deg",
        "outage_drift_m": "drift over an outage, m",
    }
    values = {t: {m: v for m in METHODS if (v := evaluation.mean(m, t))} for t in titles}
    told = {measure: shown for measure, shown in values.items() if shown}
    n = max(len(told), 1)
    figure, axes = new_figure(11 if n > 1 else 6.4, 3.4, 1, n)
    if not told:
        axes[0].set_axis_off()
        axes[0].text(0.5, 0.5, "nothing can be compared: no truth, and no outage fits", ha="center")
    for ax, (measure, shown) in zip(axes, told.items(), strict=bool(told)):
        for i, (method, value) in enumerate(shown.items()):
            ax.barh(i, value, color=LOOKS[method].color)
            ax.annotate(f" {value:.3g}", (value, i), va="center", fontsize=8)
        ax.set(xscale="log", title=titles[measure])
        ax.set_yticks(range(len(shown)), [evaluation.names[m] for m in shown], fontsize=8)
        ax.invert_yaxis()
        ax.margins(x=0.25)
    return figure


def consistency_figure(drive: Drive, parameters: FilterParameters) -> Figure:
    """NIS of the tuned filter over time and as a histogram, and the autocorrelation of its innovations."""
    innovations = run_innovations(drive, parameters)
    found = judged(innovations)
    if found is None:
        raise InputError(f"{drive.name}: the filter failed or saw too few fixes to judge its consistency")
    nis = innovations.nis
    figure, (over_time, histogram, lags) = new_figure(11, 3.4, 1, 3)
    over_time.plot(innovations.time, nis, ".", ms=3, color=LOOKS["tuned"].color)
    over_time.axhline(GATE_95, color="0.3", lw=1, ls="--")
    over_time.annotate("95% gate", (innovations.time[0], GATE_95), fontsize=8, va="bottom")
    over_time.set(xlabel="time, s", ylabel="NIS", yscale="log", ylim=(1e-2, None))
    over_time.set_title(f"{drive.name}: {found.inside_gate:.1%} inside", loc="left")
    edges: list[float] = np.linspace(0, max(12.0, float(np.quantile(nis, 0.98))), 30).tolist()
    histogram.hist(np.minimum(nis, edges[-1]), edges, density=True, color="0.8", edgecolor="0.6")
    middle = (np.array(edges[1:]) + np.array(edges[:-1])) / 2
    histogram.plot(middle, np.exp(-middle / 2) / 2, color="k", lw=1.2, label="consistent filter")
    low, high = found.nis_band
    histogram.set(xlabel="NIS (the last bar: and above)", ylabel="share per unit")
    histogram.set_title(f"mean {found.mean_nis:.2f}, consistent: {low:.2f} to {high:.2f}", loc="left")
    histogram.legend(frameon=False, fontsize=8)
    at = np.arange(1, len(found.autocorrelation) + 1)
    lags.axhspan(-found.white_band, found.white_band, color="0.9")
    lags.axhline(0, color="0.5", lw=0.8)
    lags.vlines(at, 0, found.autocorrelation, color=LOOKS["tuned"].color, lw=3)
    lags.set(xlabel="fixes apart", ylabel="autocorrelation", ylim=(-1, 1))
    lags.set_title("innovations (grey: white, 95%)", loc="left")
    return figure


def place_of_sharpest_turn(drive: Drive, estimate: Estimate) -> Array:
    """Where the car turns most within 4 s while a filter runs, m east and north."""
    turned = np.concatenate([[0.0], np.cumsum(drive.imu.gz[1:] * np.diff(drive.imu.time))])
    t = estimate.time
    inside = t[(t > t[0] + 2) & (t < t[-1] - 2)]
    if not len(inside):
        return estimate.mean[len(t) // 2, :2]
    change = np.abs(
        np.interp(inside + 2, drive.imu.time, turned) - np.interp(inside - 2, drive.imu.time, turned)
    )
    at = inside[int(np.argmax(change))]
    return np.array([np.interp(at, drive.gps.time, drive.gps.x), np.interp(at, drive.gps.time, drive.gps.y)])


def _frame_on(ax: Axes, drive: Drive) -> None:
    """Show the fixes and 8% around them: a filter that runs away must not set the scale."""
    low = np.array([drive.gps.x.min(), drive.gps.y.min()])
    high = np.array([drive.gps.x.max(), drive.gps.y.max()])
    margin = 0.08 * float((high - low).max())
    ax.set_xlim(low[0] - margin, high[0] + margin, auto=True)
    ax.set_ylim(low[1] - margin, high[1] + margin, auto=True)
