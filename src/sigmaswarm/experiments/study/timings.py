"""The time that a study took, and that one update of each filter costs: kept apart from what is the same each time."""

import json
import os
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.networks import Taught, Training
from sigmaswarm.files import write_json
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.parameters import FilterKind, FilterParameters
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.filters.recording import Recording
from sigmaswarm.scoring.targets import tracking_replay

LIVE: dict[str, tuple[FilterKind, int]] = {
    "EKF": ("ekf", 5),
    "adaptive UKF": ("adaptive-ukf", 5),
    "UKF": ("ukf", 5),
    "UKF, planar8": ("ukf", 8),
}
"""The filters whose updates are timed: kind and number of states."""


class Stopwatch:
    """Wall and processor time, lap by lap; that of forks, too, once they have ended."""

    def __init__(self) -> None:
        self.laps: dict[str, dict[str, float]] = {}
        self._wall, self._processor = time.perf_counter(), _processor_time()

    def lap(self, name: str) -> None:
        """End a lap."""
        wall, processor = time.perf_counter(), _processor_time()
        self.laps[name] = {"wall_s": wall - self._wall, "processor_s": processor - self._processor}
        self._wall, self._processor = wall, processor


def _processor_time() -> float:
    return sum(os.times()[:4])


@contextmanager
def kept_time(file: Path) -> Generator[None]:
    """Keep the processor seconds that this thread takes in a file of the form of a training's timings.json."""
    began = time.thread_time()
    yield
    write_json(file, {"processor_s": time.thread_time() - began})


def rival_times(
    out: Path, design: Design, parameters: Mapping[Task, FilterParameters], taught: Mapping[Task, Taught]
) -> dict[str, dict[str, float]]:
    """Processor time of every tuned or trained variant, as ``honest-pso-ukf``.

    ``training_s``: s of a trial, a network's without its filter's; ``sample_us``: us of an IMU sample, over a whole
    drive. A training or tuning that was killed counts from where it was gone on with.
    """
    folders = {task: out / "trials" / task.folder / f"trial-{task.trial:03d}" for task in parameters}
    folders |= {task: out / Training(task.method, task.trial).folder for task in taught}  # pyright: ignore
    spent: dict[str, list[float]] = {}
    for task, folder in folders.items():
        spent.setdefault(task.folder, []).append(_spent(folder))
    known = {name: [s for s in each if np.isfinite(s)] for name, each in spent.items()}
    found = {name: {"training_s": float(np.mean(each))} if each else {} for name, each in known.items()}
    ready = design.prepared[design.split(0)[1][0]]
    for task in folders:
        if task.trial == 0:
            run = taught.get(task) or parameters[task]
            found[task.folder]["sample_us"] = _sample_us(run, ready)
    return found


def _spent(folder: Path) -> float:
    """Processor seconds; NaN where nobody kept them."""
    try:
        return float(json.loads((folder / "timings.json").read_text())["processor_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return float("nan")


def _sample_us(run: Taught | FilterParameters, ready: PreparedDrive) -> float:
    """us of processor time an IMU sample, the second time."""
    took = 0.0
    for _ in range(2):
        replay = tracking_replay(ready)
        began = time.process_time()
        if isinstance(run, Taught):
            run.learned.run(replay, run.parameters).finished()
        else:
            Recording(replay, run).finished()
        took = 1e6 * (time.process_time() - began) / len(replay.timeline.imu_time)
    return took


def write_timings(
    out: Path, design: Design, watch: Stopwatch, rivals: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, float]]:
    """Add this run's laps to timings.json: a study that was interrupted has several, and a killed run leaves none.

    Returns the times of the live filters, ms.
    """
    file = out / "timings.json"
    try:
        runs = list(json.loads(file.read_text())["runs"])
    except (OSError, ValueError, KeyError, TypeError):
        runs: list[Any] = []
    (live,) = design.of_each(_all_live_times, [0])
    more = {"rivals": rivals} if rivals else {}
    write_json(file, {"runs": [*runs, watch.laps], "live_filter": live, **more})
    return live


def _all_live_times(ready: PreparedDrive) -> dict[str, dict[str, float]]:
    return {name: _live_times(ready, kind, n) for name, (kind, n) in LIVE.items()}


def _live_times(ready: PreparedDrive, kind: FilterKind, n_states: int) -> dict[str, float]:
    """ms per IMU sample, and per sample that absorbs a fix: medians over a drive, one call at a time."""
    parameters = _parameters(kind, n_states)
    drive, initial = ready.drive, ready.initial
    plain, absorbing = [], []
    for _ in range(2):  # the first round warms up
        live = LiveFilter(
            parameters, initial, nominal_interval=drive.nominal_interval, as_recorded=ready.as_recorded
        )
        plain, absorbing = _one_round(live, drive, initial.time)
    return {"predict_ms": _median_ms(plain), "predict_and_update_ms": _median_ms(absorbing)}


def _one_round(live: LiveFilter, drive: Drive, start: float) -> tuple[list[float], list[float]]:
    fixes = list(zip(drive.gps.time.tolist(), drive.gps.x.tolist(), drive.gps.y.tolist(), strict=True))[::-1]
    rows = np.column_stack([drive.imu.time, drive.imu.ax, drive.imu.ay, drive.imu.gz]).tolist()
    plain: list[float] = []
    absorbing: list[float] = []
    for t, *imu in rows:
        due = bool(fixes) and fixes[-1][0] <= t
        began = time.perf_counter()
        if due:
            fix = fixes.pop()
            live.update(fix[0], fix[1:])
        live.predict(t, imu)
        if t > start:
            (absorbing if due else plain).append(time.perf_counter() - began)
    return plain, absorbing


def _median_ms(seconds: list[float]) -> float:
    return float(1e3 * np.median(seconds)) if seconds else float("nan")


def _parameters(kind: FilterKind, n_states: int) -> FilterParameters:
    if n_states == 5:
        return FilterParameters(0.1, 2.0, 0.0, DEFAULTS.process_noise, DEFAULTS.measurement_noise, kind=kind)
    q = (*DEFAULTS.process_noise, 1e-8, 1e-8, 1e-8)
    return FilterParameters(0.1, 2.0, 0.0, q, DEFAULTS.measurement_noise, "planar8", kind=kind)
