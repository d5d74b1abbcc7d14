"""Records of an evaluation: scores.json and evaluation.json."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Self

from pydantic import BaseModel, Field

from sigmaswarm.drives.fingerprint import DriveRecord
from sigmaswarm.errors import InputError
from sigmaswarm.files import write_json
from sigmaswarm.filters.fixes_alone import MotionNoise
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.record_files import load_record
from sigmaswarm.scoring.consistency import Consistency, RadiusRecord
from sigmaswarm.scoring.methods import filter_called
from sigmaswarm.wording import count_of, printable

SCORES_FILE, EVALUATION_FILE, AGAINST_FILE = "scores.json", "evaluation.json", "against.toml"
Measured = dict[str, float | None]
MIN_OUTAGES = 4  # fewest outages in a placement; with fewer, all placements hide nearly the same fixes


class DriftRecord(BaseModel):
    """Drifts in outages of one length. ``outages`` is the number of outages in all placements together."""

    outages: int
    each: dict[str, list[float | None]]

    def drift_range(self, method: str) -> tuple[float, float] | None:
        """Return the lowest and the highest drift over the placements of the outages, m."""
        known = [v for v in self.each.get(method, []) if v is not None]
        return (min(known), max(known)) if known else None


class ScoresRecord(BaseModel):
    """scores.json: scores by drive, method and measure."""

    drives: dict[str, dict[str, Measured]] = Field(min_length=1)
    mean: dict[str, Measured]
    consistency: dict[str, Consistency | None] = Field(default_factory=dict)
    improvement_percent: dict[str, Measured] = Field(default_factory=dict)
    restarts: dict[str, dict[str, list[float]]] = Field(default_factory=dict)
    """Times of resets after divergence (s) by drive and method."""
    drifts: dict[str, dict[str, DriftRecord]] = Field(default_factory=dict)  # by drive and measure
    failed: dict[str, list[str]] = Field(default_factory=dict)  # methods by drive
    radius: dict[str, dict[str, RadiusRecord]] = Field(default_factory=dict)
    """Radii by drive for all fixes (``tracking``) and, by drift measure, at the ends of outages."""
    stale_fixes: dict[str, int] = Field(default_factory=dict)

    def describe_drift(self, measure: str) -> str:
        """Describe the outages, and the range of the tuned filter's drift over their placements; "" if unknown."""
        drifts = [by_measure[measure] for by_measure in self.drifts.values() if measure in by_measure]
        drawn = [one.each.get("tuned", []) for one in drifts]
        count = min(map(len, drawn), default=0)
        if not count or any(drift is None for one in drawn for drift in one):
            return ""
        means = [sum(one[i] or 0.0 for one in drawn) / len(drawn) for i in range(count)]
        outages = sum(one.outages for one in drifts)
        short = "one short stretch" if len(drifts) == 1 else "one short stretch of each drive"
        few = f". All outages are on {short}; the drift on another stretch may be far larger"
        few *= outages < MIN_OUTAGES * count
        single = f"for a single placement it is {min(means):.3g} to {max(means):.3g} m"
        placements = count_of(count, "random placement")
        return f"The drift is the RMS error over {outages} outages in {placements}; {single}{few}"

    def mean_of(self, method: str, measure: str) -> float | None:
        return self.mean.get(method, {}).get(measure)

    def known(self, methods: Iterable[str], measures: Iterable[str]) -> tuple[list[str], list[str]]:
        """Return the methods (raw GPS only if it has values), and the measures with values (all if none has values)."""
        methods, measures = [*methods], [*measures]
        known = [m for m in measures if any(self.mean_of(method, m) is not None for method in methods)]
        raw = any(self.mean_of("raw_gps", m) is not None for m in known)
        return [m for m in methods if m != "raw_gps" or raw], known or measures


EVALUATION = "evaluation"  # kind of result, in the record of its folder


class AgainstRecord(BaseModel):  # another filter in the comparison
    kind: str
    model: str
    source: str = ""  # path of the filter; empty for parameters from Python

    @classmethod
    def of(cls, other: FilterParameters, given: FilterParameters | str | Path | None) -> Self:
        """Record a filter. ``given`` is its path or its parameters."""
        source = "" if given is None or isinstance(given, FilterParameters) else str(given)
        return cls(kind=other.kind, model=other.model, source=source)

    @property
    def called(self) -> str:
        called = filter_called(self.kind, self.model)
        return f"{called} ({printable(self.source)})" if self.source else called


class EvaluationRecord(BaseModel):
    """evaluation.json: the options and the drives. The parameters of ``against`` are in against.toml."""

    outage_length_s: float
    outage_seed: int
    versions: dict[str, str]
    data: list[DriveRecord]
    against: AgainstRecord | None = None
    findings: dict[str, list[str]] = Field(default_factory=dict)
    """Serious findings and warnings of the doctor by drive; empty in files of versions before 0.4.0."""
    truth_offsets: dict[str, str] = Field(default_factory=dict)
    """Sentence on a constant offset between fixes and truth, by drive."""
    fixes_alone: MotionNoise | None = None
    """Noise parameters from the tuning; None if they were fitted to each drive."""
    as_recorded: bool = False
    files: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the files by name; empty in files of versions before 0.4.0."""


_CHECKED_FILES = (SCORES_FILE, "tracks.npz", "tuning.toml", AGAINST_FILE)


def write_checksums(folder: Path) -> None:
    record = load_record(EvaluationRecord, folder / EVALUATION_FILE)
    checksums = {name: _sha256(folder / name) for name in _CHECKED_FILES if (folder / name).exists()}
    write_json(folder / EVALUATION_FILE, record.model_copy(update={"files": checksums}).model_dump())


def verify_checksums(folder: Path, record: EvaluationRecord) -> None:
    """Raise `InputError` if a file differs from its SHA-256 in evaluation.json."""
    for name, expected in record.files.items():
        if name not in _CHECKED_FILES or not (folder / name).is_file() or _sha256(folder / name) != expected:
            raise InputError(
                f"{folder / name}: does not belong to {EVALUATION_FILE} next to it; repeat `sigmaswarm evaluate`, or "
                "restore the original file"
            )


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
