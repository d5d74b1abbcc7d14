"""Panel for a table of a log: its columns, with their uses and small plots."""

from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from sigmaswarm import Inspection, Range, TablePreview
from sigmaswarm.importing import choices as columns
from sigmaswarm.importing.choices import CUSTOM, NAMES, TARGETS, UNUSED, Uses
from sigmaswarm.workbench.elements import box, number, select, table, text
from sigmaswarm.workbench.open_log import OpenLog
from sigmaswarm.workbench.plots import sparkline

MAX_COLUMNS = 30  # largest number of columns of a table on the page; columns in use are first


class TablePanel:
    """Panel for a table, which can be folded; after a choice, only changed rows are redrawn."""

    def __init__(self, page: OpenLog, inspection: Inspection, preview: TablePreview) -> None:
        self.page, self.inspection, self.preview = page, inspection, preview
        self.uses = columns.uses_of(inspection)
        shown = sorted(preview.ranges, key=lambda r: (preview.table, r.column) not in self.uses)
        self.rows = [ColumnRow(self, one) for one in shown[:MAX_COLUMNS]]
        used = (preview.table, shown[0].column) in self.uses if shown else False
        # Until the log can be imported, tables in use are unfolded; if there are few tables, all are unfolded.
        self.unfolded = page.drive is None and (used or len(inspection.tables) <= 4)

    def update(self, inspection: Inspection, uses: Uses) -> None:
        self.inspection, self.uses = inspection, uses
        for row in self.rows:
            if row.state() != row.shown:
                row.show.refresh()

    @property
    def heading(self) -> str:
        roles: dict[str, set[str]] = {}
        for (table_, _), uses in self.uses.items():
            for target, _ in uses if table_ == self.preview.table else ():
                role, _, name = target.partition(".")
                roles.setdefault(NAMES[role], set()).add("time" if name == "t" else name)
        description = "; ".join(f"{role}: {', '.join(sorted(names))}" for role, names in roles.items())
        return f"{self.preview.table}: {description or 'not used'}"

    def show(self) -> None:
        """Show the table; its columns are created when the table is first unfolded."""
        preview = self.preview
        rows = f"{preview.rows} rows" if preview.rows is not None else ""
        rate = f"{preview.rate:.4g} Hz" if preview.rate else ""
        about = ", ".join(filter(None, (preview.kind, rows, rate, f"{len(preview.ranges)} columns")))
        fold = ui.expansion(caption=about).classes("card").bind_value(self, "unfolded")
        fold.bind_text_from(self, "heading")
        with fold:
            inside = box()

        def unfold() -> None:
            if self.unfolded and not inside.default_slot.children:
                with inside:
                    self._content()

        fold.on_value_change(unfold)
        unfold()

    def _content(self) -> None:
        with box("columns"):
            for row in self.rows:
                row.show()
        if (hidden := len(self.preview.ranges) - MAX_COLUMNS) > 0:
            text("p", f"{hidden} more columns are not shown; expressions can also use them", "soft")
        first = self.inspection.rows[self.preview.table].head(5)
        if len(first) and (names := first.columns[:12]):
            with ui.expansion("First rows").classes("soft"):
                table(names, [[_cell(row[name]) for name in names] for row in first.to_dicts()])


def _cell(value: Any) -> str:
    return (f"{value:.8g}" if isinstance(value, float) else str(value))[:40]


class ColumnRow:
    def __init__(self, panel: TablePanel, about: Range) -> None:
        self.panel, self.about = panel, about
        self.shown: Any = None

    def state(self) -> tuple[list[tuple[str, str]], list[str]]:
        uses = self.panel.uses.get((self.panel.preview.table, self.about.column), [])
        return uses, self._faults(uses[0][0] if uses else "")

    @ui.refreshable_method
    def show(self) -> None:
        self.shown = uses, faults = self.state()
        page, about, table_ = self.panel.page, self.about, self.panel.preview.table
        target, expression = uses[0] if uses else (UNUSED, "")
        with box("column-row"):
            with box():
                ui.label(about.column).classes("column-name")
                span = f"{number(about.low)} to {number(about.high)}"
                ui.label(span if about.low is not None else about.example[:40] or "empty").classes("range")
            values = np.empty(0) if about.low is None else self.panel.inspection.numbers(table_, about.column)
            ui.html(sparkline(values), sanitize=False)
            choose = partial(page.assign, table_, about.column)
            use = select(f"Use of {about.column}", TARGETS, target, choose, with_input=True)
            use.classes("field").props("dense options-dense")
            if target:
                self._unit(target, expression)
            for also, sentence in uses[1:]:
                ui.label(f"also {TARGETS[also]} = {sentence}").classes("about")
            for sentence in faults:
                with box("wrong").props('role="alert"'):
                    ui.label(sentence)

    def _unit(self, target: str, expression: str) -> None:
        page, column, units = self.panel.page, self.about.column, columns.units_of(target)

        def chosen(unit: str) -> None:
            if unit != CUSTOM:
                page.express(target, columns.expression_of(target, column, unit))

        unit = columns.unit_in(target, column, expression)
        pick = select(f"Unit of {column}", [*units, CUSTOM], unit, chosen)
        pick.classes("field").props("dense options-dense")
        field = ui.input("Expression", value=expression).classes("field").props("dense")
        field.on("change", lambda: page.express(target, field.value or ""))

    def _faults(self, target: str) -> list[str]:
        """Return the parts of the error that name the column, or the reasons why the column was not recognized."""
        page, column = self.panel.page, self.about.column
        mapped = page.bench.log_choices.get("maps", {})
        faults = [
            fault.sentence
            for fault in self.panel.inspection.faults
            if fault.table == self.panel.preview.table
            and f"{fault.role}.{fault.column}" not in mapped
            and columns.mentions(fault.sentence, column)
        ]
        own = [
            part
            for part in page.wrong.split("; and ")
            if columns.mentions(part, column) or (target and f"{target}=" in part)
        ]
        return own or list(dict.fromkeys(faults))
