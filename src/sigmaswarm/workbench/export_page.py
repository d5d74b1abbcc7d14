"""Step 5: export the filter as C, for ROS or for Python, and its trajectories."""

import shlex
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import ui

import sigmaswarm
from sigmaswarm import time_origin_of, write_estimate
from sigmaswarm.exports.names import DESCRIPTIONS, Description, next_command
from sigmaswarm.files import make_folder
from sigmaswarm.wording import count_of
from sigmaswarm.workbench.elements import Page, button, card, command, line, link, message, select, text
from sigmaswarm.workbench.state import Workbench, attempt

ENDINGS = {".csv": "CSV with standard deviations", ".tum": "TUM poses, for evo", ".kitti": "KITTI poses",
           ".mat": "MATLAB", ".geojson": "GeoJSON map", ".gpx": "GPX map", ".kml": "KML map",
           ".ros2": "ROS 2 bag"}  # fmt: skip


class ExportPage(Page):
    def __init__(self, bench: Workbench) -> None:
        super().__init__(bench)
        self.chosen: dict[str, Any] = {}
        self.outcomes: dict[str, tuple[str, str, str]] = {}
        """Keys are targets. Values are the message about written files, the error message, and the command that uses
        the files."""

    def content(self) -> None:
        tunings, drives = self.bench.finished, self.bench.drive_names
        if not tunings:
            text("p", "No tuned filter yet.")
            link("Tune a filter", "tune")
            return
        for key, names in (("tuning", tunings), ("drive", drives)):
            if self.chosen.get(key) not in names:
                self.chosen[key] = names[-1] if names else ""
        with line():
            select("Filter", tunings, self.chosen["tuning"], partial(self._choose, "tuning"))
            select("Drive to replay", drives, self.chosen["drive"], partial(self._choose, "drive"))
        message(self.waiting, "wait")
        for name, target in DESCRIPTIONS.items():
            with card():
                self._export(name, target)
        with card():
            self._trajectories()
        with card():
            text("h2", "The filter itself")
            text(
                "p",
                "tuning.toml contains parameters, units, data and versions; FilterParameters.load reads it.",
            )
            link("Download the tuning", f"download/tunings/{self.chosen['tuning']}", download=True)

    def _choose(self, key: str, value: Any) -> None:
        self.chosen[key], self.outcomes = value, {}
        self.refresh()

    def _folder(self, target: str) -> Path:
        return self.bench.path("exports", f"{self.chosen['tuning']}-{target}")

    def _export(self, name: str, target: Description) -> None:
        tuning = self.bench.path("tunings", self.chosen["tuning"])
        refused = attempt(sigmaswarm.export, tuning, name)[1]
        with line("between"):
            text("h2", target.title)
            write = button(f"Write {target.title}", partial(self._begin, name), "download", main=True)
            write.set_enabled(not self.waiting and not refused)
        text("p", (refused and f"Not available for this filter: {refused}") or target.needs, "soft")
        self._outcome(name)

    def _trajectories(self) -> None:
        text("h2", "Trajectories")
        text("p", "Estimates along the drive. Maps need a drive with an origin in degrees.", "soft")
        with line("end"):
            ending, smooth = self.chosen.get("ending", ".csv"), self.chosen.get("smooth", False)
            select("Format", ENDINGS, ending, partial(self._choose, "ending"))
            box = ui.checkbox("smoothed", value=smooth)
            box.on_value_change(lambda event: self._choose("smooth", event.value))
            write = button("Write", partial(self._begin, "track"), "timeline", main=True)
            write.set_enabled(not self.waiting)
        self._outcome("track")

    def _outcome(self, target: str) -> None:
        good, wrong, then = self.outcomes.get(target, ("", "", ""))
        message(wrong, "bad")
        message(good, "good")
        if good:
            link("Download as zip", f"download/exports/{self._folder(target).name}", download=True)
            if then:
                command(then)

    def _begin(self, target: str) -> None:
        self.start("writing", self._write, target, then=partial(self._wrote, target))
        self.refresh()

    def _wrote(self, target: str, written: tuple[str, str] | None) -> None:
        good, then = written or ("", "")
        self.outcomes[target] = good, self.wrong, then
        self.refresh()

    def _write(self, target: Any) -> tuple[str, str]:
        tuning = self.bench.path("tunings", self.chosen["tuning"])
        name, folder = self.chosen["drive"], make_folder(self._folder(target))
        drive = self.bench.read(name) if name else None
        if target == "track":
            if drive is None:
                raise sigmaswarm.InputError("there is no drive to run the filter over; import a log first")
            file = folder / f"{name}{self.chosen.get('ending', '.csv')}"
            if file.suffix == ".ros2" and file.exists():
                file = folder / f"{name}-{len(list(folder.iterdir()))}.ros2"
            estimate = sigmaswarm.run(drive, tuning, smooth=self.chosen.get("smooth", False))
            write_estimate(estimate, file, origin=drive.origin, time_origin=time_origin_of(drive), name=name)
            return f"wrote {file}", ""
        more = {"replay": drive} if target == "c99" and drive else {}
        texts = sigmaswarm.export(tuning, target, folder, **more)
        then = next_command(target, folder, texts)
        if name:
            then = then.replace(" DRIVE ", f" {shlex.quote(str(self.bench.path('drives', name)))} ")
        return f"wrote {count_of(len(texts), 'file')} to {folder}", then
