"""Layout in which Foxglove shows an exported bag: the track on a map, and plots of the consistency.

Source of the fields: layouts that Foxglove exports (docs.foxglove.dev, "Layouts").
"""

from collections.abc import Collection, Mapping
from typing import Any

LAYOUT_FILE = "foxglove-layout.json"
PLOTS: Mapping[str, tuple[str, ...]] = {
    "Innovations and their standard deviations, m": (
        "innovation.vector.x",
        "innovation.vector.y",
        "innovation_sigma.vector.x",
        "innovation_sigma.vector.y",
    ),
    "NIS, 2 on average if the filter is consistent": ("nis.data",),
    "Standard deviations: x, y (m), heading (rad)": ("sigma.vector.x", "sigma.vector.y", "sigma.vector.z"),
    "Forward speed, m/s": ("odometry.twist.twist.linear.x",),
}


def layout(topics: Collection[str]) -> dict[str, Any]:
    panels: dict[str, dict[str, Any]] = {}
    if (fix := "/sigmaswarm/fix") in topics:
        panels["map!track"] = {"followTopic": fix, "layer": "map", "disabledTopics": [], "zoomLevel": 16}
    for title, paths in PLOTS.items():
        present = [
            f"/sigmaswarm/{path}" for path in paths if f"/sigmaswarm/{path.partition('.')[0]}" in topics
        ]
        if present:
            panels[f"Plot!{len(panels)}"] = _plot(title, present)
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _arranged([*panels]),
    }


def _plot(title: str, paths: Collection[str]) -> dict[str, Any]:
    lines = [{"value": path, "enabled": True, "timestampMethod": "receiveTime"} for path in paths]
    return {
        "title": title,
        "paths": lines,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _arranged(panels: list[str], direction: str = "row") -> Any:
    """Return the panels as a binary tree whose levels are alternately rows and columns."""
    if len(panels) == 1:
        return panels[0]
    half, other = (len(panels) + 1) // 2, "column" if direction == "row" else "row"
    parts = {"first": _arranged(panels[:half], other), "second": _arranged(panels[half:], other)}
    return {"direction": direction, **parts, "splitPercentage": 50}
