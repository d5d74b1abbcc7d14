"""Evaluate a tuned filter on drives, compared with the baseline, raw GPS, fixes alone and IMU only."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import polars as pl

from sigmaswarm import notebook
from sigmaswarm.datasets.dataset import Drives, make_datasets
from sigmaswarm.doctor.diagnose import finding_sentences
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.fingerprint import DriveRecord, drive_record, rounded
from sigmaswarm.drives.gaps import share_known
from sigmaswarm.drives.overlap import Landmarks, known_overlap, landmarks
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.sensors import receiver_std
from sigmaswarm.errors import InputError, warn_deprecated
from sigmaswarm.files import write_atomically, write_json
from sigmaswarm.filters.bank.run import BankRun
from sigmaswarm.filters.fixes_alone import FixesAlone, MotionNoise, fit_noise
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, join_sums
from sigmaswarm.filters.presets import filter_for
from sigmaswarm.filters.run import Innovations, run_imu_only
from sigmaswarm.filters.smoothing import SmootherRun
from sigmaswarm.scoring.batch import scores_from_sums
from sigmaswarm.scoring.consistency import TRACKING, Consistency, RadiusRecord, consistency_of, stated_radius
from sigmaswarm.scoring.drifts import OutageDrifts, Run, RunFactories
from sigmaswarm.scoring.methods import (
    AGAINST,
    BANK,
    BASELINE,
    DRIFTS,
    FIXES,
    MEASURES,
    METHODS,
    OPTIONAL_METHODS,
    SMOOTHED,
    Measure,
    measures,
    method_names,
)
from sigmaswarm.scoring.records import (
    AGAINST_FILE,
    EVALUATION_FILE,
    SCORES_FILE,
    AgainstRecord,
    DriftRecord,
    EvaluationRecord,
    ScoresRecord,
)
from sigmaswarm.scoring.remarks import is_worse_than_untuned
from sigmaswarm.scoring.score import Score, score_estimate, score_raw_gps, truth_offset
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH, OUTAGE_LENGTH, SHORT_OUTAGE_LENGTH, tracking_pass
from sigmaswarm.scoring.tracks import (
    NOTHING_STATED,
    TRACKS_FILE,
    Picture,
    Tracker,
    Tracks,
    compared,
    save_tracks,
)
from sigmaswarm.scoring.view import EvaluationView
from sigmaswarm.versions import versions

if TYPE_CHECKING:
    import pandas as pd
    from distributed import Client


T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class EvaluationOptions:
    """Options of an evaluation.

    Attributes
    ----------
    against : FilterParameters or path, optional
        Another filter of any model, or its file: a tuning.toml, or an ekf.yaml of robot_localization. Its scores are
        the first row of every table.
    outage_length : float
        Length of the medium outages, s. The short and the long outages last 1 s and 30 s.
    outage_seed : int
        Seed of the outages. All methods have the same outages.
    as_recorded : bool
        Run without preprocessing, for diagnosis: use stale fixes, and treat IMU gaps as ordinary steps.
    smooth : bool
        Also evaluate the smoothed estimates, which use fixes after an outage (see `sigmaswarm.smooth`).
    bank : bool
        Also evaluate a filter bank (see `sigmaswarm.LiveFilterBank`).
    more : mapping of str to callable
        Functions that run further methods, such as a trained network, over a `FilterPass`. Keys are from
        `OPTIONAL_METHODS`.
    fixes_alone : MotionNoise, optional
        Noise parameters of the filter that uses only the fixes, as in ``tuning.fixes_alone``. By default, they are
        fitted to each evaluated drive, so the errors of this filter are too small.
    shown_std : float, optional
        Standard deviation of the fixes for the baseline, m per axis, computed from the truth of the training drives.
    """

    against: FilterParameters | None = None
    outage_length: float = OUTAGE_LENGTH
    outage_seed: int = 0
    as_recorded: bool = False
    smooth: bool = False
    bank: bool = False
    more: RunFactories = field(default_factory=dict[str, Callable[[FilterPass], Run]])
    fixes_alone: MotionNoise | None = None
    shown_std: float | None = None

    def optional_runs(self, parameters: FilterParameters) -> dict[str, Callable[[FilterPass], Run]]:
        runs: dict[str, Callable[[FilterPass], Run]] = {}
        if self.smooth:
            runs[SMOOTHED] = partial(SmootherRun, parameters=parameters, recover=True)
        if self.bank:
            runs[BANK] = partial(BankRun, parameters=parameters, recover=True, as_recorded=self.as_recorded)
        return {**runs, **self.more}


@dataclass(frozen=True, eq=False)
class DriveResult:
    """Results of all methods on a drive.

    ``restarts`` contains times of resets (s) by method, and ``drifts`` contains drift records by measure.
    ``consistency`` and ``innovations`` belong to the tuned filter. ``picture`` contains more points than ``tracks``.
    """

    scores: Mapping[str, Score]
    consistency: Consistency | None = None
    innovations: Innovations | None = None
    tracks: Tracks | None = None
    picture: Picture | None = None
    record: DriveRecord = field(default_factory=lambda: DriveRecord(name=""))
    restarts: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    stale_fixes: int = 0
    drifts: Mapping[str, DriftRecord] = field(default_factory=dict[str, DriftRecord])
    findings: tuple[str, ...] = ()
    truth_offset: str = ""
    radius: Mapping[str, RadiusRecord] = field(default_factory=dict[str, RadiusRecord])

    def called(self, name: str) -> "DriveResult":
        tracks, picture = self.tracks, self.picture
        return replace(
            self,
            record=self.record.model_copy(update={"name": name}),
            tracks=tracks and replace(tracks, name=name),
            picture=picture and replace(picture, whole=replace(picture.whole, name=name)),
        )


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Scores of every method on every drive.

    Attributes
    ----------
    drives : mapping of drive name to DriveResult
    names : mapping of method to str
        Display names.
    outage_length, outage_seed : float, int
        Length of the medium outages, s, and seed of the short (1 s), medium and long (30 s) outages.
    against : FilterParameters or None
        Other filter in the comparison.
    against_source : str
        Path of this filter; "" for parameters from Python.
    parameters : FilterParameters or None
        Evaluated filter.
    fixes_alone : MotionNoise or None
        Noise parameters of the filter that uses only the fixes; None if they were fitted to each drive.
    """

    drives: Mapping[str, DriveResult]
    names: Mapping[str, str] = field(default_factory=method_names)
    outage_length: float = OUTAGE_LENGTH
    outage_seed: int = 0
    against: FilterParameters | None = None
    against_source: str = ""
    parameters: FilterParameters | None = None
    fixes_alone: MotionNoise | None = None
    as_recorded: bool = False

    @property
    def scores(self) -> Mapping[str, Mapping[str, Score]]:
        """Scores by drive name and method."""
        return {name: result.scores for name, result in self.drives.items()}

    @property
    def consistency(self) -> Mapping[str, Consistency | None]:
        """Consistency of the tuned filter, by drive; None if the filter failed or had too few fixes."""
        return {name: result.consistency for name, result in self.drives.items()}

    def mean(self, method: str, measure: str) -> float | None:
        """Return the mean of a measure over the drives; None if there is no value or the method failed.

        ``method`` is a key of scores.json (``untuned``) or a display name (``baseline``).
        """
        method = self._key(method)
        if any(result.scores[method].failed for result in self.drives.values()):
            return None
        known = [v for drive in self.drives if (v := self.value(drive, method, measure)) is not None]
        return float(np.mean(known)) if known else None

    def value(self, drive: str, method: str, measure: str) -> float | None:
        """Return one score, or None if it is unknown. ``method`` is as in `mean`."""
        value = MEASURES[measure].of(self.drives[drive].scores[self._key(method)])
        return float(value) if np.isfinite(value) else None

    def _key(self, method: str) -> str:
        return next((key for key, name in self.names.items() if name == method), method)

    def improvement(self, over: str = BASELINE, measure: str = "position_rmse_m") -> float | None:
        """Return the improvement over a method, %: 100 (method - tuned) / method, from the means (the paper's eq.

        5).
        """
        other, tuned = self.mean(over, measure), self.mean("tuned", measure)
        return None if not other or tuned is None else 100 * (other - tuned) / other

    @property
    def measures(self) -> Mapping[str, Measure]:
        """The `measures`, whose titles contain the outage length of this evaluation."""
        return measures(self.outage_length)

    @property
    def is_worse_than_untuned(self) -> bool:
        """True if the errors of the baseline or of the fixes alone are over 10% smaller than those of the tuned filter.

        The condition must hold for the position RMSE or for more than half of the measures.
        """
        return is_worse_than_untuned(self.record, self.measures)

    @property
    def record(self) -> ScoresRecord:
        """The content of scores.json."""
        drives, rivals = self.drives, [m for m in (AGAINST, BASELINE, FIXES) if m in self.names]
        return ScoresRecord(
            drives={d: {m: {k: self.value(d, m, k) for k in MEASURES} for m in self.names} for d in drives},
            mean={m: {k: self.mean(m, k) for k in MEASURES} for m in self.names},
            consistency=dict(self.consistency),
            restarts={
                name: {m: list(result.restarts[m]) for m in self.names if m in result.restarts}
                for name, result in drives.items()
            },
            improvement_percent={m: {k: self.improvement(m, k) for k in MEASURES} for m in rivals},
            drifts=self._by_drive(lambda result: dict(result.drifts)),
            failed=self._by_drive(lambda result: [m for m, s in result.scores.items() if s.failed]),
            radius=self._by_drive(lambda result: dict(result.radius)),
            stale_fixes=self._by_drive(lambda result: result.stale_fixes),
        )

    def _by_drive(self, of: Callable[[DriveResult], T]) -> dict[str, T]:
        return {name: value for name, result in self.drives.items() if (value := of(result))}

    @property
    def setup(self) -> EvaluationRecord:
        """The content of evaluation.json."""
        other = self.against
        return EvaluationRecord(
            outage_length_s=self.outage_length,
            outage_seed=self.outage_seed,
            versions=versions(),
            data=[result.record for result in self.drives.values()],
            against=None if other is None else AgainstRecord.of(other, self.against_source),
            findings=self._by_drive(lambda result: list(result.findings)),
            truth_offsets=self._by_drive(lambda result: result.truth_offset),
            fixes_alone=self.fixes_alone,
            as_recorded=self.as_recorded,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return scores.json: ``{"drives": {name: {method: {measure: value}}}, "mean": {method: {...}}}``."""
        return self.record.model_dump(mode="json")

    @property
    def view(self) -> EvaluationView:
        """Tables and sentences for the terminal, notebooks and the HTML report."""
        return EvaluationView(self.record, self.setup, self.names)

    def to_frame(self) -> pl.DataFrame:
        """Return one row per drive and method. Methods have their display names."""
        return self._frame(self.names)

    def _frame(self, names: Mapping[str, str]) -> pl.DataFrame:
        rows = [
            {"drive": drive, "method": name, **{k: self.value(drive, m, k) for k in MEASURES}}
            for drive in self.drives
            for m, name in names.items()
        ]
        return pl.DataFrame(rows, schema_overrides=dict.fromkeys(MEASURES, pl.Float64))

    def to_pandas(self) -> "pd.DataFrame":
        """Return the table of `to_frame` as a pandas DataFrame."""
        return notebook.to_pandas(self.to_frame().to_dict(as_series=False))

    def __repr__(self) -> str:
        return self.view.to_text()

    def _repr_html_(self) -> str:
        return self.view.to_html()

    def save(self, folder: str | Path) -> list[Path]:
        """Write scores.json, scores.csv, evaluation.json, tracks.npz and, if known, ``against``. Return the paths."""
        folder = Path(folder)
        paths = [folder / name for name in (SCORES_FILE, "scores.csv", EVALUATION_FILE, TRACKS_FILE)]
        write_json(paths[0], self.to_dict())
        write_atomically(paths[1], self._frame({m: m for m in self.names}).write_csv())
        write_json(paths[2], self.setup.model_dump())
        save_tracks([result.tracks for result in self.drives.values() if result.tracks], paths[3])
        if self.against is not None:
            paths.append(folder / AGAINST_FILE)
            self.against.save(paths[-1])
        return paths


def evaluate(
    drives: Drives,
    parameters: FilterParameters,
    *,
    seen: Sequence[Landmarks] | None = None,
    cluster: "Client | None" = None,
    **options: Any,
) -> Evaluation:
    """Compare a tuned filter with the baseline, raw GPS, fixes alone and IMU only (see `sigmaswarm.evaluate`).

    ``seen`` contains positions and yaw rates of the training drives (see `drives.overlap`), by which these drives,
    their copies and their parts are recognized. ``cluster`` is a Dask cluster whose workers read the drives and run the
    filters; ``drives`` may then be paths or URLs. ``options`` are attributes of `EvaluationOptions`.
    """
    (dataset,) = make_datasets(drives, cluster=cluster)
    if not len(dataset):
        raise InputError("no drives were given; name at least one drive folder")
    if "swarm" in options:
        warn_deprecated("evaluate(swarm=...)", "bank")
        options["bank"] = options.pop("swarm")
    given: FilterParameters | str | Path | None = options.pop("against", None)
    other = None if given is None else filter_for(given, dataset)
    against = None if other is None else AgainstRecord.of(other, given)
    chosen = EvaluationOptions(other, **options)
    one = partial(_evaluated, parameters=parameters, options=chosen, marked=seen is not None)
    results: dict[str, DriveResult] = {}
    for drive, result, marks in dataset.imap(one):
        numbered = (f"{drive} ({i})" for i in range(2, len(results) + 2))  # two drives may have the same name
        name = next(n for n in (drive, *numbered) if n not in results)
        results[name] = result if name == drive else result.called(name)
        if seen is not None and marks is not None and (overlap := known_overlap(marks, seen)) is not None:
            part = {"seen_s": overlap.seconds, "seen_in": list(overlap.of)}
            results[name] = replace(results[name], record=results[name].record.model_copy(update=part))
    also = (*([AGAINST] if other else []), *chosen.optional_runs(parameters))
    names = method_names(parameters.kind, parameters.model, also=also, against=against and against.called)
    return Evaluation(
        results,
        names,
        outage_length=chosen.outage_length,
        outage_seed=chosen.outage_seed,
        against=other,
        against_source=against.source if against else "",
        parameters=parameters,
        fixes_alone=chosen.fixes_alone,
        as_recorded=chosen.as_recorded,
    )


def _evaluated(
    drive: Drive, parameters: FilterParameters, options: EvaluationOptions, marked: bool
) -> tuple[str, DriveResult, Landmarks | None]:
    """Run every method over a drive. Return the drive's name, the results and, if ``marked``, the landmarks."""
    marks = landmarks(drive) if marked else None
    own = {} if options.against is None else {AGAINST: options.against}
    filters = compared(drive, parameters, options.shown_std) | own
    ready = PreparedDrive(drive, as_recorded=options.as_recorded)
    tracker = Tracker(ready, picture=True)
    lengths = dict(zip(DRIFTS, (SHORT_OUTAGE_LENGTH, options.outage_length, LONG_OUTAGE_LENGTH), strict=True))
    outages = {m: OutageDrifts(ready, length=s, seed=options.outage_seed) for m, s in lengths.items()}

    imu_only = run_imu_only(ready)  # runs first, before the filters' targets take memory
    tracker.keep_estimate("imu_only", imu_only)
    for drifts in outages.values():
        drifts.add_estimate("imu_only", imu_only)
    scores = {"imu_only": replace(score_estimate(drive, imu_only), failed=False)}
    del imu_only
    passed, further = _tracked(ready, tracker, filters, options)
    for drifts in outages.values():
        drifts.run(filters, further)

    for method, score in {**scores, **passed.scores}.items():
        drift_scores = {measure.removesuffix("_m"): d.drift(method) for measure, d in outages.items()}
        failed = score.failed or any(method in d.failed for d in outages.values())
        scores[method] = replace(score, **drift_scores, failed=failed)
    scores["raw_gps"] = score_raw_gps(drive, ready.initial)
    tuned, start, end = scores["tuned"], ready.initial.time, float(drive.imu.time[-1])
    consistency = None
    if passed.innovations is not None and not tuned.failed:
        consistency = consistency_of(passed.innovations, tuned.mean_nees, tracker.own_sigma["tuned"])
    radii = {m: stated_radius(drive, parameters, d.stated) for m, d in outages.items()}
    result = replace(
        passed,
        scores={
            method: scores[method]
            for method in (AGAINST, "tuned", *OPTIONAL_METHODS, *METHODS)
            if method in scores
        },
        consistency=consistency,
        tracks=tracker.tracks(drive.name),
        picture=tracker.picture(drive.name),
        record=DriveRecord(
            **drive_record(drive),
            receiver_std_m=rounded(max(receiver_std(drive))),
            scored_from_s=round(start - float(drive.imu.time[0]), 3),
            truth_share=share_known(drive.truth, start, end),
        ),
        stale_fixes=int(ready.stale.sum()),
        drifts={measure: d.record for measure, d in outages.items() if d.seeds},
        findings=finding_sentences(drive),
        truth_offset=truth_offset(drive),
        radius={**passed.radius, **{measure: one for measure, one in radii.items() if one}},
    )
    return drive.name, result, marks


def _tracked(
    ready: PreparedDrive,
    tracker: Tracker,
    filters: Mapping[str, FilterParameters],
    options: EvaluationOptions,
) -> tuple[DriveResult, RunFactories]:
    """Run every method with all fixes. Return the results, and functions that run methods other than single filters.

    This is a separate function, so that its memory is freed before the next pass.
    """
    drive_pass = tracking_pass(ready)
    further = options.optional_runs(filters["tuned"])
    further[FIXES] = partial(FixesAlone, noise=options.fixes_alone or fit_noise(drive_pass))
    recorded = {m: tracker.record(m, drive_pass, p, recover=True) for m, p in filters.items()}
    restarts = {m: tuple(recording.restarts) for m, recording in recorded.items()}
    sums = join_sums([recording.sums for recording in recorded.values()])
    whole = scores_from_sums({"tracking": [drive_pass]}, {"tracking": sums})
    scores = {
        m: replace(whole[i, 0], position_median=score.position_median, position_95=score.position_95)
        for i, (m, score) in enumerate(tracker.scores.items())
    }
    for method, make in further.items():
        run = make(drive_pass)
        tracker.follow(method, run)
        scores[method] = tracker.scores[method]
        if method != FIXES:  # the filter of the fixes alone is never reset
            restarts[method] = tuple(run.restarts)
    radius = stated_radius(ready.drive, filters["tuned"], tracker.stated)
    tracker.stated = NOTHING_STATED  # frees three arrays of the length of truth
    innovations, radii = recorded["tuned"].innovations, {TRACKING: radius} if radius else {}
    return DriveResult(scores, innovations=innovations, restarts=restarts, radius=radii), further
