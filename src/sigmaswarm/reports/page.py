"""A report as one HTML file, which needs no network and no other file.

matplotlib draws the charts as SVG. plotly.js draws the tracks; the page contains its basic bundle (MIT license,
assets/).
"""

import base64
import gzip
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from sigmaswarm.files import nan_to_none
from sigmaswarm.reports.figures import Chart, svg
from sigmaswarm.reports.style import Look
from sigmaswarm.scoring.consistency import GATE_95
from sigmaswarm.scoring.tracks import ThinnedSeries, Tracks
from sigmaswarm.tables import Cell, Column, Table, cell_numbers, format_cell
from sigmaswarm.versions import __version__

LONG_CELL = 24  # characters of a cell above which the column gets a minimum width
TERMS = {
    "NIS": "normalized innovation squared: squared innovation of a fix, relative to the covariance of the innovation",
    "NEES": "normalized estimation error squared: squared position error, relative to the filter's covariance",
    "RMSE": "square root of the mean squared error",
    "whiteness p": "probability that uncorrelated innovations appear at least as correlated as the observed "
    "innovations (Ljung-Box test over lags of one to ten fixes)",
    "correlation": "correlation of consecutive innovations; 0 if the filter is consistent",
    "consistent": "95% range of the mean NIS of a consistent filter",
    "95% gate": "limit of 5.99 for the NIS; 95% of the fixes are below this limit if the filter is consistent",
    "outage drift": "RMS position error at the ends of intervals without fixes",
    "position 50%": "median of the position error",
    "position 95%": "95th percentile of the position error",
    "baseline": "a filter with the tuned filter's model and typical noise parameters, not tuned",
    "fixes alone": "a constant-velocity filter without the IMU",
    "raw GPS": "the receiver's fixes, without a filter",
    "IMU only": "dead reckoning: integration of the IMU from the start of the filters, without fixes",
    "3 sigma": "three standard deviations, computed from the covariance of the filter",
    "cost": "value of the objective; lower is better",
    "density": "noise density that corresponds to the variance per step",
}
PLOTLY_DASHES = {"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot", "none": "none"}
_TERM = re.compile(rf"(?<!\w)({'|'.join(map(re.escape, sorted(TERMS, key=len, reverse=True)))})(?!\w)")
MAX_NUMBERS = 250_000
"""Maximum number of values in all tracks of a page together, about 2 MB; above this number, the tracks are thinned."""


@dataclass(frozen=True, eq=False)
class TrackView:
    """Interactive tracks.

    ``labels`` and ``looks`` have an entry per series, from top to bottom. When the page opens, it shows 3 sigma and NIS
    of the series ``main``, whose heading errors also determine the scale of the heading plot.
    """

    drives: Sequence[Tracks]
    labels: Mapping[str, str]
    looks: Mapping[str, Look]
    main: str


KeyFigure = tuple[str, str, str]  # label, number with unit, and note


@dataclass(frozen=True)
class Section:
    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    charts: tuple[Chart, ...] = ()
    tracks: TrackView | None = None


@dataclass(frozen=True)
class Report:
    """Content of a page. At most one section has tracks."""

    title: str
    lead: tuple[str, ...]
    figures: tuple[KeyFigure, ...] = ()
    remarks: tuple[str, ...] = ()
    sections: tuple[Section, ...] = ()
    config: Mapping[str, Any] = field(default_factory=dict[str, Any])
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    command: str = ""
    command_note: str = ""


def page(report: Report) -> str:
    """Render the page. Names of drives may contain code, so texts are escaped and the page can't make requests."""
    tracks = next((section.tracks for section in report.sections if section.tracks), None)
    return (
        _environment()
        .get_template("page.html")
        .render(
            report=report,
            version=__version__,
            style=Markup(_asset("page.css")),
            script=Markup(_asset("page.js")),
            tracks=tracks and _packed(json.dumps(_view(tracks), allow_nan=False, separators=(",", ":"))),
            plotly=tracks and _plotly(),
        )
    )


@cache
def _environment() -> Environment:
    loader = PackageLoader("sigmaswarm.reports", "assets")
    made = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    made.trim_blocks = made.lstrip_blocks = True
    made.filters.update(svg=lambda chart: Markup(svg(chart)), plain=_plain, cell=_cell, terms=_terms)  # pyright: ignore
    return made


def _asset(name: str) -> str:
    return files("sigmaswarm.reports").joinpath("assets", name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    return _packed(_asset("plotly-basic.min.js"))


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def _view(view: TrackView) -> dict[str, Any]:
    present = {name for drive in view.drives for name in drive.series}
    lines = [
        {
            "series": name,
            "label": label,
            "shown": view.looks[name].visible,
            "color": view.looks[name].color,
            "dash": PLOTLY_DASHES[view.looks[name].style],
            "width": max(view.looks[name].width, 1.2),
        }
        for name, label in view.labels.items()
        if name in present
    ]
    size = sum(len(v) for drive in view.drives for of in drive.series.values() for v in of.values())
    share = min(1.0, MAX_NUMBERS / max(size, 1))
    drives = [_tracks(drive, share) for drive in view.drives]
    return {"drives": drives, "lines": lines, "main": view.main, "gate": GATE_95}


def _tracks(tracks: Tracks, share: float) -> dict[str, Any]:
    """Thin the tracks, and round them to mm and ms. Large times are stored relative to the start of the drive."""
    first = min(float(columns["time"][0]) for columns in tracks.series.values())
    origin = first if abs(first) > 1000 else 0.0
    series: dict[str, Any] = {}
    for name, columns in tracks.series.items():
        if share < 1.0:
            n = len(columns["time"])
            thin = ThinnedSeries(n, max(int(share * n), 50))
            thin.add(columns)
            columns = thin.columns
        numbers = {
            column: np.round(np.asarray(values - origin * (column == "time"), np.float64), 3).tolist()
            for column, values in columns.items()
        }
        series[name] = nan_to_none(numbers)
    return {"name": tracks.name, "origin": origin, "series": series}


def _cell(cell: Cell, column: Column) -> dict[str, Any]:
    if isinstance(cell, str):
        return {"text": cell, "style": "long" if len(cell) > LONG_CELL else "", "key": None}
    known = cell_numbers(cell)
    return {"text": format_cell(cell, column, "–"), "style": "number", "key": known and repr(known[0])}


def _terms(text: str) -> Markup:
    return Markup(
        _TERM.sub(lambda found: f'<abbr title="{escape(TERMS[found[0]])}">{found[0]}</abbr>', escape(text))
    )


def _plain(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(str, value)) or "none"
    return str(value)
