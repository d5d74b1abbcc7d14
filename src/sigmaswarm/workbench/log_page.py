"""Step 1: the content of a log, and its conversion to a drive."""

import asyncio
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui
from nicegui.events import MultiUploadEventArguments

import sigmaswarm
from sigmaswarm import Drive, InputError, write_drive
from sigmaswarm.doctor.agreements import Agreement, agreements
from sigmaswarm.importing.look import Look
from sigmaswarm.importing.mounting import find_mount
from sigmaswarm.workbench import columns
from sigmaswarm.workbench.mounting_panel import MountingPanel
from sigmaswarm.workbench.parts import aside, button, card, command, link, message, start, text
from sigmaswarm.workbench.plots import agreement_plot, fixes_of, map_plot
from sigmaswarm.workbench.state import CHECKED, MOST_UPLOADED, NAME, Workbench, attempt
from sigmaswarm.workbench.table_panel import TablePanel

SHOWN_FIRST = ("gravity", "turning", "forward")


class LogPage:
    """The open log: its content, the choices made, and the resulting drive."""

    def __init__(self, bench: Workbench) -> None:
        self.bench = bench
        self.look: Look | None = None
        self.drive: Drive | None = None
        self.found: tuple[Agreement, ...] = ()
        self.wrong = self.waiting = self.done = ""
        self.panels: list[TablePanel] = []
        self.mounting = MountingPanel(self)
        self._opened: Path | None = None
        self._asked = 0

    def content(self) -> None:
        """Show the step."""
        if self._opened != self.bench.log:
            self.reread()
        self._pick()
        self._status()
        self._notes()
        self._tables()
        self.mounting.show()
        self._agreement()
        self._finish()

    def refresh(self) -> None:
        """Show changes in all tabs."""
        same = self.look is not None and [p.glance.table for p in self.panels] == [
            g.table for g in self.look.tables
        ]
        if self.look is not None and same:
            uses = columns.uses_of(self.look)
            for panel in self.panels:
                panel.update(self.look, uses)
        else:
            self.panels = [TablePanel(self, self.look, g) for g in self.look.tables] if self.look else []
            self._tables.refresh()
        for part in (self._status, self._notes, self._agreement, self._finish):
            part.refresh()
        if self.mounting.shown != (self.look is not None, self.bench.log_choices.get("mount", "")):
            self.mounting.show.refresh()

    @ui.refreshable_method
    def _status(self) -> None:
        message(self.waiting, "wait")
        message(self.wrong, "bad")
        if self.wrong and self.look and self.look.tables:
            text("p", "Choose below what each column is used for; the log is read again after every choice.")
        message(self.done, "good")

    @ui.refreshable_method
    def _pick(self) -> None:
        """Choose a log, or drop one."""
        sources = {str(path): self._named(path) for path in self.bench.sources}
        with card():
            if sources:
                chosen = self.bench.choices.get("log")
                with ui.element("div").classes("line"):
                    options = {"": "choose a log", **sources}
                    pick = ui.select(options, label="Log", value=chosen if chosen in sources else "").classes(
                        "grow"
                    )
                    pick.on_value_change(lambda event: self.open(event.value))
                    further = {"": "in the same log", **sources}
                    for role, label in (("gps", "Fixes"), ("truth", "Truth, if any")):
                        value = self.bench.log_choices.get(role, "") if self.bench.log else ""
                        other = ui.select(further, label=label, value=value if value in further else "")
                        other.classes("grow").on_value_change(partial(self._other_log, role))
            else:
                text("h2", "Begin with a log")
                text(
                    "p",
                    "CSV, Parquet, a ROS bag, MCAP, u-blox, NMEA, PX4, a phone's export: the format is detected.",
                )
            drop = ui.upload(
                multiple=True,
                auto_upload=True,
                max_total_size=MOST_UPLOADED,
                on_multi_upload=self._dropped,
                on_rejected=lambda: ui.notify("too large: name the log on the command line"),
                label="Drop a file or a folder here, or press + and choose all files of one log",
            )
            drop.classes("drop").props(
                ':filter="files => files.filter(f => !window.droppedFolders.has(f.name))"'
            )

    def _named(self, path: Path) -> str:
        """The log's name, within its folder."""
        inside = path.parent in self.bench.named or path.parent.parent == self.bench.folder / "logs"
        return f"{path.parent.name} / {path.name}" if inside else path.name

    async def _dropped(self, event: MultiUploadEventArguments) -> None:
        """Save the files of one drop: a single file as it is, several as a folder."""
        files = [file for file in event.files if NAME.fullmatch(file.name)]
        if len(files) < len(event.files) or not files:
            self.wrong = "a dropped file has a name that can't be used; rename it to letters, digits, - and _"
            self._status.refresh()
            return
        name = self.bench.free("logs", Path(files[0].name).stem if len(files) == 1 else "log")
        folder = self.bench.path("logs", name)
        folder.mkdir()
        for file in files:
            await file.save(folder / file.name)
        self.open(str(folder / files[0].name if len(files) == 1 else folder))

    def open(self, path: str) -> None:
        """Open another log."""
        self.bench.choices["log"] = path
        self.bench.save()
        self.look, self.drive, self.found, self.panels, self.wrong, self.done = None, None, (), [], "", ""
        self._pick.refresh()
        self.reread()
        self.refresh()

    def _other_log(self, role: str, event: Any) -> None:
        self.choose(**{role: event.value})

    def choose(self, **choices: Any) -> None:
        """Change choices for the open log; look again."""
        self.bench.log_choices.update(choices)
        self.bench.save()
        self.reread()
        self._status.refresh()

    def assign(self, table: str, column: str, target: str) -> None:
        """Use a column for another quantity."""
        if self.look:
            columns.assign(self.bench.log_choices, self.look, table, column, target)
            self.choose()

    def express(self, target: str, expression: str) -> None:
        """Read a target by another expression."""
        self.choose(maps={**self.bench.log_choices.get("maps", {}), target: expression})

    def reread(self) -> None:
        """Inspect the log and import it in the background; only the last of several requests is used."""
        self._opened, self._asked = self.bench.log, self._asked + 1
        self.waiting, self.done = "reading the log" if self._opened else "", ""
        start(self._read(self._asked))

    async def _read(self, asked: int) -> None:
        log, look, drive, found = self.bench.log, self.look, None, ()
        await asyncio.sleep(0.1)
        if log is None or asked != self._asked:
            return
        options, wrong = attempt(columns.options_of, self.bench.log_choices)
        if options is not None:
            look, wrong = await aside(sigmaswarm.inspect_log, log, **options)
        if options is not None and not wrong:
            drive, wrong = await aside(sigmaswarm.import_log, log, name="drive", **options)
        if drive is not None:
            found, wrong = await aside(agreements, drive)
        if asked == self._asked:
            self.look, self.drive, self.found, self.wrong, self.waiting = look, drive, found or (), wrong, ""
            self.refresh()

    @ui.refreshable_method
    def _notes(self) -> None:
        """Assumptions of the import, and a proposal for the rest."""
        if (look := self.look) is None:
            return
        with ui.element("div").classes("section"):
            text("h2", "What is in it")
            for note in look.notes:
                text("p", note, "soft")
            if look.proposal:
                with card("warning"):
                    text("p", f"Not recognized automatically, but the names suggest: {look.proposal}")
                    text("p", look.evidence, "soft")
                    button("Use this", self._propose, "auto_fix_high", main=True)

    @ui.refreshable_method
    def _tables(self) -> None:
        for panel in self.panels:
            panel.show()

    def _propose(self) -> None:
        """Take the proposal's options as choices."""
        words, choices = shlex.split(self.look.proposal if self.look else ""), self.bench.log_choices
        key = ""
        for word in words:
            if word.startswith("--"):
                key = word
            elif key == "--map":
                target, _, expression = word.partition("=")
                role = next(
                    r for r in columns.ROLES if target.partition(".")[2] or target in columns.COLUMNS[r]
                )
                choices.setdefault("maps", {})[target if "." in target else f"{role}.{target}"] = expression
            else:
                choices.setdefault("tables", {})[key.removeprefix("--").removesuffix("-table")] = word
        self.choose()

    @ui.refreshable_method
    def _agreement(self) -> None:
        """Gravity, course and gyro, and their expected values."""
        if (drive := self.drive) is None:
            return
        with ui.element("div").classes("section"):
            text("h2", "Does it agree?")
            text(
                "p",
                "Solid: measured by the IMU. Dashed: expected. Zoom with the mouse.",
                "soft",
            )
            with ui.element("div").classes("grid"):
                for found in self.found:
                    if found.key in SHOWN_FIRST:
                        agreement_plot(found)
                with ui.element("figure"):
                    with ui.element("figcaption"):
                        ui.label("Map of the fixes")
                    map_plot(fixes_of(drive), "Map of the fixes", points=("fixes",), height=220)

    @ui.refreshable_method
    def _finish(self) -> None:
        """Name the drive and write it."""
        if (log := self.bench.log) is None or self.look is None:
            return
        made = self.bench.log_choices.get("made", "")
        name = self.bench.log_choices.get("name") or self.bench.free("drives", log.stem)
        again = bool(made) and made == name
        with card():
            text("h2", "Make a drive of it")
            with ui.element("div").classes("line end"):
                field = ui.input("Name of the drive", value=name).classes("grow")
                field.on("change", lambda: self.choose(name=field.value))
                label = "Make the drive again" if again else "Make the drive"
                make = button(label, lambda: self._make(field.value or "", again=again), "check", main=True)
                make.set_enabled(self.drive is not None and not self.waiting)
            ui.element("div").style("height: 12px")
            command(columns.command_of(log, self.bench.folder / "drives" / name, self.bench.log_choices))
            if self.done:
                link("Next: check it", "check")

    def _make(self, name: str, *, again: bool) -> None:
        """Write the drive; one that was made of this log before is replaced, and its repairs with it."""
        if self.drive is None:
            return
        path, wrong = attempt(self.bench.path, "drives", name)
        if path is not None:
            _, wrong = attempt(write_drive, replace(self.drive, name=name), path, overwrite=again)
        self.wrong, self.done = wrong, "" if wrong else f"wrote drives/{name}; check it next"
        if not wrong:
            self.bench.remove("drives", name + CHECKED)
            self.bench.log_choices.update(name=name, made=name)
            self.bench.choices["drive"] = name
            self.bench.save()
        self.refresh()

    def find_mounting(self) -> None:
        """Find the mounting in the log itself."""
        self.waiting = "looking for the mounting"
        self._status.refresh()
        start(self._find_mounting())

    async def _find_mounting(self) -> None:
        found, wrong = await aside(self._mounting_of_log)
        self.waiting, self.wrong = "", wrong
        if found:
            self.choose(mount=found)
        else:
            self._status.refresh()

    def _mounting_of_log(self) -> str:
        """The mounting that is found in the log, whatever the present choice."""
        if self.bench.log is None:
            raise InputError("no log is open")
        plain = {**self.bench.log_choices, "mount": ""}
        drive = sigmaswarm.import_log(self.bench.log, name="drive", **columns.options_of(plain))
        return find_mount(drive)[1]
