"""Step 4: evaluate a filter on drives that its tuning did not use, and compare two filters on one map."""

from functools import partial
from typing import Any

from nicegui import ui

import sigmaswarm
from sigmaswarm import Tuning, save_evaluation
from sigmaswarm.workbench.elements import Page, box, button, card, line, link, select, text
from sigmaswarm.workbench.state import Workbench, attempt


class EvaluatePage(Page):
    def __init__(self, bench: Workbench) -> None:
        super().__init__(bench)
        self.chosen: dict[str, Any] = {}

    def content(self) -> None:
        tunings, chosen = self.bench.finished, self.chosen
        if not tunings:
            text("p", "No tuned filter yet.")
            link("Tune a filter", "tune")
            return
        if chosen.get("tuning") not in tunings:
            chosen |= {"tuning": tunings[-1], "drives": self._held_out(tunings[-1])}
        with card():
            text("h2", "Evaluate a filter")
            with line():
                select("Filter", tunings, chosen["tuning"], self._choose_tuning)
                others = {name: name for name in tunings if name != chosen["tuning"]}
                rivals = {"": "no other filter", **others}
                against = chosen.get("against", "")
                select("Compare with", rivals, against, partial(self._choose, "against"))
            drives = self.bench.drive_names
            on = [name for name in chosen["drives"] if name in drives]
            choose = partial(self._choose, "drives")
            select("On these drives", drives, on, choose, multiple=True).props("use-chips")
            self.messages()
            evaluate = button("Evaluate this filter", self._begin, "speed", main=True)
            evaluate.set_enabled(bool(chosen["drives"]) and not self.waiting)
        self._result()

    def _choose(self, key: str, value: Any) -> None:
        self.chosen[key] = value
        self.refresh()

    def _choose_tuning(self, name: str) -> None:
        self.chosen["drives"] = self._held_out(name)
        self._choose("tuning", name)

    def _held_out(self, name: str) -> list[str]:
        """Return the validation drives of a tuning or, if there are none, the drives that the tuning did not use."""
        tuning, _ = attempt(Tuning.load, self.bench.path("tunings", name))
        if tuning is None:
            return []
        validation = tuning.validation.drives if tuning.validation else ()
        training = {one["name"] for one in tuning.data}
        known = [name for name in validation if name in self.bench.drive_names]
        return known or [name for name in self.bench.drives if name not in training]

    def _begin(self) -> None:
        self.start("evaluating", self._evaluate, {**self.chosen}, then=self._show)
        self.refresh()

    def _show(self, name: str | None) -> None:
        if name:
            self.bench.choices["evaluation"] = name
            self.bench.save()
        self.refresh()

    def _evaluate(self, chosen: dict[str, Any]) -> str:
        folder, rival = self.bench.path("tunings", chosen["tuning"]), chosen.get("against")
        tuning = Tuning.load(folder)
        against = Tuning.load(self.bench.path("tunings", rival)) if rival else None
        drives = [self.bench.read(name) for name in chosen["drives"]]
        evaluation = sigmaswarm.evaluate(drives, tuning, against=against)
        stem = f"{chosen['tuning']}-against-{rival}" if rival else chosen["tuning"]
        name = self.bench.free("evaluations", stem)
        made = self.bench.path("evaluations", name)
        save_evaluation(evaluation, made, folder)
        sigmaswarm.report(made, made / "page.html")
        return name

    def _result(self) -> None:
        names = self.bench.names("evaluations", "scores.json")
        if not names:
            return
        chosen = self.bench.choices.get("evaluation")
        shown = chosen if chosen in names else names[-1]
        with box("section"):
            with line():
                select("Evaluation", names, shown, self._show)
                link("Open the report on a separate page", f"report/evaluations/{shown}")
                link("Next: export the filter", "export")
            frame = ui.element("iframe").classes("report")
            frame.props["src"] = f"report/evaluations/{shown}"
            frame.props["title"] = f"Report of {shown}"
            frame.props["sandbox"] = "allow-scripts allow-downloads"
