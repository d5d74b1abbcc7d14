"""The scores of all methods on all drives, each trial's on the drives that it held back."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array, Drive
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.config import BY_BO, BY_DEFAULT, TUNED_METHODS, UNTUNED, StudyConfig
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.network_scores import scores_of_networks
from sigmaswarm.experiments.study.networks import Taught
from sigmaswarm.experiments.study.record import Variant
from sigmaswarm.files import write_whole
from sigmaswarm.filters.dead_reckoning import run_imu_only
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, PAPER, baseline
from sigmaswarm.scoring.batch import Replayer, Replays, Scores
from sigmaswarm.scoring.evaluation import score_imu_only
from sigmaswarm.scoring.score import Score, score_raw_gps
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, outage_windows

LABELS = {
    "imu-only": "IMU only",
    "raw-gps": "raw GPS",
    "ekf-defaults": "EKF, manual: defaults",
    "ekf-datasheet": "EKF, manual: data sheet",
    "adaptive-ukf-defaults": "adaptive UKF, manual: defaults",
    "adaptive-ukf-datasheet": "adaptive UKF, manual: data sheet",
    "ukf-defaults": "UKF, manual: defaults",
    "ukf-datasheet": "UKF, manual: data sheet",
    "ukf-paper": "UKF, the paper's optimum",
    "pso-ukf": "PSO-UKF",
    "pso-ekf": "PSO-EKF",
    "pso-adaptive-ukf": "PSO-adaptive UKF",
    "pso-planar8": "PSO-UKF, planar8",
    BY_DEFAULT: "what tune takes by itself",
}
"""All methods but the rivals, and what people call them."""
RIVAL_LABELS = {
    "pso-fuzzy-ukf": "PSO-fuzzy UKF",
    BY_BO: "UKF by Bayesian optimization",
    "outage-lstm": "planar8 with outage-lstm",
    "noise-gru": "planar8 with noise-gru",
}

STUDY_MEASURES: dict[str, tuple[str, Callable[[Scores], Array]]] = {
    "position_rmse_m": ("position RMSE against truth, m", lambda s: s.position_rmse),
    "gps_rmse_m": ("RMSE against the absorbed GPS (equation 4), m", lambda s: s.fix_rmse),
    "heading_rmse_deg": ("heading error, deg", lambda s: np.degrees(s.heading_rmse)),
    "outage_drift_m": ("drift over a 5 s outage, m", lambda s: s.outage_drift),
    "nis": ("mean NIS, 2 where the filter is consistent", lambda s: s.mean_nis),
}
"""What is measured on each drive, and how it is taken from the compiled scores."""


def labels_of(config: StudyConfig) -> dict[str, str]:
    """All methods of a study, and what people call them."""
    return LABELS | (RIVAL_LABELS if config.rivals else {})


def measures_of(config: StudyConfig) -> dict[str, str]:
    """All measures of a study, and what they are, with their units."""
    usual = {name: meaning for name, (meaning, _) in STUDY_MEASURES.items()}
    return usual | {name: f"drift over a {s:g} s outage, m" for name, s in config.long_outages.items()}


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """All scores of a study.

    Attributes
    ----------
    design : Design
    values : mapping of (protocol, method) to mapping of measure to ndarray, shape (trials, drives)
        NaN where the trial did not hold the drive back or the measure can't be said; ``inf`` where the filter failed.
    """

    design: Design
    values: Mapping[Variant, Mapping[str, Array]]

    def to_frame(self) -> pl.DataFrame:
        """The long table: protocol, trial, method, drive, maneuver, environment, measure, value."""
        names = np.array([drive.name for drive in self.design.drives])
        maneuvers, environments = (np.array(column) for column in zip(*self.design.conditions, strict=True))
        parts: list[pl.DataFrame] = []
        for (protocol, method), measures in self.values.items():
            for measure, values in measures.items():
                trial, drive = np.nonzero(~np.isnan(values))
                constant = {"protocol": protocol, "method": method, "measure": measure}
                part = pl.DataFrame(
                    {
                        "trial": trial,
                        "drive": names[drive],
                        "maneuver": maneuvers[drive],
                        "environment": environments[drive],
                        "value": values[trial, drive],
                    }
                )
                parts.append(part.with_columns(**{k: pl.lit(v) for k, v in constant.items()}))
        order = ("protocol", "trial", "method", "drive", "maneuver", "environment", "measure", "value")
        return pl.concat(parts).select(order)

    def write(self, folder: Path) -> None:
        """Write scores.csv."""
        write_whole(folder / "scores.csv", self.to_frame().write_csv())


def manual(method: str, drive: Drive) -> FilterParameters:
    """The parameters of an untuned filter for a drive."""
    if method == "ukf-paper":
        return PAPER
    kind, _, preset = method.rpartition("-")
    chosen = baseline(drive) if preset == "datasheet" else DEFAULTS
    return replace(chosen, kind=kind)  # pyright: ignore[reportArgumentType]


def score_all(
    design: Design,
    parameters: Mapping[Task, FilterParameters],
    executor: Executor | None = None,
    taught: Mapping[Task, Taught] | None = None,
) -> ScoreTable:
    """Score every method on the drives that each trial held back, networks (``taught``) too."""
    measuring = _Measuring.of(design)
    trials = design.config.trials
    tested = np.zeros((trials, len(design.drives)), dtype=np.bool_)
    for trial in range(trials):
        tested[trial, design.split(trial)[1]] = True
    values: dict[Variant, dict[str, Array]] = {}
    for method in LABELS:
        if method not in TUNED_METHODS:
            once = _untuned(method, design, measuring, executor)
            values[UNTUNED, method] = {m: np.where(tested, row, np.nan) for m, row in once.items()}
    for protocol, method in dict.fromkeys((task.protocol, task.method) for task in parameters):
        own = {t: p for t, p in parameters.items() if (t.protocol, t.method) == (protocol, method)}
        each = _tuned(own, design, measuring, executor)
        values[protocol, method] = {m: np.where(tested, array, np.nan) for m, array in each.items()}
    for protocol, method in dict.fromkeys((task.protocol, task.method) for task in taught or {}):
        networks = [
            t for task, t in (taught or {}).items() if (task.protocol, task.method) == (protocol, method)
        ]
        held_back = [design.split(trial)[1] for trial in range(trials)]
        values[protocol, method] = scores_of_networks(design, networks, held_back, executor)
    return ScoreTable(design, values)


@dataclass(frozen=True, eq=False)
class _Measuring:
    """Drives made ready for all measures: ``long`` has those of the longer outages, and on which drives one fits."""

    usual: Replays
    long: Mapping[str, tuple[Replays, NDArray[np.bool_]]]

    @classmethod
    def of(cls, design: Design) -> "_Measuring":
        """The drives of a study; longer outages are measured here alone, not by a cluster's workers."""
        long: dict[str, tuple[Replays, NDArray[np.bool_]]] = {}
        for measure, length in design.config.long_outages.items():
            seed = design.config.seed
            replays = Replayer(design.prepared, outages=True, outage_length=length, outage_seed=seed)
            long[measure] = replays, np.array(design.of_each(partial(_fits, length=length, seed=seed)))
        return cls(design.replays(outages=True), long)

    def subset(self, drives: Sequence[int]) -> "_Measuring":
        """Some of the drives, by index."""
        long = {m: (replays.subset(drives), fits[drives]) for m, (replays, fits) in self.long.items()}
        return _Measuring(self.usual.subset(drives), long)

    def told(self, sets: Sequence[FilterParameters], executor: Executor | None) -> dict[str, Array]:
        """Every measure of parameter sets, shape (sets, drives); ``inf`` where the filter failed."""
        scores = self.usual.scores(sets, executor)
        found = {m: np.where(scores.failed, np.inf, take(scores)) for m, (_, take) in STUDY_MEASURES.items()}
        for measure, (replays, fits) in self.long.items():
            scores = replays.scores(sets, executor)
            found[measure] = np.where(scores.failed & fits, np.inf, scores.outage_drift)
        return found


def _fits(ready: PreparedDrive, length: float, seed: int) -> bool:
    return len(outage_windows(ready.drive, ready.initial, length=length, seed=seed)) > 0


def _tuned(
    parameters: Mapping[Task, FilterParameters],
    design: Design,
    measuring: _Measuring,
    executor: Executor | None,
) -> dict[str, Array]:
    """Scores of one tuned method, shape (trials, drives): on each drive the filter of its own group."""
    found = {
        m: np.full((design.config.trials, len(design.drives)), np.nan) for m in measures_of(design.config)
    }
    for group in design.groups:
        own = {task.trial: p for task, p in parameters.items() if task.group == group}
        members = design.members(group)
        told = measuring.subset(members).told([own[trial] for trial in sorted(own)], executor)
        for measure, values in told.items():
            found[measure][:, members] = values
    return found


def _untuned(
    method: str, design: Design, measuring: _Measuring, executor: Executor | None
) -> dict[str, Array]:
    """Scores of an untuned method on all drives, shape (drives,)."""
    if method in ("imu-only", "raw-gps"):
        score = _imu_only if method == "imu-only" else _raw_gps
        usual = partial(score, seed=design.config.seed)
        drifts: dict[str, Array] = {}
        for measure, length in design.config.long_outages.items():
            drifts[measure] = np.array(
                [s.outage_drift for s in design.of_each(partial(usual, length=length))]
            )
        return _of_scores(design.of_each(usual)) | drifts
    by_set: dict[FilterParameters, list[int]] = {}
    for i, parameters in enumerate(design.of_each(partial(_manual, method=method))):
        by_set.setdefault(parameters, []).append(i)
    found = {m: np.full(len(design.drives), np.nan) for m in measures_of(design.config)}
    for parameters, members in by_set.items():
        for measure, values in measuring.subset(members).told([parameters], executor).items():
            found[measure][members] = values[0]
    return found


def _manual(ready: PreparedDrive, method: str) -> FilterParameters:
    return manual(method, ready.drive)


def _of_scores(scores: list[Score]) -> dict[str, Array]:
    return {
        "position_rmse_m": np.array([s.position_rmse for s in scores]),
        "gps_rmse_m": np.array([s.fix_rmse for s in scores]),
        "heading_rmse_deg": np.degrees([s.heading_rmse for s in scores]),
        "outage_drift_m": np.array([s.outage_drift for s in scores]),
    }


def _raw_gps(ready: PreparedDrive, seed: int, length: float = OUTAGE_LENGTH) -> Score:
    del seed, length  # there is nothing to hide
    return replace(score_raw_gps(ready.drive, ready.initial), fix_rmse=0.0)  # what equation 4 compares with


def _imu_only(ready: PreparedDrive, seed: int, length: float = OUTAGE_LENGTH) -> Score:
    drive, estimate = ready.drive, run_imu_only(ready)
    gps = drive.gps.select((drive.gps.time > ready.initial.time) & (drive.gps.time <= estimate.time[-1]))
    x, y = (np.interp(gps.time, estimate.time, estimate.mean[:, i]) for i in range(2))
    residual = float(np.sqrt(np.mean((x - gps.x) ** 2 + (y - gps.y) ** 2))) if len(gps) else float("nan")
    return replace(score_imu_only(ready, estimate, length, seed), fix_rmse=residual)
