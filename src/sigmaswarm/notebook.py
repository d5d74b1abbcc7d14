"""HTML of records for notebooks, without scripts or external files, and conversion to pandas.

Texts are escaped, since names come from logs.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sigmaswarm.errors import not_installed

if TYPE_CHECKING:
    import pandas as pd

WIDTH, HEIGHT, MARGIN = 360.0, 240.0, 10.0  # px
MAX_POINTS = 400  # largest number of points of a path, since a notebook stores its pictures
COLORS = {"truth": "#000000", "fixes": "#009e73", "estimate": "#0072b2"}
"""Colors of the paths, by content. Color-blind readers can also distinguish them."""


def number(value: float | None) -> str:
    """Format with three significant digits, or as an integer if 1000 <= abs(value) < 1e7. None and inf give a dash."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.3g}"


def table(caption: str, head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return an HTML table whose first column contains the row names. Header cells have scopes for screen readers."""

    def cell(value: object) -> str:
        text = number(value) if isinstance(value, float) else str(value)
        return f'<td style="text-align:right">{escape(text)}</td>'

    heads = "".join(f'<th scope="col">{escape(title)}</th>' for title in head)
    body = "".join(
        f'<tr><th scope="row" style="text-align:left">{escape(str(name))}</th>{"".join(map(cell, values))}</tr>'
        for name, *values in rows
    )
    return (
        f'<table><caption style="text-align:left"><b>{escape(caption)}</b></caption>'
        f"<thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table>"
    )


def html_list(title: str, sentences: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    return f"<p>{escape(title)}</p><ul>{items}</ul>" if sentences else ""


def track(title: str, paths: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> str:
    """Draw paths as on a map (north up, to scale), with a sentence that describes the picture.

    ``paths`` contains arrays of positions east and north (m), shape (n,) each; NaN where a position is unknown. The
    path ``fixes`` is drawn as dots.
    """
    drawn = {name: _thinned(*path) for name, path in paths.items()}
    drawn = {name: path for name, path in drawn.items() if len(path)}
    if not drawn:
        return ""
    points = np.concatenate(list(drawn.values()))
    low, high = points.min(axis=0), points.max(axis=0)
    span = high - low
    scale = min((WIDTH - 2 * MARGIN) / max(span[0], 1e-9), (HEIGHT - 2 * MARGIN) / max(span[1], 1e-9), 1e6)
    summary = (
        f"{title} seen from above, {span[0]:.0f} m from west to east and {span[1]:.0f} m from south to north: "
        f"{', '.join(drawn)}"
    )
    shapes = "".join(_shape(name, path, low, high, scale) for name, path in drawn.items())
    key = " ".join(
        f'<span style="color:{COLORS.get(name, "#555555")}">{"&#9679;" if name == "fixes" else "&#9473;"}</span>'
        f" {escape(name)}"
        for name in drawn
    )
    return (
        f'<figure style="margin:0"><svg role="img" aria-label="{escape(summary)}" width="{WIDTH:.0f}" '
        f'height="{HEIGHT:.0f}" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" xmlns="http://www.w3.org/2000/svg" '
        f'style="background:#ffffff"><title>{escape(summary)}</title>{shapes}</svg>'
        f"<figcaption>{key} &middot; {span[0]:.0f} m x {span[1]:.0f} m, north up</figcaption></figure>"
    )


def _thinned(x: ArrayLike, y: ArrayLike) -> np.ndarray[Any, np.dtype[np.float64]]:
    points = np.stack([np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)], axis=1)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) <= MAX_POINTS:
        return points
    return points[np.linspace(0, len(points) - 1, MAX_POINTS).round().astype(np.int64)]


def _shape(name: str, path: Any, low: Any, high: Any, scale: float) -> str:
    color = COLORS.get(name, "#555555")
    at = MARGIN + scale * np.stack([path[:, 0] - low[0], high[1] - path[:, 1]], axis=1)
    if name == "fixes":
        return "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.5" fill="{color}"/>' for x, y in at)
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in at)
    start = f'<circle cx="{at[0, 0]:.1f}" cy="{at[0, 1]:.1f}" r="3.5" fill="{color}"/>'
    return f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="1.5"/>{start}'


def to_pandas(columns: Mapping[str, Any]) -> "pd.DataFrame":
    try:
        import pandas as pd
    except ImportError:
        raise not_installed("to_pandas", "pandas") from None
    return pd.DataFrame(dict(columns))
