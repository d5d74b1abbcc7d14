"""The records of an evaluation: scores.json and evaluation.json."""

import hashlib
import math
from collections.abc import Iterable
from pathlib import Path

from pydantic import BaseModel, Field

from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.errors import InputError
from sigmaswarm.files import write_json
from sigmaswarm.records import load_record
from sigmaswarm.scoring.consistency import Consistency, Summary

SCORES_FILE, ASKED_FILE, AGAINST_FILE = "scores.json", "evaluation.json", "against.toml"

Measured = dict[str, float | None]
"""By measure; None where it is not known."""


class ConsistencyRecord(BaseModel):
    """Consistency of the tuned filter on a drive."""

    n_fixes: int
    mean_nis: float
    nis_band_95: tuple[float, float]
    share_inside_95_gate: float
    autocorrelation: list[float] = Field(min_length=1)
    autocorrelation_band_95: float = math.nan
    white_p: float
    mean_nees: float | None = None
    missed_m: float | None = None
    expected_m: float | None = None
    own_sigma_m: float | None = None

    @classmethod
    def of(cls, found: Consistency) -> "ConsistencyRecord":
        """Convert to plain types."""
        return cls(
            n_fixes=found.n_fixes,
            mean_nis=found.mean_nis,
            nis_band_95=found.nis_band,
            share_inside_95_gate=found.inside_gate,
            autocorrelation=found.autocorrelation.tolist(),
            autocorrelation_band_95=found.white_band,
            white_p=found.white_p,
            mean_nees=None if math.isnan(found.mean_nees) else found.mean_nees,
            missed_m=found.missed,
            expected_m=found.expected,
            own_sigma_m=None if math.isnan(found.own_sigma) else found.own_sigma,
        )

    @property
    def summary(self) -> Summary:
        """The figures that `verdicts` reads."""
        return self.mean_nis, self.nis_band_95, self.mean_nees, self.autocorrelation[0]


FEW = 4
"""Outages of one placement: with fewer, all placements hide much the same fixes."""


class DriftRecord(BaseModel):
    """Drifts over outages of one length on a drive, for each random placement of the outages.

    ``each``: by method, m, RMS over the outages of each placement; None where a filter failed.
    """

    outages: int
    each: dict[str, list[float | None]]

    def spread(self, method: str) -> tuple[float, float] | None:
        """Return the lowest and the highest drift of a single placement, m."""
        known = [v for v in self.each.get(method, []) if v is not None]
        return (min(known), max(known)) if known else None


class ScoresRecord(BaseModel):
    """scores.json: by drive, method and measure; means over the drives; consistency; improvement by the tuning."""

    drives: dict[str, dict[str, Measured]] = Field(min_length=1)
    mean: dict[str, Measured]
    consistency: dict[str, ConsistencyRecord | None] = Field(default_factory=dict)
    improvement_percent: dict[str, Measured] = Field(default_factory=dict)
    restarts: dict[str, dict[str, list[float]]] = Field(default_factory=dict)
    """By drive and method, s: resets after divergence."""
    drifts: dict[str, dict[str, DriftRecord]] = Field(default_factory=dict)
    """By drive and measure."""
    failed: dict[str, list[str]] = Field(default_factory=dict)
    """By drive: methods that failed."""
    stale_fixes: dict[str, int] = Field(default_factory=dict)
    """By drive: fixes that repeat an earlier one although the vehicle may have moved; filters do not use them."""

    def drift_said(self, measure: str, method: str = "tuned") -> str:
        """Describe the number of outages behind a drift, and the range of drifts of a single placement.

        Empty if unknown, or where the method failed in any placement: the others have other outages.
        """
        found = [of[measure] for of in self.drifts.values() if measure in of]
        drawn = [one.each.get(method, []) for one in found]
        each = [[v for v in one if v is not None] for one in drawn]
        count = min(map(len, each), default=0) if each == drawn else 0
        if not count:
            return ""
        means = [sum(one[i] for one in each) / len(each) for i in range(count)]
        outages = sum(one.outages for one in found)
        said = f"{outages} outages in {count} placements"
        said += f"; a single placement gives {min(means):.3g} to {max(means):.3g} m"
        few = (
            ", all on the same short stretch: another one may give far more" if outages < FEW * count else ""
        )
        return said + few

    def mean_of(self, method: str, measure: str) -> float | None:
        """Return the mean over the drives that have it, or None."""
        return self.mean.get(method, {}).get(measure)

    def known(self, methods: Iterable[str], measures: Iterable[str]) -> tuple[list[str], list[str]]:
        """Return the methods and measures that have any value: without truth no errors and no raw GPS."""
        methods, measures = [*methods], [*measures]
        known = [
            m for m in measures if any(self.mean_of(method, m) is not None for method in methods)
        ] or measures
        return [
            m for m in methods if m != "raw_gps" or any(self.mean_of(m, k) is not None for k in known)
        ], known


class AgainstRecord(BaseModel):
    """Name of the other filter that was compared."""

    kind: str
    model: str


class EvaluationRecord(BaseModel):
    """evaluation.json: the options and the drives.

    ``against``: the other filter that was compared, if any; its parameters are in against.toml.
    """

    outage_length_s: float
    outage_seed: int
    versions: dict[str, str]
    data: list[DriveRecord]
    against: AgainstRecord | None = None
    files: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files that belong to the evaluation, by name; empty before 0.4.0."""


_SEALED = (SCORES_FILE, "tracks.npz", "tuning.toml", AGAINST_FILE)


def seal(folder: Path) -> None:
    """Write into evaluation.json which files belong to the evaluation."""
    record = load_record(EvaluationRecord, folder / ASKED_FILE)
    found = {name: _sha256(folder / name) for name in _SEALED if (folder / name).exists()}
    write_json(folder / ASKED_FILE, record.model_copy(update={"files": found}).model_dump())


def require_sealed(folder: Path, record: EvaluationRecord) -> None:
    """Raise `InputError` if a file of the folder is not the one that was written with its evaluation.json."""
    for name, expected in record.files.items():
        if name not in _SEALED or not (folder / name).is_file() or _sha256(folder / name) != expected:
            raise InputError(
                f"{folder / name}: does not belong to {ASKED_FILE} next to it; repeat `sigmaswarm evaluate`, or take "
                "the file from where it came"
            )


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
