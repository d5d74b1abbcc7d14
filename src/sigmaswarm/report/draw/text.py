"""Tables as text: Markdown, LaTeX, CSV, and for the terminal. All of them, and pages, write a cell the same way."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import polars as pl

from sigmaswarm.report.views.record import Cell, Column, Table

if TYPE_CHECKING:
    from rich.table import Table as RichTable

UNKNOWN = "-"


def shown(cell: Cell, column: Column, unknown: str = UNKNOWN) -> str:
    """A cell as people read it: numbers to four digits, ranges to three, unless the column writes them itself."""
    if isinstance(cell, str):
        return cell
    ends = cell if isinstance(cell, tuple) else (cell,)
    known = [end for end in ends if end is not None and math.isfinite(end)]
    if len(known) < len(ends):
        return unknown
    return " to ".join((column.number or _digits(5 - len(ends)))(end) for end in known)


def _digits(digits: int) -> Callable[[float], str]:
    """So many of them; whole numbers in full."""

    def number(value: float) -> str:
        whole = value == int(value) or abs(value) >= 10**digits
        return f"{value:.0f}" if whole and abs(value) < 1e9 else f"{value:.{digits}g}"

    return number


def _texts(table: Table) -> list[list[str]]:
    return [
        [shown(cell, column) for cell, column in zip(row, table.columns, strict=True)] for row in table.rows
    ]


def markdown(table: Table) -> str:
    """For README-like pages."""
    header = [column.heading for column in table.columns]
    lines = [f"**{table.caption}**", ""] if table.caption else []
    lines += [_bar(header), _bar(["---", *["---:"] * (len(header) - 1)]), *map(_bar, _texts(table))]
    return "\n".join([*lines, *(["", table.note] if table.note else [])]) + "\n"


def _bar(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def latex(table: Table) -> str:
    """A booktabs table."""
    body = " \\\\\n".join(" & ".join(map(_escaped, row)) for row in _texts(table))
    return (
        f"% {table.note}\n\\begin{{table}}\n\\caption{{{_escaped(table.caption)}}}\n"
        f"\\begin{{tabular}}{{l{'r' * (len(table.columns) - 1)}}}\n\\toprule\n"
        f"{' & '.join(_escaped(column.heading) for column in table.columns)} \\\\\n\\midrule\n{body} \\\\\n"
        "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
    )


def _escaped(text: str) -> str:
    for plain in ("&", "%", "_", "#"):
        text = text.replace(plain, f"\\{plain}")
    return text.replace("+-", "$\\pm$")


def csv(table: Table) -> str:
    """For spreadsheets."""
    return pl.DataFrame(
        _texts(table), schema=[column.heading for column in table.columns], orient="row"
    ).write_csv()


def terminal(table: Table) -> "RichTable":
    """For `rich`: rows that matter most are bold, a line stands between those of one name and the next."""
    from rich.table import Table as RichTable

    drawn = RichTable(title=table.caption or None, title_justify="left")
    numeric = [any(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))]
    for column, right in zip(table.columns, numeric, strict=True):
        drawn.add_column(column.heading, justify="right" if right else "left")
    for i, row in enumerate(_texts(table)):
        starts = i == 0 or row[0] != table.rows[i - 1][0]
        if starts and i and len(row) > 1 and isinstance(table.rows[i][1], str):
            drawn.add_section()
        first = row[0] if starts else ""
        drawn.add_row(first, *row[1:], style="bold" if i in table.strong else None)
    return drawn
