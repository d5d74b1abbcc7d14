"""Step 3: tune a filter, watch it, stop and resume it, and compare tunings."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from nicegui import run, ui

import sigmaswarm
from sigmaswarm import Drive, FilterParameters, Tuning
from sigmaswarm.drives.sensors import sensors_of
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.defaults import objective_for, with_filter
from sigmaswarm.tuning.objectives import objective_named
from sigmaswarm.workbench.parts import button, card, link, message, number, start, table, text
from sigmaswarm.workbench.plots import curves, fixes_of, map_plot
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
"""s between two looks at running tunings."""


class TunePage:
    """The choice of drives and of the filter, and the tunings."""

    def __init__(self, bench: Workbench, runs: Runs) -> None:
        self.bench, self.runs = bench, runs
        self.wrong = self.waiting = ""
        self.why: list[str] = []
        self.compared: list[str] = []

    def content(self) -> None:
        """Show the step."""
        self._setup()
        self._running()
        self._finished()
        seen: list[Any] = [None]

        def look() -> None:
            now = [(r.name, r.version, r.ended) for r in self.runs.runs.values()]
            if now != seen[0]:
                ended = seen[0] is not None and [n[2] for n in now] != [n[2] for n in seen[0]]
                seen[0] = now
                self._running.refresh()
                if ended:
                    self._finished.refresh()

        ui.timer(REFRESH, look)

    @property
    def plan(self) -> dict[str, str]:
        """What to do with each drive: as chosen, or one to tune on and one to hold back."""
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
            with ui.element("div").classes("row"):
                model = ui.select(MODELS, label="Filter", value=options.get("model", "")).classes("grow")
                model.on_value_change(lambda event: self._set("model", event.value))
                for key, usual in SIZES.items():
                    size = ui.number(key, value=options.get(key, usual), min=0, step=1, precision=0).style(
                        "width: 110px"
                    )
                    size.on("change", lambda key=key, size=size: self._set(key, int(size.value or 0)))
            message(self.waiting, "wait")
            message(self.wrong, "bad")
            for sentence in self.why:
                text("p", sentence)
            with ui.element("div").classes("row"):
                button("What will be tuned, and why", self._explain, "help_outline")
                begin = button("Start", self._begin, "play_arrow", main=True)
                begin.set_enabled(not self.waiting)

    def _planned(self, name: str, value: str) -> None:
        self.bench.choices.setdefault("plan", {})[name] = value
        self.why = []
        self.bench.save()
        self._setup.refresh()

    def _set(self, key: str, value: Any) -> None:
        self.bench.choices.setdefault("options", {})[key] = value
        self.why = []
        self.bench.save()

    @property
    def _options(self) -> dict[str, Any]:
        return {key: value for key, value in self.bench.choices.get("options", {}).items() if value != ""}

    def _explain(self) -> None:
        self.waiting = "reading the drives"
        self._setup.refresh()
        start(self._explained())

    async def _explained(self) -> None:
        why, self.wrong = await run.io_bound(attempt, self._reasons)
        self.why, self.waiting = why or [], ""
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
        parts, wrong = await run.io_bound(attempt, self._drives)
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
        self._running.refresh()

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

    @ui.refreshable_method
    def _running(self) -> None:
        """Tunings of this server that run or failed, and those that wait to be resumed."""
        message(self.wrong, "bad")
        live = [r for r in self.runs.runs.values() if not r.ended or r.error]
        for one in live:
            self._run_card(one)
        known = {r.name for r in live}
        for name in self.bench.unfinished:
            if name not in known:
                with card("warning"), ui.element("div").classes("row between"):
                    history = attempt(self._saved, name)[0] or {}
                    done = sum(map(len, history.values()))
                    text("h3", f"{name}: not finished, {done} generations are saved")
                    button("Resume", lambda name=name: self._resume(name), "play_arrow", main=True)

    def _saved(self, name: str) -> Mapping[int, list[float]]:
        from sigmaswarm.tuning.store import saved_history

        return saved_history(self.bench.path("tunings", name))

    def _resume(self, name: str) -> None:
        _, self.wrong = attempt(self.runs.resume, name)
        self._running.refresh()

    def _run_card(self, one: Run) -> None:
        progress = one.progress
        with card("warning" if one.error else ""):
            with ui.element("div").classes("row between"):
                text(
                    "h2",
                    f"{one.name}: {'failed' if one.error else 'stopping' if one.stopping else 'running'}",
                )
                if not one.ended:
                    stop = button("Stop", lambda: self._stop(one), "stop")
                    stop.set_enabled(not one.stopping)
            message(one.error, "bad")
            if progress is None:
                message("" if one.error else "compiling and reading", "wait")
                return
            share = progress.done / progress.total
            bar = ui.linear_progress(value=share, show_value=False, size="10px")
            bar.props(f'aria-label="{progress.done} of {progress.total} generations"')
            with ui.element("div").classes("figures"):
                _figure("generation", f"{progress.done} of {progress.total}")
                _figure("trial", f"{progress.trial + 1}")
                _figure("best cost", number(progress.best_cost))
            with ui.element("div").classes("grid"):
                lines = {f"trial {n + 1}": best_so_far(h) for n, h in one.history.items()}
                curves(lines, "Lowest cost", "generation", "cost")
                tracks = fixes_of(one.shown_on)
                if one.track is not None:
                    tracks["best filter so far"] = one.track
                map_plot(tracks, f"Held out: {one.shown_on.name}", points=("fixes",), height=260)
            if isinstance(progress.parameters, FilterParameters):
                _parameters(progress.parameters)

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


def _figure(label: str, value: str) -> None:
    with ui.element("div"):
        ui.label(label).classes("soft")
        ui.label(value).classes("value")


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
    with ui.expansion("Parameters").classes("soft"):
        table(["parameter", "value"], rows)
