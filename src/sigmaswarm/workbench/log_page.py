"""Step 1: show the content of a log, and convert it to a drive."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from nicegui import ui
from nicegui.events import MultiUploadEventArguments

from sigmaswarm import write_drive
from sigmaswarm.workbench import columns
from sigmaswarm.workbench.elements import box, button, card, command, line, link, select, text
from sigmaswarm.workbench.open_log import OpenLog
from sigmaswarm.workbench.panels import FIND, MountingPanel, TablePanel
from sigmaswarm.workbench.plots import agreement_plot, show_map
from sigmaswarm.workbench.state import CHECKED, MAX_UPLOAD_SIZE, NAME, TOO_LARGE, Workbench, attempt


class LogPage(OpenLog):
    def __init__(self, bench: Workbench) -> None:
        super().__init__(bench)
        self.panels: list[TablePanel] = []
        self.mounting = MountingPanel(self)
        self.finished = self._finishing

    def content(self) -> None:
        if self.opened != self.bench.log:
            self.reread()
        self._pick()
        self.status()
        self._notes()
        self._tables()
        self.mounting.show()
        self._agreement()
        self._finish()

    def refresh(self) -> None:
        """Redraw what has changed. Unchanged rows of a table are kept, with the keyboard focus."""
        shown = [panel.preview.table for panel in self.panels]
        if self.inspection and shown == [preview.table for preview in self.inspection.tables]:
            uses = columns.uses_of(self.inspection)
            for panel in self.panels:
                panel.update(self.inspection, uses)
        else:
            tables = self.inspection.tables if self.inspection else ()
            self.panels = [TablePanel(self, self.inspection, table) for table in tables if self.inspection]
            self._tables.refresh()
        for part in (self.status, self._notes, self._agreement, self._command):
            part.refresh()
        if self.finished != self._finishing:
            self._finish.refresh()
        if self.mounting.shown != self.mounting.state:
            self.mounting.show.refresh()

    @ui.refreshable_method
    def _pick(self) -> None:
        sources = {str(path): self._named(path) for path in self.bench.sources}
        with card():
            if sources:
                with line():
                    chosen = str(self.bench.log or "")
                    select("Log", {"": "choose a log", **sources}, chosen, self.open)
                    further = {"": "in the same log", **sources}
                    for role, label in (("gps", "Fixes"), ("truth", "Truth, if any")):
                        value = self.bench.log_choices.get(role, "") if self.bench.log else ""
                        select(label, further, value, lambda path, role=role: self.choose(**{role: path}))
            else:
                text("h2", "Begin with a log")
                formats = "CSV, Parquet, a ROS bag, MCAP, u-blox, NMEA, PX4, a phone's export"
                text("p", f"{formats}: the format is detected.")
            drop = ui.upload(
                multiple=True,
                auto_upload=True,
                max_total_size=MAX_UPLOAD_SIZE,
                on_multi_upload=self._dropped,
                on_rejected=lambda: ui.notify(f"the log is {TOO_LARGE}"),
                label="Drop a file or a folder here, or press + and choose all files of one log",
            )
            only_files = "files => files.filter(f => !window.droppedFolders.has(f.name))"
            drop.classes("drop").props(f':filter="{only_files}"')

    def _named(self, path: Path) -> str:
        """Return the name of a log. The name of a file in a folder includes the name of the folder."""
        inside = path.parent in self.bench.named or path.parent.parent == self.bench.folder / "logs"
        return f"{path.parent.name} / {path.name}" if inside else path.name

    async def _dropped(self, event: MultiUploadEventArguments) -> None:
        """Save dropped files in a folder, and open the folder or the only file."""
        files, dropped = event.files, await ui.run_javascript("window.nameOfDrop()")
        if invalid := [file.name for file in files if not NAME.fullmatch(file.name)]:
            self.wrong = (
                f"{invalid[0]}: this name can't be used; use a file name of letters, digits, dots, - and _"
            )
            self.status.refresh()
            return
        name = dropped or (Path(files[0].name).stem if len(files) == 1 else "log")
        folder = self.bench.path("logs", self.bench.free("logs", name))
        folder.mkdir()
        for file in files:
            await file.save(folder / file.name)
        self.open(str(folder / files[0].name if len(files) == 1 else folder))

    def open(self, path: str) -> None:
        self.bench.choices["log"] = path
        self.bench.save()
        self.inspection, self.drive, self.after_reading = None, None, None
        self.found, self.panels, self.wrong, self.mounted = (), [], "", ""
        self._pick.refresh()
        self.reread()
        self.refresh()

    @ui.refreshable_method
    def _notes(self) -> None:
        if (inspection := self.inspection) is None:
            return
        with box("section"):
            text("h2", "Contents of the log")
            for note in self.notes:
                text("p", note, "soft")
            if any("--mount" in note for note in self.notes):
                text("p", f"On this page: press {FIND!r}, or enter the mounting below the tables.", "soft")
            if inspection.proposal:
                with card("warning"):
                    text("p", f"Some columns were not recognized. Their names suggest: {inspection.proposal}")
                    text("p", inspection.evidence, "soft")
                    button("Use this", self._propose, "auto_fix_high", main=True)

    def _propose(self) -> None:
        for key, proposed in (self.inspection.settings if self.inspection else {}).items():
            self.bench.log_choices.setdefault(key, {}).update(proposed)
        self.choose()

    @ui.refreshable_method
    def _tables(self) -> None:
        for panel in self.panels:
            panel.show()

    @ui.refreshable_method
    def _agreement(self) -> None:
        if (drive := self.drive) is None:
            return
        with box("section"):
            text("h2", "Agreement of the IMU with the fixes")
            about = (
                "Solid: measured by the IMU. Dashed: expected from gravity or the fixes. Zoom with the mouse."
            )
            text("p", about, "soft")
            with box("grid"):
                for agreement in self.found:
                    if agreement.key in ("gravity", "turning", "forward"):
                        agreement_plot(agreement)
                with ui.element("figure"):
                    text("figcaption", "Map of the fixes")
                    show_map(drive, "Map of the fixes", 220)

    @ui.refreshable_method
    def _finish(self) -> None:
        self.finished = opened, name, made, done = self._finishing
        if not opened:
            return

        def label(name: str) -> str:
            return "Make the drive again" if name == made else "Make the drive"

        with card():
            text("h2", "Make a drive from the log")
            with line("end"):
                field = ui.input("Name of the drive", value=name).classes("grow")
                field.on("change", lambda: self._rename(field.value or ""))
                make = button(label(name), lambda: self._make(field.value or ""), "check", main=True)
                make.bind_enabled_from(self, "drive", bool).bind_text_from(field, "value", label)
            self._command()
            if done:
                link("Next: check the drive", "check")

    @property
    def _finishing(self) -> tuple[bool, str, str, str]:
        """State of the last card: True if a log is open, the drive's name, the last written drive, and a message."""
        choices, log = self.bench.log_choices, self.bench.log
        name = choices.get("name") or self.bench.free("drives", log.stem if log else "")
        return log is not None and self.inspection is not None, name, choices.get("made", ""), self.done

    @ui.refreshable_method
    def _command(self) -> None:
        if log := self.bench.log:
            folder = self.bench.folder / "drives" / self._finishing[1]
            command(columns.command_of(log, folder, self.bench.log_choices))

    def _rename(self, name: str) -> None:
        self.bench.log_choices["name"] = name
        self.bench.save()
        self._command.refresh()

    def _make(self, name: str) -> None:
        """Write the drive and remove its checked copy. An earlier drive of this log with the same name is replaced."""
        if self.waiting:  # the log is being read again after a choice
            self.after_reading = partial(self._make, name)
            return
        if self.drive is None:
            return
        path, wrong = attempt(self.bench.path, "drives", name)
        if path is not None:
            again = self.bench.log_choices.get("made") == name
            _, wrong = attempt(write_drive, replace(self.drive, name=name), path, overwrite=again)
        self.wrong, self.done = wrong, "" if wrong else f"wrote drives/{name}; check this drive next"
        if not wrong:
            self.bench.remove("drives", name + CHECKED)
            self.bench.log_choices.update(name=name, made=name)
            self.bench.choices["drive"] = name
            self.bench.save()
        self.refresh()
