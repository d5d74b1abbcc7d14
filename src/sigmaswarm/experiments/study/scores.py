"""Scores of all methods in each trial on the trial's test drives, and tracks on a few of these drives."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.experiments.study.config import ALL, MAIN_METHOD, NO_PROTOCOL, ProtocolName
from sigmaswarm.experiments.study.design import Design, Filters, Task
from sigmaswarm.experiments.study.networks import Networks, TrainedNetwork
from sigmaswarm.experiments.study.record import Variant
from sigmaswarm.files import write_atomically
from sigmaswarm.filters.fixes_alone import FixesAlone, MotionNoise, fitted_noise
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, PAPER, baseline
from sigmaswarm.filters.run import estimate_of, run_imu_only
from sigmaswarm.scoring.batch import BatchScorer, PassOptions, Scores, scores_from_sums
from sigmaswarm.scoring.drifts import rms_drift
from sigmaswarm.scoring.remote import AnyBatchScorer
from sigmaswarm.scoring.score import PieceErrors, Score, root_mean, score_estimate, score_raw_gps
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, outage_pass, outage_windows, tracking_pass
from sigmaswarm.scoring.tracks import Picture, Tracker, Tracks

SCORE_OF_MEASURE: dict[str, Callable[[Any], Any]] = {
    "position_rmse_m": lambda s: s.position_rmse,
    "gps_rmse_m": lambda s: s.fix_rmse,
    "heading_rmse_deg": lambda s: np.degrees(s.heading_rmse),
    "outage_drift_m": lambda s: s.outage_drift,
    "nis": lambda s: s.mean_nis,
}
"""Functions that return a measure from `Scores` or from a `Score`."""


def _measured(score: Score) -> dict[str, float]:
    """Return the measures of a score except the drift."""
    return {m: float(take(score)) for m, take in SCORE_OF_MEASURE.items() if m != "outage_drift_m"}


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """Scores of a study: arrays of shape (trials, drives) by variant and measure.

    A score is NaN if the drive is not a test drive of the trial or if the measure is undefined. It is ``inf`` if the
    filter failed.
    """

    design: Design
    values: Mapping[Variant, Mapping[str, Array]]

    def columns(self) -> Iterator[tuple[dict[str, str], Array]]:
        """Yield the scores of each variant and measure, with the names of protocol, method and measure."""
        for (protocol, method), measures in self.values.items():
            for measure, values in measures.items():
                yield {"protocol": protocol, "method": method, "measure": measure}, values

    def to_frame(self) -> pl.DataFrame:
        """Return a table in long format: protocol, trial, method, drive, maneuver, environment, measure, value."""
        names = np.array([drive.name for drive in self.design.drives])
        maneuvers, environments = (np.array(column) for column in zip(*self.design.conditions, strict=True))
        parts: list[pl.DataFrame] = []
        for of, values in self.columns():
            trial, drive = np.nonzero(~np.isnan(values))
            columns = {
                "protocol": of["protocol"],
                "trial": trial,
                "method": of["method"],
                "drive": names[drive],
                "maneuver": maneuvers[drive],
                "environment": environments[drive],
                "measure": of["measure"],
                "value": values[trial, drive],
            }
            parts += [pl.DataFrame(columns)] if len(trial) else []
        return pl.concat(parts)

    def write(self, folder: Path) -> None:
        write_atomically(folder / "scores.csv", self.to_frame().write_csv())


def manual(ready: PreparedDrive, method: str) -> FilterParameters:
    """Return the parameters of a manually tuned filter for a drive."""
    if method == "ukf-paper":
        return PAPER
    kind, _, preset = method.rpartition("-")
    chosen = baseline(ready.drive) if preset == "datasheet" else DEFAULTS
    return replace(chosen, kind=kind)


def score_all(
    design: Design, parameters: Filters, executor: Executor | None = None, networks: Networks | None = None
) -> ScoreTable:
    test = [design.split(trial)[1] for trial in range(design.config.trials)]
    tested = np.array([np.isin(np.arange(len(design.drives)), drives) for drives in test])
    score = partial(_score_sets, design, _passes(design), executor)
    values: dict[Variant, dict[str, Array]] = {}
    for name, method in design.config.methods.items():
        if name in ("imu-only", "raw-gps", "fixes-alone"):
            values[NO_PROTOCOL, name] = _unfiltered(name, design)
        elif not method.protocols:
            drives: dict[FilterParameters, list[int]] = {}
            for i, by_hand in enumerate(design.map_prepared(partial(manual, method=name))):
                drives.setdefault(by_hand, []).append(i)
            values[NO_PROTOCOL, name] = score((own, [by_hand]) for by_hand, own in drives.items())
    for variant in dict.fromkeys(task.variant for task in parameters):
        own = {(task.group, task.trial): p for task, p in parameters.items() if task.variant == variant}
        sets = ([own[group, trial] for trial in range(len(test))] for group in design.groups)
        values[variant] = score(zip(map(design.members, design.groups), sets, strict=True))
    for variant in dict.fromkeys(task.variant for task in networks or {}):
        own = [network for task, network in (networks or {}).items() if task.variant == variant]
        values[variant] = score_networks(design, own, test, executor)
    masked = {v: {m: np.where(tested, a, np.nan) for m, a in own.items()} for v, own in values.items()}
    return ScoreTable(design, masked)


@dataclass(frozen=True, eq=False)
class _Pass:
    """Prepared drives, a mask of those that are long enough for the outage, and functions that return measures."""

    scorer: AnyBatchScorer
    fits: NDArray[np.bool_]
    take: Mapping[str, Callable[[Scores], Array]]


def _passes(design: Design) -> list[_Pass]:
    """Prepare the drives for outages of each length. Longer outages are measured only on local drives."""
    all_drives = np.ones(len(design.drives), dtype=np.bool_)
    passes = [_Pass(design.scorer(outages=True), all_drives, SCORE_OF_MEASURE)]
    ready, seed = design.prepared, design.config.seed
    for measure, length in design.config.long_outages.items():
        scorer = BatchScorer.prepare(ready, PassOptions(outages=True, outage_length=length, outage_seed=seed))
        fits = [len(outage_windows(r.drive, r.initial, length=length, seed=seed)) > 0 for r in ready]
        passes.append(_Pass(scorer, np.array(fits), {measure: SCORE_OF_MEASURE["outage_drift_m"]}))
    return passes


def _score_sets(
    design: Design,
    passes: Sequence[_Pass],
    executor: Executor | None,
    jobs: Iterable[tuple[Sequence[int], Sequence[FilterParameters]]],
) -> dict[str, Array]:
    """Score the parameter sets of each job on its drives: arrays of shape (sets, all drives) by measure.

    A score is ``inf`` if the filter failed, and NaN if no job includes the drive.
    """
    results: dict[str, Array] = {}
    for drives, sets in jobs:
        for one in passes:
            scores = one.scorer.subset(drives).scores(sets, executor)
            for measure, take in one.take.items():
                column = results.setdefault(measure, np.full((len(sets), len(design.drives)), np.nan))
                column[:, drives] = np.where(scores.failed & one.fits[drives], np.inf, take(scores))
    return results


def _unfiltered(method: str, design: Design) -> dict[str, Array]:
    """Score a method without an IMU filter on all drives: arrays of shape (1, drives) by measure.

    The constant-velocity filter ("fixes-alone") has the medians of the noise parameters that are fitted to the drives.
    """
    lengths, seed = {"outage_drift_m": OUTAGE_LENGTH} | design.config.long_outages, design.config.seed
    noise = MotionNoise.typical(design.map_prepared(fitted_noise)) if method == "fixes-alone" else None
    one = partial(_score_unfiltered, method=method, noise=noise, lengths=lengths, seed=seed)
    each = design.map_prepared(one)
    return {measure: np.array([[scores[measure] for scores in each]]) for measure in each[0]}


def _score_unfiltered(
    ready: PreparedDrive, method: str, noise: MotionNoise | None, lengths: Mapping[str, float], seed: int
) -> dict[str, float]:
    drive, start = ready.drive, ready.initial
    drifts = dict.fromkeys(lengths, np.nan)
    if method == "raw-gps":
        score = replace(score_raw_gps(drive, start), fix_rmse=0.0)  # equation 4 compares with the fixes
    else:
        whole = run_imu_only(ready)
        if noise is not None:
            whole = estimate_of(FixesAlone(tracking_pass(ready), noise), recover=False)
        score = score_estimate(drive, whole)
        for measure, length in lengths.items():
            ends, hidden = outage_windows(drive, start, length=length, seed=seed)[:, 1], whole
            if noise is not None:
                outages = outage_pass(ready, length=length, seed=seed)
                hidden = estimate_of(FixesAlone(outages, noise), recover=False)
            drifts[measure] = rms_drift(ready, hidden, ends)
        if method == "imu-only":
            gps = drive.gps.select((drive.gps.time > start.time) & (drive.gps.time <= whole.time[-1]))
            x, y = (np.interp(gps.time, whole.time, whole.mean[:, i]) for i in range(2))
            score = replace(score, fix_rmse=root_mean((x - gps.x) ** 2 + (y - gps.y) ** 2))
    return {m: value for m, value in _measured(score).items() if m != "nis"} | drifts


def score_networks(
    design: Design,
    networks: Sequence[TrainedNetwork],
    drives: Sequence[Sequence[int]],
    executor: Executor | None = None,
) -> dict[str, Array]:
    """Score each network on its ``drives`` (indices). Return arrays of shape (networks, all drives) by measure."""
    jobs = [(k, i) for k, chosen in enumerate(drives) for i in chosen]
    one = partial(_score, long=design.config.long_outages, seed=design.config.seed)
    results = (executor.map if executor else map)(
        one, [networks[k] for k, _ in jobs], [design.prepared[i] for _, i in jobs]
    )
    found: dict[str, Array] = {}
    for at, scores in zip(jobs, results, strict=True):
        for measure, value in scores.items():
            found.setdefault(measure, np.full((len(networks), len(design.drives)), np.nan))[at] = value
    return found


def _score(
    trained: TrainedNetwork, ready: PreparedDrive, long: Mapping[str, float], seed: int
) -> dict[str, float]:
    drive_pass, truth = tracking_pass(ready), ready.drive.truth
    assert truth is not None
    run = trained.run(drive_pass)
    errors = PieceErrors(truth, ready.initial)
    for piece in run:
        errors.add(piece.time, piece.mean)
    sums = scores_from_sums({"tracking": [drive_pass]}, {"tracking": run.sums})[0, 0]
    position, heading = errors.score.position_rmse, errors.score.heading_rmse
    score = _measured(replace(sums, position_rmse=position, heading_rmse=heading))
    scores = {measure: np.inf if run.failure else value for measure, value in score.items()}
    for measure, length in {"outage_drift_m": OUTAGE_LENGTH, **long}.items():
        ends = outage_windows(ready.drive, ready.initial, length=length, seed=seed)[:, 1]
        scores[measure] = np.nan
        if len(ends):
            run = trained.run(outage_pass(ready, length=length, seed=seed))
            whole = run.whole()
            scores[measure] = np.inf if run.failure else rms_drift(ready, whole, ends)
    return scores


MANUAL_FILTERS = ("ukf-datasheet", "ukf-defaults")
# Tuned filters with saved tracks, in series such as ``honest-pso-ukf``.
TRACKED_FILTERS: tuple[tuple[ProtocolName, str], ...] = (
    ("honest", MAIN_METHOD),
    ("paper", MAIN_METHOD),
    ("honest", "pso-ekf"),
    ("honest", "pso-planar8"),
)
MAX_TRACKED_DRIVES = 10
MAX_TRACK_POINTS = 700  # largest number of points of a series, to limit the size of the page


def record_tracks(design: Design, parameters: Filters, trial: int) -> tuple[list[Tracks], Picture]:
    """Record tracks on some test drives of a trial, and the data of the figures on the first drive."""
    tracks: list[Tracks] = []
    pictures: list[Picture] = []
    for i in tracked_drives(design, trial):
        tuned = {f"{p}-{m}": parameters[Task(p, m, design.group_of(i), trial)] for p, m in TRACKED_FILTERS}
        ((followed, picture),) = design.map_prepared(partial(_followed, tuned=tuned, drawn=not pictures), [i])
        tracks.append(followed)
        pictures += [picture] if picture else []
    return tracks, pictures[0]


def _followed(
    ready: PreparedDrive, tuned: Mapping[str, FilterParameters], *, drawn: bool
) -> tuple[Tracks, Picture | None]:
    name = ready.drive.name
    drive_pass, tracker = tracking_pass(ready), Tracker(ready, MAX_TRACK_POINTS, picture=drawn)
    by_hand = {method: manual(ready, method) for method in MANUAL_FILTERS}
    for series, one in {**tuned, **by_hand}.items():
        tracker.record(series, drive_pass, one)
    tracker.keep_estimate("imu_only", run_imu_only(ready))
    return tracker.tracks(name), tracker.picture(name) if drawn else None


def tracked_drives(design: Design, trial: int) -> list[int]:
    """Choose test drives of a trial: one of each condition, or of each maneuver if there are many conditions.

    The drives are chosen at different positions in the lists of the maneuvers, so that the environments differ. The
    first drive contains turns. If all drives have the same condition, the first test drives are chosen.
    """
    _, test = design.split(trial)
    named = {i: design.conditions[i] for i in test}
    if len(set(named.values())) > MAX_TRACKED_DRIVES:
        named = {i: (maneuver, ALL) for i, (maneuver, _) in named.items()}
    groups = list(dict.fromkeys(named.values()))[:MAX_TRACKED_DRIVES]
    if len(groups) == 1:
        return test[:MAX_TRACKED_DRIVES]
    members = [[i for i in test if named[i] == group] for group in groups]
    chosen = [own[k * len(own) // len(groups)] for k, own in enumerate(members)]
    return sorted(chosen, key=lambda i: design.conditions[i][0] != "turns")
