"""A report as one HTML file that needs nothing else: no network, no other file."""

import json
import math
from collections.abc import Iterator
from html import escape
from importlib.resources import files
from importlib.resources.abc import Traversable
from string import Template
from typing import Any

import numpy as np

from sigmaswarm.reports.draw import plotly
from sigmaswarm.reports.draw.text import shown
from sigmaswarm.reports.views.record import Cell, Column, Line, Report, Section, Table, TrackView
from sigmaswarm.scoring.consistency import GATE_95
from sigmaswarm.scoring.tracks import Tracks
from sigmaswarm.versions import __version__

LONG = 24
"""Characters of a cell above which it needs some width, lest it become a tall column of words."""


def page(report: Report) -> str:
    """The whole page.

    Every text of the report is escaped, and the page's policy forbids any request, so that neither a drive's name nor
    anything else can reach out of it.
    """
    from plotly.offline import get_plotlyjs

    assets = _assets()
    charts = [chart for section in report.sections for chart in section.charts]
    data = {
        "charts": [plotly.content(chart) for chart in charts],
        "tracks": next((_view(section.tracks) for section in report.sections if section.tracks), None),
        "gate": GATE_95,
    }
    numbers = iter(range(len(charts)))
    return Template(assets.joinpath("page.html").read_text(encoding="utf-8")).substitute(
        title=escape(report.title),
        lead="".join(f"<p>{escape(sentence)}</p>" for sentence in report.lead),
        figures="".join(
            f"<div><dt>{escape(f.label)}</dt><dd>{escape(f.value)}<small>{escape(f.note)}</small></dd></div>"
            for f in report.figures
        ),
        remarks=_remarks(report),
        sections="".join(_section(section, numbers) for section in report.sections),
        repeat=_repeat(report),
        version=escape(__version__),
        style=assets.joinpath("page.css").read_text(encoding="utf-8"),
        plotly=get_plotlyjs(),
        script=assets.joinpath("page.js").read_text(encoding="utf-8"),
        data=_json(data),
    )


def _assets() -> Traversable:
    """The folder of the page's frame, style and script."""
    return files("sigmaswarm.reports.draw").joinpath("page")


def _json(content: Any) -> str:
    """JSON that can stand inside a script element: no text in it can end the element."""
    return json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _view(view: TrackView) -> dict[str, Any]:
    there = {name for drive in view.drives for name in drive.series}
    lines = [_line(line) for line in view.lines if line.series in there]
    return {"drives": [_tracks(t) for t in view.drives], "lines": lines, "main": view.main}


def _line(line: Line) -> dict[str, Any]:
    look = {"color": line.look.color, "dash": line.look.dash, "width": max(line.look.width, 1.2)}
    return {"series": line.series, "label": line.label, "shown": line.shown, **look}


def _tracks(tracks: Tracks) -> dict[str, Any]:
    """Numbers to the millimetre and millisecond; large time stamps from the drive's beginning."""
    first = min(float(columns["time"][0]) for columns in tracks.series.values())
    origin = first if abs(first) > 1000 else 0.0
    series = {
        name: {
            column: _rounded(values - origin if column == "time" else values)
            for column, values in columns.items()
        }
        for name, columns in tracks.series.items()
    }
    return {"name": tracks.name, "origin": origin, "series": series}


def _rounded(values: np.ndarray[Any, Any]) -> list[float | None]:
    return [v if math.isfinite(v) else None for v in np.round(values.astype(np.float64), 3).tolist()]


def _remarks(report: Report) -> str:
    if not report.remarks:
        return ""
    items = "".join(f"<li>{escape(remark)}</li>" for remark in report.remarks)
    return f'<aside><h2>Before you trust it</h2><ul id="remarks">{items}</ul></aside>'


def _section(section: Section, numbers: Iterator[int]) -> str:
    parts = [f"<section><h2>{escape(section.title)}</h2>"]
    parts += [f"<p>{escape(text)}</p>" for text in section.text]
    parts += [_table(table) for table in section.tables]
    charts = [
        f'<figure><figcaption>{escape(c.title)}</figcaption><div class="chart" data-chart="{next(numbers)}" role="img" '
        f'aria-label="{escape(c.title)}"></div></figure>'
        for c in section.charts
    ]
    look = "charts two" if any(chart.broad for chart in section.charts) else "charts"
    parts += [f'<div class="{look}">{"".join(charts)}</div>'] if charts else []
    if section.tracks:
        parts.append(_assets().joinpath("tracks.html").read_text(encoding="utf-8"))
    return "".join([*parts, "</section>"])


def _table(table: Table) -> str:
    head = "".join(_head(column) for column in table.columns)
    strong = [' class="strong"' if i in table.strong else "" for i in range(len(table.rows))]
    rows = zip(strong, table.rows, strict=True)
    body = "".join(f"<tr{look}>{''.join(map(_cell, row, table.columns))}</tr>" for look, row in rows)
    caption = f"<caption>{escape(table.caption)}</caption>" if table.caption else ""
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="table"><table class="sortable">{caption}'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _head(column: Column) -> str:
    return f'<th scope="col"><button type="button">{escape(column.heading)}</button></th>'


def _cell(cell: Cell, column: Column) -> str:
    """With the number that the table is sorted by."""
    if isinstance(cell, str):
        look = ' class="long"' if len(cell) > LONG else ""
        return f"<td{look}>{escape(cell)}</td>"
    ends = cell if isinstance(cell, tuple) else (cell,)
    known = [end for end in ends if end is not None and math.isfinite(end)]
    if len(known) < len(ends):
        return '<td class="number">–</td>'
    return f'<td class="number" data-value="{known[0]!r}">{shown(cell, column)}</td>'


def _repeat(report: Report) -> str:
    """How to get the same result again: the command, the configuration, the versions."""
    command = ""
    if report.command:
        command = (
            f'<div class="command"><pre><code id="command">{escape(report.command)}</code></pre>'
            '<button type="button" id="copy">Copy</button></div>'
        )
    note = f"<p>{escape(report.command_note)}</p>" if report.command_note else ""
    return command + note + _pairs("Configuration", report.config) + _pairs("Versions", report.versions)


def _pairs(title: str, pairs: Any) -> str:
    rows = "".join(
        f"<tr><th scope='row'>{escape(str(key))}</th><td>{escape(_plain(value))}</td></tr>"
        for key, value in pairs.items()
    )
    return (
        f"<h3>{title}</h3><div class='wide'><table class='pairs'><tbody>{rows}</tbody></table></div>"
        if rows
        else ""
    )


def _plain(value: Any) -> str:
    return ", ".join(map(str, value)) or "none" if isinstance(value, list | tuple) else str(value)  # pyright: ignore
