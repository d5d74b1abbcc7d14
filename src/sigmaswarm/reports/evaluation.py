"""Files and pictures of an evaluation: bars of the methods, consistency, tracks and errors over time."""

from collections.abc import Callable, Mapping
from itertools import accumulate
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sigmaswarm.drives.overlap import TRAINING_DATA_FILE
from sigmaswarm.errors import InputError
from sigmaswarm.files import DETAILS_FILE, staged_files, write_atomically
from sigmaswarm.reports.figures import (
    Chart,
    as_map,
    band,
    curve,
    figure_of,
    logarithmic,
    name_rows,
    save,
    short_number,
    show_time,
)
from sigmaswarm.reports.style import (
    BLACK,
    BLUE,
    CHARCOAL,
    GREEN,
    GREY,
    LABELS,
    MIST,
    NO_LINE,
    ORANGE,
    PURPLE,
    SILVER,
    STYLES,
    Look,
    many_styles,
)
from sigmaswarm.scoring.consistency import GATE_95
from sigmaswarm.scoring.evaluation import DriveResult, Evaluation
from sigmaswarm.scoring.methods import FIXES, Measure, with_outages
from sigmaswarm.scoring.records import EVALUATION, EVALUATION_FILE, write_checksums
from sigmaswarm.scoring.tracks import CLOSE_UP_SIZE, MOVED, SHARES, Columns, Picture, Tracks
from sigmaswarm.scoring.view import EvaluationView
from sigmaswarm.tuning.record import FILE, HISTORY_FILE, filter_file
from sigmaswarm.wording import list_names

DRAWING_ORDER = [name for name, look in reversed(STYLES.items()) if look.visible]
"""Series of a track from bottom to top. The truth is drawn above the tuned filter, whose line is wider."""
HEADING_LIMITS = 1.0, 30.0  # deg, smallest and largest end of the axis; diverged filters have larger errors


def save_evaluation(
    evaluation: Evaluation,
    folder: Path,
    tuning: Path | None = None,
    save_network: Callable[[Path], list[Path]] | None = None,
    details: str = "",
) -> list[Path]:
    """Write the records and pictures of an evaluation into a folder. Return the paths of all files.

    ``tuning``: the evaluated tuning.toml or its folder; the tuning is also copied. ``save_network`` writes a copy of
    the evaluated network into a folder. ``details``: the content of details.txt; "" for no such file.
    """
    with staged_files(folder, EVALUATION, EVALUATION_FILE) as new:
        written = [*evaluation.save(new), save(comparison(evaluation), new / "comparison.png")]
        labels = LABELS | dict(evaluation.names)
        for name, result in evaluation.drives.items():
            figures = {
                "track": result.picture and tracks(result.picture, labels),
                "consistency": consistency(name, result),
                "error": result.picture and errors(result.picture, labels),
            }
            stem = name.replace("/", "-")
            written += [save(f, new / f"{stem}-{kind}.png") for kind, f in figures.items() if f]
        written += copy_tuning(tuning, new) if tuning else []
        written += save_network(new) if save_network else []
        if details:
            write_atomically(new / DETAILS_FILE, details)
            written.append(new / DETAILS_FILE)
        write_checksums(new)
    return [folder / file.relative_to(new) for file in written]


def copy_tuning(tuning: Path, folder: Path) -> list[Path]:
    """Copy tuning.toml, convergence.csv and seen.npz of a tuning into a folder. Return the paths of the copies."""
    file = filter_file(tuning)
    written: list[Path] = []
    for name in (FILE, HISTORY_FILE, TRAINING_DATA_FILE):
        source = file if name == FILE else file.parent / name
        if source.is_file():
            write_atomically(folder / name, source.read_bytes())
            written.append(folder / name)
    return written


def track_figure(evaluation: Evaluation, drive: str) -> Figure:
    result = evaluation.drives.get(drive)
    if result is None or result.picture is None:
        raise InputError(f"no track of {drive!r}; choose from {list_names(evaluation.drives)}")
    return tracks(result.picture, LABELS | dict(evaluation.names))


def comparison(evaluation: Evaluation) -> Figure:
    charts = method_bars(evaluation.view, titled=True)
    if not charts:
        figure = figure_of(Chart("", Axes.set_axis_off), size=(6.4, 3.4))
        why = "nothing can be compared, since there is no truth and the drives are too short for an outage"
        figure.axes[0].text(0.5, 0.5, why, ha="center")
        return figure
    columns = min(len(charts), 3)
    rows = -(-len(charts) // columns)
    return figure_of(*charts, size=(11 if columns > 1 else 6.4, 3.4 * rows), columns=columns)


def method_bars(view: EvaluationView, *, titled: bool = False) -> tuple[Chart, ...]:
    """Draw the mean of every method over the drives as a bar, one chart per measure.

    The methods "IMU only" and "fixes alone" do not affect the scale. A bar beyond the scale is cut and has an arrow. If
    ``titled`` is True, the unit of the measure is in the title of the chart, and the axis has no label.
    """

    def bars(measure: Measure, values: Mapping[str, float]) -> Chart:
        scaling = [v for m, v in values.items() if m not in ("imu_only", FIXES)]
        longest = 1.25 * max(scaling or values.values())

        def draw(ax: Axes) -> None:
            shown = [min(v, longest) for v in values.values()]
            ax.barh(range(len(shown)), shown, color=[STYLES[m].color for m in values], alpha=1.0, lw=0.0)
            for i, value in enumerate(values.values()):
                text = f" {short_number(value)}{' →' * (value > longest)}"
                ax.annotate(text, (shown[i], i), va="center", fontsize=8)
            ax.set(xlabel="" if titled else measure.heading, xlim=(0.0, 1.2 * longest))
            name_rows(ax, [view.names[m] for m in values])

        title = measure.heading if titled else f"{measure.title}, mean over drives"
        return Chart(title, draw, rows=len(values))

    means = {m: with_outages(m, view.scores.mean.get(m, {})) for m in view.names}
    known = {name: {m: v for m, of in means.items() if (v := of.get(name))} for name in view.measures}
    return tuple(bars(view.measures[name], values) for name, values in known.items() if values)


def consistency(name: str, evaluated: DriveResult) -> Figure | None:
    """Draw the tuned filter's NIS over time, a histogram of the NIS, and the autocorrelation of the innovations.

    Return None if the filter failed or had too few fixes.
    """
    found, innovations = evaluated.consistency, evaluated.innovations
    if found is None or innovations is None:
        return None
    nis, tuned = innovations.nis, STYLES["tuned"].color
    low, high = found.nis_band

    def over_time(ax: Axes) -> None:
        curve(ax, innovations.time, nis, Look(tuned, 0.0, NO_LINE, ".", 3.0))
        ax.axhline(GATE_95, **Look(CHARCOAL, 1.0, "--").line)
        behind = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1}
        across = ax.get_yaxis_transform()
        ax.annotate("95% gate", (0.01, GATE_95), xycoords=across, va="bottom", bbox=behind, fontsize=8)
        show_time(ax)
        ax.set(ylabel="NIS")
        logarithmic(ax.yaxis)
        ax.set_ylim(1e-2, None)

    def histogram(ax: Axes) -> None:
        edges = np.linspace(0, max(12.0, float(np.quantile(nis, 0.98))), 30)
        density, _ = np.histogram(np.minimum(nis, edges[-1]), edges, density=True)
        middle = (edges[1:] + edges[:-1]) / 2
        ax.bar(middle, density, float(edges[1]), color=SILVER, alpha=1.0, lw=1.0, edgecolor=GREY)
        curve(ax, middle, np.exp(-middle / 2) / 2, Look(BLACK, 1.2), "consistent filter")
        ax.set(xlabel="NIS (the last bar includes larger values)", ylabel="probability density")

    def lags(ax: Axes) -> None:
        ax.axhspan(-found.white_band, found.white_band, color=MIST, alpha=1.0, lw=0)
        ax.axhline(0.0, **Look(GREY, 0.8).line)
        at = np.arange(1, len(found.autocorrelation) + 1)
        ax.vlines(at, 0.0, found.autocorrelation, color=tuned, lw=3.0, alpha=1.0)
        ax.set(xlabel="lag, fixes", ylabel="autocorrelation", ylim=(-1.0, 1.0))

    charts = (
        Chart(f"{name}: {found.inside_gate:.1%} in the 95% gate", over_time),
        Chart(f"mean NIS {found.mean_nis:.2f}, consistent: {low:.2f} to {high:.2f}", histogram),
        Chart("innovations (gray: 95% band of white noise)", lags),
    )
    return figure_of(*charts, size=(11, 3.4))


def tracks(picture: Picture, labels: Mapping[str, str]) -> Figure:
    """Draw the whole track and a close-up of the sharpest turn (the paper's Fig. 3)."""
    half, (x, y) = CLOSE_UP_SIZE / 2, picture.turn

    def paths(ax: Axes, series: Mapping[str, Columns]) -> None:
        for name in (name for name in DRAWING_ORDER if name in series):
            curve(ax, series[name]["x"], series[name]["y"], STYLES[name], labels[name])

    def whole(ax: Axes) -> None:
        paths(ax, picture.whole.series)
        start = Look(BLACK, 0.0, NO_LINE, "^", 7.0)
        curve(ax, picture.start[:1], picture.start[1:], start, "filter starts")
        corners = half * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
        curve(ax, x + corners[0], y + corners[1], Look(CHARCOAL, 0.8))
        low, high = picture.frame
        margin = 0.08 * float((high - low).max())  # the fixes set the scale, not a diverged filter
        as_map(ax, *zip(low - margin, high + margin, strict=True))

    def close(ax: Axes) -> None:
        paths(ax, picture.close)
        as_map(ax, (x - half, x + half), (y - half, y + half))

    charts = Chart(picture.whole.name, whole), Chart("close-up of the sharpest turn", close)
    return figure_of(*charts, size=(11, 5.4), legend="below")


def errors(picture: Picture, labels: Mapping[str, str]) -> Figure | None:
    """Draw the position and heading errors over time with 3-sigma bounds. Return None if there is no truth."""
    series = picture.whole.series
    if "position_error" not in series["tuned"]:
        return None
    methods = [name for name in DRAWING_ORDER if "heading_error" in series.get(name, {})]
    bounds = [name for name in ("tuned", "smoothed") if name in series]

    def position(ax: Axes) -> None:
        for name, style in zip(bounds, ("-", ":"), strict=False):
            radius, text = series[name]["position_3sigma"], f"3 sigma of the {labels[name]}"
            curve(ax, series[name]["time"], radius, Look(GREY, 1.0, style), text)
        for name in methods:
            curve(ax, series[name]["time"], series[name]["position_error"], STYLES[name], labels[name])
        ax.set(ylabel="position error, m")
        logarithmic(ax.yaxis)  # errors range from centimeters to hundreds of meters
        ax.set_ylim(0.03, None)

    def heading(ax: Axes) -> None:
        for name, color in zip(bounds, (MIST, SILVER), strict=False):
            sigma = series[name]["heading_3sigma"]
            band(ax, series[name]["time"], -sigma, sigma, Look(color))
        for name in methods:
            curve(ax, series[name]["time"], series[name]["heading_error"], STYLES[name])
        values = [np.abs(series[name]["heading_error"]) for name in methods]
        shown = np.concatenate([*values, series["tuned"]["heading_3sigma"]])
        known = np.isfinite(shown).any()
        most = float(np.clip(1.2 * np.nanquantile(shown, 0.98), *HEADING_LIMITS)) if known else 30.0
        show_time(ax)
        ax.set(ylabel="heading error, deg", ylim=(-most, most))

    charts = Chart(f"{picture.whole.name}: error against truth", position), Chart("", heading)
    return figure_of(*charts, size=(9, 6), columns=1, legend="below", sharex=True)


def swarm_charts(tracks: Tracks) -> tuple[Chart, ...]:
    """Draw a bank's weights (stacked) over time, and the offsets of its variances from the tuned variances."""
    shares, moved = (tracks.series.get("swarm" + ending) for ending in (SHARES, MOVED))
    if shares is None or moved is None:
        return ()

    def weights(ax: Axes) -> None:
        names = [name for name in shares if name != "time"]
        sums = [*accumulate((shares[name] for name in names), initial=np.zeros(len(shares["time"])))]
        for name, color, low, high in zip(names, (BLUE, ORANGE, GREEN, PURPLE), sums, sums[1:], strict=False):
            band(ax, shares["time"], low, high, Look(color, opacity=0.7), name)
        show_time(ax)
        ax.set(ylabel="weight", ylim=(0.0, 1.0))

    def distance(ax: Axes) -> None:
        ax.axhline(0.0, **Look(GREY, 0.8).line)
        offsets = [name for name in moved if name not in ("time", "rear_axle")]
        for name, look in zip(offsets, many_styles(len(offsets), 1.2), strict=True):
            curve(ax, moved["time"], moved[name], look, name)
        show_time(ax)
        ax.set(ylabel="decades of variance")

    return (
        Chart(f"{tracks.name}: weights of the filters of the bank", weights),
        Chart(f"{tracks.name}: offsets from the tuned variances", distance),
    )
