"""Step 5: export the filter as C, for ROS or for Python, or its trajectories."""

import shlex
from typing import Any

from nicegui import ui

import sigmaswarm
from sigmaswarm import FilterParameters
from sigmaswarm.exports.trajectory import time_origin_of, write_estimate
from sigmaswarm.files import make_folder
from sigmaswarm.tuning.record import FILE
from sigmaswarm.workbench.parts import aside, button, card, command, link, message, start, text
from sigmaswarm.workbench.state import Workbench

BUILD = (
    "cc -std=c99 -O2 ins_gps.c ins_gps_align.c replay.c -lm -o replay && ./replay < replay.csv > estimate.csv"
)
TARGETS = {
    "c99": (
        "C99",
        "Needs a C compiler and math.h; no heap, no other library. Runs on a microcontroller.",
        BUILD,
    ),
    "filterpy": (
        "Python",
        "Needs numpy and filterpy (pip install filterpy).",
        "python run_filter.py DRIVE estimate.csv",
    ),
    "robot_localization": (
        "ROS robot_localization",
        "Needs ROS 2 and robot_localization. Its filter has no IMU biases, so these are initial values.",
        "ros2 launch ekf.launch.py",
    ),
}
"""For each target its name, its requirements, and the next command."""
ENDINGS = {".csv": "CSV with standard deviations", ".tum": "TUM poses, for evo", ".kitti": "KITTI poses",
           ".mat": "MATLAB", ".geojson": "GeoJSON map", ".gpx": "GPX map", ".kml": "KML map",
           ".ros2": "ROS 2 bag"}  # fmt: skip


class TakePage:
    """The choice of a filter, its exports and its trajectories."""

    def __init__(self, bench: Workbench) -> None:
        self.bench = bench
        self.chosen: dict[str, Any] = {}
        self.said: dict[str, tuple[str, str]] = {}
        self.waiting = ""

    @ui.refreshable_method
    def content(self) -> None:
        """Show the step."""
        tunings, drives = self.bench.finished, self.bench.names("drives", "drive.toml")
        if not tunings:
            text("p", "No tuned filter yet.")
            link("Tune one", "tune")
            return
        if self.chosen.get("tuning") not in tunings:
            self.chosen["tuning"] = tunings[-1]
        if self.chosen.get("drive") not in drives:
            self.chosen["drive"] = drives[-1] if drives else ""
        with ui.element("div").classes("line"):
            for key, label, names in (("tuning", "Filter", tunings), ("drive", "Drive to replay", drives)):
                pick = ui.select(names, label=label, value=self.chosen[key] or None).classes("grow")
                pick.on_value_change(lambda event, key=key: self._choose(key, event.value))
        message(self.waiting, "wait")
        for target, (title, needs, then) in TARGETS.items():
            with card():
                self._head(target, title, needs)
                self._outcome(target, f"cd {shlex.quote(str(self._folder(target)))} && {then}")
        with card():
            text("h2", "Trajectories")
            text("p", "The filter's estimates over the drive. Maps need a drive with degrees.", "soft")
            with ui.element("div").classes("line end"):
                ending = ui.select(ENDINGS, label="Format", value=self.chosen.get("ending", ".csv")).classes(
                    "grow"
                )
                ending.on_value_change(lambda event: self._choose("ending", event.value))
                smooth = ui.checkbox("smoothed", value=self.chosen.get("smooth", False))
                smooth.on_value_change(lambda event: self._choose("smooth", event.value))
                button("Write", lambda: self._begin("track"), "timeline", main=True)
            self._outcome("track", "")
        with card():
            text("h2", "The filter itself")
            text(
                "p",
                "tuning.toml has the parameters with units, data and versions; FilterParameters.load reads it.",
            )
            link("Download the tuning", f"download/tunings/{self.chosen['tuning']}", download=True)

    def _choose(self, key: str, value: Any) -> None:
        self.chosen[key], self.said = value, {}
        self.content.refresh()

    def _folder(self, target: str) -> Any:
        return self.bench.path("exports", f"{self.chosen['tuning']}-{target}")

    def _head(self, target: str, title: str, needs: str) -> None:
        with ui.element("div").classes("line between"):
            text("h2", title)
            write = button(f"Write {title}", lambda: self._begin(target), "download", main=True)
            write.set_enabled(not self.waiting)
        text("p", needs, "soft")

    def _outcome(self, target: str, then: str) -> None:
        """The written files, the download, and the next command."""
        if target not in self.said:
            return
        good, wrong = self.said[target]
        message(wrong, "bad")
        if good:
            message(good, "good")
            link("Download as zip", f"download/exports/{self._folder(target).name}", download=True)
            if then:
                command(then)

    def _begin(self, target: str) -> None:
        self.waiting = "writing"
        self.content.refresh()
        start(self._work(target))

    async def _work(self, target: str) -> None:
        good, wrong = await aside(self._write, target)
        self.said[target], self.waiting = (good or "", wrong), ""
        self.content.refresh()

    def _write(self, target: str) -> str:
        """Write an export or a trajectory; return a sentence on it."""
        tuning = self.bench.path("tunings", self.chosen["tuning"])
        name, folder = self.chosen["drive"], make_folder(self._folder(target))
        drive = self.bench.read(name) if name else None
        if target == "track":
            if drive is None:
                raise sigmaswarm.InputError("there is no drive to run over; make one of a log")
            file = folder / f"{name}{self.chosen.get('ending', '.csv')}"
            if file.suffix == ".ros2" and file.exists():
                file = folder / f"{name}-{len(list(folder.iterdir()))}.ros2"
            estimate = sigmaswarm.run(drive, tuning / FILE, smooth=self.chosen.get("smooth", False))
            write_estimate(estimate, file, origin=drive.origin, time_origin=time_origin_of(drive), name=name)
            return f"wrote {file}"
        more = {"replay": drive} if target == "c99" and drive else {}
        texts = sigmaswarm.export(FilterParameters.load(tuning), target, folder, **more)  # pyright: ignore
        return f"wrote {len(texts)} files to {folder}"
