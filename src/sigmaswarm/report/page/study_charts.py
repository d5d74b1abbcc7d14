"""The plots of a study: means with their intervals, spread over drives, and convergence."""

import math
from collections.abc import Sequence
from typing import Any

from sigmaswarm.report.draw.plotly import Ready as Chart
from sigmaswarm.report.page.study_schema import (
    EVERYWHERE,
    UNTUNED,
    Bands,
    Interval,
    Spread,
    StudyFile,
)
from sigmaswarm.report.style import STUDY_LOOKS
from sigmaswarm.report.views.charts import Look

COLORS = {
    UNTUNED: "#51585f",
    "paper": STUDY_LOOKS["paper-pso-ukf"].color,
    "honest": STUDY_LOOKS["honest-pso-ukf"].color,
}
"""Of the protocols."""
OTHER = Look("#009E73")
"""The look of a tuned method that has no tracks."""
LEGEND = {"orientation": "h", "y": 1.01, "yanchor": "bottom"}
ROW = 26
"""px: height of a method."""
REACH = 12
"""Means more than so many times the lowest one lie beyond the scale: else nobody could tell the good ones apart."""


def means_chart(
    file: StudyFile, measure: str, reach: float = REACH, mark: float | None = None
) -> Chart | None:
    """Means of every method with two intervals; the scale is logarithmic, and reaches from the lowest mean."""
    rows = [(r, r.mean) for r in file.means(measure) if r.mean]
    if not rows:
        return None
    best = min(mean for _, mean in rows)
    low, high = best / 3, min(best * reach, 2 * max(mean for _, mean in rows))
    names = [file.label(r.method, r.protocol) for r, _ in rows]
    beyond = [mean > high for _, mean in rows]
    means = {
        "mode": "markers+text",
        "x": [min(mean, high) for _, mean in rows],
        "y": names,
        "text": [_short(mean) if far else "" for (_, mean), far in zip(rows, beyond, strict=True)],
        "textposition": "middle left",
        "marker": {
            "size": 9,
            "color": [COLORS.get(r.protocol, COLORS[UNTUNED]) for r, _ in rows],
            "symbol": ["triangle-right" if far else "circle" for far in beyond],
        },
        "customdata": [[mean, _said(r.bootstrap_interval), _said(r.trial_interval)] for r, mean in rows],
        "hovertemplate": "%{customdata[0]:.3g}<br>95% for new drives: %{customdata[1]}"
        "<br>95% over trials: %{customdata[2]}<extra>%{y}</extra>",
        "showlegend": False,
    }
    near = [(name, r) for name, (r, _), far in zip(names, rows, beyond, strict=True) if not far]
    wide = _bars([(name, r.bootstrap_interval) for name, r in near], (low, high), 1.5)
    narrow = _bars([(name, r.trial_interval) for name, r in near], (low, high), 7)
    traces = (
        narrow | {"name": "95% over trials, as in the paper", "opacity": 0.4},
        wide | {"name": "95% for new drives (bootstrap)"},
        means,
    )
    layout = _layout(names, mark, head=80)
    ends = [math.log10(low), math.log10(1.15 * high)]
    layout["xaxis"] |= {"range": ends, **_ticks(*ends)}
    layout["legend"] = LEGEND | {"x": 1, "xanchor": "right"}
    return Chart(file.measures[measure], traces, layout, broad=True)


def _short(value: float) -> str:
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def _ticks(low: float, high: float) -> dict[str, Any]:
    """Between two exponents of 10; plotly.js would write 0.5 as a bare 5."""
    steps = (1, 2, 5) if high - low < 2 else (1,)
    values = [d * 10.0**k for k in range(math.floor(low), math.ceil(high)) for d in steps]
    return {"tickvals": values, "ticktext": [f"{v:g}" for v in values]}


def _said(interval: Interval | None) -> str:
    low, high = interval or (None, None)
    return "–" if low is None or high is None else f"{low:.3g} to {high:.3g}"


def _bars(
    intervals: Sequence[tuple[str, Interval | None]], reach: tuple[float, float], width: float
) -> dict[str, Any]:
    """Lines from end to end, one a method, as far as the scale reaches."""
    x: list[float | None] = []
    y: list[str | None] = []
    for name, interval in intervals:
        low, high = interval or (None, None)
        if low is not None and high is not None:
            x += [max(low, reach[0]), min(high, reach[1]), None]
            y += [name, name, None]
    line = {"width": width, "color": COLORS[UNTUNED]}
    return {"mode": "lines", "x": x, "y": y, "line": line, "hoverinfo": "skip"}


def _layout(names: Sequence[str], mark: float | None = None, head: int = 50) -> dict[str, Any]:
    """The first method stands on top; a dashed line where the mark is."""
    line = {"color": COLORS[UNTUNED], "width": 1, "dash": "dash"}
    ends = {"x0": mark, "x1": mark, "yref": "paper", "y0": 0, "y1": 1}
    order = {"categoryorder": "array", "categoryarray": list(reversed(names)), "type": "category"}
    reach = [-0.6, len(names) - 0.4]
    return {
        "xaxis": {"type": "log", "tickangle": 0, "tickfont": {"size": 11}},
        "yaxis": {"automargin": True, "tickfont": {"size": 11}, "range": reach, **order},
        "height": head + ROW * len(names),
        "margin": {"b": 28},
        "shapes": [] if mark is None else [{"type": "line", "line": line, **ends}],
    }


def spread_chart(
    file: StudyFile, spreads: Sequence[Spread], measure: str, mark: float | None = None
) -> Chart | None:
    """Boxes over the drives: quartiles, whiskers from 5 to 95%; the scale is logarithmic."""
    rows = [s for s in spreads if s.measure == measure and s.high > 0]
    if not rows:
        return None
    names = [file.label(s.method, s.protocol) for s in rows]
    traces = tuple(
        _boxes(file, [s for s in rows if s.protocol == p]) for p in dict.fromkeys(s.protocol for s in rows)
    )
    layout = _layout(names, mark)
    layout["xaxis"] |= {"dtick": 1, "minor": {"showgrid": True, "gridcolor": "#f2f3f5"}}
    failed = sum(s.failed for s in rows)
    said = f" ({failed} drives on which a filter failed left out)" if failed else ""
    return Chart(f"{file.measures[measure]}{said}", traces, layout, broad=True)


def _boxes(file: StudyFile, rows: Sequence[Spread]) -> dict[str, Any]:
    """Those of one protocol."""
    return {
        "type": "box",
        "orientation": "h",
        "y": [file.label(s.method, s.protocol) for s in rows],
        "lowerfence": [s.low for s in rows],
        "q1": [s.first for s in rows],
        "median": [s.median for s in rows],
        "q3": [s.third for s in rows],
        "upperfence": [s.high for s in rows],
        "marker": {"color": COLORS.get(rows[0].protocol, COLORS[UNTUNED])},
        "line": {"width": 1.5},
        "width": 0.6,
        "name": rows[0].protocol,
        "showlegend": False,
    }


def convergence_charts(file: StudyFile) -> tuple[Chart, ...]:
    """Best cost over generations, one plot a protocol: their costs can't be compared."""
    charts: list[Chart] = []
    for protocol, asked in file.protocols.items():
        mine = [b for b in file.convergence if b.protocol == protocol]
        if any(b.group != EVERYWHERE for b in mine):  # a line a condition: only one method finds room
            mine = [b for b in mine if b.method == mine[0].method]
        looks = [STUDY_LOOKS.get(f"{b.protocol}-{b.method}", OTHER) for b in mine]
        traces = [t for b, look in zip(mine, looks, strict=True) for t in _band(file, b, look.color)]
        if traces:
            cost = {
                "title": {"text": f"cost: {asked.get('objective', '')}, m", "standoff": 8},
                "type": "log",
                "exponentformat": "power",
                "automargin": True,
            }
            layout = {"xaxis": {"title": {"text": "generation"}}, "yaxis": cost, "legend": LEGEND}
            charts.append(Chart(f"Cost over generations, {protocol}", tuple(traces), layout))
    return tuple(charts)


def _band(file: StudyFile, bands: Bands, color: str) -> Sequence[dict[str, Any]]:
    """The middle 80% of the trials, their median, and where that settles."""
    whole = bands.group == EVERYWHERE
    name = file.label(bands.method) if whole else bands.group
    x = list(range(1, len(bands.median) + 1))
    edge = {"x": x, "mode": "lines", "line": {"width": 0}, "showlegend": False, "hoverinfo": "skip"}
    fill = {"fill": "tonexty", "fillcolor": f"{color}26"}
    settled = {
        "x": [bands.stable],
        "y": [bands.median[bands.stable - 1]],
        "mode": "markers",
        "marker": {"symbol": "diamond", "size": 9, "color": color, "line": {"color": "#fff", "width": 1}},
        "hovertemplate": f"within 1% of its end from generation {bands.stable} on<extra></extra>",
        "showlegend": False,
    }
    line = {"x": x, "y": bands.median, "mode": "lines", "line": {"color": color, "width": 2}}
    line |= {"name": name, "showlegend": whole}
    return (*(({**edge, "y": bands.low}, {**edge, **fill, "y": bands.high}) if whole else ()), line, settled)
