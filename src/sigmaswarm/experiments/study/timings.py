"""The duration of a study and of an update of each filter: the only results that differ between two runs."""

import json
import os
import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.networks import Trained, Training
from sigmaswarm.files import write_json
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.parameters import FilterKind, FilterParameters, ModelName
from sigmaswarm.filters.presets import DEFAULTS
from sigmaswarm.filters.recording import Recording
from sigmaswarm.scoring.targets import tracking_replay

LIVE: dict[str, tuple[FilterKind, ModelName]] = {
    "EKF": ("ekf", "planar5"),
    "adaptive UKF": ("adaptive-ukf", "planar5"),
    "UKF": ("ukf", "planar5"),
    "UKF, planar8": ("ukf", "planar8"),
}
"""Filter type and model of the filters whose updates are timed."""


class Stopwatch:
    """Measure wall and processor time, lap by lap; that of child processes once they have ended."""

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
    """Write the processor time of this thread in the block, as a training does, to timings.json."""
    began = time.thread_time()
    yield
    write_json(file, {"processor_s": time.thread_time() - began})


def rival_times(
    out: Path,
    design: Design,
    parameters: Mapping[Task, FilterParameters],
    networks: Mapping[Training, Trained],
) -> dict[str, dict[str, float]]:
    """Return processor times of every tuned or trained variant, as ``honest-pso-ukf``.

    ``training_s``: s of a trial, a network's without its filter's; ``sample_us``: us of an IMU sample over a whole
    drive. A training or tuning that was killed counts from where it was resumed.
    """
    runs: list[tuple[Task, Path, Trained | FilterParameters]] = [
        (task, out / "trials" / task.folder / f"trial-{task.trial:03d}", own)
        for task, own in parameters.items()
    ]
    runs += [(t.task, out / t.folder, own) for t, own in networks.items() if t.minutes is None]
    found: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(task.folder for task, _, _ in runs):
        spent = [s for task, folder, _ in runs if task.folder == name for s in _spent(folder)]
        found[name] = {"training_s": float(np.mean(spent))} if spent else {}
    ready = design.prepared[design.split(0)[1][0]]
    for task, _, own in runs:
        if task.trial == 0:
            found[task.folder]["sample_us"] = _sample_us(own, ready)
    return found


def _spent(folder: Path) -> list[float]:
    """Read the processor time, if it was written."""
    try:
        spent = float(json.loads((folder / "timings.json").read_text())["processor_s"])
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [spent] if np.isfinite(spent) else []


def _sample_us(own: Trained | FilterParameters, ready: PreparedDrive) -> float:
    """Measure the processor time of an IMU sample, us, in the second of two runs."""
    took = 0.0
    for _ in range(2):
        replay = tracking_replay(ready)
        began = time.process_time()
        run = own.learned.run(replay, own.parameters) if isinstance(own, Trained) else Recording(replay, own)
        run.finished()
        took = 1e6 * (time.process_time() - began) / len(replay.timeline.imu_time)
    return took


def write_timings(
    out: Path, design: Design, watch: Stopwatch, rivals: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, float]]:
    """Append this run's laps to timings.json, one entry for each run that was not killed.

    Returns
    -------
    dict
        The times of the live filters, ms.
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
    return {name: _live_times(ready, kind, model) for name, (kind, model) in LIVE.items()}


def _live_times(ready: PreparedDrive, kind: FilterKind, model: ModelName) -> dict[str, float]:
    """Measure ms per IMU sample, and per sample with a fix: medians over a drive, one call at a time."""
    drive, start = ready.drive, ready.initial.time
    biases = (1e-8,) * (3 if model == "planar8" else 0)
    q, r = (*DEFAULTS.process_noise, *biases), DEFAULTS.measurement_noise
    parameters = FilterParameters(0.1, 2.0, 0.0, q, r, model, kind=kind)
    rows = np.column_stack([drive.imu.time, drive.imu.ax, drive.imu.ay, drive.imu.gz]).tolist()
    plain, updating = list[float](), list[float]()
    for _ in range(2):  # the first round warms up
        live = LiveFilter(
            parameters,
            ready.initial,
            nominal_interval=drive.nominal_interval,
            as_recorded=ready.as_recorded,
        )
        fixes = list(zip(*(a.tolist() for a in (drive.gps.time, drive.gps.x, drive.gps.y)), strict=True))[
            ::-1
        ]
        plain, updating = [], []
        for t, *imu in rows:
            due = bool(fixes) and fixes[-1][0] <= t
            began = time.perf_counter()
            if due:
                fix = fixes.pop()
                live.update(fix[0], fix[1:])
            live.predict(t, imu)
            if t > start:
                (updating if due else plain).append(time.perf_counter() - began)
    return {"predict_ms": _median_ms(plain), "predict_and_update_ms": _median_ms(updating)}


def _median_ms(seconds: list[float]) -> float:
    return float(1e3 * np.median(seconds)) if seconds else float("nan")
