"""Plots of any length: the server sends the smallest and largest value per pixel of the visible part."""

from collections.abc import Callable, Mapping
from typing import Any, cast

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from sigmaswarm import Drive
from sigmaswarm.doctor.agreements import Agreement
from sigmaswarm.drives.drive import Array
from sigmaswarm.reports.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

PIXELS = 600
"""Columns of a plot, each with two points."""
MOST_PLACES = 3000
"""Points of a track on a map."""
COLORS = (BLUE, VERMILION, GREEN, PURPLE, SKY, BLACK)
Series = tuple[Array, Array]
"""Times (n,) and values (n,)."""
CONFIG = {"displayModeBar": False, "responsive": True, "doubleClick": "reset"}
AXIS = {
    "gridcolor": "#e8ebee",
    "zerolinecolor": "#c6cbd0",
    "linecolor": "#a9b0b7",
    "automargin": True,
    "exponentformat": "none",
}


def envelope(series: Series, start: float = -np.inf, end: float = np.inf) -> Series:
    """Reduce values between two times to the smallest and the largest value of each of `PIXELS` columns."""
    time, values = series
    first, last = np.searchsorted(time, start), np.searchsorted(time, end, side="right")
    time, values = time[max(first - 1, 0) : last + 1], values[max(first - 1, 0) : last + 1]
    if len(time) <= 2 * PIXELS:
        return time, values
    edges = np.linspace(0, len(time), PIXELS + 1).astype(np.intp)[:-1]
    ends = np.column_stack([np.fmin.reduceat(values, edges), np.fmax.reduceat(values, edges)])
    middle = np.append(edges[1:], len(time)) - 1
    return np.column_stack([time[edges], time[middle]]).ravel(), ends.ravel()


def thinned(x: Array, y: Array, most: int = MOST_PLACES) -> Series:
    """Take every n-th point of a track."""
    step = max(len(x) // most, 1)
    return x[::step], y[::step]


def numbers(values: Array, digits: int = 4) -> list[float]:
    """Values as JSON."""
    return np.round(values, digits).tolist()


class TimePlot:
    """Series over time. Zooming in fetches the detail; with ``on_select`` the mouse selects a span instead.

    Parameters
    ----------
    title, unit : str
    series : mapping of label to `Series`
    dashed : labels drawn as dashes: the expected values
    spans : from when to when to shade, s
    """

    def __init__(
        self,
        title: str,
        unit: str,
        series: Mapping[str, Series],
        *,
        dashed: tuple[str, ...] = (),
        span: tuple[float, float] | None = None,
        on_select: Callable[[float, float], Any] | None = None,
        height: int = 220,
    ) -> None:
        self.series, self.dashed, self._on_select = series, dashed, on_select
        x = AXIS | {"title": {"text": "time, s"}}
        layout: dict[str, Any] = base_layout(height) | {"xaxis": x, "yaxis": AXIS | {"title": {"text": unit}}}
        layout["dragmode"] = "select" if on_select else "zoom"
        layout |= {"selectdirection": "h", "uirevision": title}
        layout["shapes"] = [_shade(*span)] if span and np.isfinite(span).all() else []
        self.figure: dict[str, Any] = {"data": self._traces(), "layout": layout, "config": CONFIG}
        self.plot = _plot(self.figure, f"{title}; lines: {', '.join(series)}")
        self.plot.on("plotly_relayout", self._zoomed, throttle=0.2)
        if on_select:
            self.plot.on("plotly_selected", self._selected)

    def _traces(self, start: float = -np.inf, end: float = np.inf) -> list[dict[str, Any]]:
        traces: list[dict[str, Any]] = []
        for color, (label, series) in zip(COLORS * 3, self.series.items(), strict=False):
            time, values = envelope(series, start, end)
            line: dict[str, Any] = {"color": color, "width": 1.4}
            if label in self.dashed:
                line = {"color": ORANGE, "width": 1.8, "dash": "dash"}
            ends = {"x": numbers(time), "y": numbers(values)}
            traces.append(ends | {"name": label, "type": "scatter", "mode": "lines", "line": line})
        return traces

    def _zoomed(self, event: GenericEventArguments) -> None:
        args = cast("dict[str, Any]", event.args)
        if "xaxis.range[0]" in args:
            self.figure["data"] = self._traces(float(args["xaxis.range[0]"]), float(args["xaxis.range[1]"]))
        elif args.get("xaxis.autorange"):
            self.figure["data"] = self._traces()
        else:
            return
        self.plot.update()

    def _selected(self, event: GenericEventArguments) -> None:
        chosen = cast("dict[str, Any]", event.args or {}).get("range", {}).get("x")
        if chosen and self._on_select:
            self._on_select(*sorted(map(float, chosen)))


def agreement_plot(
    found: Agreement, span: tuple[float, float] | None = None, after: Agreement | None = None
) -> None:
    """Plot measured values next to expected ones; ``after``: the same after a repair."""
    measured = found.measured
    if after:
        changed = {
            name: (t, v) for name, (t, v) in after.measured.items() if not _same(measured.get(name), (t, v))
        }
        measured = {f"{name} before": s for name, s in measured.items()}
        measured |= {f"{name} after": series for name, series in changed.items()}
    with ui.element("figure"):
        with ui.element("figcaption"):
            ui.label(found.title)
        TimePlot(found.title, found.unit, measured | found.expected, dashed=tuple(found.expected), span=span)


def _same(a: Series | None, b: Series) -> bool:
    return a is not None and len(a[1]) == len(b[1]) and np.array_equal(a[0], b[0]) and np.allclose(a[1], b[1])


def map_plot(
    tracks: Mapping[str, Series], title: str, *, points: tuple[str, ...] = (), height: int = 340
) -> ui.plotly:
    """Draw tracks east and north, m; those in ``points`` as points."""
    x_axis = AXIS | {"title": {"text": "east, m"}}
    y_axis = AXIS | {"title": {"text": "north, m"}, "scaleanchor": "x"}
    layout = base_layout(height) | {"xaxis": x_axis, "yaxis": y_axis, "uirevision": title, "dragmode": "zoom"}
    figure = {"data": track_traces(tracks, points), "layout": layout, "config": CONFIG}
    return _plot(figure, f"{title}; {', '.join(tracks)}")


def track_traces(tracks: Mapping[str, Series], points: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """The lines and points of a map."""
    traces: list[dict[str, Any]] = []
    for color, (label, track) in zip((GREEN, *COLORS), tracks.items(), strict=False):
        x, y = thinned(*track)
        looks = {"mode": "lines", "line": {"color": color, "width": 2}}
        if label in points:
            looks = {"mode": "markers", "marker": {"color": color, "size": 4}}
        traces.append({"x": numbers(x, 2), "y": numbers(y, 2), "name": label, "type": "scatter", **looks})
    return traces


def fixes_of(drive: Drive) -> dict[str, Series]:
    """The fixes, and the truth where known, as tracks."""
    truth = {"truth": (drive.truth.x, drive.truth.y)} if drive.truth else {}
    return {"fixes": (drive.gps.x, drive.gps.y)} | truth


def curves(lines: Mapping[str, Series], title: str, x: str, y: str, height: int = 260) -> ui.plotly:
    """Draw curves of few points."""
    axes = {"xaxis": AXIS | {"title": {"text": x}}, "yaxis": AXIS | {"title": {"text": y}}}
    layout = base_layout(height) | axes | {"uirevision": title}
    return _plot({"data": curve_traces(lines), "layout": layout, "config": CONFIG}, title)


def curve_traces(lines: Mapping[str, Series]) -> list[dict[str, Any]]:
    """The lines of curves of few points."""
    return [
        {
            "x": numbers(a),
            "y": numbers(b),
            "name": label,
            "type": "scatter",
            "mode": "lines",
            "line": {"color": color},
        }
        for color, (label, (a, b)) in zip(COLORS * 4, lines.items(), strict=False)
    ]


def redraw(plot: ui.plotly, traces: list[dict[str, Any]]) -> None:
    """Replace the lines of a plot."""
    cast("dict[str, Any]", plot.figure)["data"] = traces
    plot.update()


def base_layout(height: int) -> dict[str, Any]:
    """The common layout of all plots."""
    legend = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0}
    font = {"family": "system-ui, sans-serif", "size": 12, "color": "#1c2024"}
    margin = {"l": 56, "r": 10, "t": 30, "b": 44}
    return {"height": height, "margin": margin, "font": font, "legend": legend, "showlegend": True,
            "paper_bgcolor": "#fff", "plot_bgcolor": "#fff"}  # fmt: skip


def _plot(figure: dict[str, Any], label: str) -> ui.plotly:
    plot = ui.plotly(figure).classes("plot")
    plot.props["role"], plot.props["aria-label"] = "img", label
    return plot


def _shade(start: float, end: float) -> dict[str, Any]:
    fill = {"fillcolor": ORANGE, "opacity": 0.12, "line": {"width": 0}}
    return {"type": "rect", "xref": "x", "yref": "paper", "x0": start, "x1": end, "y0": 0, "y1": 1} | fill


def sparkline(values: Array, width: int = 120, height: int = 26) -> str:
    """A small line of a column's values, as SVG."""
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return ""
    _, shown = envelope((np.arange(len(values), dtype=np.float64), values))
    shown = shown[:: max(len(shown) // (2 * width), 1)]
    low, high = float(shown.min()), float(shown.max())
    x = np.linspace(1, width - 1, len(shown))
    y = height / 2 if high == low else height - 2 - (shown - low) / (high - low) * (height - 4)
    places = " ".join(f"{a:.1f},{b:.1f}" for a, b in np.broadcast(x, y))
    return (
        f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" aria-hidden="true">'
        f'<polyline points="{places}" fill="none" stroke="{BLUE}" stroke-width="1.2"/></svg>'
    )
