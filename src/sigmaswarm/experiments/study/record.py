"""The files of a study: results.json, scores.csv, timings.json and tracks.npz.

results.json contains (null where a figure is unknown):

    schema         1
    config         study.toml
    drives         count, strata (number of conditions), fingerprint
    protocols      {name: {objective, scale}}; methods without tuning have the protocol "untuned"
    methods        {name: label}
    measures       {name: meaning and unit}
    summary        `VariantSummary` of every variant and measure, over all conditions and in each
    comparisons    `PairedComparison`: pso-ukf under each protocol against every other method
    tunings        `TrialTuning`, one a trial
    convergence    `Convergence` of every tuned variant and group
    paper          the paper's figures
    rivals         `RivalResults`, of a study with rivals alone
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import polars as pl
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer

from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.config import ALL, UNTUNED, Protocol, StudyConfig
from sigmaswarm.files import write_json
from sigmaswarm.records import load_record
from sigmaswarm.scoring.tracks import Tracks, load_tracks
from sigmaswarm.tuning.box import TouchedBound

Variant = tuple[str, str]
"""Protocol and method."""


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


Figure = Annotated[float | None, BeforeValidator(_finite)]
"""A number; None in place of NaN and infinity, which JSON lacks."""
Interval = tuple[Figure, Figure]
Touched = Annotated[TouchedBound, BeforeValidator(TouchedBound.read), PlainSerializer(str)]
"""A touched bound; in the file it is a sentence."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, populate_by_name=True)


class DriveCount(_Part):
    """Number of drives and of conditions, and a hash of all numbers."""

    count: int
    strata: int
    fingerprint: str


class ScoreStatistics(_Part):
    """Mean and intervals of a measure.

    Attributes
    ----------
    mean, sd : over trials, of the mean over each trial's test drives
    trial_interval : mean +- 1.96 SD / sqrt(n): the uncertainty from optimizer and split, not for new drives
    corrected_t_interval : for new drives, corrected resampled t
    bootstrap_interval : for new drives; drives, within conditions, and trials are resampled
    n_trials, n_drives : number of each behind the figures
    """

    mean: Figure
    sd: Figure
    trial_interval: Interval
    corrected_t_interval: Interval
    bootstrap_interval: Interval
    n_trials: int
    n_drives: int


class _Scored(_Part):
    protocol: str
    method: str
    measure: str
    maneuver: str
    environment: str


class VariantSummary(ScoreStatistics, _Scored):
    """The statistics of a variant's measure, in one condition or over all of them."""


class PairedStatistics(_Part):
    """Two methods on the same drives, with one value per drive: the mean over the trials that tested on it.

    Attributes
    ----------
    mean_difference, interval : method less other (negative: better), with its bootstrap interval over drives
    p : of Wilcoxon's signed-rank test, two-sided
    rank_biserial : effect size, -1 to 1: share of the rank sum in favor minus the share against
    improvement, improvement_interval : percent, the paper's equation 5
    n_drives : int
    """

    mean_difference: Figure
    interval: Interval
    p: float
    rank_biserial: float
    improvement: Figure
    improvement_interval: Interval
    n_drives: int


class _Compared(_Part):
    protocol: str
    measure: str
    method: str
    against: str


class PairedComparison(PairedStatistics, _Compared):
    """The statistics of a method against another; ``holm_p`` is corrected over those of a protocol and measure."""

    holm_p: float


class TrialTuning(_Part):
    """A tuning in a trial; ``folder``, relative to the study's, contains result.json and history.npz."""

    protocol: str
    method: str
    group: str
    trial: int
    cost: float
    parameters: dict[str, Any]
    touched_bounds: list[Touched]
    evaluations: int
    failures: int
    folder: str


class Convergence(_Part):
    """Quantiles (10%, 50%, 90%) over trials of the best cost after each generation.

    ``stable``: the generation after which the median stays within 1% of its last value.
    """

    protocol: str
    method: str
    group: str
    low: list[Figure]
    median: list[Figure]
    high: list[Figure]
    stable: int


class Effort(_Part):
    """The data and the free numbers of a tuned or trained method; means over trials.

    Attributes
    ----------
    labelled_s : s of driving with truth: all training drives, which its filter was tuned on
    learned_s : s of driving, without truth, that its network learned from
    numbers : how many numbers tuning and training set
    """

    protocol: str
    method: str
    labelled_s: float
    learned_s: Figure
    numbers: float


class ElsewhereSummary(VariantSummary):
    """The statistics of a variant's measure on drives of another sensor grade or another car."""

    place: str


class CurvePoint(_Part):
    """A network trained on some minutes (0: the filter alone), scored on the first trial's test drives.

    ``interval`` of the mean is by bootstrap over drives.
    """

    method: str
    minutes: float
    measure: str
    mean: Figure
    interval: Interval
    n_drives: int


class RivalResults(_Part):
    """Additional results of a study with rivals.

    ``gains``: each network against the filter that it helps; ``holm_p`` is of each test alone.
    """

    efforts: list[Effort]
    gains: list[PairedComparison]
    elsewhere: list[ElsewhereSummary]
    curve: list[CurvePoint]


class Results(_Part):
    """results.json."""

    schema_version: int = Field(default=1, alias="schema")
    config: StudyConfig
    drives: DriveCount
    protocols: dict[str, Protocol]
    methods: dict[str, str]
    measures: dict[str, str]
    summaries: list[VariantSummary] = Field(alias="summary")
    comparisons: list[PairedComparison]
    tunings: list[TrialTuning]
    convergence: list[Convergence]
    paper: dict[str, Any]
    rivals: RivalResults | None = None

    def label(self, method: str, protocol: str = UNTUNED) -> str:
        """Return the label of a method, with its protocol if it is tuned."""
        name = self.methods.get(method, method)
        return name if protocol == UNTUNED else f"{name} ({protocol})"

    def means(self, measure: str) -> list[VariantSummary]:
        """Return the summaries of every variant over all conditions."""
        wanted = (measure, ALL, ALL)
        return [row for row in self.summaries if (row.measure, row.maneuver, row.environment) == wanted]

    def summary(self, protocol: str, method: str, measure: str) -> VariantSummary | None:
        """Return one of `means`, if it exists."""
        found = (row for row in self.means(measure) if (row.protocol, row.method) == (protocol, method))
        return next(found, None)

    def content(self) -> dict[str, Any]:
        """Return the content of results.json in plain types."""
        left_out = {"rivals"} if self.rivals is None else None
        return self.model_dump(mode="json", by_alias=True, exclude=left_out)

    def write(self, folder: Path) -> None:
        """Write results.json."""
        write_json(folder / "results.json", self.content(), indent=1)


QUANTILES = {"low": 0.05, "first": 0.25, "median": 0.5, "third": 0.75, "high": 0.95}


class Spread(_Part):
    """Quantiles over drives of one value per drive, the mean over its trials.

    Failed drives are counted and left out.
    """

    protocol: str
    method: str
    measure: str
    low: float
    first: float
    median: float
    third: float
    high: float
    failed: int


def spreads_of(scores: pl.DataFrame | pl.LazyFrame) -> list[Spread]:
    """Compute the spread of every variant's measures from the table of scores."""
    keys = ["protocol", "method", "measure"]
    value = pl.col("value").filter(pl.col("value").is_finite())
    drives = scores.lazy().group_by([*keys, "drive"], maintain_order=True).agg(pl.col("value").mean())
    found = drives.group_by(keys, maintain_order=True).agg(
        *[value.quantile(q, "linear").alias(name) for name, q in QUANTILES.items()],
        (~pl.col("value").is_finite()).sum().alias("failed"),
    )
    return [Spread(**row) for row in found.drop_nulls().collect().to_dicts()]


def read_spreads(folder: Path) -> list[Spread]:
    """Compute the spread from scores.csv."""
    path = folder / "scores.csv"
    try:
        return spreads_of(pl.scan_csv(path, glob=False, schema_overrides={"value": pl.Float64()}))
    except (pl.exceptions.PolarsError, OSError):
        raise InputError(f"{path}: not readable; repeat `sigmaswarm study` with --resume") from None


Times = Mapping[str, Mapping[str, float]]


class _Timings(BaseModel):
    live_filter: dict[str, dict[str, float]] = Field(default_factory=dict[str, dict[str, float]])
    rivals: dict[str, dict[str, float]] = Field(default_factory=dict[str, dict[str, float]])


class _TuningConfig(BaseModel):
    versions: dict[str, str]


@dataclass(frozen=True, eq=False)
class StudyRecord:
    """Everything in the folder of a study.

    Attributes
    ----------
    results : Results
        results.json.
    spreads : list of Spread
        Of scores.csv.
    live : mapping of filter to mapping
        predict_ms and predict_and_update_ms of live filters, and their ranges, of timings.json.
    rival_times : mapping of variant to mapping
        Of timings.json: training_s (processor time of a trial) and sample_us (of an IMU sample).
    tracks : list of Tracks
        tracks.npz.
    versions : mapping of str to str
        Of the software, as its tunings state them.
    """

    results: Results
    spreads: list[Spread]
    live: Times = field(default_factory=dict[str, dict[str, float]])
    rival_times: Times = field(default_factory=dict[str, dict[str, float]])
    tracks: list[Tracks] = field(default_factory=list[Tracks])
    versions: Mapping[str, str] = field(default_factory=dict[str, str])

    @classmethod
    def read(cls, folder: Path) -> "StudyRecord":
        """Read the folder of a study."""
        timings, tracks = folder / "timings.json", folder / "tracks.npz"
        times = load_record(_Timings, timings) if timings.exists() else _Timings()
        configs = sorted(folder.glob("trials/*/config.json"))
        return cls(
            load_record(Results, folder / "results.json"),
            read_spreads(folder),
            times.live_filter,
            times.rivals,
            load_tracks(tracks) if tracks.exists() else [],
            load_record(_TuningConfig, configs[0]).versions if configs else {},
        )
