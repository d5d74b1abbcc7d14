"""Durations of a study and of filter updates. Only these results differ between two runs."""

import os
import time
from collections import deque
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.design import Design, Filters
from sigmaswarm.experiments.study.networks import Networks, TrainedNetwork, Training
from sigmaswarm.experiments.study.record import Times
from sigmaswarm.files import write_json
from sigmaswarm.filters.filter_run import FilterRun
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.parameters import FilterKind, FilterParameters, ModelName
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.record_files import content_if_readable
from sigmaswarm.scoring.targets import tracking_pass

LIVE_FILTERS: dict[str, tuple[FilterKind, ModelName]] = {
    "EKF": ("ekf", "planar5"),
    "adaptive UKF": ("adaptive-ukf", "planar5"),
    "UKF": ("ukf", "planar5"),
    "UKF, planar8": ("ukf", "planar8"),
}


class Stopwatch:
    """Wall time and processor time of each lap (s). The processor time includes child processes that have ended."""

    def __init__(self) -> None:
        self.laps: Times = {}
        self._began = self._now()

    @staticmethod
    def _now() -> dict[str, float]:
        return {"wall_s": time.perf_counter(), "processor_s": sum(os.times()[:4])}

    def lap(self, name: str) -> None:
        began, self._began = self._began, self._now()
        self.laps[name] = {clock: self._began[clock] - t for clock, t in began.items()}


@contextmanager
def stored_time(file: Path) -> Generator[None]:
    """Measure this thread's processor time in a ``with`` block, and write it to ``file``."""
    began = time.thread_time()
    yield
    write_json(file, {"processor_s": time.thread_time() - began})


def rival_times(out: Path, design: Design, parameters: Filters, networks: Networks) -> Times:
    """Return the processor times of every tuned or trained variant, by names such as ``honest-pso-ukf``.

    ``training_s`` is the mean time (s) of tuning or training in a trial; for a network, it excludes the tuning of the
    filter. ``sample_us`` is the mean time (us) per IMU sample of a run. For a resumed trial, only the time since the
    last interruption is counted.
    """
    ready = design.prepared[design.split(0)[1][0]]
    spent: dict[str, list[float]] = {}
    results: Times = {}
    for task, own in {**parameters, **networks}.items():
        trial = f"trials/{task.folder}/trial-{task.trial:03d}"
        folder = Training(task.method, task.trial).folder if isinstance(own, TrainedNetwork) else trial  # pyright: ignore
        times = content_if_readable(out / folder / "timings.json").get("processor_s")
        if isinstance(times, float) and np.isfinite(times):
            spent.setdefault(task.folder, []).append(times)
        if task.trial == 0:
            results[task.folder] = {"sample_us": _sample_us(own, ready)}
    for name, seconds in spent.items():
        results[name] = {"training_s": float(np.mean(seconds)), **results[name]}
    return results


def _sample_us(own: TrainedNetwork | FilterParameters, ready: PreparedDrive) -> float:
    took = 0.0
    for _ in range(2):
        drive_pass = tracking_pass(ready)
        began = time.process_time()
        run = own.run(drive_pass) if isinstance(own, TrainedNetwork) else FilterRun(drive_pass, own)
        run.finished()
        took = 1e6 * (time.process_time() - began) / len(drive_pass.timeline.imu_time)
    return took


def write_timings(out: Path, design: Design, watch: Stopwatch, rivals: Times) -> Times:
    """Append this run's laps to timings.json. Return the times of the live filters, ms."""
    runs = content_if_readable(out / "timings.json").get("runs")
    (live,) = design.map_prepared(_live_times, [0])
    more = {"rivals": rivals} if rivals else {}
    runs = [*(runs if isinstance(runs, list) else []), watch.laps]
    write_json(out / "timings.json", {"runs": runs, "live_filter": live, **more})
    return live


def _live_times(ready: PreparedDrive) -> Times:
    return {name: _live_time(ready, *chosen) for name, chosen in LIVE_FILTERS.items()}


def _live_time(ready: PreparedDrive, kind: FilterKind, model: ModelName) -> dict[str, float]:
    """Measure the processing time of an IMU sample without and with a fix, ms: median, and 95% range."""
    drive = ready.drive
    q = (*DEFAULTS.process_noise, *(1e-8,) * (3 if model == "planar8" else 0))
    parameters = FilterParameters(0.1, 2.0, 0.0, q, DEFAULTS.measurement_noise, model, kind=kind)
    rows = np.column_stack([drive.imu.time, drive.imu.ax, drive.imu.ay, drive.imu.gz]).tolist()
    fixes = np.column_stack([drive.gps.time, drive.gps.x, drive.gps.y]).tolist()
    spent: dict[bool, list[float]] = {}
    for _ in range(2):  # the second round counts; in the first, caches are empty
        interval = drive.nominal_interval
        live = LiveFilter(parameters, ready.initial, nominal_interval=interval, as_recorded=ready.as_recorded)
        waiting, spent = deque[list[float]](fixes), {False: [], True: []}
        for t, *imu in rows:
            due = bool(waiting) and waiting[0][0] <= t
            began = time.perf_counter()
            if due:
                fixed, *position = waiting.popleft()
                live.update(fixed, position)
            live.predict(t, imu)
            if t > ready.initial.time:
                spent[due].append(time.perf_counter() - began)
    times = dict[str, float]()
    for name, each in zip(("predict", "predict_and_update"), spent.values(), strict=True):
        percentiles = 1e3 * np.percentile(each, (50, 2.5, 97.5)) if each else np.full(3, np.nan)
        times |= zip((f"{name}_ms", f"{name}_low_ms", f"{name}_high_ms"), percentiles.tolist(), strict=True)
    return times
