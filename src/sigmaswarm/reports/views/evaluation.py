"""The charts of an evaluation: bars of the methods, consistency, tracks and errors over time."""

from collections.abc import Mapping

import numpy as np

from sigmaswarm.reports.style import (
    BLACK,
    BLUE,
    CHARCOAL,
    DASHES,
    GREEN,
    GREY,
    LOOKS,
    MANY,
    MIST,
    ORANGE,
    PURPLE,
    SILVER,
    SLATE,
)  # fmt: skip
from sigmaswarm.reports.views.charts import (
    Axis,
    Band,
    Bars,
    Chart,
    Curve,
    Intervals,
    Look,
    Mark,
    Points,
    Rule,
    Span,
    short_number,
)
from sigmaswarm.scoring.consistency import GATE_95
from sigmaswarm.scoring.drifts import FIXES, LEARNED, OWN, UNTUNED
from sigmaswarm.scoring.evaluation import Evaluated
from sigmaswarm.scoring.measures import Measure
from sigmaswarm.scoring.records import ScoresRecord
from sigmaswarm.scoring.tracks import CLOSE_UP, MOVED, SHARES, Columns, Picture, Tracks

DRAWN = ("raw_gps", UNTUNED, OWN, "tuned", *LEARNED, "swarm", "smoothed", "truth")
"""The series of a track, the last one on top: the tuned filter's line is wider than the truth's."""


HEADING_SHOWN = (1.0, 30.0)
"""deg: limits of half of the axis of heading errors; larger errors are those of a diverged filter."""


def method_bars(
    scores: ScoresRecord, names: Mapping[str, str], measures: Mapping[str, Measure]
) -> tuple[Chart, ...]:
    """Bars of the means over the drives, a chart for each measure that any method has.

    IMU only and fixes alone do not set the scale: their bars end at the longest other bar, with an arrow at the text.
    """
    charts: list[Chart] = []
    for name, measure in measures.items():
        values = {m: v for m in names if (v := scores.mean_of(m, name))}
        if not values:
            continue
        longest = max([v for m, v in values.items() if m not in ("imu_only", FIXES)] or values.values())
        bars = Bars(
            "x",
            range(len(values)),
            tuple(min(v, longest) for v in values.values()),
            Look(SLATE, 0.0),
            colors=tuple(LOOKS[m].color for m in values),
            texts=tuple(short_number(v) + " →" * (v > longest) for v in values.values()),
        )
        rows = Axis(categories=tuple(names[m] for m in values))
        title = f"{measure.title}, mean over drives"
        charts.append(Chart(title, (bars,), Axis(measure.heading, range=(0.0, 1.3 * longest)), rows))
    return tuple(charts)


def consistency_charts(name: str, evaluated: Evaluated) -> tuple[Chart, ...]:
    """NIS of the tuned filter over time and as a histogram, and the autocorrelation of its innovations.

    Nothing where the filter failed or saw too few fixes.
    """
    found, innovations = evaluated.consistency, evaluated.innovations
    if found is None or innovations is None:
        return ()
    nis, tuned = innovations.nis, LOOKS["tuned"].color
    gate = Rule("y", GATE_95, Look(CHARCOAL, 1.0, "dash"), label="95% gate")
    over_time = Chart(
        f"{name}: {found.inside_gate:.1%} inside",
        (Points(innovations.time, nis, Look(tuned, 0.0, "none", "dot", 3.0)), gate),
        Axis("time, s"),
        Axis("NIS", "log", (1e-2, None)),
    )
    edges = np.linspace(0, max(12.0, float(np.quantile(nis, 0.98))), 30)
    share, _ = np.histogram(np.minimum(nis, edges[-1]), edges, density=True)
    middle = (edges[1:] + edges[:-1]) / 2
    colors = (SILVER,) * len(share)
    low, high = found.nis_band
    histogram = Chart(
        f"mean {found.mean_nis:.2f}, consistent: {low:.2f} to {high:.2f}",
        (
            Bars("y", middle, share, Look(GREY, 1.0), colors, width=float(edges[1] - edges[0])),
            Curve(middle, np.exp(-middle / 2) / 2, Look(BLACK, 1.2), "consistent filter"),
        ),
        Axis("NIS (the last bar: and above)"),
        Axis("share per unit"),
    )
    at = np.arange(1, len(found.autocorrelation) + 1)
    lags = Chart(
        "innovations (grey: white, 95%)",
        (
            Span("y", -found.white_band, found.white_band, Look(MIST)),
            Rule("y", 0.0, Look(GREY, 0.8)),
            Intervals("y", at, np.zeros(len(at)), found.autocorrelation, Look(tuned, 3.0)),
        ),
        Axis("fixes apart"),
        Axis("autocorrelation", range=(-1.0, 1.0)),
    )
    return over_time, histogram, lags


def track_charts(picture: Picture, labels: Mapping[str, str]) -> tuple[Chart, Chart]:
    """The whole track, and a close-up where the car turns most (the paper's Fig. 3)."""
    half = CLOSE_UP / 2
    (x, y), (east, north) = picture.turn, ("east, m", "north, m")
    corners = half * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
    low, high = picture.frame
    margin = 0.08 * float((high - low).max())  # the fixes: a filter that runs away must not set the scale
    whole = (
        *_paths(picture.whole.series, labels),
        Points(
            picture.start[:1],
            picture.start[1:],
            Look(BLACK, 0.0, "none", "triangle-up", 7.0),
            "filter starts",
        ),
        Curve(x + corners[0], y + corners[1], Look(CHARCOAL, 0.8)),
    )
    return (
        Chart(
            picture.whole.name,
            whole,
            Axis(east, range=(low[0] - margin, high[0] + margin)),
            Axis(north, range=(low[1] - margin, high[1] + margin)),
            equal=True,
        ),
        Chart(
            "close-up of the sharpest turn",
            _paths(picture.close, labels),
            Axis(east, range=(x - half, x + half)),
            Axis(north, range=(y - half, y + half)),
            equal=True,
        ),
    )


def _paths(series: Mapping[str, Columns], labels: Mapping[str, str]) -> tuple[Mark, ...]:
    return tuple(
        Curve(series[name]["x"], series[name]["y"], LOOKS[name], labels[name])
        for name in DRAWN
        if name in series
    )


def error_charts(picture: Picture, labels: Mapping[str, str]) -> tuple[Chart, ...]:
    """Position and heading error over time with the 3-sigma bounds of the tuned and the smoothed filter."""
    series = picture.whole.series
    tuned = series["tuned"]
    if "position_error" not in tuned:
        return ()
    methods = [name for name in DRAWN if "heading_error" in series.get(name, {})]
    sigma = tuned["heading_3sigma"]
    radius = Curve(
        tuned["time"], tuned["position_3sigma"], Look(GREY, 1.0), f"3 sigma of the {labels['tuned']}"
    )
    bounds: list[Mark] = [Band(tuned["time"], -sigma, sigma, Look(MIST))]
    radii: list[Mark] = [radius]
    if smoothed := series.get("smoothed"):
        time, sigma = smoothed["time"], smoothed["heading_3sigma"]
        look = Look(GREY, 1.0, "dot")
        bounds.append(Band(time, -sigma, sigma, Look(SILVER)))
        radii.append(Curve(time, smoothed["position_3sigma"], look, f"3 sigma of the {labels['smoothed']}"))
    position = [Curve(series[m]["time"], series[m]["position_error"], LOOKS[m], labels[m]) for m in methods]
    heading = [Curve(series[m]["time"], series[m]["heading_error"], LOOKS[m]) for m in methods]
    shown = np.concatenate([np.abs(mark.y) for mark in heading] + [tuned["heading_3sigma"]])
    most = (
        float(np.clip(1.2 * np.nanquantile(shown, 0.98), *HEADING_SHOWN))
        if np.isfinite(shown).any()
        else 30.0
    )
    # From centimetres to hundreds of metres: only a logarithmic scale shows all methods.
    scale = Axis("position error, m", "log", (0.03, None))
    title = f"{picture.whole.name}: error against truth"
    return (
        Chart(title, (*radii, *position), Axis(), scale),
        Chart("", (*bounds, *heading), Axis("time, s"), Axis("heading error, deg", range=(-most, most))),
    )


def swarm_charts(tracks: Tracks) -> tuple[Chart, ...]:
    """Weights of the filters of a swarm over time, stacked, and their distance from the tuning."""
    shares, moved = (tracks.series.get("swarm" + ending) for ending in (SHARES, MOVED))
    if shares is None or moved is None:
        return ()
    river, low = list[Mark](), np.zeros(len(shares["time"]))
    for color, (name, share) in zip(
        (BLUE, ORANGE, GREEN, PURPLE), [(n, v) for n, v in shares.items() if n != "time"], strict=False
    ):
        river.append(Band(shares["time"], low, low + share, Look(color, opacity=0.7), name))
        low = low + share
    offsets = [(name, by) for name, by in moved.items() if name not in ("time", "rear_axle")]
    looks = [
        Look(MANY[i % len(MANY)], 1.2, DASHES[i // len(MANY) % len(DASHES)]) for i in range(len(offsets))
    ]
    curves = [Curve(moved["time"], by, look, name) for (name, by), look in zip(offsets, looks, strict=True)]
    title = f"{tracks.name}: weights of the filters of the swarm"
    return (
        Chart(title, tuple(river), Axis("time, s"), Axis("share", range=(0.0, 1.0))),
        Chart(
            f"{tracks.name}: distance of the swarm from its tuning",
            (Rule("y", 0.0, Look(GREY, 0.8)), *curves),
            Axis("time, s"),
            Axis("decades of variance"),
        ),
    )
