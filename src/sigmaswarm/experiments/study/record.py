"""The files of a study: results.json, scores.csv, timings.json and tracks.npz.

results.json contains (unknown numbers are null):

    schema         1
    config         study.toml
    drives         count, strata (number of conditions), fingerprint
    protocols      {name: {objective, scale}}; methods without tuning have the protocol "untuned"
    methods        {name: label}
    measures       {name: meaning and unit}
    summary        `VariantSummary` of every variant and measure, for all conditions together and for each condition
    comparisons    `PairedComparison` of pso-ukf with every other method, by protocol
    tunings        `TrialTuning` of every tuning run and trial
    convergence    `Convergence` of every tuned variant and group
    paper          the paper's results
    rivals         `RivalResults`, only in a study with rivals
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import polars as pl
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer

from sigmaswarm.errors import InputError
from sigmaswarm.experiments.study.config import ALL, NO_PROTOCOL, PROTOCOL_LABELS, Protocol, StudyConfig
from sigmaswarm.files import nan_to_none, write_json
from sigmaswarm.record_files import load_record
from sigmaswarm.scoring.tracks import Tracks, load_tracks
from sigmaswarm.tuning.bounds import TouchedBound

Variant = tuple[str, str]  # protocol, method


OptionalFloat = Annotated[float | None, BeforeValidator(nan_to_none)]
"""A number, or None in place of NaN and infinity, which JSON does not have."""
Interval = tuple[OptionalFloat, OptionalFloat]
Touched = Annotated[TouchedBound, BeforeValidator(TouchedBound.read), PlainSerializer(str)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, populate_by_name=True)


class DriveCount(_Part):
    """Number of drives, number of conditions, and a hash of all data."""

    count: int
    strata: int
    fingerprint: str


class VariantSummary(_Part):
    """Mean and intervals of a measure in one condition or over all conditions.

    Attributes
    ----------
    mean, sd : mean and standard deviation over trials; the value of a trial is the mean over its test drives
    trial_interval : mean +- 1.96 SD / sqrt(n); accounts for optimizer and split, not for new drives
    corrected_t_interval : interval for new drives, by the corrected resampled t-test
    bootstrap_interval : interval for new drives, by a bootstrap over trials, and over drives within conditions
    n_trials, n_drives : numbers of trials and drives that have values
    """

    protocol: str
    method: str
    measure: str
    maneuver: str
    environment: str
    mean: OptionalFloat
    sd: OptionalFloat
    trial_interval: Interval
    corrected_t_interval: Interval
    bootstrap_interval: Interval
    n_trials: int
    n_drives: int


class PairedComparison(_Part):
    """Comparison of two methods on the same drives. The value for a drive is the mean over its trials.

    Attributes
    ----------
    mean_difference, interval : method minus other (negative is better), with the bootstrap interval over drives
    p : p-value of Wilcoxon's two-sided signed-rank test
    rank_biserial : effect size from -1 (``method`` worse on every drive) to 1 (better): see `statistics.rank_biserial`
    improvement, improvement_interval : %, the paper's equation 5
    holm_p : p, corrected over all comparisons of a protocol and measure
    """

    protocol: str
    measure: str
    method: str
    against: str
    mean_difference: OptionalFloat
    interval: Interval
    p: float
    rank_biserial: float
    improvement: OptionalFloat
    improvement_interval: Interval
    n_drives: int
    holm_p: float


class TrialTuning(_Part):
    """Tuning in one trial. ``folder`` is relative to the study's folder."""

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

    ``stable`` is the generation from which the median stays within 1% of the last median.
    """

    protocol: str
    method: str
    group: str
    low: list[OptionalFloat]
    median: list[OptionalFloat]
    high: list[OptionalFloat]
    stable: int


class Effort(_Part):
    """Data and free parameters of a tuned or trained method, as means over trials.

    - ``labelled_s``: driving time (s) of the training drives of the filter, which have truth.
    - ``learned_s``: driving time (s) on which the network is trained without truth.
    - ``numbers``: number of parameters that tuning and training determine.
    """

    protocol: str
    method: str
    labelled_s: float
    learned_s: OptionalFloat
    numbers: float


class ElsewhereSummary(VariantSummary):
    """Statistics of a measure on drives with other sensors or another car."""

    place: str


class CurvePoint(_Part):
    """Score of a network on the first trial's test drives, after training on ``minutes`` of data.

    ``minutes`` is 0 for the filter without a network. ``interval`` is the bootstrap interval of the mean over drives.
    """

    method: str
    minutes: float
    measure: str
    mean: OptionalFloat
    interval: Interval
    n_drives: int


class RivalResults(_Part):
    """Additional results of a study with rivals.

    ``gains`` compares each network with the same filter without a network. In these comparisons, ``holm_p`` equals
    ``p``.
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

    def label(self, method: str, protocol: str = NO_PROTOCOL) -> str:
        name = self.methods.get(method, method)
        return name if protocol == NO_PROTOCOL else f"{name} ({PROTOCOL_LABELS.get(protocol, protocol)})"

    def means(self, measure: str) -> list[VariantSummary]:
        wanted = (measure, ALL, ALL)
        return [row for row in self.summaries if (row.measure, row.maneuver, row.environment) == wanted]

    def summary(self, protocol: str, method: str, measure: str) -> VariantSummary | None:
        summaries = (row for row in self.means(measure) if (row.protocol, row.method) == (protocol, method))
        return next(summaries, None)

    def content(self) -> dict[str, Any]:
        left_out = {"rivals"} if self.rivals is None else None
        return self.model_dump(mode="json", by_alias=True, exclude=left_out)

    def write(self, folder: Path) -> None:
        write_json(folder / "results.json", self.content(), indent=1)


QUANTILES = {"low": 0.05, "first": 0.25, "median": 0.5, "third": 0.75, "high": 0.95}


class ScoreQuantiles(_Part):
    """Quantiles of the scores over the drives. The score of a drive is the mean over its trials.

    ``failed`` is the number of drives on which the filter failed.
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


def quantiles_of(scores: pl.DataFrame | pl.LazyFrame) -> list[ScoreQuantiles]:
    keys = ["protocol", "method", "measure"]
    value = pl.col("value").filter(pl.col("value").is_finite())
    drives = scores.lazy().group_by([*keys, "drive"], maintain_order=True).agg(pl.col("value").mean())
    quantiles = drives.group_by(keys, maintain_order=True).agg(
        *[value.quantile(q, "linear").alias(name) for name, q in QUANTILES.items()],
        (~pl.col("value").is_finite()).sum().alias("failed"),
    )
    return [ScoreQuantiles(**row) for row in quantiles.drop_nulls().collect().to_dicts()]


def read_quantiles(folder: Path) -> list[ScoreQuantiles]:
    path = folder / "scores.csv"
    try:
        return quantiles_of(pl.scan_csv(path, glob=False, schema_overrides={"value": pl.Float64()}))
    except (pl.exceptions.PolarsError, OSError):
        raise InputError(f"{path}: not readable; repeat `sigmaswarm study` with --resume") from None


Times = dict[str, dict[str, float]]


class _Timings(BaseModel):
    live_filter: Times = {}
    rivals: Times = {}


class _TuningConfig(BaseModel):
    versions: dict[str, str]


@dataclass(frozen=True, eq=False)
class StudyRecord:
    """Content of the folder of a study.

    ``quantiles`` are from scores.csv, ``versions`` from the tunings. ``live`` contains medians and ranges of the
    processing time (ms) of live filters per IMU sample, without and with a fix. ``rival_times`` contains training time
    of a trial (s) and processing time of an IMU sample (us) of each variant.
    """

    results: Results
    quantiles: list[ScoreQuantiles]
    live: Times
    rival_times: Times
    tracks: list[Tracks]
    versions: Mapping[str, str]

    @classmethod
    def read(cls, folder: Path) -> "StudyRecord":
        timings, tracks = folder / "timings.json", folder / "tracks.npz"
        times = load_record(_Timings, timings) if timings.exists() else _Timings()
        configs = sorted(folder.glob("trials/*/config.json"))
        return cls(
            load_record(Results, folder / "results.json"),
            read_quantiles(folder),
            times.live_filter,
            times.rivals,
            load_tracks(tracks) if tracks.exists() else [],
            load_record(_TuningConfig, configs[0]).versions if configs else {},
        )
