"""Step 2: findings on a drive with plots; repairs and cuts, which can be undone."""

from dataclasses import replace
from typing import Any

from nicegui import ui

import sigmaswarm
from sigmaswarm import Agreement, Diagnosis, Drive, Finding, agreements, shown_by
from sigmaswarm.wording import count_of
from sigmaswarm.workbench.elements import Page, box, button, card, line, link, message, select, text
from sigmaswarm.workbench.plots import agreement_plot, show_map, time_plot
from sigmaswarm.workbench.state import CHECKED, LEFT_OUT, Workbench

MIN_PART_LENGTH = 30.0  # s, shortest beginning of a drive that a button offers to keep
Step = dict[str, Any]  # ``{"repair": [codes]}`` or ``{"keep": [start, end]}``, s
Agreements = dict[str, Agreement]
Repaired = dict[str, tuple[Agreements, str]]
"""For each code of a finding: the series to plot after the repair, and the reason why the repair is rejected, or ""."""
CheckState = tuple[list[Drive], list[Step], Diagnosis, Agreements]
"""The drive before and after each step, the steps, and the diagnosis and agreements after the last step."""


class CheckPage(Page):
    def __init__(self, bench: Workbench) -> None:
        super().__init__(bench)
        self.stages: list[Drive] = []
        self.steps: list[Step] = []
        self.diagnosis: Diagnosis | None = None
        self.before: Agreements = {}
        self.after: Repaired = {}
        self.done = self._opened = ""

    @property
    def originals(self) -> list[str]:
        return [name for name in self.bench.drive_names if not name.endswith(CHECKED)]

    def content(self) -> None:
        names = self.originals
        if not names:
            text("p", "No drive yet.")
            link("Make a drive from a log", "log")
            return
        chosen = self.bench.choices.get("drive")
        name = chosen if chosen in names else names[-1]
        if self._opened != name:
            self._open(name)
        with line():
            select("Drive", names, name, self.choose)
        self.messages()
        message(self.done, "good")
        if self.stages:
            self._steps()
            self._findings()
            self._cut()
            link("Next: tune a filter", "tune")

    def choose(self, name: str) -> None:
        self.done = ""
        self._open(name)
        self.refresh()

    def _open(self, name: str) -> None:
        self.bench.choices["drive"] = self._opened = name
        self.bench.save()
        self.stages, self.steps, self.diagnosis, self.wrong = [], [], None, ""
        self.start("reading and checking the drive", self._checked, name, None, then=self._set_state)

    def _do(self, waiting: str, steps: list[Step]) -> None:
        """Apply all steps. The results of unchanged first steps are reused."""
        self.start(waiting, self._checked, self._opened, steps, then=self._set_state)
        self.refresh()

    def add(self, step: Step) -> None:
        self._do("repairing and checking" if "repair" in step else "cutting", [*self.steps, step])

    def leave_out(self, start: float, end: float) -> None:
        def parted(drive: Drive) -> list[str]:
            return [self.bench.write(part) for part in sigmaswarm.split(drive, at=(start, end))]

        self.start("cutting", parted, self.stages[-1], then=self._was_parted)
        self.refresh()

    def _was_parted(self, names: list[str] | None) -> None:
        if names:
            whole = self._opened
            plan = self.bench.choices.setdefault("plan", {})
            plan |= dict.fromkeys((whole, whole + CHECKED), LEFT_OUT)
            self._open(names[0])
            wrote = " and ".join(f"drives/{name}" for name in names)
            self.done = f"wrote {wrote}; check both. Tuning will not use {whole}"
        self.refresh()

    def _set_state(self, checked: CheckState | None) -> None:
        if checked is not None:
            self.stages, self.steps, self.diagnosis, self.before = checked
            self.after = {}
            self.start("", _try_repairs, self.stages[-1], self.diagnosis, then=self._show_repairs)
        self.refresh()

    def _show_repairs(self, after: Repaired | None) -> None:
        self.after = after or {}
        if self.after:
            self._evidence.refresh()  # not the buttons, since the user may be clicking one

    def _checked(self, name: str, steps: list[Step] | None) -> CheckState:
        """Apply ``steps``, by default the saved steps, to a drive, write the result, and check it."""
        stages, known, target = self.stages, self.steps, name + CHECKED
        if steps is None:
            saved = self.bench.read(target).metadata if target in self.bench.drive_names else {}
            stages, known, steps = [self.bench.read(name)], [], list(saved.get("steps", []))
        same = 0
        while same < min(len(steps), len(known)) and steps[same] == known[same]:
            same += 1
        stages = stages[: same + 1]
        for step in steps[same:]:
            stages = [*stages, _apply(stages[-1], step)]
        if steps:
            made = replace(stages[-1], name=target, metadata={**stages[-1].metadata, "steps": steps})
            self.bench.write(made)
        else:
            self.bench.remove("drives", target)
        return stages, steps, sigmaswarm.diagnose(stages[-1]), _agreements(stages[-1])

    def _steps(self) -> None:
        for number, step in enumerate(self.steps):
            if "repair" in step:
                description = "repaired: " + ", ".join(step["repair"])
            else:
                description = "kept only {:g} to {:g} s".format(*step["keep"])
            rest = [*self.steps[:number], *self.steps[number + 1 :]]
            with card("done"), line("between"):
                text("h2", description)
                back = button("Undo", lambda rest=rest: self._do("undoing the step", rest), "undo")
                back.props(f'aria-label="Undo: {description}"').set_enabled(not self.waiting)

    def _findings(self) -> None:
        findings = self.diagnosis.findings if self.diagnosis else ()
        with box("section"):
            serious = sum(finding.severity == "serious" for finding in findings)
            with line("between"):
                text("h2", f"{count_of(serious, 'serious finding')}" if serious else "No serious finding")
                codes = list(dict.fromkeys(f.code for f in findings if f.repair is not None))
                if len(codes) > 1:
                    repair = button("Repair all", lambda: self.add({"repair": codes}), "done_all", main=True)
                    repair.set_enabled(not self.waiting)
            for finding in findings:
                if finding.severity != "note":
                    self._card(finding)
            if notes := [f for f in findings if f.severity == "note"]:
                with ui.expansion(count_of(len(notes), "note")).classes("card"):
                    for finding in notes:
                        self._card(finding)

    def _card(self, finding: Finding) -> None:
        with card(finding.severity):
            with line("between"):
                with line():
                    ui.label(finding.severity).classes(f"tag {finding.severity}")
                    text("h3", finding.code)
                self._ways(finding)
            text("p", finding.what)
            if finding.consequence:
                text("p", finding.consequence)
            text("p", finding.remedy)
            first, last = finding.span
            confidence = f"confidence {finding.confidence:.0%}"
            text("p", f"{finding.where}, {first:.1f} to {last:.1f} s, {confidence}", "soft")
            if finding.severity != "note":
                self._evidence(finding)

    @ui.refreshable_method
    def _evidence(self, finding: Finding) -> None:
        """Show the plot of a finding before and (if known) after its repair, and why the repair is rejected."""
        after, rejected = self.after.get(finding.code, ({}, ""))
        message(rejected, "bad")
        if shown := self.before.get(shown_by(finding.code)):
            agreement_plot(shown, finding.span, after.get(shown.key))

    def _ways(self, finding: Finding) -> None:
        first, last = (float(t) for t in self.stages[-1].imu.time[[0, -1]])
        steps: dict[str, Step] = {"Repair": {"repair": [finding.code]}} if finding.repair else {}
        if (at := finding.cut) is not None:
            steps |= {f"Keep from {at:g} s": {"keep": [at, last + 1]}}
            if at - first > MIN_PART_LENGTH:
                steps |= {f"Keep until {at:g} s": {"keep": [first, at]}}
        with line():
            for label, step in steps.items():
                icon = "build" if "repair" in step else "content_cut"
                apply = button(label, lambda step=step: self.add(step), icon, main=True)
                apply.props(f'aria-label="{label}: {finding.code}"').set_enabled(not self.waiting)

    def _cut(self) -> None:
        drive = self.stages[-1]
        time = drive.imu.time
        low, high = float(time[0]), float(time[-1])
        series = {"gz, rad/s": (time, drive.imu.gz)}
        if drive.gps.speed is not None:
            series["speed, 10 m/s"] = (drive.gps.time, drive.gps.speed / 10)

        def selected(a: float, b: float) -> None:
            begin.value, end.value = round(max(a, low), 2), round(min(b, high), 2)

        def span() -> list[float]:
            return [float(low if begin.value is None else begin.value), float(end.value or high)]

        with card():
            text("h2", "Cut")
            text("p", "Drag over a part of the plot, or enter its start and end.", "soft")
            with box("grid"):
                with box():
                    with line():
                        begin = ui.number("from, s", value=round(low, 2)).classes("grow")
                        end = ui.number("to, s", value=round(high + 0.01, 2)).classes("grow")
                    time_plot("Select a part", "", series, on_select=selected)
                    with line():
                        for label, cut, icon in (
                            ("Keep only this part", lambda: self.add({"keep": span()}), "content_cut"),
                            (
                                "Remove this part (makes two drives)",
                                lambda: self.leave_out(*span()),
                                "call_split",
                            ),
                        ):
                            button(label, cut, icon).set_enabled(not self.waiting)
                show_map(drive, "Map of the drive", 340)


def _agreements(drive: Drive) -> Agreements:
    return {agreement.key: agreement for agreement in agreements(drive)}


def _apply(drive: Drive, step: Step) -> Drive:
    if "keep" in step:
        return sigmaswarm.clip(drive, *step["keep"])
    return sigmaswarm.repair(drive, sigmaswarm.diagnose(drive), only=step["repair"])


def _try_repairs(drive: Drive, diagnosis: Diagnosis) -> Repaired:
    """Try each repair alone. Return the results (see `Repaired`)."""
    after: Repaired = {}
    reason = "This repair is rejected, since it makes a filter's predictions of the fixes less accurate. Check the log."
    for code in dict.fromkeys(f.code for f in diagnosis.findings if f.repair is not None):
        repaired = sigmaswarm.repair(drive, diagnosis, only=[code])
        rejected = code in repaired.metadata.get("withheld", ())
        after[code] = _agreements(repaired), reason if rejected else ""
    return after
