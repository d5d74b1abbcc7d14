"""What an evaluation leaves in scores.json and evaluation.json."""

import math

from pydantic import BaseModel, Field

from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.scoring.consistency import Consistency, Summary

SCORES_FILE, ASKED_FILE = "scores.json", "evaluation.json"

Measured = dict[str, float | None]
"""By measure; None where it can't be said."""


class ConsistencyRecord(BaseModel):
    """What scores.json says of the tuned filter's covariances on a drive."""

    n_fixes: int
    mean_nis: float
    nis_band_95: tuple[float, float]
    share_inside_95_gate: float
    autocorrelation: list[float] = Field(min_length=1)
    autocorrelation_band_95: float = math.nan
    white_p: float
    mean_nees: float | None = None

    @classmethod
    def of(cls, found: Consistency) -> "ConsistencyRecord":
        """The same in plain types."""
        return cls(
            n_fixes=found.n_fixes,
            mean_nis=found.mean_nis,
            nis_band_95=found.nis_band,
            share_inside_95_gate=found.inside_gate,
            autocorrelation=found.autocorrelation.tolist(),
            autocorrelation_band_95=found.white_band,
            white_p=found.white_p,
            mean_nees=None if math.isnan(found.mean_nees) else found.mean_nees,
        )

    @property
    def summary(self) -> Summary:
        """What `verdicts` looks at."""
        return self.mean_nis, self.nis_band_95, self.mean_nees


class ScoresRecord(BaseModel):
    """scores.json: drive, method, measure; means over the drives; consistency; what the tuning improved."""

    drives: dict[str, dict[str, Measured]] = Field(min_length=1)
    mean: dict[str, Measured]
    consistency: dict[str, ConsistencyRecord | None] = Field(default_factory=dict)
    improvement_percent: dict[str, Measured] = Field(default_factory=dict)
    restarts: dict[str, dict[str, list[float]]] = Field(default_factory=dict)
    """By drive and method, s: when a filter was lost and started anew."""

    def mean_of(self, method: str, measure: str) -> float | None:
        """Over the drives that have it; None where it can't be said."""
        return self.mean.get(method, {}).get(measure)


class EvaluationRecord(BaseModel):
    """evaluation.json: what was asked, of which drives."""

    outage_length_s: float
    outage_seed: int
    versions: dict[str, str]
    data: list[DriveRecord]
