"""Step 4: evaluate a filter on drives that its tuning never saw, and compare two filters on one map."""

from typing import Any

from nicegui import ui

import sigmaswarm
from sigmaswarm import Tuning
from sigmaswarm.reports.evaluation import save_evaluation
from sigmaswarm.workbench.parts import aside, button, card, link, message, start, text
from sigmaswarm.workbench.state import Workbench, attempt

SCORES = "scores.json"


class JudgePage:
    """The choice of filter, rival and drives, and the page of the evaluation."""

    def __init__(self, bench: Workbench) -> None:
        self.bench = bench
        self.wrong = self.waiting = ""
        self.chosen: dict[str, Any] = {}

    @ui.refreshable_method
    def content(self) -> None:
        """Show the step."""
        tunings = self.bench.finished
        if not tunings:
            text("p", "No tuned filter yet.")
            link("Tune one", "tune")
            return
        chosen = self.chosen
        if chosen.get("tuning") not in tunings:
            chosen["tuning"] = tunings[-1]
            chosen["drives"] = self._held(tunings[-1])
        with card():
            text("h2", "Judge a filter")
            with ui.element("div").classes("line"):
                filter_ = ui.select(tunings, label="Filter", value=chosen["tuning"]).classes("grow")
                filter_.on_value_change(
                    lambda event: self._choose(tuning=event.value, drives=self._held(event.value))
                )
                rivals = {"": "no other", **{name: name for name in tunings if name != chosen["tuning"]}}
                rival = chosen.get("against", "")
                other = ui.select(
                    rivals, label="Compare with", value=rival if rival in rivals else ""
                ).classes("grow")
                other.on_value_change(lambda event: self._choose(against=event.value))
            drives = self.bench.names("drives", "drive.toml")
            on = ui.select(drives, label="On these drives", value=chosen["drives"], multiple=True).props(
                "use-chips"
            )
            on.on_value_change(lambda event: self._choose(drives=event.value))
            message(self.waiting, "wait")
            message(self.wrong, "bad")
            judge = button("Evaluate", self._begin, "speed", main=True)
            judge.set_enabled(bool(chosen["drives"]) and not self.waiting)
        self._result()

    def _choose(self, **chosen: Any) -> None:
        self.chosen.update(chosen)
        self.content.refresh()

    def _held(self, name: str) -> list[str]:
        """The drives that a tuning held back, else those that it did not see."""
        drives = self.bench.names("drives", "drive.toml")
        tuning, _ = attempt(Tuning.load, self.bench.path("tunings", name))
        if tuning is None:
            return []
        held = list(tuning.validation.drives) if tuning.validation else []
        seen = {one["name"] for one in tuning.data}
        return [d for d in held if d in drives] or [d for d in self.bench.drives if d not in seen]

    def _begin(self) -> None:
        self.waiting, self.wrong = "evaluating", ""
        self.content.refresh()
        start(self._work(dict(self.chosen)))

    async def _work(self, chosen: dict[str, Any]) -> None:
        name, self.wrong = await aside(self._evaluate, chosen)
        self.waiting = ""
        if name:
            self.bench.choices["evaluation"] = name
            self.bench.save()
        self.content.refresh()

    def _evaluate(self, chosen: dict[str, Any]) -> str:
        """Evaluate and save; return the evaluation's name."""
        folder = self.bench.path("tunings", chosen["tuning"])
        tuning, rival = Tuning.load(folder), chosen.get("against")
        against = Tuning.load(self.bench.path("tunings", rival)) if rival else None
        drives = [self.bench.read(name) for name in chosen["drives"]]
        recorded = tuning.config.model_dump()["as_recorded"]
        found = sigmaswarm.evaluate(drives, tuning, against=against, as_recorded=recorded)
        name = self.bench.free(
            "evaluations", f"{chosen['tuning']}-against-{rival}" if rival else chosen["tuning"]
        )
        save_evaluation(found, self.bench.path("evaluations", name), folder)
        return name

    def _result(self) -> None:
        names = self.bench.names("evaluations", SCORES)
        if not names:
            return
        chosen = self.bench.choices.get("evaluation")
        shown = chosen if chosen in names else names[-1]
        with ui.element("div").classes("section"):
            with ui.element("div").classes("line"):
                pick = ui.select(names, label="Evaluation", value=shown).classes("grow")
                pick.on_value_change(lambda event: self._show(event.value))
                link("Open the page alone", f"report/evaluations/{shown}")
                link("Next: take it away", "take")
            frame = ui.element("iframe").classes("report").style("margin-top: 12px")
            frame.props["src"] = f"report/evaluations/{shown}"
            frame.props["title"] = f"Report of {shown}"
            frame.props["sandbox"] = "allow-scripts allow-downloads"

    def _show(self, name: str) -> None:
        self.bench.choices["evaluation"] = name
        self.bench.save()
        self.content.refresh()
