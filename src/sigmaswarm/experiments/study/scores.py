"""The scores of all methods, those of each trial on its test drives."""

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
from sigmaswarm.experiments.study.config import UNTUNED
from sigmaswarm.experiments.study.design import Design, Task
from sigmaswarm.experiments.study.networks import Trained, score_networks
from sigmaswarm.experiments.study.record import Variant
from sigmaswarm.files import write_whole
from sigmaswarm.filters.dead_reckoning import run_imu_only
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, PAPER, baseline
from sigmaswarm.scoring.batch import Replayer, Scores
from sigmaswarm.scoring.evaluation import score_imu_only
from sigmaswarm.scoring.remote import Replays
from sigmaswarm.scoring.score import score_raw_gps
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, outage_windows

TAKEN: dict[str, Callable[[Scores], Array]] = {
    "position_rmse_m": lambda s: s.position_rmse,
    "gps_rmse_m": lambda s: s.fix_rmse,
    "heading_rmse_deg": lambda s: np.degrees(s.heading_rmse),
    "outage_drift_m": lambda s: s.outage_drift,
    "nis": lambda s: s.mean_nis,
}
"""The measures, taken from compiled scores."""


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """All scores of a study.

    Attributes
    ----------
    design : Design
    values : mapping of (protocol, method) to mapping of measure to ndarray, shape (trials, drives)
        NaN where the trial did not test on the drive or the measure is unknown; ``inf`` where the filter failed.
    """

    design: Design
    values: Mapping[Variant, Mapping[str, Array]]

    def to_frame(self) -> pl.DataFrame:
        """Return the long table: protocol, trial, method, drive, maneuver, environment, measure, value."""
        names = np.array([drive.name for drive in self.design.drives])
        maneuvers, environments = (np.array(column) for column in zip(*self.design.conditions, strict=True))
        parts: list[pl.DataFrame] = []
        for (protocol, method), measures in self.values.items():
            for measure, values in measures.items():
                trial, drive = np.nonzero(~np.isnan(values))
                parts.append(
                    pl.DataFrame({"trial": trial}).select(
                        pl.lit(protocol).alias("protocol"),
                        "trial",
                        pl.lit(method).alias("method"),
                        pl.Series("drive", names[drive]),
                        pl.Series("maneuver", maneuvers[drive]),
                        pl.Series("environment", environments[drive]),
                        pl.lit(measure).alias("measure"),
                        pl.Series("value", values[trial, drive]),
                    )
                )
        return pl.concat(parts)

    def write(self, folder: Path) -> None:
        """Write scores.csv."""
        write_whole(folder / "scores.csv", self.to_frame().write_csv())


def manual(method: str, drive: Drive) -> FilterParameters:
    """Return the parameters of a filter without tuning for a drive."""
    if method == "ukf-paper":
        return PAPER
    kind, _, preset = method.rpartition("-")
    chosen = baseline(drive) if preset == "datasheet" else DEFAULTS
    return replace(chosen, kind=kind)  # pyright: ignore[reportArgumentType]


def score_all(
    design: Design,
    parameters: Mapping[Task, FilterParameters],
    executor: Executor | None = None,
    networks: Mapping[Task, Trained] | None = None,
) -> ScoreTable:
    """Score every method, networks too, on each trial's test drives."""
    passes, trials = _passes(design), range(design.config.trials)
    test = [design.split(trial)[1] for trial in trials]
    tested = np.zeros((len(trials), len(design.drives)), dtype=np.bool_)
    for trial, drives in enumerate(test):
        tested[trial, drives] = True
    values: dict[Variant, dict[str, Array]] = {}
    for name, method in design.config.methods.items():
        if not method.protocols:
            values[UNTUNED, name] = _score_untuned(name, design, passes, executor)
    for variant in dict.fromkeys(task.variant for task in parameters):
        own = {task: p for task, p in parameters.items() if task.variant == variant}
        values[variant] = _score_tuned(own, design, passes, executor)
    for variant in dict.fromkeys(task.variant for task in networks or {}):
        own = [network for task, network in (networks or {}).items() if task.variant == variant]
        values[variant] = score_networks(design, own, test, executor)
    masked = {v: {m: np.where(tested, a, np.nan) for m, a in own.items()} for v, own in values.items()}
    return ScoreTable(design, masked)


@dataclass(frozen=True, eq=False)
class _Pass:
    """Prepared drives, the drives (bool) whose failures count, and the measures."""

    replays: Replays
    fits: NDArray[np.bool_]
    take: Mapping[str, Callable[[Scores], Array]]


def _passes(design: Design) -> list[_Pass]:
    """Prepare the drives for all measures; longer outages are measured locally alone."""
    passes = [_Pass(design.replays(outages=True), np.ones(len(design.drives), dtype=np.bool_), TAKEN)]
    seed = design.config.seed
    for measure, length in design.config.long_outages.items():
        replays = Replayer(design.prepared, outages=True, outage_length=length, outage_seed=seed)
        fits = np.array(design.of_each(partial(_fits, length=length, seed=seed)))
        passes.append(_Pass(replays, fits, {measure: TAKEN["outage_drift_m"]}))
    return passes


def _fits(ready: PreparedDrive, length: float, seed: int) -> bool:
    return len(outage_windows(ready.drive, ready.initial, length=length, seed=seed)) > 0


def _score_sets(
    passes: Sequence[_Pass],
    drives: Sequence[int],
    sets: Sequence[FilterParameters],
    executor: Executor | None,
) -> dict[str, Array]:
    """Score parameter sets on some drives, shape (sets, drives) each; ``inf`` where the filter failed."""
    found: dict[str, Array] = {}
    for one in passes:
        scores = one.replays.subset(drives).scores(sets, executor)
        for measure, take in one.take.items():
            found[measure] = np.where(scores.failed & one.fits[drives], np.inf, take(scores))
    return found


def _score_tuned(
    parameters: Mapping[Task, FilterParameters],
    design: Design,
    passes: Sequence[_Pass],
    executor: Executor | None,
) -> dict[str, Array]:
    """Score a tuned method, shape (trials, drives): on each drive the filter of its group."""
    found = {m: np.full((design.config.trials, len(design.drives)), np.nan) for m in design.config.measures}
    for group in design.groups:
        own = {task.trial: p for task, p in parameters.items() if task.group == group}
        members = design.members(group)
        scores = _score_sets(passes, members, [own[trial] for trial in sorted(own)], executor)
        for measure, values in scores.items():
            found[measure][:, members] = values
    return found


def _score_untuned(
    method: str, design: Design, passes: Sequence[_Pass], executor: Executor | None
) -> dict[str, Array]:
    """Score a method without tuning on all drives, shape (drives,)."""
    if method in ("imu-only", "raw-gps"):
        lengths, seed = {"outage_drift_m": OUTAGE_LENGTH} | design.config.long_outages, design.config.seed
        each = design.of_each(partial(_score_unfiltered, method=method, lengths=lengths, seed=seed))
        return {measure: np.array([scores[measure] for scores in each]) for measure in each[0]}
    by_set: dict[FilterParameters, list[int]] = {}
    for i, parameters in enumerate(design.of_each(partial(_manual, method=method))):
        by_set.setdefault(parameters, []).append(i)
    found = {m: np.full(len(design.drives), np.nan) for m in design.config.measures}
    for parameters, members in by_set.items():
        for measure, values in _score_sets(passes, members, [parameters], executor).items():
            found[measure][members] = values[0]
    return found


def _manual(ready: PreparedDrive, method: str) -> FilterParameters:
    return manual(method, ready.drive)


def _score_unfiltered(
    ready: PreparedDrive, method: str, lengths: Mapping[str, float], seed: int
) -> dict[str, float]:
    """Score the raw fixes or the IMU alone on a drive."""
    drive = ready.drive
    if method == "raw-gps":
        residual, score = 0.0, score_raw_gps(drive, ready.initial)  # equation 4 compares with the fixes
        drifts = dict.fromkeys(lengths, score.outage_drift)
    else:
        estimate = run_imu_only(ready)
        gps = drive.gps.select((drive.gps.time > ready.initial.time) & (drive.gps.time <= estimate.time[-1]))
        x, y = (np.interp(gps.time, estimate.time, estimate.mean[:, i]) for i in range(2))
        residual = float(np.sqrt(np.mean((x - gps.x) ** 2 + (y - gps.y) ** 2))) if len(gps) else float("nan")
        scores = {
            measure: score_imu_only(ready, estimate, length, seed) for measure, length in lengths.items()
        }
        score = scores["outage_drift_m"]
        drifts = {measure: one.outage_drift for measure, one in scores.items()}
    return {
        "position_rmse_m": score.position_rmse,
        "gps_rmse_m": residual,
        "heading_rmse_deg": float(np.degrees(score.heading_rmse)),
        **drifts,
    }
