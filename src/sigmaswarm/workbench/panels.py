"""Panels of step 1: a table of a log with its columns, and the mounting of the IMU in the vehicle."""

from functools import partial
from importlib.resources import files
from typing import Any

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from sigmaswarm import Inspection, Range, TablePreview, parse_mount
from sigmaswarm.arrays import Array
from sigmaswarm.geodesy import roll_pitch_yaw
from sigmaswarm.reports.style import BLUE, GREEN, VERMILION
from sigmaswarm.workbench import columns
from sigmaswarm.workbench.columns import CUSTOM, NAMES, TARGETS, UNUSED, Uses
from sigmaswarm.workbench.elements import box, button, card, line, message, number, select, table, text
from sigmaswarm.workbench.open_log import OpenLog
from sigmaswarm.workbench.plots import sparkline
from sigmaswarm.workbench.state import attempt

MAX_COLUMNS = 30  # largest number of columns of a table on the page; columns in use are first


class TablePanel:
    """Panel for a table, which can be folded. After a choice, only changed rows are redrawn."""

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
        """Show the table. Its columns are created when the table is first unfolded."""
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


FIND = "Find the mounting in the log"
ANGLES = ("roll", "pitch", "yaw")
SLIDER_DELAY = 0.6  # s from a change of a slider until the log is read again

CENTER, SCALE = np.array([170.0, 136.0]), 46
"""Pixel of the vehicle's origin in car.svg, and pixels per m."""
VIEW = np.array([(-0.530, 0.848, 0.0), (-0.345, -0.216, 0.914), (0.775, 0.484, 0.407)])
"""Rows: unit vectors right, up and towards the viewer of car.svg, in the axes of the vehicle."""
MOUNTED = np.array([-0.4, 0.0, 1.15])  # m, position of the drawn IMU, in the axes of the vehicle
AXES = (("x", VERMILION), ("y", GREEN), ("z", BLUE))
DIRECTIONS = (("forward", "backward"), ("left", "right"), ("up", "down"))


class MountingPanel:
    """Panel for the choice of the mounting. Moving a slider updates the sketch at once, and the plots after a pause."""

    def __init__(self, page: OpenLog) -> None:
        self.page = page
        self.shown: tuple[bool, str] = False, ""

    @property
    def state(self) -> tuple[bool, str]:
        return self.page.inspection is not None, self.page.bench.log_choices.get("mount", "")

    @ui.refreshable_method
    def show(self) -> None:
        self.shown = opened, mount = self.state
        if not opened:
            return
        rotation, wrong = attempt(parse_mount, mount) if mount else (None, "")
        rotation = np.eye(3) if rotation is None else rotation
        with card():
            text("h2", "Mounting of the IMU in the vehicle")
            message(wrong, "bad")
            with box("message good").props('role="status"') as element:
                ui.label().bind_text_from(self.page, "mounted")
            element.bind_visibility_from(self.page, "mounted")
            with box("grid"):
                picture = ui.html(sketch(rotation), sanitize=False)
                with box():
                    sliders = box()
                    with line("end"):
                        field = ui.input("Mounting (--mount)", value=mount)
                        field.props('hint="90, or 0,10,90, or x=-y,y=x"')
                        field.classes("grow").on("change", lambda: self._mount(field.value or ""))
                        with sliders:
                            self._angles(rotation, picture, field)
                        button(FIND, self.page.find_mounting, "explore")
                    about = "The arrows are the sensor's axes. No rotation is needed if x is forward, y left and z up."
                    text("p", about, "soft")
                    with ui.expansion("More settings").classes("soft"):
                        self._settings()

    def _mount(self, mount: str) -> None:
        self.page.mounted = ""
        self._choose("mount", mount)

    def _choose(self, key: str, value: object) -> None:
        self.page.choose(**{key: value.strip() if isinstance(value, str) else value})

    def _angles(self, rotation: Array, picture: ui.html, field: ui.input) -> None:
        sliders: list[ui.slider] = []

        def moved() -> None:
            angles = ",".join(f"{slider.value:.1f}" for slider in sliders)
            picture.set_content(sketch(parse_mount(angles)))

        def rested(changed: int, event: GenericEventArguments) -> None:
            values = [slider.value for slider in sliders]
            values[changed] = float(event.args)  # the slider itself may be updated later
            angles = ",".join(f"{round(value or 0.0, 1):g}" for value in values)
            field.value = "" if angles == "0,0,0" else angles
            self.shown = True, field.value
            self._mount(field.value)

        for index, (name, angle) in enumerate(zip(ANGLES, roll_pitch_yaw(rotation, 1), strict=True)):
            with line():
                label = ui.label().style("width: 110px")
                # With step 0, a slider keeps fractions of a degree, and an arrow key changes the angle by 1 degree.
                slider = ui.slider(min=-180, max=180, step=0, value=angle).classes("grow")
                slider.props(f'aria-label="{name}, degrees"').on_value_change(moved)
                slider.on("change", partial(rested, index), throttle=SLIDER_DELAY, leading_events=False)
                label.bind_text_from(slider, "value", lambda value, name=name: f"{name} {round(value, 1):g}°")
                sliders.append(slider)

    def _settings(self) -> None:
        chosen = self.page.bench.log_choices.get
        about = "Seconds to add to the times of the fixes (--gps-offset)"
        offset = ui.number(about, value=chosen("gps_offset_s"), step=0.01)
        about = "Vector from IMU to antenna: forward,left,up in m (--lever-arm)"
        arm = ui.input(about, value=chosen("gps_lever_arm_m", ""))
        about = "Number of the recording, if a clock restarts in the log (--part)"
        part = ui.number(about, value=chosen("part"), min=1, precision=0)
        offset.on("change", lambda: self._choose("gps_offset_s", offset.value or 0.0))
        arm.on("change", lambda: self._choose("gps_lever_arm_m", arm.value))
        part.on("change", lambda: self._choose("part", int(part.value) if part.value else None))


def sketch(rotation: Array) -> str:
    """Draw the vehicle and the sensor's axes as SVG. ``rotation`` is the result of `parse_mount`, shape (3, 3)."""
    corners = np.array([(0.3, 0.2, 0.0), (-0.3, 0.2, 0.0), (-0.3, -0.2, 0.0), (0.3, -0.2, 0.0)])
    box = _polygon(_place(MOUNTED + corners @ rotation.T), 'fill="#ffffffcc" stroke="#1c2024"')
    parts = [_arrow(np.array([2.2, 0.0, 0.6]), np.array([3.3, 0.0, 0.6]), "#51585f", "forward"), box]
    for k in np.argsort(VIEW[2] @ rotation):
        name, color = AXES[k]
        parts.append(_arrow(MOUNTED, MOUNTED + 1.35 * rotation[:, k], color, name))
    description = ", ".join(f"{name} {_direction(rotation[:, k])}" for k, (name, _) in enumerate(AXES))
    car = files("sigmaswarm.workbench").joinpath("car.svg").read_text()
    labeled = car.replace('aria-label=""', f'aria-label="The IMU in the vehicle: {description}"')
    return labeled.replace("</svg>", "".join([*parts, "</svg>"]))


def _place(points: Array) -> Array:
    """Project points (n, 3), m, to pixels (n, 2)."""
    return CENTER + SCALE * ((points - np.array([0.2, 0.0, 0.8])) @ VIEW[:2].T) * [1.0, -1.0]


def _polygon(places: Array, style: str) -> str:
    return f'<polygon points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in places)}" {style}/>'


def _arrow(start: Array, end: Array, color: str, name: str) -> str:
    first, last = _place(np.array([start, end]))
    length = float(np.hypot(*(last - first)))
    direction = (last - first) / length if length >= 8 else np.array([0.7, -0.7])
    across = np.array([-direction[1], direction[0]])
    head = np.array([last, last - 9 * direction + 4.5 * across, last - 9 * direction - 4.5 * across])
    if length >= 8:
        (x0, y0), (x1, y1) = first, last
        ends = f'x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}"'
        drawn = f'<line {ends} stroke="{color}" stroke-width="3"/>' + _polygon(head, f'fill="{color}"')
    else:  # towards the viewer, or away
        drawn = f'<circle cx="{last[0]:.1f}" cy="{last[1]:.1f}" r="5" fill="{color}"/>'
    x, y = last + 9 * direction
    style = 'text-anchor="middle" dominant-baseline="middle" font-size="14" font-weight="700"'
    halo = 'stroke="#fff" stroke-width="4" paint-order="stroke"'
    return f'{drawn}<text x="{x:.1f}" y="{y:.1f}" fill="{color}" {style} {halo}>{name}</text>'


def _direction(axis: Array) -> str:
    k = int(np.argmax(np.abs(axis)))
    return DIRECTIONS[k][int(axis[k] < 0)]
