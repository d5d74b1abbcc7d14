"""Step 2: the findings on a drive, each with the plot that shows it; repairs and cuts, and how to undo them."""

from dataclasses import replace
from typing import Any

from nicegui import ui

import sigmaswarm
from sigmaswarm import Drive
from sigmaswarm.doctor.agreements import Agreement, agreements, shown_by
from sigmaswarm.doctor.findings import Diagnosis, Finding
from sigmaswarm.wording import counted
from sigmaswarm.workbench.parts import aside, button, card, link, message, start, text
from sigmaswarm.workbench.plots import TimePlot, agreement_plot, fixes_of, map_plot
from sigmaswarm.workbench.state import CHECKED, Workbench

SHORTEST = 30.0
"""s: length of the shortest part that can be kept."""
Step = dict[str, Any]
"""``{"repair": [codes]}`` or ``{"keep": [start, end]}``, s; steps are done in order."""
Agreements = dict[str, Agreement]


class CheckPage:
    """The drive that is checked: the original, the steps applied to it, and the remaining findings."""

    def __init__(self, bench: Workbench) -> None:
        self.bench = bench
        self.stages: list[Drive] = []
        self.steps: list[Step] = []
        self.diagnosis: Diagnosis | None = None
        self.before: Agreements = {}
        self.after: dict[str, tuple[Agreements, str]] = {}
        self.waiting = self.wrong = ""
        self._opened = ""
        self._asked = 0

    @property
    def name(self) -> str:
        """The drive to check, by its original's name."""
        names = self._originals()
        chosen = self.bench.choices.get("drive", "")
        return chosen if chosen in names else (names[-1] if names else "")

    def _originals(self) -> list[str]:
        return [name for name in self.bench.names("drives", "drive.toml") if not name.endswith(CHECKED)]

    @ui.refreshable_method
    def content(self) -> None:
        """Show the step."""
        if not self.name:
            text("p", "No drive yet.")
            link("Make one of a log", "log")
            return
        with ui.element("div").classes("line"):
            pick = ui.select(self._originals(), label="Drive", value=self.name).classes("grow")
            pick.on_value_change(lambda event: self.open(event.value))
        if self._opened != self.name:
            self.open(self.name, show=False)
        message(self.waiting, "wait")
        message(self.wrong, "bad")
        if not self.stages:
            return
        self._done()
        self._findings()
        self._cut()
        with ui.element("div").classes("line"):
            link("Next: tune a filter on it", "tune")

    def open(self, name: str, *, show: bool = True) -> None:
        """Check another drive."""
        self.bench.choices["drive"] = self._opened = name
        self.bench.save()
        self.stages, self.steps, self.diagnosis, self.wrong = [], [], None, ""
        self._begin("reading and checking the drive", None, show=show)

    def add(self, step: Step) -> None:
        """Do a repair or a cut."""
        self._begin("repairing and checking" if "repair" in step else "cutting", [*self.steps, step])

    def take_back(self, number: int) -> None:
        """Undo one step; the later ones are done again without it."""
        self._begin("taking it back", [*self.steps[:number], *self.steps[number + 1 :]])

    def _begin(self, waiting: str, steps: list[Step] | None, *, show: bool = True) -> None:
        self.waiting, self._asked = waiting, self._asked + 1
        start(self._work(self._asked, self.name, steps))
        if show:
            self.content.refresh()

    async def _work(self, asked: int, name: str, steps: list[Step] | None) -> None:
        done, wrong = await aside(self._rebuilt, name, steps)
        if asked != self._asked:
            return
        self.waiting, self.wrong = "", wrong
        if done is not None:
            self.stages, self.steps, self.diagnosis, self.before, self.after = *done, {}
        self.content.refresh()
        if self.diagnosis and self.stages:
            await self._look_ahead(asked, self.stages[-1], self.diagnosis)

    def _rebuilt(
        self, name: str, steps: list[Step] | None
    ) -> tuple[list[Drive], list[Step], Diagnosis | None, Agreements]:
        """Apply the steps, earlier ones from memory, and write the result."""
        stages, known = self.stages, self.steps
        if steps is None:
            stages, known, steps = [self.bench.read(name)], [], self._saved_steps(name)
        same = next(
            (i for i, (a, b) in enumerate(zip(steps, known, strict=False)) if a != b),
            min(len(steps), len(known)),
        )
        stages = stages[: same + 1]
        for step in steps[same:]:
            stages = [*stages, _apply(stages[-1], step)]
        target = self.bench.path("drives", name + CHECKED)
        if steps:
            metadata = {**stages[-1].metadata, "steps": steps}
            sigmaswarm.write_drive(
                replace(stages[-1], name=target.name, metadata=metadata), target, overwrite=True
            )
        else:
            self.bench.remove("drives", target.name)
        diagnosis = sigmaswarm.diagnose(stages[-1])
        return stages, steps, diagnosis, {a.key: a for a in agreements(stages[-1])}

    def _saved_steps(self, name: str) -> list[Step]:
        if name + CHECKED not in self.bench.names("drives", "drive.toml"):
            return []
        return list(self.bench.read(name + CHECKED).metadata.get("steps", []))

    async def _look_ahead(self, asked: int, drive: Drive, diagnosis: Diagnosis) -> None:
        """Try each repair, so that its card shows its effect."""
        for finding in diagnosis.findings:
            if finding.repair is None or finding.code in self.after:
                continue
            tried, wrong = await aside(_tried, drive, diagnosis, finding.code)
            if asked != self._asked:
                return
            self.after[finding.code] = tried or ({}, wrong)
        if self.after:
            self._findings.refresh()

    def _done(self) -> None:
        """The applied steps, each with a button to undo it."""
        for number, step in enumerate(self.steps):
            with card("done"), ui.element("div").classes("line between"):
                said = f"repaired: {', '.join(step['repair'])}" if "repair" in step else _kept(step["keep"])
                text("h3", said)
                back = button("Take it back", lambda number=number: self.take_back(number), "undo")
                back.props(f'aria-label="Take back: {said}"').set_enabled(not self.waiting)

    @ui.refreshable_method
    def _findings(self) -> None:
        if (diagnosis := self.diagnosis) is None:
            return
        with ui.element("div").classes("section"):
            serious = sum(finding.severity == "serious" for finding in diagnosis.findings)
            with ui.element("div").classes("line between"):
                text("h2", f"{counted(serious, 'serious finding')}" if serious else "Nothing serious")
                mendable = list(dict.fromkeys(f.code for f in diagnosis.findings if f.repair is not None))
                if len(mendable) > 1:
                    every = button("Mend all", lambda: self.add({"repair": mendable}), "done_all", main=True)
                    every.set_enabled(not self.waiting)
            for finding in diagnosis.findings:
                if finding.severity != "note":
                    self._card(finding)
            if notes := [f for f in diagnosis.findings if f.severity == "note"]:
                with ui.expansion(f"Good to know: {counted(len(notes), 'note')}").classes("card"):
                    for finding in notes:
                        self._card(finding)

    def _card(self, finding: Finding) -> None:
        with card(finding.severity):
            with ui.element("div").classes("line between"):
                with ui.element("div").classes("line"):
                    ui.label(finding.severity).classes(f"tag {finding.severity}")
                    text("h3", finding.code)
                self._ways(finding)
            text("p", finding.what)
            text("p", finding.remedy)
            first, last = finding.span
            confidence = f"confidence {finding.confidence:.0%}"
            text("p", f"{finding.where}, {first:.1f} to {last:.1f} s, {confidence}", "soft")
            if finding.severity == "note":
                return
            after, withheld = self.after.get(finding.code, ({}, ""))
            message(withheld, "bad")
            if shown := self.before.get(shown_by(finding.code)):
                agreement_plot(shown, finding.span, after.get(shown.key))

    def _ways(self, finding: Finding) -> None:
        """The buttons that repair a finding."""
        first, last = (float(t) for t in self.stages[-1].imu.time[[0, -1]])
        steps: dict[str, Step] = {"Mend": {"repair": [finding.code]}} if finding.repair else {}
        if (at := finding.cut) is not None:
            steps |= {f"Keep from {at:g} s": {"keep": [at, last + 1]}}
            if at - first > SHORTEST:
                steps |= {f"Keep until {at:g} s": {"keep": [first, at]}}
        with ui.element("div").classes("line"):
            for label, step in steps.items():
                icon = "build" if "repair" in step else "content_cut"
                mend = button(label, lambda step=step: self.add(step), icon, main=True)
                mend.props(f'aria-label="{label}: {finding.code}"').set_enabled(not self.waiting)

    def _cut(self) -> None:
        """Select a span with the mouse or by numbers, and keep only it."""
        drive = self.stages[-1]
        time = drive.imu.time
        with card():
            text("h2", "Cut")
            text("p", "Drag over the part to keep, or enter its ends.", "soft")
            with ui.element("div").classes("grid"):
                with ui.element("div"):
                    low, high = float(time[0]), float(time[-1])
                    with ui.element("div").classes("line"):
                        begin = ui.number("from, s", value=round(low, 2)).classes("grow")
                        end = ui.number("to, s", value=round(high + 0.01, 2)).classes("grow")

                    def selected(a: float, b: float) -> None:
                        begin.value, end.value = round(max(a, low), 2), round(min(b, high), 2)

                    series = {"gz": (time, drive.imu.gz)}
                    if drive.gps.speed is not None:
                        series["speed / 10"] = (drive.gps.time, drive.gps.speed / 10)
                    TimePlot("Select the part to keep", "rad/s", series, on_select=selected)
                    keep = button(
                        "Keep only this part",
                        lambda: self.add({"keep": [float(begin.value or low), float(end.value or high)]}),
                        "content_cut",
                    )
                    keep.set_enabled(not self.waiting)
                map_plot(fixes_of(drive), "Map of the drive", points=("fixes",))


def _kept(ends: list[float]) -> str:
    return f"kept only {ends[0]:g} to {ends[1]:g} s"


def _apply(drive: Drive, step: Step) -> Drive:
    if "keep" in step:
        start_at, end = step["keep"]
        return sigmaswarm.clip(drive, start_at, end)
    return sigmaswarm.repair(drive, sigmaswarm.diagnose(drive), only=step["repair"])


def _tried(drive: Drive, diagnosis: Diagnosis, code: str) -> tuple[Agreements, str]:
    """The agreements after one repair; a sentence where it is withheld."""
    mended = sigmaswarm.repair(drive, diagnosis, only=[code])
    withheld = code in mended.metadata.get("withheld", ())
    said = "This repair is withheld: with it a filter forecasts the fixes worse. Check the log by hand."
    return {a.key: a for a in agreements(mended)}, said if withheld else ""
