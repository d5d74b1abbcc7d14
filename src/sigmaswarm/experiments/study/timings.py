"""The time that a study took, and that one update of each filter costs: kept apart from what is the same each time."""

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.design import Design
from sigmaswarm.files import write_json
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.parameters import FilterKind, FilterParameters
from sigmaswarm.filters.presets import DEFAULTS

LIVE: dict[str, tuple[FilterKind, int]] = {
    "EKF": ("ekf", 5),
    "adaptive UKF": ("adaptive-ukf", 5),
    "UKF": ("ukf", 5),
    "UKF, planar8": ("ukf", 8),
}
"""The filters whose updates are timed: kind and number of states."""


class Stopwatch:
    """Wall and processor time, lap by lap."""

    def __init__(self) -> None:
        self.laps: dict[str, dict[str, float]] = {}
        self._wall, self._processor = time.perf_counter(), time.process_time()

    def lap(self, name: str) -> None:
        """End a lap."""
        wall, processor = time.perf_counter(), time.process_time()
        self.laps[name] = {"wall_s": wall - self._wall, "processor_s": processor - self._processor}
        self._wall, self._processor = wall, processor


def write_timings(out: Path, design: Design, watch: Stopwatch) -> dict[str, dict[str, float]]:
    """Add this run's laps to timings.json: a study that was interrupted has several, and a killed run leaves none.

    Returns the times of the live filters, ms.
    """
    file = out / "timings.json"
    try:
        runs = list(json.loads(file.read_text())["runs"])
    except (OSError, ValueError, KeyError, TypeError):
        runs: list[Any] = []
    (live,) = design.of_each(_all_live_times, [0])
    write_json(file, {"runs": [*runs, watch.laps], "live_filter": live})
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
