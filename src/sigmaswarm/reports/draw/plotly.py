"""Charts as plotly.js takes them: traces and layout, of JSON types. `page.js` adds what all plots of a page share."""

import math
from functools import singledispatch
from typing import Any

from sigmaswarm.reports.style import SLATE
from sigmaswarm.reports.views.charts import (
    Axis,
    Band,
    Bars,
    Boxes,
    Chart,
    Curve,
    Intervals,
    Look,
    Points,
    Rule,
    Span,
    Symbol,
    Values,
)

ROW = 26
"""px: height of a category."""
LEGEND_ABOVE = {"orientation": "h", "y": 1.01, "yanchor": "bottom"}

_SYMBOLS: dict[Symbol, str] = {
    "": "circle",
    "dot": "circle",
    "circle": "circle",
    "ring": "circle-open",
    "diamond": "diamond",
    "triangle-up": "triangle-up",
    "triangle-right": "triangle-right",
    "tick": "line-ns-open",
}
_POINT = 96 / 72
"""px."""

Trace = dict[str, Any]


def content(chart: Chart) -> dict[str, Any]:
    """Traces and layout."""
    return {"traces": traces(chart), "layout": layout(chart)}


def traces(chart: Chart) -> list[Trace]:
    """What plotly.js draws, the later ones on top."""
    return [_placed(trace, chart) for mark in chart.marks for trace in _traces(mark)]


def layout(chart: Chart) -> dict[str, Any]:
    """Axes, legend, size, and the lines across."""
    shapes = [_shape(mark) for mark in chart.marks if isinstance(mark, Rule | Span)]
    notes = [_note(mark) for mark in chart.marks if isinstance(mark, Rule) and mark.label]
    bars = any(isinstance(mark, Bars) and mark.texts for mark in chart.marks)
    size: dict[str, Any] = {}
    if bars:  # texts at their ends need room
        size = {"height": max(230, 50 + ROW * len(chart.y.categories)), "margin": {"r": 56}}
    elif chart.y.categories:
        named = any(getattr(mark, "name", "") for mark in chart.marks)
        size = {"height": (80 if named else 50) + ROW * len(chart.y.categories)}
        size |= {"margin": {"b": 44 if chart.x.title else 28}}
        size |= {"legend": LEGEND_ABOVE | {"x": 1, "xanchor": "right"}} if named else {}
    elif any(isinstance(mark, Band) for mark in chart.marks):
        size = {"legend": LEGEND_ABOVE}
    axes = {"xaxis": _axis(chart.x, sparse=bool(chart.y.categories)), "yaxis": _axis(chart.y, top_down=True)}
    if chart.y.categories and not bars:
        axes["yaxis"]["tickfont"] = {"size": 11}
    if chart.equal:
        axes["yaxis"]["scaleanchor"] = "x"
    return axes | size | ({"shapes": shapes} if shapes else {}) | ({"annotations": notes} if notes else {})


def _axis(axis: Axis, *, sparse: bool = False, top_down: bool = False) -> dict[str, Any]:
    if axis.categories:
        names = list(reversed(axis.categories)) if top_down else list(axis.categories)
        order = {"type": "category", "categoryorder": "array", "categoryarray": names}
        return {**order, "range": [-0.6, len(names) - 0.4], "automargin": True}
    told: dict[str, Any] = {"title": {"text": axis.title}} if axis.title else {}
    told |= {"type": axis.scale, "automargin": True}
    low, high = axis.range
    if low is not None and high is not None:
        ends = [math.log10(low), math.log10(high)] if axis.scale == "log" else [low, high]
        told["range"] = ends
        if axis.scale == "log" and not axis.ticks:
            told |= _ticks(*ends)
    elif axis.scale == "log" and not axis.plain:
        told |= {"dtick": 1} if sparse else {"exponentformat": "power"}
    if axis.ticks:
        told |= {"tickvals": list(axis.ticks), "ticktext": [f"{tick:g}" for tick in axis.ticks]}
    return told


def _ticks(low: float, high: float) -> dict[str, Any]:
    """Between two exponents of 10; plotly.js would write 0.5 as a bare 5."""
    steps = (1, 2, 5) if high - low < 2 else (1,)
    values = [d * 10.0**k for k in range(math.floor(low), math.ceil(high)) for d in steps]
    return {"tickvals": values, "ticktext": [f"{v:g}" for v in values], "tickangle": 0}


def _placed(trace: Trace, chart: Chart) -> Trace:
    """With the names of categories in the place of their numbers."""
    for direction, axis in (("x", chart.x), ("y", chart.y)):
        if axis.categories and direction in trace:
            trace[direction] = [None if v is None else axis.categories[round(v)] for v in trace[direction]]
    return trace


@singledispatch
def _traces(mark: Any) -> list[Trace]:
    """Rules and spans are shapes; only those with a name need a trace, for the legend."""
    if isinstance(mark, Rule) and mark.name:
        return [{"x": [None], "y": [None], "mode": "lines", "line": _line(mark.look), "name": mark.name}]
    return []


@_traces.register
def _(mark: Curve) -> list[Trace]:
    shown = "markers" if mark.look.dash == "none" else "lines+markers" if mark.look.symbol else "lines"
    trace: Trace = {"x": numbers(mark.x), "y": numbers(mark.y), "mode": shown, **_named(mark.name)}
    trace |= {"line": _line(mark.look)} if mark.look.dash != "none" else {}
    trace |= {"marker": _marker(mark.look)} if mark.look.symbol else {}
    return [trace | {"opacity": mark.look.opacity}]


@_traces.register
def _(mark: Points) -> list[Trace]:
    marker: dict[str, Any] = _marker(mark.look)
    marker |= {"color": list(mark.colors)} if mark.colors else {}
    marker |= {"symbol": [_SYMBOLS[s] for s in mark.symbols]} if mark.symbols else {}
    trace: Trace = {"x": numbers(mark.x), "y": numbers(mark.y), "mode": "markers", "marker": marker}
    if mark.texts:
        trace |= {"mode": "markers+text", "text": list(mark.texts), "textposition": "middle left"}
    if mark.hovers:
        trace |= {"hovertext": list(mark.hovers), "hovertemplate": "%{hovertext}<extra></extra>"}
    return [trace | {"opacity": mark.look.opacity, **_named(mark.name)}]


@_traces.register
def _(mark: Band) -> list[Trace]:
    edge = {"x": numbers(mark.x), "mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
    fill = {"fill": "tonexty", "fillcolor": f"{mark.look.color}{round(255 * mark.look.opacity):02x}"}
    low = {**edge, "y": numbers(mark.low), "showlegend": False}
    return [low, {**edge, **fill, "y": numbers(mark.high), **_named(mark.name)}]


@_traces.register
def _(mark: Bars) -> list[Trace]:
    across, along = ("y", "x") if mark.along == "x" else ("x", "y")
    trace: Trace = {"type": "bar", "orientation": "h" if mark.along == "x" else "v", "showlegend": False}
    trace |= {along: numbers(mark.values), across: numbers(mark.at), "width": mark.width}
    trace["marker"] = {"color": list(mark.colors) or mark.look.color, "opacity": mark.look.opacity}
    if mark.texts:
        trace |= {"text": list(mark.texts), "textposition": "outside", "cliponaxis": False}
    return [trace]


@_traces.register
def _(mark: Intervals) -> list[Trace]:
    """Lines from end to end, with gaps between."""
    places: list[float | None] = []
    ends: list[float | None] = []
    for at, low, high in zip(*map(numbers, (mark.at, mark.low, mark.high)), strict=True):
        if low is not None and high is not None:
            places += [at, at, None]
            ends += [low, high, None]
    across, along = ("y", "x") if mark.along == "x" else ("x", "y")
    trace = {"mode": "lines", across: places, along: ends, "line": _line(mark.look), "hoverinfo": "skip"}
    return [trace | {"opacity": mark.look.opacity, **_named(mark.name)}]


@_traces.register
def _(mark: Boxes) -> list[Trace]:
    parts = {"lowerfence": mark.low, "q1": mark.first, "median": mark.median}
    parts |= {"q3": mark.third, "upperfence": mark.high}
    across = "y" if mark.along == "x" else "x"
    return [
        {
            "type": "box",
            "orientation": "h" if mark.along == "x" else "v",
            across: numbers(mark.at),
            **{name: numbers(values) for name, values in parts.items()},
            "marker": {"color": mark.look.color},
            "line": {"width": 1.5},
            "width": 0.6,
            "name": mark.name,
            "showlegend": False,
        }
    ]


def _named(name: str) -> dict[str, Any]:
    return {"name": name, "showlegend": True} if name else {"showlegend": False}


def _line(look: Look) -> dict[str, Any]:
    return {"color": look.color, "dash": look.dash, "width": look.width}


def _marker(look: Look) -> dict[str, Any]:
    return {"color": look.color, "symbol": _SYMBOLS[look.symbol], "size": round(look.size * _POINT, 1)}


def _shape(mark: Rule | Span) -> dict[str, Any]:
    ends = (mark.at, mark.at) if isinstance(mark, Rule) else (mark.low, mark.high)
    along, across = ("x", "y") if mark.axis == "x" else ("y", "x")
    place = {
        f"{along}0": ends[0],
        f"{along}1": ends[1],
        f"{across}ref": "paper",
        f"{across}0": 0,
        f"{across}1": 1,
    }
    if isinstance(mark, Rule):
        return {"type": "line", "line": _line(mark.look), **place}
    fill = {"fillcolor": mark.look.color, "opacity": mark.look.opacity, "line": {"width": 0}}
    return {"type": "rect", "layer": "below", **fill, **place}


def _note(mark: Rule) -> dict[str, Any]:
    text = {"text": mark.label, "showarrow": False, "font": {"size": 11, "color": SLATE}}
    if mark.axis == "x":
        return {**text, "x": mark.at, "y": 1, "yref": "paper", "xanchor": "left", "yanchor": "top"}
    return {**text, "y": mark.at, "x": 0, "xref": "paper", "xanchor": "left", "yanchor": "bottom"}


def numbers(values: Values) -> list[float | None]:
    """Plain numbers; None, which leaves a gap, where JSON has no number."""
    return [v if math.isfinite(v) else None for v in map(float, values)]
