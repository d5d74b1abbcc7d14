"""What a tuning is worth: the same drives by the tuned filter, the manual ones, raw GPS and IMU only."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.drives.drive import Drive, listed
from sigmaswarm.drives.fingerprint import DriveRecord, described
from sigmaswarm.drives.overlap import Landmarks, Overlap, landmarks, overlap_of
from sigmaswarm.drives.prepared import PreparedDrive, prepared
from sigmaswarm.errors import InputError
from sigmaswarm.files import write_json, write_whole
from sigmaswarm.filters.dead_reckoning import run_imu_only
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.recording import Recording
from sigmaswarm.filters.replay import joined
from sigmaswarm.filters.run import Estimate, Innovations
from sigmaswarm.scoring.batch import scores_of
from sigmaswarm.scoring.consistency import Consistency, consistency_of
from sigmaswarm.scoring.records import (
    ASKED_FILE,
    SCORES_FILE,
    ConsistencyRecord,
    EvaluationRecord,
    ScoresRecord,
)
from sigmaswarm.scoring.score import Score, score_estimate, score_raw_gps
from sigmaswarm.scoring.targets import (
    LONG_OUTAGE_LENGTH,
    OUTAGE_LENGTH,
    drift_reference,
    outage_replay,
    outage_windows,
    tracking_replay,
)
from sigmaswarm.scoring.tracks import TRACKS_FILE, Picture, Tracker, Tracks, compared, save_tracks
from sigmaswarm.versions import versions

METHODS = {
    "tuned": "tuned filter",
    "defaults": "manual: defaults",
    "datasheet": "manual: data sheet",
    "raw_gps": "raw GPS",
    "imu_only": "IMU only",
}
"""The rows of every comparison: what files and what people call them."""

KIND_NAMES = {
    "ukf": "UKF",
    "ekf": "EKF",
    "adaptive-ukf": "adaptive UKF",
    "strong-tracking-ukf": "strong tracking UKF",
}
"""What people call the kinds of filters."""


def method_names(kind: str = "ukf", model: str = "planar5") -> dict[str, str]:
    """`METHODS`, the tuned filter called after its kind, and after its model where that is not the paper's."""
    suffix = "" if model == "planar5" else f", {model}"
    return METHODS | {"tuned": f"tuned {KIND_NAMES.get(kind, kind)}{suffix}"}


@dataclass(frozen=True)
class Measure:
    """Something that is compared: what people call it, its unit, and how it is taken from a score."""

    title: str
    unit: str
    of: Callable[[Score], float]

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title}, {self.unit}"


def measures(outage_length: float = OUTAGE_LENGTH) -> dict[str, Measure]:
    """What is compared, in the units in which people read it; ``outage_length``, s, is that of the shorter outages."""
    return {
        "position_rmse_m": Measure("position RMSE", "m", lambda s: s.position_rmse),
        "position_median_m": Measure("position 50%", "m", lambda s: s.position_median),
        "position_95_m": Measure("position 95%", "m", lambda s: s.position_95),
        "heading_rmse_deg": Measure("heading error", "deg", lambda s: float(np.degrees(s.heading_rmse))),
        "outage_drift_m": Measure(f"{outage_length:g} s outage drift", "m", lambda s: s.outage_drift),
        "long_outage_drift_m": Measure(
            f"{LONG_OUTAGE_LENGTH:g} s outage drift", "m", lambda s: s.long_outage_drift
        ),
    }


MEASURES = measures()
POSITION_MEASURES = {"position_rmse_m": "RMSE", "position_median_m": "50%", "position_95_m": "95%"}
"""Those in which a filter is held against the raw fixes, and what a sentence calls them."""


def restarted(scores: ScoresRecord) -> tuple[str, ...]:
    """A sentence for each drive on which the tuned filter lost its way."""
    said: list[str] = []
    for drive, found in scores.restarts.items():
        if times := found.get("tuned"):
            at = ", ".join(f"{t:.1f}" for t in times[:5]) + (" ..." if len(times) > 5 else "")
            often = f"{len(times)} times" if len(times) > 1 else "once"
            said.append(f"on {drive} the tuned filter lost its way and started anew {often}, at t = {at} s")
    return tuple(said)


def said_of_drives(data: Sequence[DriveRecord]) -> str:
    """What a sentence calls drives: how many they are, and how much of them the tuning saw."""
    called = f"{len(data)} drive{'s' if len(data) != 1 else ''}"
    if any(drive.seen_s is None for drive in data):
        return called
    if not any(drive.seen_s for drive in data):
        return f"{called} that the tuning never saw"
    told = [
        f"the tuning saw {drive.seen_s:.0f} of the {drive.duration_s or 0:.0f} s of {drive.name}, in "
        f"{', '.join(drive.seen_in)}"
        for drive in data
        if drive.seen_s
    ]
    return f"{called} (NOT {'all ' if len(data) > 1 else ''}held out: {'; '.join(told)})"


def worse_than_raw(scores: ScoresRecord) -> tuple[str, ...]:
    """A sentence for each drive on which the tuned filter's position is worse than the fixes that it was given."""
    said: list[str] = []
    for drive, found in scores.drives.items():
        pairs = {
            what: (found["tuned"].get(measure), found["raw_gps"].get(measure))
            for measure, what in POSITION_MEASURES.items()
        }
        worse = [
            f"{what} {tuned:.3g} m against {raw:.3g} m"
            for what, (tuned, raw) in pairs.items()
            if tuned is not None and raw is not None and tuned > raw
        ]
        if worse:
            said.append(f"on {drive} the tuned filter is WORSE than the raw fixes: {', '.join(worse)}")
    return tuple(said)


@dataclass(frozen=True, eq=False)
class Evaluated:
    """What running every method once over a drive leaves.

    Attributes
    ----------
    scores : mapping of method to Score
    consistency : Consistency or None
        Of the tuned filter; None where it failed or saw too few fixes.
    innovations : Innovations or None
        Of the tuned filter.
    tracks : Tracks or None
        As tracks.npz keeps them.
    picture : Picture or None
        The same, fine enough for paper.
    data : mapping
        What identifies the drive.
    restarts : mapping of method to tuple of float
        s: when a filter was lost and started anew, see `filters.recovery`.
    frozen : int
        Fixes that repeat an earlier one although the car may have moved: no filter took them for positions.
    seen : Overlap or None
        How much of it the filter was tuned on; None where nobody said what that was.
    """

    scores: Mapping[str, Score]
    consistency: Consistency | None = None
    innovations: Innovations | None = None
    tracks: Tracks | None = None
    picture: Picture | None = None
    data: Mapping[str, Any] = field(default_factory=dict[str, Any])
    restarts: Mapping[str, tuple[float, ...]] = field(default_factory=dict[str, tuple[float, ...]])
    frozen: int = 0
    seen: Overlap | None = None

    @property
    def record(self) -> DriveRecord:
        """The drive as files and sentences name it."""
        of = {} if self.seen is None else {"seen_s": self.seen.seconds, "seen_in": list(self.seen.of)}
        return DriveRecord.model_validate({**self.data, **of})


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of every method on every drive.

    Attributes
    ----------
    drives : mapping of drive name to Evaluated
    names : mapping of method to str
        What people call the methods.
    outage_length, outage_seed : float, int
        s without fixes, beside windows of 30 s, and what placed the outages.
    """

    drives: Mapping[str, Evaluated]
    names: Mapping[str, str] = field(default_factory=method_names)
    outage_length: float = OUTAGE_LENGTH
    outage_seed: int = 0

    @property
    def scores(self) -> Mapping[str, Mapping[str, Score]]:
        """Mapping of drive name to mapping of method to Score."""
        return {name: found.scores for name, found in self.drives.items()}

    @property
    def consistency(self) -> Mapping[str, Consistency | None]:
        """Of the tuned filter, by drive; None where it failed or saw too few fixes."""
        return {name: found.consistency for name, found in self.drives.items()}

    def mean(self, method: str, measure: str) -> float | None:
        """The mean of a measure over the drives that have it; None where none has, or the method failed."""
        if any(found.scores[method].failed for found in self.drives.values()):
            return None
        known = [v for drive in self.drives if (v := self.value(drive, method, measure)) is not None]
        return float(np.mean(known)) if known else None

    def value(self, drive: str, method: str, measure: str) -> float | None:
        """One figure, None where it can't be said."""
        value = MEASURES[measure].of(self.drives[drive].scores[method])
        return float(value) if np.isfinite(value) else None

    def improvement(self, over: str = "defaults", measure: str = "position_rmse_m") -> float | None:
        """The paper's equation 5: (manual - tuned) / manual x 100, in percent, of the means over drives."""
        manual, tuned = self.mean(over, measure), self.mean("tuned", measure)
        return None if not manual or tuned is None else 100 * (manual - tuned) / manual

    @property
    def measures(self) -> Mapping[str, Measure]:
        """`MEASURES`, called after the length of this evaluation's outages."""
        return measures(self.outage_length)

    @property
    def restarted(self) -> tuple[str, ...]:
        """See the function of that name."""
        return restarted(self.record)

    @property
    def worse_than_raw(self) -> tuple[str, ...]:
        """See the function of that name."""
        return worse_than_raw(self.record)

    @property
    def record(self) -> ScoresRecord:
        """As scores.json holds it."""
        told = {name: c and ConsistencyRecord.of(c) for name, c in self.consistency.items()}
        return ScoresRecord(
            drives={
                drive: {m: {k: self.value(drive, m, k) for k in MEASURES} for m in METHODS}
                for drive in self.drives
            },
            mean={m: {k: self.mean(m, k) for k in MEASURES} for m in METHODS},
            consistency=told,
            restarts={
                drive: {m: list(found.restarts.get(m, ())) for m in METHODS if m in found.restarts}
                for drive, found in self.drives.items()
            },
            improvement_percent={
                over: {k: self.improvement(over, k) for k in MEASURES} for over in ("defaults", "datasheet")
            },
        )

    def to_dict(self) -> dict[str, Any]:
        """For machines: ``{"drives": {name: {method: {measure: value}}}, "mean": {method: {...}}}``."""
        return self.record.model_dump(mode="json")

    def to_frame(self) -> pl.DataFrame:
        """One row per drive and method."""
        rows = [
            {"drive": drive, "method": m, **{k: self.value(drive, m, k) for k in MEASURES}}
            for drive in self.drives
            for m in METHODS
        ]
        return pl.DataFrame(rows, schema_overrides=dict.fromkeys(MEASURES, pl.Float64))

    def save(self, folder: Path) -> list[Path]:
        """Write scores.json, scores.csv, evaluation.json and tracks.npz; their paths."""
        paths = [folder / name for name in (SCORES_FILE, "scores.csv", ASKED_FILE, TRACKS_FILE)]
        write_json(paths[0], self.to_dict())
        write_whole(paths[1], self.to_frame().write_csv())
        write_json(paths[2], self.asked.model_dump())
        save_tracks([found.tracks for found in self.drives.values() if found.tracks], paths[3])
        return paths

    @property
    def asked(self) -> EvaluationRecord:
        """As evaluation.json holds it."""
        return EvaluationRecord(
            outage_length_s=self.outage_length,
            outage_seed=self.outage_seed,
            versions=versions(),
            data=[found.record.model_copy(update={"name": name}) for name, found in self.drives.items()],
        )


def evaluate(
    drives: Sequence[Drive] | Drive,
    parameters: FilterParameters,
    *,
    outage_length: float = OUTAGE_LENGTH,
    outage_seed: int = 0,
    as_recorded: bool = False,
    seen: Sequence[Landmarks] | None = None,
) -> Evaluation:
    """Compare tuned parameters with the manual ones, raw GPS and IMU only.

    Parameters
    ----------
    drives : Drive or sequence of Drive
        Best those that the tuning never saw. Without truth only the outage drift can be said, against the
        hidden fixes.
    parameters : FilterParameters
        The tuned ones.
    outage_length : float
        s without fixes; outages of 30 s are tried beside those.
    outage_seed : int
        Places the outages: the same for every method.
    as_recorded : bool
        Absorb frozen fixes, and cross gaps in the IMU as if they were steps like others: for diagnosis.
    seen : sequence of Landmarks, optional
        What the tuning saw: ``tuning.seen``, or `tuning.record.seen_by` its file. The evaluation then says how much
        of each drive that is, whatever it is called, and however it was cut or mended.

    Raises
    ------
    InputError
        If there are no drives, or the two arguments are in the order of version 0.1.
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    if isinstance(drives, FilterParameters):
        raise InputError("evaluate takes the drives first: evaluate(drives, parameters)")
    drives = listed(drives)
    if not drives:
        raise InputError("no drives were given; name at least one drive folder")
    found: dict[str, Evaluated] = {}
    for drive in drives:
        name = _unique(drive.name, found)
        ready = prepared(drive, as_recorded=as_recorded)
        known = None if seen is None else overlap_of(landmarks(drive), seen)
        each = _evaluated(ready, parameters, name, outage_length, outage_seed)
        found[name] = replace(each, seen=known)
    names = method_names(parameters.kind, parameters.model)
    return Evaluation(found, names, outage_length, outage_seed)


def _evaluated(
    ready: PreparedDrive, tuned: FilterParameters, name: str, length: float, seed: int
) -> Evaluated:
    """Every method once over the whole drive, and the filters once more with the outages."""
    drive = ready.drive
    filters = compared(drive, tuned)
    tracker = Tracker(ready, picture=True)
    imu_only = run_imu_only(ready)  # first: it is held whole, and the filters' targets are not yet there
    tracker.keep_estimate("imu_only", imu_only)
    dead_reckoning = score_imu_only(ready, imu_only, length, seed)
    del imu_only
    tracking = tracking_replay(ready)
    # Manual filters go on as they are: what is wrong by hundreds of metres for hours would be set right at each sample.
    recorded = [tracker.record(m, tracking, p, recover=m == "tuned") for m, p in filters.items()]
    innovations = recorded[list(filters).index("tuned")].innovations
    restarts = {m: tuple(recording.restarts) for m, recording in zip(filters, recorded, strict=True)}
    sums = joined([recording.sums for recording in recorded], axis=1)
    whole = scores_of({"tracking": [tracking]}, {"tracking": sums})
    del recorded, tracking  # the next pass has steps and targets of its own
    drifts = [_drifts(ready, filters, each, seed) for each in (length, LONG_OUTAGE_LENGTH)]
    each = {
        method: _joined(whole[i, 0], drifts[0][i], drifts[1][i], tracker.quantiles[method])
        for i, method in enumerate(filters)
    }
    others = {"raw_gps": score_raw_gps(drive, ready.initial), "imu_only": dead_reckoning}
    failed, nees = each["tuned"].failed, each["tuned"].mean_nees
    return Evaluated(
        scores={method: (each | others)[method] for method in METHODS},
        consistency=None if failed else consistency_of(innovations, nees),
        innovations=innovations,
        tracks=tracker.tracks(name),
        picture=tracker.picture(name),
        data=described(drive),
        restarts=restarts,
        frozen=int(ready.frozen.sum()),
    )


def _drifts(
    ready: PreparedDrive, filters: Mapping[str, FilterParameters], length: float, seed: int
) -> list[Score]:
    """What outages of a length (s) make of filters; nothing is known where none fits. No steps are kept."""
    if not len(outage_windows(ready.drive, ready.initial, length=length, seed=seed)):
        return [Score()] * len(filters)
    ready.forget()
    outages = outage_replay(ready, length=length, seed=seed)
    recordings = [Recording(outages, p, recover=m == "tuned") for m, p in filters.items()]
    sums = joined([recording.finished().sums for recording in recordings], axis=1)
    scores = scores_of({"outages": [outages]}, {"outages": sums})
    ready.forget()
    return [scores[i, 0] for i in range(len(filters))]


def _joined(whole: Score, outages: Score, long_outages: Score, quantiles: tuple[float, float]) -> Score:
    """One score of a filter's passes."""
    return replace(
        whole,
        position_median=quantiles[0],
        position_95=quantiles[1],
        outage_drift=outages.outage_drift,
        long_outage_drift=long_outages.outage_drift,
        failed=whole.failed or outages.failed or long_outages.failed,
    )


def score_imu_only(ready: PreparedDrive, estimate: Estimate, length: float, seed: int) -> Score:
    """Dead reckoning from the common start: errors against truth, and the drift at the ends of the outages."""
    drift, long_drift = (
        _drift(ready, estimate, outage_windows(ready.drive, estimate.initial, length=each, seed=seed)[:, 1])
        for each in (length, LONG_OUTAGE_LENGTH)
    )
    score = score_estimate(ready.drive, estimate)
    return replace(score, outage_drift=drift, long_outage_drift=long_drift, failed=False)


def _drift(ready: PreparedDrive, estimate: Estimate, ends: np.ndarray) -> float:
    """RMS position error at the windows' ends; dead reckoning needs no run of its own for that."""
    if not len(ends):
        return float("nan")
    reference = drift_reference(ready)
    errors = [
        np.interp(ends, estimate.time, estimate.mean[:, i]) - np.interp(ends, reference.time, column)
        for i, column in enumerate((reference.x, reference.y))
    ]
    return float(np.sqrt(np.mean(np.square(errors).sum(axis=0))))


def _unique(name: str, taken: Mapping[str, Any]) -> str:
    """Two drives of one name must not hide each other."""
    numbered = (f"{name} ({i})" for i in range(2, len(taken) + 2))
    return name if name not in taken else next(n for n in numbered if n not in taken)
