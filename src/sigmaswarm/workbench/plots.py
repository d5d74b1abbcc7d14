"""Plots of series of any length: the server sends only the extreme values per pixel of the visible part."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, cast

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from sigmaswarm import Agreement, Drive
from sigmaswarm.arrays import Array
from sigmaswarm.reports.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION
from sigmaswarm.workbench.elements import box

PIXELS = 600  # columns of a plot, with two points each
EAST = "east, m"  # label of the horizontal axis of a map; a plot with this label has equal scales
MAX_LINE_POINTS = 3000  # largest number of points of a line on a map
MAX_MARKERS = 600  # largest number of fixes on a map; each is an element of the page
COLORS = (BLUE, VERMILION, GREEN, PURPLE, SKY, BLACK)
Series = tuple[Array, Array]  # times (n,), s, and values (n,); or east and north (n,), m
Lines = list[dict[str, Any]]
CONFIG = {"displayModeBar": False, "responsive": True, "doubleClick": "reset"}
AXIS = {
    "gridcolor": "#e8ebee",
    "zerolinecolor": "#c6cbd0",
    "linecolor": "#a9b0b7",
    "automargin": True,
    "exponentformat": "none",
}
LAYOUT: dict[str, Any] = {
    "margin": {"l": 56, "r": 10, "t": 30, "b": 44},
    "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#1c2024"},
    "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
    "showlegend": True,
    "paper_bgcolor": "#fff",
    "plot_bgcolor": "#fff",
    "selectdirection": "h",
}


def envelope(series: Series, start: float = -np.inf, end: float = np.inf) -> Series:
    """Reduce the values between two times to the lowest and the highest in each of `PIXELS` columns."""
    time, values = series
    first, last = np.searchsorted(time, start), np.searchsorted(time, end, side="right")
    time, values = time[max(first - 1, 0) : last + 1], values[max(first - 1, 0) : last + 1]
    if len(time) <= 2 * PIXELS:
        return time, values
    edges = np.linspace(0, len(time), PIXELS + 1).astype(np.intp)[:-1]
    ends = np.column_stack([np.fmin.reduceat(values, edges), np.fmax.reduceat(values, edges)])
    middle = np.append(edges[1:], len(time)) - 1
    return np.column_stack([time[edges], time[middle]]).ravel(), ends.ravel()


def thinned(x: Array, y: Array, most: int = MAX_LINE_POINTS) -> Series:
    step = max(-(-len(x) // most), 1)
    return x[::step], y[::step]


def lines(
    series: Mapping[str, Series],
    *,
    points: Collection[str] = (),
    dashed: Collection[str] = (),
    pale: Mapping[str, Series] | None = None,
) -> Lines:
    """Create the lines of a plot.

    ``points`` and ``dashed`` are names of series drawn as markers or dashed lines. ``pale`` is the series before a
    change.
    """
    made: Lines = []
    for color, (label, (x, y)) in zip(COLORS * 4, series.items(), strict=False):
        drawn: dict[str, Any] = {"mode": "lines", "line": {"color": color, "width": 1.4}}
        if label in points:
            drawn = {"mode": "markers", "marker": {"color": color, "size": 4}}
        elif label in dashed:
            drawn["line"] = {"color": ORANGE, "width": 1.8, "dash": "dash"}
        ends = {"x": np.round(x, 4).tolist(), "y": np.round(y, 4).tolist()}
        made.append(ends | {"name": label, "type": "scatter"} | drawn)
    if pale is None:
        return made
    before = lines({label: pale.get(label, (x[:0], y[:0])) for label, (x, y) in series.items()})
    return [one | {"opacity": 0.35, "showlegend": False} for one in before if one["x"]] + made


def show_plot(title: str, x: str, y: str, drawn: Lines, height: int = 260, **layout: Any) -> ui.plotly:
    across: dict[str, Any] = AXIS | {"title": {"text": x}}
    up: dict[str, Any] = AXIS | {"title": {"text": y}} | ({"scaleanchor": "x"} if x == EAST else {})
    whole = LAYOUT | {"xaxis": across, "yaxis": up, "height": height, "uirevision": title} | layout
    plot = ui.plotly({"data": drawn, "layout": whole, "config": CONFIG}).classes("plot")
    named = ", ".join(one["name"] for one in drawn if one.get("showlegend", True))
    plot.props["role"], plot.props["aria-label"] = "img", f"{title}; lines: {named}"
    return plot


def redraw(plot: ui.plotly, drawn: Lines) -> None:
    cast("dict[str, Any]", plot.figure)["data"] = drawn
    plot.update()


def time_plot(
    title: str,
    unit: str,
    series: Mapping[str, Series],
    *,
    dashed: Collection[str] = (),
    pale: Mapping[str, Series] | None = None,
    span: tuple[float, float] | None = None,
    on_select: Callable[[float, float], Any] | None = None,
    **layout: Any,
) -> None:
    """Show series over time.

    Dragging the mouse zooms and loads details. If ``on_select`` is given, dragging instead calls it with the start and
    end (s) of the selected time span.

    For ``dashed`` and ``pale`` see `lines`. ``span``, s, is shaded if it is clearly shorter than the series.
    """

    def visible(start: float = -np.inf, end: float = np.inf) -> Lines:
        cut = [{k: envelope(s, start, end) for k, s in some.items()} for some in (series, pale or {})]
        return lines(cut[0], dashed=dashed, pale=cut[1])

    def zoomed(event: GenericEventArguments) -> None:
        ends = cast("dict[str, Any]", event.args)
        if "xaxis.range[0]" in ends:
            redraw(plot, visible(float(ends["xaxis.range[0]"]), float(ends["xaxis.range[1]"])))
        elif ends.get("xaxis.autorange"):
            redraw(plot, visible())

    def selected(event: GenericEventArguments) -> None:
        chosen = cast("dict[str, Any]", event.args or {}).get("range", {}).get("x")
        if chosen and on_select:
            on_select(*sorted(map(float, chosen)))

    ends = np.array([time[[0, -1]] for time, _ in series.values() if len(time)]).T
    part = span and np.isfinite(span).all() and span[1] - span[0] < 0.95 * np.ptp(ends)
    shade: dict[str, Any] = {"type": "rect", "xref": "x", "yref": "paper", "y0": 0, "y1": 1}
    shade |= {"fillcolor": ORANGE, "opacity": 0.12, "line": {"width": 0}}
    layout["shapes"] = [shade | {"x0": span[0], "x1": span[1]}] if span and part else []
    layout["dragmode"] = "select" if on_select else "zoom"
    plot = show_plot(title, "time t, s", unit, visible(), 220, **layout)
    plot.on("plotly_relayout", zoomed, throttle=0.2)
    if on_select:
        plot.on("plotly_selected", selected)


def agreement_plot(
    found: Agreement, span: tuple[float, float] | None = None, after: Agreement | None = None
) -> None:
    series = after.measured.items() if after else ()
    changed = any(not _same(found.measured.get(key), values) for key, values in series)
    shown = after if after and changed else found
    both, pale = shown.measured | shown.expected, found.measured if changed else None
    with ui.element("figure"):
        with ui.element("figcaption"):
            ui.label(f"{found.title}{'; pale: before the repair' if changed else ''}")
            with box("legend"):
                empty = {label: (x[:0], y[:0]) for label, (x, y) in both.items()}
                for one in lines(empty, dashed=shown.expected):
                    dash = "dashed" if "dash" in one["line"] else "solid"
                    ui.label(one["name"]).style(f"border: 0 {dash} {one['line']['color']}")
        bare: dict[str, Any] = {"showlegend": False, "margin": LAYOUT["margin"] | {"t": 8}}
        time_plot(found.title, found.unit, both, dashed=shown.expected, pale=pale, span=span, **bare)


def _same(a: Series | None, b: Series) -> bool:
    return a is not None and len(a[1]) == len(b[1]) and np.array_equal(a[0], b[0]) and np.allclose(a[1], b[1])


def map_lines(drive: Drive, tracks: Mapping[str, Series] | None = None) -> Lines:
    truth = {"truth": thinned(drive.truth.x, drive.truth.y)} if drive.truth else {}
    shown = {"fixes": thinned(drive.gps.x, drive.gps.y, MAX_MARKERS)} | truth | {**(tracks or {})}
    return lines(shown, points=("fixes",))


def show_map(drive: Drive, title: str, height: int = 260) -> ui.plotly:
    return show_plot(title, EAST, "north, m", map_lines(drive), height)


def sparkline(values: Array) -> str:
    width, height = 120, 26
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return ""
    _, shown = envelope((np.arange(len(values), dtype=np.float64), values))
    shown = shown[:: max(len(shown) // (2 * width), 1)]
    low, high = float(shown.min()), float(shown.max())
    x = np.linspace(1, width - 1, len(shown))
    y = height / 2 if high == low else height - 2 - (shown - low) / (high - low) * (height - 4)
    places = " ".join(f"{a:.1f},{b:.1f}" for a, b in np.broadcast(x, y))
    box = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}" aria-hidden="true"'
    return f'<svg {box}><polyline points="{places}" fill="none" stroke="{BLUE}" stroke-width="1.2"/></svg>'
