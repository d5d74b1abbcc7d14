"""The open log of step 1, the user's choices for its import, and the resulting drive."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import ui

import sigmaswarm
from sigmaswarm import Agreement, Drive, Inspection, agreements, find_mount
from sigmaswarm.workbench import columns
from sigmaswarm.workbench.elements import Page, message, text
from sigmaswarm.workbench.state import Workbench, attempt

Reading = tuple[Inspection | None, Drive | None, tuple[Agreement, ...], str, list[str]]
"""Content of a log, the drive, its `Agreement` plots, an error message, and notes on the log and the import."""


class OpenLog(Page):
    def __init__(self, bench: Workbench) -> None:
        super().__init__(bench)
        self.inspection: Inspection | None = None
        self.drive: Drive | None = None
        self.found: tuple[Agreement, ...] = ()
        self.done = self.mounted = ""
        self.notes: list[str] = []
        self.after_reading: Callable[[], Any] | None = None
        self.opened: Path | None = None

    @ui.refreshable_method
    def status(self) -> None:
        self.messages()
        if self.wrong and self.inspection and self.inspection.tables:
            text(
                "p", "Choose the use of each column below (--map). After each choice, the log is read again."
            )
        message(self.done, "good")

    def choose(self, **choices: Any) -> None:
        self.bench.log_choices.update(choices)
        self.bench.save()
        self.reread()
        self.status.refresh()

    def assign(self, table: str, column: str, target: str | None) -> None:
        if self.inspection:
            columns.assign(self.bench.log_choices, self.inspection, table, column, target or columns.UNUSED)
            self.choose()

    def express(self, target: str, expression: str) -> None:
        self.choose(maps={**self.bench.log_choices.get("maps", {}), target: expression})

    def reread(self) -> None:
        self.opened, self.done = self.bench.log, ""
        if self.opened:
            choices = {**self.bench.log_choices}
            self.start("reading the log", _read, self.opened, choices, then=self._set_reading)

    def _set_reading(self, reading: Reading | None) -> None:
        failed = None, None, (), self.wrong, self.notes
        inspection, self.drive, self.found, wrong, self.notes = reading or failed
        self.inspection, self.wrong = inspection or self.inspection, wrong
        self.refresh()
        proceed, self.after_reading = self.after_reading, None
        if proceed and not wrong:
            proceed()

    def find_mounting(self) -> None:
        if log := self.bench.log:
            choices = {**self.bench.log_choices, "mount": ""}
            self.start("looking for the mounting", _mounting, log, choices, then=self._found_mounting)
            self.status.refresh()

    def _found_mounting(self, mounting: tuple[str, str] | None) -> None:
        if mounting:
            mount, self.mounted = mounting
            self.choose(mount=mount)
        else:
            self.after_reading = None
            self.status.refresh()


def _read(log: Path, choices: dict[str, Any]) -> Reading:
    """Inspect and import a log. After an error, the results of earlier stages are kept."""
    settings = columns.settings_of(choices)
    drive, found, notes = None, (), list[str]()
    inspection, wrong = attempt(sigmaswarm.inspect_log, log, **settings)
    if inspection is not None:
        notes += inspection.notes
        drive, wrong = attempt(sigmaswarm.import_log, log, say=notes.append, **settings)
    if drive is not None:
        found, wrong = attempt(agreements, drive)
    return inspection, drive, found or (), wrong, [*dict.fromkeys(notes)]


def _mounting(log: Path, choices: dict[str, Any]) -> tuple[str, str]:
    return find_mount(sigmaswarm.import_log(log, **columns.settings_of(choices)))[1:]
