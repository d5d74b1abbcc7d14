"""Step 3: start, watch, stop, resume and compare tuning runs."""

from collections.abc import Callable
from functools import partial
from typing import Any, get_args

from nicegui import ui

import sigmaswarm
from sigmaswarm import Drive, FilterParameters, Option, TuneConfig, Tuning, explain_tuning, saved_history
from sigmaswarm.wording import count_of
from sigmaswarm.workbench.elements import (
    Page,
    box,
    button,
    card,
    line,
    link,
    message,
    number,
    select,
    table,
    text,
)
from sigmaswarm.workbench.plots import lines, map_lines, redraw, show_map, show_plot
from sigmaswarm.workbench.state import CHECKED, LEFT_OUT, Workbench, attempt
from sigmaswarm.workbench.tuning_runs import TuningRun, TuningRuns, best_so_far

TRAIN, SPLIT, HOLD = "tune on it", "tune on the first 70%, hold back the rest", "hold it back"
MODELS = {
    "": "chosen from the sensors",
    "planar5": "planar5 (the paper's)",
    "planar8": "planar8",
    "tilted12": "tilted12",
}
STARTING = "reading the training drives"  # a changed choice does not interrupt this work
MAX_COMPARED_TUNINGS = 6
Update = Callable[[], None]


class TunePage(Page):
    def __init__(self, bench: Workbench, runs: TuningRuns) -> None:
        super().__init__(bench)
        self.runs = runs
        self.why: list[str] = []

    def content(self) -> None:
        """Show the page. A timer in each tab checks the tuning runs."""
        if self.plan and not self.why and not self.waiting:
            self._explain()
        self._setup()
        cards = box()
        self._finished()
        updates: dict[str, Update] = {}
        shown: list[Any] = [None]

        def check_runs() -> None:
            runs = [(run.name, run.ended, run.error) for run in self.runs.runs.values()]
            now = runs, self.bench.unfinished, self.wrong
            if now != shown[0]:
                self._finished.refresh()
                shown[0] = now
                cards.clear()
                with cards:
                    updates.clear()
                    updates.update(self._cards())
            for update in updates.values():
                update()

        ui.timer(0.7, check_runs)  # s

    def refresh(self) -> None:
        self._setup.refresh()

    @property
    def plan(self) -> dict[str, str]:
        names = [n for n in self.bench.drives if not n.endswith(("-train", "-test"))] or self.bench.drives
        chosen = self.bench.choices.get("plan", {})
        used = [name for name in names if chosen.get(name) != LEFT_OUT]
        usual = dict.fromkeys(used, TRAIN)
        if used:
            usual[used[-1]] = HOLD if len(used) > 1 else SPLIT
        return {name: chosen.get(name) or usual[name] for name in names}

    @ui.refreshable_method
    def _setup(self) -> None:
        with card():
            text("h2", "Drives to tune on")
            if not self.plan:
                text("p", "No drive yet.")
                link("Make a drive from a log", "log")
                return
            planned = self.bench.choices.setdefault("plan", {})
            options = self.bench.choices.setdefault("options", {})
            for name, value in self.plan.items():
                ways = [TRAIN, SPLIT, HOLD, LEFT_OUT]
                select(name, ways, value, lambda way, name=name: self._choose(planned, name, way))
            with line():
                choose = partial(self._choose, options)
                select("Filter", MODELS, options.get("model", ""), partial(choose, "model"))
                use, names = options.get("use") or [], list(get_args(Option))
                more = select("Measurements (--use)", names, use, partial(choose, "use"), multiple=True)
                more.props('hint="if empty, chosen to suit the sensors"')
            with line():
                for key in ("particles", "generations", "trials", "seed"):
                    value = options.setdefault(key, TuneConfig.model_fields[key].default)
                    size = ui.number(key, value=value, min=0, precision=0).classes("size")
                    size.bind_value(options, key, forward=lambda value: value and int(value))
                    size.on("change", self._changed)
            self._reasoning()
            begin = button("Start", self._begin, "play_arrow", main=True)
            begin.bind_enabled_from(self, "waiting", lambda waiting: waiting != STARTING)

    @ui.refreshable_method
    def _reasoning(self) -> None:
        """Show messages and the explanation of the next tuning. This part is redrawn without the input fields."""
        self.messages()
        for sentence in self.why:
            text("p", sentence)

    def _choose(self, choices: dict[str, Any], key: str, value: Any) -> None:
        choices[key] = value
        self._changed()
        self.refresh()

    def _changed(self) -> None:
        self.bench.save()
        self.why = []
        if self.waiting != STARTING:
            self._explain()
        self._reasoning.refresh()

    @property
    def _options(self) -> dict[str, Any]:
        return {k: v for k, v in self.bench.choices.get("options", {}).items() if v not in ("", [], None)}

    def _explain(self) -> None:
        def reasons() -> list[str]:
            used = [self.bench.read(name) for name, what in self.plan.items() if what != LEFT_OUT]
            return explain_tuning(used, **self._options)

        def explained(why: list[str] | None) -> None:
            self.why = why or []
            self._reasoning.refresh()

        self.start("reading the drives", reasons, then=explained)

    def _begin(self) -> None:
        self.start(STARTING, self._drives, then=self._begun)
        self._reasoning.refresh()

    def _begun(self, parts: tuple[list[Drive], list[Drive]] | None) -> None:
        if parts:
            used = [n.removesuffix(CHECKED) for n, what in self.plan.items() if what in (TRAIN, SPLIT)]
            name = self.bench.free("tunings", "+".join(used)[:40])
            drives, held_back = ([drive.name for drive in part] for part in parts)
            self.bench.choices.setdefault("tunings", {})[name] = {"drives": drives, "held": held_back}
            self.bench.save()
            self.runs.begin(name, *parts, self._options)
        if not self.why:
            self._explain()
        self._reasoning.refresh()

    def _drives(self) -> tuple[list[Drive], list[Drive]]:
        """Return the training and validation drives. Split drives and write their parts, as `sigmaswarm split` does."""
        drives: list[Drive] = []
        held_back: list[Drive] = []
        for name, what in self.plan.items():
            if what == SPLIT:
                parts = sigmaswarm.split(self.bench.read(name))
                for part, group in zip(parts, (drives, held_back), strict=True):
                    group.append(self.bench.read(self.bench.write(part)))
            elif what in (TRAIN, HOLD):
                (drives if what == TRAIN else held_back).append(self.bench.read(name))
        if not drives:
            raise sigmaswarm.InputError(
                f"no drive is chosen for the tuning; choose {TRAIN!r} for at least one drive"
            )
        return drives, held_back

    def _cards(self) -> dict[str, Update]:
        updates = {r.name: self._run_card(r) for r in self.runs.runs.values() if not r.ended or r.error}
        for name in self.bench.unfinished:
            if name not in updates:
                with card("warning"), line("between"):
                    saved = attempt(saved_history, self.bench.path("tunings", name))[0] or {}
                    done = count_of(sum(map(len, saved.values())), "generation")
                    text("h3", f"{name}: not finished, {done} saved")
                    button("Resume", lambda name=name: self._resume(name), "play_arrow", main=True)
        return updates

    def _resume(self, name: str) -> None:
        _, self.wrong = attempt(self.runs.resume, name)
        self.refresh()

    def _run_card(self, run: TuningRun) -> Update:
        with card("warning" if run.error else ""):
            with line("between"):
                with ui.element("h2"):
                    title = ui.label(f"{run.name}: {run.state}")
                stop = button("Stop", run.stop, "stop")
                stop.set_visibility(not run.ended)
            message(run.error, "bad")
            if run.error and run.progress is None:
                return lambda: None
            bar = ui.linear_progress(value=0.0, show_value=False, size="10px")
            bar.props('aria-label="generations" rounded')
            with box("figures"):
                figures = [_figure(label) for label in ("generation", "trial", "lowest cost")]
            with box("grid"):
                cost = show_plot("Lowest cost", "generation", "cost", [])
                track = show_map(run.shown_on, f"Track over {run.shown_on.name}")
            with ui.expansion("Parameters").classes("soft"):
                parameters = box()
        shown = [-1]

        def update() -> None:
            if run.version == shown[0]:
                return
            shown[0], progress = run.version, run.progress
            title.text = f"{run.name}: {run.state}"
            stop.set_enabled(not run.stopping)
            redraw(cost, lines({f"trial {n + 1}": best_so_far(h) for n, h in run.history.items()}))
            best = {} if run.track is None else {"best filter so far": run.track}
            redraw(track, map_lines(run.shown_on, best))
            if progress is None:
                return
            bar.value = progress.done / progress.total
            figures[0].text = f"{progress.done} of {progress.total}"
            figures[1].text, figures[2].text = str(progress.trial + 1), number(progress.best_cost)
            parameters.clear()
            with parameters:
                _parameters(progress.parameters)

        return update

    @ui.refreshable_method
    def _finished(self) -> None:
        names = self.bench.finished
        if not names:
            return
        loaded = {name: attempt(Tuning.load, self.bench.path("tunings", name)) for name in names}
        tunings = {name: tuning for name, (tuning, _) in loaded.items() if tuning}
        with box("section"):
            text("h2", "Tunings")
            rows = [[name, *_row(tuning)] for name, tuning in tunings.items()]
            heads = ["name", "filter", "objective", "cost", "cost on held-out drives", "training drives"]
            table(heads, rows, "stacks")
            for _, wrong in loaded.values():
                message(wrong, "bad")
            costs = {
                name if len(t.trials) == 1 else f"{name}, trial {i + 1}": best_so_far(trial.best.tolist())
                for name, t in list(tunings.items())[-MAX_COMPARED_TUNINGS:]
                for i, trial in enumerate(t.trials)
            }
            if costs:
                show_plot("Convergence of the tuning runs", "generation", "lowest cost", lines(costs))
            for name, tuning in reversed(tunings.items()):
                with ui.expansion(f"{name}: parameters and remarks").classes("card"):
                    for remark in tuning.remarks:
                        text("p", remark, "soft")
                    _parameters(tuning.parameters)
                    link("Page of this tuning", f"report/tunings/{name}")
            link("Next: evaluate the filter", "evaluate")


def _figure(label: str) -> ui.label:
    with box():
        ui.label(label).classes("soft")
        return ui.label("-").classes("value")


def _row(tuning: Tuning[Any]) -> list[str]:
    config, validation = tuning.config, tuning.validation
    chosen = f"{config.model} ({config.kind})" if isinstance(config, TuneConfig) else "custom model"
    held_out = f"{validation.cost:.4g} on {', '.join(validation.drives)}" if validation else "none"
    drives = ", ".join(drive["name"] for drive in tuning.data)
    return [chosen, config.objective, f"{tuning.cost:.4g}", held_out, drives]


def _parameters(parameters: Any) -> None:
    if isinstance(parameters, FilterParameters):
        values = parameters.to_dict().items()
        rows = [[k, ", ".join(f"{x:.4g}" for x in v) if isinstance(v, list) else str(v)] for k, v in values]
        table(["parameter", "value"], rows)
