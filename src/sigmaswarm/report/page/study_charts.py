"""The plots of a study: means with their intervals, and convergence."""

from collections.abc import Callable, Sequence
from typing import Any

from sigmaswarm.report.page.record import Chart
from sigmaswarm.report.page.study_schema import EVERYWHERE, UNKNOWN, Bands, StudyFile, Summary
from sigmaswarm.report.style import LOOKS

GRAY = "#51585f"
HUES = [LOOKS[m]["color"] for m in ("tuned", "defaults", "datasheet", "imu_only", "raw_gps")]


def means_chart(file: StudyFile, measure: str, strong: str) -> Chart | None:
    """Means of every method with their intervals; the scale is logarithmic."""
    rows = [r for r in reversed(file.means(measure)) if r.mean]
    if not rows:
        return None

    def arm(end: Callable[[Summary], float | None], sign: int) -> list[float]:
        return [max(0.0, sign * ((end(r) or r.mean or 0) - (r.mean or 0))) for r in rows]

    trace: dict[str, Any] = {
        "mode": "markers",
        "x": [r.mean for r in rows],
        "y": [file.label(r.method) + ("" if r.protocol == "untuned" else f" ({r.protocol})") for r in rows],
        "error_x": {
            "type": "data",
            "color": GRAY,
            "symmetric": False,
            "array": arm(lambda r: (r.drive_interval or UNKNOWN)[1], 1),
            "arrayminus": arm(lambda r: (r.drive_interval or UNKNOWN)[0], -1),
        },
        "marker": {"size": 8, "color": [HUES[0] if r.method == strong else GRAY for r in rows]},
        "showlegend": False,
    }
    layout = {
        "xaxis": {"type": "log", "title": {"text": file.measures[measure]}},
        "yaxis": {"automargin": True, "tickfont": {"size": 11}},
        "height": 60 + 26 * len(rows),
    }
    return Chart(f"{file.measures[measure]}, with the interval for new drives", (trace,), layout)


def convergence_charts(file: StudyFile) -> tuple[Chart, ...]:
    """Best cost over generations, one plot a protocol: their costs can't be compared."""
    charts: list[Chart] = []
    for protocol, asked in file.protocols.items():
        mine = [b for b in file.convergence if (b.protocol, b.group) == (protocol, EVERYWHERE)]
        traces = [t for i, b in enumerate(mine) for t in _band(b, file.label(b.method), HUES[i % len(HUES)])]
        if traces:
            cost = {"title": {"text": f"cost: {asked.get('objective', '')}"}, "type": "log"}
            layout = {"xaxis": {"title": {"text": "generation"}}, "yaxis": cost}
            charts.append(Chart(f"Cost over generations, {protocol}", tuple(traces), layout))
    return tuple(charts)


def _band(bands: Bands, label: str, color: str) -> Sequence[dict[str, Any]]:
    x = list(range(1, len(bands.median) + 1))
    edge = {"x": x, "mode": "lines", "line": {"width": 0}, "showlegend": False, "hoverinfo": "skip"}
    fill = {"fill": "tonexty", "fillcolor": f"{color}26"}
    return (
        {**edge, "y": bands.low},
        {**edge, **fill, "y": bands.high},
        {"x": x, "y": bands.median, "name": label, "line": {"color": color, "width": 2}},
    )
