"""What a tuning is worth: the same drives by the tuned filter, the manual ones, raw GPS and IMU only."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Drive, listed
from sigmaswarm.errors import InputError
from sigmaswarm.filters.dead_reckoning import run_imu_only
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.presets import DEFAULTS, datasheet
from sigmaswarm.filters.run import Estimate
from sigmaswarm.scoring.batch import Replayer
from sigmaswarm.scoring.consistency import Consistency, consistency
from sigmaswarm.scoring.score import Score, score_estimate, score_raw_gps
from sigmaswarm.scoring.targets import OUTAGE_LENGTH, outage_windows

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


MEASURES: dict[str, Callable[[Score], float]] = {
    "position_rmse_m": lambda s: s.position_rmse,
    "heading_rmse_deg": lambda s: float(np.degrees(s.heading_rmse)),
    "outage_drift_m": lambda s: s.outage_drift,
}
"""What is compared, in the units in which people read it."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Scores of every method on every drive.

    Attributes
    ----------
    scores : mapping of drive name to mapping of method to Score
    consistency : mapping of drive name to Consistency or None
        Of the tuned filter; None where it failed or saw too few fixes.
    names : mapping of method to str
        What people call the methods.
    """

    scores: Mapping[str, Mapping[str, Score]]
    consistency: Mapping[str, Consistency | None] = field(default_factory=dict[str, Consistency | None])
    names: Mapping[str, str] = field(default_factory=method_names)

    def mean(self, method: str, measure: str) -> float | None:
        """The mean of a measure over the drives that have it; None where none has, or the method failed."""
        values = [self.value(drive, method, measure) for drive in self.scores]
        if any(self.scores[drive][method].failed for drive in self.scores):
            return None
        known = [v for v in values if v is not None]
        return float(np.mean(known)) if known else None

    def value(self, drive: str, method: str, measure: str) -> float | None:
        """One figure, None where it can't be said."""
        value = MEASURES[measure](self.scores[drive][method])
        return float(value) if np.isfinite(value) else None

    def improvement(self, over: str = "defaults", measure: str = "position_rmse_m") -> float | None:
        """The paper's equation 5: (manual - tuned) / manual x 100, in percent, of the means over drives."""
        manual, tuned = self.mean(over, measure), self.mean("tuned", measure)
        return None if not manual or tuned is None else 100 * (manual - tuned) / manual

    def to_dict(self) -> dict[str, Any]:
        """For machines: ``{"drives": {name: {method: {measure: value}}}, "mean": {method: {...}}}``."""
        return {
            "drives": {
                drive: {m: {k: self.value(drive, m, k) for k in MEASURES} for m in METHODS}
                for drive in self.scores
            },
            "mean": {m: {k: self.mean(m, k) for k in MEASURES} for m in METHODS},
            "consistency": {name: c.to_dict() if c else None for name, c in self.consistency.items()},
            "improvement_percent": {
                over: {k: self.improvement(over, k) for k in MEASURES} for over in ("defaults", "datasheet")
            },
        }

    def to_frame(self) -> pl.DataFrame:
        """One row per drive and method."""
        rows = [
            {"drive": drive, "method": m, **{k: self.value(drive, m, k) for k in MEASURES}}
            for drive in self.scores
            for m in METHODS
        ]
        return pl.DataFrame(rows, schema_overrides=dict.fromkeys(MEASURES, pl.Float64))


def evaluate(
    parameters: FilterParameters,
    drives: Sequence[Drive] | Drive,
    *,
    outage_length: float = OUTAGE_LENGTH,
    outage_seed: int = 0,
) -> Evaluation:
    """Compare tuned parameters with the manual ones, raw GPS and IMU only.

    Parameters
    ----------
    parameters : FilterParameters
        The tuned ones.
    drives : Drive or sequence of Drive
        Best those that the tuning never saw. Without truth only the outage drift can be said, against the
        hidden fixes.
    outage_length : float
        s without fixes.
    outage_seed : int
        Places the outages: the same for every method.

    Raises
    ------
    AlignmentError
        If a drive never moves far enough to start a filter.
    """
    drives = listed(drives)
    if not drives:
        raise InputError("no drives were given; name at least one drive folder")
    scores: dict[str, dict[str, Score]] = {}
    consistent: dict[str, Consistency | None] = {}
    for drive in drives:
        replayer = Replayer([drive], outages=True, outage_length=outage_length, outage_seed=outage_seed)
        batch = replayer.scores([parameters, DEFAULTS, datasheet(drive)])
        initial = replayer.initial[0]
        name = _unique(drive.name, scores)
        consistent[name] = (
            None if batch.failed[0, 0] else consistency(drive, parameters, batch[0, 0].mean_nees)
        )
        scores[name] = {
            "tuned": batch[0, 0],
            "defaults": batch[1, 0],
            "datasheet": batch[2, 0],
            "raw_gps": score_raw_gps(drive, initial),
            "imu_only": score_imu_only(drive, initial, outage_length, outage_seed),
        }
    return Evaluation(scores, consistent, method_names(parameters.kind, parameters.model))


def score_imu_only(drive: Drive, initial: InitialState, length: float, seed: int) -> Score:
    """Dead reckoning from the common start: errors against truth, and the drift at the ends of the outages."""
    estimate = run_imu_only(drive, initial=initial)
    score = score_estimate(drive, estimate)
    ends = outage_windows(drive, initial, length=length, seed=seed)[:, 1]
    return Score(score.position_rmse, score.heading_rmse, _drift(drive, estimate, ends))


def _drift(drive: Drive, estimate: Estimate, ends: np.ndarray) -> float:
    """RMS position error at the windows' ends; dead reckoning needs no run of its own for that."""
    if not len(ends):
        return float("nan")
    reference = drive.gps if drive.truth is None else drive.truth
    errors = [
        np.interp(ends, estimate.time, estimate.mean[:, i]) - np.interp(ends, reference.time, column)
        for i, column in enumerate((reference.x, reference.y))
    ]
    return float(np.sqrt(np.mean(np.square(errors).sum(axis=0))))


def _unique(name: str, taken: Mapping[str, Any]) -> str:
    """Two drives of one name must not hide each other."""
    numbered = (f"{name} ({i})" for i in range(2, len(taken) + 2))
    return name if name not in taken else next(n for n in numbered if n not in taken)
