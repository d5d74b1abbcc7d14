"""Step 3: tune a filter, watch it, stop and resume it, and compare tunings."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

import sigmaswarm
from sigmaswarm import Drive, FilterParameters, Tuning
from sigmaswarm.drives.sensors import sensors_of
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.defaults import objective_for, with_filter
from sigmaswarm.tuning.objectives import objective_named
from sigmaswarm.tuning.store import saved_history
from sigmaswarm.wording import counted
from sigmaswarm.workbench.parts import aside, button, card, link, message, number, start, table, text
from sigmaswarm.workbench.plots import curve_traces, curves, fixes_of, map_plot, redraw, track_traces
from sigmaswarm.workbench.runs import Run, Runs, best_so_far
from sigmaswarm.workbench.state import CHECKED, Workbench, attempt

TRAIN, SPLIT, HOLD, LEAVE = (
    "tune on it",
    "tune on the first 70%, hold back the rest",
    "hold it back",
    "leave it out",
)
MODELS = {
    "": "chosen by the log",
    "planar5": "planar5 (the paper's)",
    "planar8": "planar8",
    "tilted12": "tilted12",
}
SIZES = {"particles": 30, "generations": 50, "trials": 1, "seed": 0}
REFRESH = 0.7
"""s between two updates of running tunings."""


class TunePage:
    """The choice of drives and of the filter, and the tunings."""

    def __init__(self, bench: Workbench, runs: Runs) -> None:
        self.bench, self.runs = bench, runs
        self.wrong = self.waiting = ""
        self.why: list[str] = []
        self.compared: list[str] = []

    def content(self) -> None:
        """Show the step."""
        if self.plan and not self.why and not self.waiting:
            self._explain()
        self._setup()
        cards = ui.element("div")
        self._finished()
        updates: dict[str, Callable[[], None]] = {}
        shown: list[Any] = [None]

        def look() -> None:
            now = (
                [(r.name, r.ended, r.error) for r in self.runs.runs.values()],
                self.bench.unfinished,
                self.wrong,
            )
            if now != shown[0]:
                self._finished.refresh()
                shown[0] = now
                cards.clear()
                with cards:
                    updates.clear()
                    updates.update(self._cards())
            for update in updates.values():
                update()

        ui.timer(REFRESH, look)

    @property
    def plan(self) -> dict[str, str]:
        """The use of each drive: as chosen, or one to tune on and one to hold back."""
        names = [n for n in self.bench.drives if not n.endswith(("-train", "-test"))] or self.bench.drives
        usual = dict.fromkeys(names, TRAIN)
        if len(names) == 1:
            usual = {names[0]: SPLIT}
        elif names:
            usual[names[-1]] = HOLD
        chosen = self.bench.choices.get("plan", {})
        return {name: chosen.get(name, value) for name, value in usual.items()}

    @ui.refreshable_method
    def _setup(self) -> None:
        with card():
            text("h2", "What to tune on")
            plan = self.plan
            if not plan:
                text("p", "No drive yet.")
                link("Make one of a log", "log")
                return
            for name, value in plan.items():
                pick = ui.select([TRAIN, SPLIT, HOLD, LEAVE], label=name, value=value)
                pick.on_value_change(lambda event, name=name: self._planned(name, event.value))
            options = self.bench.choices.setdefault("options", {})
            with ui.element("div").classes("line"):
                model = ui.select(MODELS, label="Filter", value=options.get("model", "")).classes("grow")
                model.on_value_change(lambda event: self._set("model", event.value))
                for key, usual in SIZES.items():
                    size = ui.number(key, value=options.get(key, usual), min=0, step=1, precision=0).style(
                        "width: 110px"
                    )
                    size.on("change", partial(self._sized, key, size))
            message(self.waiting, "wait")
            message(self.wrong, "bad")
            for sentence in self.why:
                text("p", sentence)
            begin = button("Start", self._begin, "play_arrow", main=True)
            begin.set_enabled(not self.waiting)

    def _planned(self, name: str, value: str) -> None:
        self.bench.choices.setdefault("plan", {})[name] = value
        self._changed()

    def _set(self, key: str, value: Any) -> None:
        self.bench.choices.setdefault("options", {})[key] = value
        self._changed()

    def _sized(self, key: str, size: ui.number) -> None:
        self._set(key, int(size.value or 0))

    @property
    def _options(self) -> dict[str, Any]:
        return {key: value for key, value in self.bench.choices.get("options", {}).items() if value != ""}

    def _explain(self) -> None:
        """Show the filter to be tuned, and why; the drives are read in the background."""
        self.waiting = "reading the drives"
        start(self._explained())

    async def _explained(self) -> None:
        why, self.wrong = await aside(self._reasons)
        self.why, self.waiting = why or [], ""
        self._setup.refresh()

    def _changed(self) -> None:
        self.bench.save()
        self._explain()
        self._setup.refresh()

    def _reasons(self) -> list[str]:
        """The filter, the objective, and why."""
        sensors = [sensors_of(self.bench.read(n)) for n, what in self.plan.items() if what != LEAVE]
        options, because = with_filter(self._options, sensors)
        config = TuneConfig(**options)
        objective = objective_for(sensors, config.objective, config.model)
        sets = config.particles * config.generations * config.trials
        return [
            f"Filter: {because or config.model}",
            f"Objective: {objective}: {objective_named(objective).summary}",
            f"Search: {sets} parameter sets by {config.optimizer}, {config.trials} trial(s), seed {config.seed}",
        ]

    def _begin(self) -> None:
        self.waiting = "reading the drives"
        self._setup.refresh()
        start(self._begun())

    async def _begun(self) -> None:
        name = self.bench.free(
            "tunings",
            "+".join(n.removesuffix(CHECKED) for n, w in self.plan.items() if w in (TRAIN, SPLIT))[:40],
        )
        parts, wrong = await aside(self._drives)
        if parts and not wrong:
            drives, held = parts
            self.bench.choices.setdefault("tunings", {})[name] = {
                "drives": [d.name for d in drives],
                "held": [d.name for d in held],
            }
            self.bench.save()
            self.runs.begin(name, drives, held, self._options)
        self.wrong, self.waiting = wrong, ""
        self._setup.refresh()

    def _drives(self) -> tuple[list[Drive], list[Drive]]:
        """Read the drives; split those that are to be split, as `sigmaswarm split` does."""
        drives: list[Drive] = []
        held: list[Drive] = []
        for name, what in self.plan.items():
            if what == SPLIT:
                for part, group in zip(sigmaswarm.split(self.bench.read(name)), (drives, held), strict=True):
                    sigmaswarm.write_drive(part, self.bench.path("drives", part.name), overwrite=True)
                    group.append(self.bench.read(part.name))
            elif what in (TRAIN, HOLD):
                (drives if what == TRAIN else held).append(self.bench.read(name))
        if not drives:
            raise sigmaswarm.InputError("no drive to tune on is chosen; tune on at least one")
        return drives, held

    def _cards(self) -> dict[str, Callable[[], None]]:
        """Show tunings that run or failed, and those that wait to be resumed.

        Return a function that updates the former.
        """
        live = [r for r in self.runs.runs.values() if not r.ended or r.error]
        updates = {one.name: self._run_card(one) for one in live}
        for name in self.bench.unfinished:
            if name not in updates:
                with card("warning"), ui.element("div").classes("line between"):
                    saved = attempt(saved_history, self.bench.path("tunings", name))[0] or {}
                    done = counted(sum(map(len, saved.values())), "generation")
                    text("h3", f"{name}: not finished, {done} saved")
                    button("Resume", lambda name=name: self._resume(name), "play_arrow", main=True)
        return updates

    def _resume(self, name: str) -> None:
        _, self.wrong = attempt(self.runs.resume, name)
        self._setup.refresh()

    def _run_card(self, one: Run) -> Callable[[], None]:
        """Show a tuning; return a function that updates the card."""
        with card("warning" if one.error else ""):
            with ui.element("div").classes("line between"):
                with ui.element("h2"):
                    title = ui.label(one.name)
                stop = button("Stop", lambda: self._stop(one), "stop")
                stop.set_visibility(not one.ended)
            message(one.error, "bad")
            if one.error and one.progress is None:
                title.text = f"{one.name}: {one.state}"
                return lambda: None
            bar = ui.linear_progress(value=0.0, show_value=False, size="10px")
            bar.props('aria-label="generations" rounded')
            with ui.element("div").classes("figures"):
                figures = [_figure(label) for label in ("generation", "trial", "best cost")]
            with ui.element("div").classes("grid"):
                cost = curves({}, "Lowest cost", "generation", "cost")
                track = map_plot({}, f"Held out: {one.shown_on.name}", height=260)
            with ui.expansion("Parameters").classes("soft"):
                parameters = ui.element("div")
        shown = [-1]

        def update() -> None:
            if one.version == shown[0]:
                return
            shown[0] = one.version
            progress = one.progress
            title.text = f"{one.name}: {one.state}"
            stop.set_enabled(not one.stopping)
            redraw(cost, curve_traces({f"trial {n + 1}": best_so_far(h) for n, h in one.history.items()}))
            best = {"best filter so far": one.track} if one.track is not None else {}
            redraw(track, track_traces(fixes_of(one.shown_on) | best, points=("fixes",)))
            if progress is None:
                return
            bar.value = progress.done / progress.total
            values = (
                f"{progress.done} of {progress.total}",
                str(progress.trial + 1),
                number(progress.best_cost),
            )
            for label, value in zip(figures, values, strict=True):
                label.text = value
            if isinstance(progress.parameters, FilterParameters):
                parameters.clear()
                with parameters:
                    _parameters(progress.parameters)

        return update

    def _stop(self, one: Run) -> None:
        one.stopping = True
        one.version += 1

    @ui.refreshable_method
    def _finished(self) -> None:
        """The results, side by side."""
        names = self.bench.finished
        if not names:
            return
        found = {name: attempt(Tuning.load, self.bench.path("tunings", name)) for name in names}
        tunings = {name: tuning for name, (tuning, _) in found.items() if tuning}
        with ui.element("div").classes("section"):
            text("h2", "Tunings")
            rows = [[name, *_row(tuning)] for name, tuning in tunings.items()]
            table(["name", "filter", "objective", "cost", "held out", "drives"], rows)
            for _, wrong in found.values():
                message(wrong, "bad")
            lines = {
                name if len(t.trials) == 1 else f"{name}, trial {i + 1}": best_so_far(trial.best.tolist())
                for name, t in list(tunings.items())[-6:]
                for i, trial in enumerate(t.trials)
            }
            if lines:
                curves(lines, "Convergence of the tunings", "generation", "lowest cost")
            for name, tuning in reversed(tunings.items()):
                with ui.expansion(f"{name}: parameters and remarks").classes("card"):
                    for remark in tuning.remarks:
                        text("p", remark, "soft")
                    if isinstance(tuning.parameters, FilterParameters):
                        _parameters(tuning.parameters)
                    link("The page of this tuning", f"report/tunings/{name}")
            link("Next: judge it", "judge")


def _figure(label: str) -> ui.label:
    with ui.element("div"):
        ui.label(label).classes("soft")
        return ui.label("-").classes("value")


def _row(tuning: Tuning[Any]) -> list[str]:
    config = tuning.config
    chosen = f"{config.model} ({config.kind})" if isinstance(config, TuneConfig) else "own model"
    held = (
        f"{tuning.validation.cost:.4g} on {', '.join(tuning.validation.drives)}"
        if tuning.validation
        else "none"
    )
    return [chosen, config.objective, f"{tuning.cost:.4g}", held, ", ".join(d["name"] for d in tuning.data)]


def _parameters(parameters: FilterParameters) -> None:
    """Numbers of the filter as it would be saved."""
    rows: list[list[str]] = []
    for name, value in parameters.to_dict().items():
        several = isinstance(value, list | tuple | np.ndarray)
        rows.append([name, ", ".join(f"{v:.4g}" for v in value) if several else str(value)])  # pyright: ignore
    table(["parameter", "value"], rows)
