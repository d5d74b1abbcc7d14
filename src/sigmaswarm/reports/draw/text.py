"""Tables as text: Markdown, LaTeX, CSV, and for the terminal. All of them, and pages, write a cell the same way."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import polars as pl

from sigmaswarm.reports.views.record import Cell, Column, Table

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


@dataclass(frozen=True, repr=False)
class Printed:
    """A table to be printed; a notebook shows it as it is."""

    table: Table

    def to_markdown(self) -> str:
        """For README-like pages."""
        table, header = self.table, _header(self.table)
        lines = [f"**{table.caption}**", ""] if table.caption else []
        lines += [_bar(header), _bar(["---", *["---:"] * (len(header) - 1)]), *map(_bar, _rows(table))]
        return "\n".join([*lines, *(["", table.note] if table.note else [])]) + "\n"

    __repr__ = _repr_markdown_ = to_markdown

    def to_latex(self) -> str:
        """A booktabs table."""
        table, header = self.table, _header(self.table)
        body = " \\\\\n".join(" & ".join(map(_escaped, row)) for row in _rows(table))
        return (
            f"% {table.note}\n\\begin{{table}}\n\\caption{{{_escaped(table.caption)}}}\n"
            f"\\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}\n\\toprule\n"
            f"{' & '.join(map(_escaped, header))} \\\\\n\\midrule\n{body} \\\\\n"
            "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
        )

    def to_csv(self) -> str:
        """For spreadsheets."""
        return pl.DataFrame(_rows(self.table), schema=_header(self.table), orient="row").write_csv()


def _header(table: Table) -> list[str]:
    header: list[str] = []
    for column in table.columns:
        if column.joined:
            header[-1] += f" [{column.title}]"
        else:
            header.append(column.heading)
    return header


def _rows(table: Table) -> list[list[str]]:
    rows: list[list[str]] = []
    for cells in table.rows:
        rows.append([])
        for cell, column in zip(cells, table.columns, strict=True):
            if not column.joined:
                rows[-1].append(_printed(cell, column))
            elif cell is not None:
                rows[-1][-1] += f" {_printed(cell, column)}"
    return rows


def _printed(cell: Cell, column: Column) -> str:
    """As `shown`, but for how numbers are printed, and with a range in brackets."""
    column = replace(column, number=column.printed or column.number)
    if isinstance(cell, tuple):
        return f"[{', '.join(shown(end, column) for end in cell)}]"
    return shown(cell, column)


def _bar(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escaped(text: str) -> str:
    for plain in ("&", "%", "_", "#"):
        text = text.replace(plain, f"\\{plain}")
    return text.replace("+-", "$\\pm$")


def terminal(table: Table) -> "RichTable":
    """For `rich`: rows that matter most are bold, a line stands between those of one name and the next."""
    from rich.table import Table as RichTable

    drawn = RichTable(title=table.caption or None, title_justify="left")
    numeric = [any(not isinstance(row[i], str) for row in table.rows) for i in range(len(table.columns))]
    for column, right in zip(table.columns, numeric, strict=True):
        drawn.add_column(column.heading, justify="right" if right else "left")
    for i, cells in enumerate(table.rows):
        row = list(map(shown, cells, table.columns))
        starts = i == 0 or row[0] != table.rows[i - 1][0]
        if starts and i and len(row) > 1 and isinstance(table.rows[i][1], str):
            drawn.add_section()
        first = row[0] if starts else ""
        drawn.add_row(first, *row[1:], style="bold" if i in table.strong else None)
    return drawn
