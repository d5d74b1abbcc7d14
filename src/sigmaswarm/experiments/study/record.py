"""The record of a study: results.json, with what it says in words, numbers and files.

It holds (null where a figure can't be said):

    schema         1
    config         what study.toml says
    drives         count, strata (number of conditions), fingerprint
    protocols      {name: {objective, scale}}; methods that nothing is tuned for have the protocol "untuned"
    methods        {name: what people call it}
    measures       {name: what it is, with its unit}
    summary        `VariantSummary` of every variant and measure, over all conditions and in each
    comparisons    `PairedComparison`: pso-ukf under each protocol against every other method
    tunings        `TrialTuning`, one a trial
    convergence    `Convergence` of every tuned variant and group
    paper          the paper's figures, as `paper.py` has them
    rivals         `RivalResults`, of a study with rivals alone
"""

import math
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer

from sigmaswarm.experiments.study.config import ALL, UNTUNED, Protocol, StudyConfig
from sigmaswarm.files import write_json
from sigmaswarm.tuning.box import TouchedBound

Variant = tuple[str, str]
"""Protocol and method."""


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


Figure = Annotated[float | None, BeforeValidator(_finite)]
"""A number; None where it can't be said, as JSON has neither NaN nor infinity."""
Interval = tuple[Figure, Figure]
Touched = Annotated[TouchedBound, BeforeValidator(TouchedBound.read), PlainSerializer(str)]
"""A touched bound, which a file holds as a sentence."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, populate_by_name=True)


class DriveCount(_Part):
    """The drives: how many, of how many conditions, and a hash of all their numbers."""

    count: int
    strata: int
    fingerprint: str


class ScoreStatistics(_Part):
    """Mean and intervals of a measure.

    Attributes
    ----------
    mean, sd : over trials, of the mean over each trial's held-out drives
    trial_interval : mean +- 1.96 SD / sqrt(n): what optimizer and split leave open, not what a new drive would bring
    corrected_t_interval : corrected resampled t: for drives that were never seen
    bootstrap_interval : for drives that were never seen, too: drives, within conditions, and trials resampled
    n_trials, n_drives : how many of each the figures rest on
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
    """Two methods on the same drives, one value a drive: the mean over the trials that held it back.

    Attributes
    ----------
    mean_difference : of the method less the other, negative where the method is better
    interval : of it, by bootstrap over drives
    p : of Wilcoxon's signed-rank test, two-sided
    rank_biserial : share of the rank sum that says better less that which says worse, -1 to 1: the effect's size
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
    """One tuning of one trial; ``folder``, relative to the study's, has its result.json and history.npz."""

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

    ``stable``: the generation from which on the median is within 1% of its last value.
    """

    protocol: str
    method: str
    group: str
    low: list[Figure]
    median: list[Figure]
    high: list[Figure]
    stable: int


class Effort(_Part):
    """What a tuned or trained method took; means over trials.

    Attributes
    ----------
    labelled_s : s of driving whose truth was looked at: all training drives, by the tuning of its filter
    learned_s : s of driving that its network learned from, without truth; None where there is no network
    numbers : how many were set by tuning and training
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
    """A network that learned from so many minutes, on the drives that the first trial held back; 0: the filter alone.

    ``interval`` of the mean is by bootstrap over drives.
    """

    method: str
    minutes: float
    measure: str
    mean: Figure
    interval: Interval
    n_drives: int


class RivalResults(_Part):
    """What a study with rivals says beside.

    ``gains``: each network against the filter that it stands beside; ``holm_p`` is of each alone.
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
        """What people call a method, and under which protocol it was tuned."""
        name = self.methods.get(method, method)
        return name if protocol == UNTUNED else f"{name} ({protocol})"

    def means(self, measure: str) -> list[VariantSummary]:
        """The summaries of every variant over all conditions."""
        wanted = (measure, ALL, ALL)
        return [row for row in self.summaries if (row.measure, row.maneuver, row.environment) == wanted]

    def summary(self, protocol: str, method: str, measure: str) -> VariantSummary | None:
        """One of `means`; None where there is none."""
        found = (row for row in self.means(measure) if (row.protocol, row.method) == (protocol, method))
        return next(found, None)

    def content(self) -> dict[str, Any]:
        """The content of results.json, in plain types."""
        left_out = {"rivals"} if self.rivals is None else None
        return self.model_dump(mode="json", by_alias=True, exclude=left_out)

    def write(self, folder: Path) -> None:
        """Write results.json."""
        write_json(folder / "results.json", self.content(), indent=1)
