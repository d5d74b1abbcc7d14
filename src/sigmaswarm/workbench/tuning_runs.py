"""Start tuning runs in threads of the server. If the server is killed, a run can be resumed from its folder."""

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import sigmaswarm
from sigmaswarm import Drive, Progress, TuningStopped, saved_history, saved_options
from sigmaswarm.workbench.plots import Series, thinned
from sigmaswarm.workbench.state import Workbench


@dataclass
class TuningRun:
    """A running or finished tuning.

    Attributes
    ----------
    shown_on : first validation drive; if there is none, the first training drive
    history : lowest cost so far after each generation, by trial
    track : track of the best filter so far on ``shown_on``; None if there is none yet or this filter failed
    """

    name: str
    shown_on: Drive
    history: dict[int, list[float]] = field(default_factory=dict[int, list[float]])
    progress: Progress | None = None
    track: Series | None = None
    error: str = ""
    stopping: bool = False
    ended: bool = False
    version: int = 0
    drawn_at: float = 0.0

    @property
    def state(self) -> str:
        if self.error or self.ended:
            return "failed" if self.error else "done"
        if self.stopping:
            return "stopping"
        done = self.progress is not None and self.progress.done == self.progress.total
        return "last checks" if done else "running" if self.progress else "compiling"

    def advance(self, progress: Progress) -> bool:
        """Store the progress. Return False to stop the tuning."""
        self.history.setdefault(progress.trial, []).append(progress.best_cost)
        self.progress = progress
        if progress.parameters is not None and time.monotonic() - self.drawn_at > 1.5:  # s
            self.drawn_at = time.monotonic()
            try:
                estimate = sigmaswarm.run(self.shown_on, progress.parameters)
                self.track = thinned(estimate.mean[:, 0], estimate.mean[:, 1])
            except sigmaswarm.SigmaswarmError:  # this filter failed, the next may succeed
                self.track = None
        self.version += 1
        return not self.stopping

    def stop(self) -> None:
        self.stopping, self.version = True, self.version + 1

    def tune(self, drives: Sequence[Drive], options: Mapping[str, Any]) -> None:
        try:
            sigmaswarm.tune(drives, progress=self.advance, **options)
        except TuningStopped:
            pass
        except (sigmaswarm.SigmaswarmError, OSError, MemoryError) as error:
            self.error = str(error) or type(error).__name__
        finally:
            self.ended, self.version = True, self.version + 1


class TuningRuns:
    def __init__(self, bench: Workbench) -> None:
        self.bench = bench
        self.runs: dict[str, TuningRun] = {}
        self._threads: list[threading.Thread] = []

    def begin(
        self, name: str, drives: Sequence[Drive], held_back: Sequence[Drive], options: Mapping[str, Any]
    ) -> None:
        run, folder = TuningRun(name, (held_back or drives)[0]), self.bench.path("tunings", name)
        if options.get("resume"):
            run.history = {n: list(best) for n, best in saved_history(folder).items()}
        self.runs[name] = run
        work = {**options, "validation": held_back, "out": folder}
        self._threads.append(threading.Thread(target=run.tune, args=(drives, work), daemon=True))
        self._threads[-1].start()

    def resume(self, name: str) -> None:
        options, data = saved_options(self.bench.path("tunings", name))
        known = self.bench.choices.get("tunings", {}).get(name, {})
        drives = [self.bench.read(one) for one in known.get("drives", [one["name"] for one in data])]
        held_back = [self.bench.read(one) for one in known.get("held", [])]
        self.begin(name, drives, held_back, {**options, "resume": True})

    def stop_all(self) -> None:
        for run in self.runs.values():
            run.stop()
        for thread in self._threads:
            thread.join(timeout=20.0)


def best_so_far(history: Sequence[float]) -> Series:
    """Return the numbers of the generations, and the lowest cost up to each generation; NaN until a filter succeeds."""
    costs = np.array(history)
    return np.arange(1.0, len(costs) + 1), np.where(np.isfinite(costs), costs, np.nan)
