"""One table of a log: its columns with a plot, and what each is used for."""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import ui

from sigmaswarm.importing.look import Glance, Look, Range
from sigmaswarm.importing.times import numbers_of
from sigmaswarm.workbench import columns
from sigmaswarm.workbench.columns import CUSTOM, NAMES, TARGETS, UNUSED, Uses
from sigmaswarm.workbench.parts import number, table, text
from sigmaswarm.workbench.plots import sparkline

if TYPE_CHECKING:
    from sigmaswarm.workbench.log_page import LogPage

MOST_COLUMNS = 30
"""Columns of a table that can be edited; columns in use come first."""
FIRST_ROWS = 5


def show_table(page: "LogPage", look: Look, glance: Glance, uses: Uses) -> None:
    """Show a table that can be folded; those in use are open."""
    used = [r for r in glance.ranges if (glance.table, r.column) in uses]
    rest = [r for r in glance.ranges if (glance.table, r.column) not in uses]
    roles: dict[str, list[str]] = {}
    for target in dict.fromkeys(t for r in used for t, _ in uses[glance.table, r.column]):
        role, _, name = target.partition(".")
        roles.setdefault(NAMES[role], []).append(name.replace("t", "time") if name == "t" else name)
    said = "; ".join(f"{role}: {', '.join(sorted(names))}" for role, names in roles.items())
    rows = f"{glance.rows} rows" if glance.rows is not None else ""
    rate = f"{glance.rate:.4g} Hz" if glance.rate else ""
    about = ", ".join(filter(None, (glance.kind, rows, rate, f"{len(glance.ranges)} columns")))
    heading = f"{glance.table}: {said or 'not used'}"
    unsure = page.drive is None and (bool(used) or len(look.tables) == 1)
    fold = ui.expansion(heading, caption=about, value=unsure or glance.table in page.unfolded).classes("card")
    fold.on_value_change(lambda event: _folded(page, glance.table, open_=event.value))
    with fold:
        with ui.element("div").classes("columns"):
            for shown in [*used, *rest][:MOST_COLUMNS]:
                _column(page, look, glance, shown, uses)
        if (left := len(glance.ranges) - MOST_COLUMNS) > 0:
            text("p", f"and {left} more columns, which expressions can use, too", "soft")
        first = look.rows[glance.table].head(FIRST_ROWS)
        if len(first) and (names := first.columns[:12]):
            with ui.expansion("First rows").classes("soft"):
                table(names, [[_cell(row[name]) for name in names] for row in first.to_dicts()])


def _folded(page: "LogPage", table_: str, *, open_: bool) -> None:
    (page.unfolded.add if open_ else page.unfolded.discard)(table_)


def _cell(value: Any) -> str:
    return (f"{value:.8g}" if isinstance(value, float) else str(value))[:40]


def _column(page: "LogPage", look: Look, glance: Glance, shown: Range, uses: Uses) -> None:
    """One row: name, plot, use, unit, expression, and below it what is wrong."""
    found = uses.get((glance.table, shown.column), [])
    target, expression = found[0] if found else (UNUSED, "")
    numeric = shown.low is not None
    with ui.element("div").classes("column-row"):
        with ui.element("div"):
            ui.label(shown.column).classes("column-name")
            span = (
                f"{number(shown.low)} to {number(shown.high)}" if numeric else shown.example[:40] or "empty"
            )
            ui.label(span).classes("range")
        values = numbers_of(look.rows[glance.table][shown.column]) if numeric else None
        drawn = (
            sparkline(values.cast(float).drop_nulls().to_numpy().astype(np.float64))
            if values is not None
            else ""
        )
        ui.html(drawn, sanitize=False)
        use = ui.select(TARGETS, label=f"Use of {shown.column}", value=target, with_input=True).classes(
            "field"
        )
        use.props("dense options-dense")
        use.on_value_change(lambda event: page.assign(glance.table, shown.column, event.value or UNUSED))
        if target:
            units = columns.units_of(target)
            unit = columns.unit_in(target, shown.column, expression)
            pick = (
                ui.select([*units, CUSTOM], label="Unit", value=unit)
                .classes("field")
                .props("dense options-dense")
            )
            pick.on_value_change(partial(_unit_chosen, page, target, shown.column))
            field = ui.input("Expression", value=expression).classes("field").props("dense")
            field.on("change", lambda: page.express(target, field.value or ""))
        for also, text_of in found[1:]:
            ui.label(f"also {TARGETS[also]} = {text_of}").classes("about")
        for sentence in _faults(page, look, glance, shown.column, target):
            with ui.element("div").classes("wrong").props('role="alert"'):
                ui.label(sentence)


def _unit_chosen(page: "LogPage", target: str, column: str, event: Any) -> None:
    if event.value != CUSTOM:
        page.express(target, columns.units_of(target)[event.value].format(columns.written(column)))


def _faults(page: "LogPage", look: Look, glance: Glance, column: str, target: str) -> list[str]:
    """Sentences about a column: reasons not to read it as guessed, and an error that names it."""
    mapped = page.bench.log_choices.get("maps", {})
    faults = [
        fault.sentence
        for fault in look.faults
        if fault.table == glance.table
        and f"{fault.role}.{fault.column}" not in mapped
        and columns.mentions(fault.sentence, column)
    ]
    own = page.wrong and (columns.mentions(page.wrong, column) or (target and f"{target}=" in page.wrong))
    return list(dict.fromkeys([*faults, *([page.wrong] if own else [])]))
