"""Tables of results for terminal, notebooks, pages, Markdown, LaTeX and CSV."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING

import polars as pl

from sigmaswarm import notebook

if TYPE_CHECKING:
    from rich.table import Table as RichTable

Range = tuple[float | None, float | None]  # lower and upper end
Cell = str | float | Range | None  # None: unknown
UNKNOWN = "-"
MAX_NAME_WIDTH = 20  # characters; longer names may be broken in a terminal
MAX_REPR_ROWS = 10  # rows in `repr`


@dataclass(frozen=True)
class Column:
    """A column of a table.

    ``number`` formats a number and both ends of a range; the default format has four digits for a number and three for
    the ends of a range. ``printed`` replaces ``number`` in Markdown, LaTeX and CSV. In these formats, the cell of a
    ``joined`` column is added to the previous cell: ``1.28 [1.26, 1.30]``.
    """

    title: str
    unit: str = ""
    number: Callable[[float], str] | None = None
    printed: Callable[[float], str] | None = None
    joined: bool = False

    @property
    def heading(self) -> str:
        return f"{self.title}, {self.unit}" if self.unit else self.title


@dataclass(frozen=True, repr=False)
class Table:
    """A table, which notebooks display. Rows with indices in ``strong`` are emphasized."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    strong: frozenset[int] = frozenset()
    note: str = ""

    def to_markdown(self) -> str:
        header, *rows = self._printed()
        rule = ["---", *["---:"] * (len(header) - 1)]
        lines = [f"**{self.caption}**", ""] if self.caption else []
        lines += [f"| {' | '.join(row)} |" for row in (header, rule, *rows)]
        return "\n".join([*lines, *(["", self.note] if self.note else [])]) + "\n"

    _repr_markdown_ = to_markdown

    def __repr__(self) -> str:
        hidden = len(self.rows) - MAX_REPR_ROWS
        if hidden <= 0:
            return replace(self, note="").to_markdown()
        few = replace(self, rows=self.rows[:MAX_REPR_ROWS], note=f"{hidden} more rows; to_markdown() has all")
        return few.to_markdown()

    def to_html(self) -> str:
        rows = [list(map(format_cell, row, self.columns)) for row in self.rows]
        return notebook.table(self.caption, [c.heading for c in self.columns], rows)

    def to_text(self) -> str:
        """Return aligned columns of plain text."""
        cells = [list(map(format_cell, row, self.columns)) for row in self.rows]
        lines = [[column.heading for column in self.columns], *cells]
        first, *widths = (max(map(len, column)) for column in zip(*lines, strict=True))
        return "\n".join("  ".join([row[0].ljust(first), *map(str.rjust, row[1:], widths)]) for row in lines)

    def to_latex(self) -> str:
        """Return a booktabs table."""
        header, *rows = (" & ".join(map(_escaped, row)) for row in self._printed())
        body = " \\\\\n".join(rows)
        return (
            f"% {self.note}\n\\begin{{table}}\n\\caption{{{_escaped(self.caption)}}}\n"
            f"\\begin{{tabular}}{{l{'r' * header.count(' & ')}}}\n\\toprule\n"
            f"{header} \\\\\n\\midrule\n{body} \\\\\n"
            "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
        )

    def to_csv(self) -> str:
        header, *rows = self._printed()
        return pl.DataFrame(rows, schema=header, orient="row").write_csv()

    def to_rich(self, *, grouped: bool = False) -> "RichTable":
        """Return the table for a terminal of 80 columns, with emphasized rows in bold.

        With ``grouped``, neighboring rows with the same first cell form a group whose heading is this cell. If there is
        only one group, the caption ends with this cell.
        """
        from rich import box
        from rich.table import Table as RichTable
        from rich.text import Text

        names = [str(row[0]) for row in self.rows]
        headings = grouped and len({*names}) > 1
        captions = self.caption, *names[: int(grouped and not headings)]
        drawn = RichTable(
            title=": ".join(filter(None, captions)) or None,
            title_justify="left",
            box=box.SIMPLE_HEAD,
            show_edge=False,
            padding=(0, 1, 0, 0),
        )
        for i, column in enumerate(self.columns[grouped:], start=int(grouped)):
            words = all(isinstance(row[i], str) for row in self.rows)
            heading = "\n".join(wrap(column.heading, 8, break_long_words=False))
            least = max(map(len, heading.split("\n")))
            if words and self.rows:
                least = max(least, min(MAX_NAME_WIDTH, *(len(str(row[i])) for row in self.rows)))
            justify = "left" if words else "right"
            drawn.add_column(heading, justify=justify, overflow="fold", min_width=least, no_wrap=not words)
        for i, cells in enumerate(self.rows):
            if headings and (i == 0 or names[i] != names[i - 1]):
                drawn.add_section()
                drawn.add_row(Text(names[i], "italic"))
            row = list(map(format_cell, cells, self.columns))
            drawn.add_row(*map(Text, row[grouped:]), style="bold" if i in self.strong else None)
        return drawn

    def _printed(self) -> list[list[str]]:
        """Return the heading and the rows. The text of a joined column is added to the previous column."""
        lines: list[list[str]] = [[]]
        for column in self.columns:
            if column.joined:
                lines[0][-1] += f" [{column.title}]"
            else:
                lines[0].append(column.heading)
        for cells in self.rows:
            lines.append([])
            for cell, column in zip(cells, self.columns, strict=True):
                if not column.joined:
                    lines[-1].append(_printed(cell, column))
                elif cell is not None:
                    lines[-1][-1] += f" {_printed(cell, column)}"
        return lines


def format_cell(cell: Cell, column: Column, unknown: str = UNKNOWN) -> str:
    if isinstance(cell, str):
        return cell
    known = cell_numbers(cell)
    if known is None:
        return unknown
    return " to ".join((column.number or partial(_short, 5 - len(known)))(end) for end in known)


def cell_numbers(cell: Cell) -> list[float] | None:
    """Return the number of a cell, or both ends of its range; None for an unknown number."""
    ends = cell if isinstance(cell, tuple) else (cell,)
    known = [float(end) for end in ends if isinstance(end, int | float) and math.isfinite(end)]
    return known if len(known) == len(ends) else None


def _short(digits: int, value: float) -> str:
    """Format a value with ``digits`` significant digits. Integers are written in full."""
    whole = value == int(value) or abs(value) >= 10**digits
    return f"{value:.0f}" if whole and abs(value) < 1e9 else f"{value:.{digits}g}"


def _printed(cell: Cell, column: Column) -> str:
    """Format a cell as `format_cell` does, with the printed number format and ranges in brackets."""
    column = replace(column, number=column.printed or column.number)
    if isinstance(cell, tuple):
        return f"[{', '.join(format_cell(end, column) for end in cell)}]"
    return format_cell(cell, column)


def _escaped(text: str) -> str:
    return re.sub("([&%_#])", r"\\\1", text).replace("+-", "$\\pm$")
