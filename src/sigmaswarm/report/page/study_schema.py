"""What the files of a study hold, as far as its page shows it."""

from pathlib import Path
from typing import Any

import polars as pl
from pydantic import BaseModel

from sigmaswarm.errors import InputError
from sigmaswarm.records import load_record as load

EVERYWHERE = "all"
"""The maneuver, the environment and the group of rows over all conditions."""
UNTUNED = "untuned"
"""The protocol of methods that nothing is tuned for."""
Interval = tuple[float | None, float | None]
Cell = tuple[str, str]
"""Protocol and method."""


class Summary(BaseModel):
    """A row of ``summary``."""

    protocol: str
    method: str
    measure: str
    maneuver: str
    environment: str
    mean: float | None
    sd: float | None
    trial_interval: Interval | None
    corrected_t_interval: Interval | None
    bootstrap_interval: Interval | None
    n_drives: int


class Comparison(BaseModel):
    """A row of ``comparisons``."""

    protocol: str
    measure: str
    against: str
    holm_p: float | None
    rank_biserial: float | None
    improvement: float | None
    improvement_interval: Interval | None
    n_drives: int


class Tuned(BaseModel):
    """A row of ``tunings``."""

    protocol: str
    method: str
    group: str
    trial: int
    cost: float
    parameters: dict[str, Any]
    touched_bounds: list[str]
    evaluations: int
    failures: int


class Bands(BaseModel):
    """A row of ``convergence``."""

    protocol: str
    method: str
    group: str
    low: list[float | None]
    median: list[float | None]
    high: list[float | None]
    stable: int


class TuningConfig(BaseModel):
    """config.json of one of the tunings."""

    versions: dict[str, str]


class Drives(BaseModel):
    """The table ``drives``."""

    count: int
    strata: int


class Timings(BaseModel):
    """timings.json: ms of the live filters' calls."""

    live_filter: dict[str, dict[str, float]]


class StudyFile(BaseModel):
    """results.json."""

    config: dict[str, Any]
    drives: Drives
    protocols: dict[str, dict[str, str]]
    methods: dict[str, str]
    measures: dict[str, str]
    summary: list[Summary]
    comparisons: list[Comparison]
    tunings: list[Tuned]
    convergence: list[Bands]
    paper: dict[str, Any]

    def label(self, method: str, protocol: str = UNTUNED) -> str:
        """What people call a method, and under which protocol it was tuned."""
        name = self.methods.get(method, method)
        return name if protocol == UNTUNED else f"{name} ({protocol})"

    def means(self, measure: str) -> list[Summary]:
        """Of every method under every protocol, over all conditions."""
        wanted = (measure, EVERYWHERE, EVERYWHERE)
        return [r for r in self.summary if (r.measure, r.maneuver, r.environment) == wanted]

    def mean(self, cell: Cell, measure: str) -> Summary | None:
        """One of `means`; None where there is none."""
        return next((r for r in self.means(measure) if (r.protocol, r.method) == cell), None)


class Spread(BaseModel):
    """One value a drive, the mean over the trials that held it back: quantiles over drives.

    Drives that the method failed on are counted and left out.
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


QUANTILES = {"low": 0.05, "first": 0.25, "median": 0.5, "third": 0.75, "high": 0.95}


def read_spreads(folder: Path) -> list[Spread]:
    """The spread of every method's measures over the drives, from scores.csv.

    Raises
    ------
    InputError
        If the file can't be read.
    """
    path, keys = folder / "scores.csv", ["protocol", "method", "measure"]
    value = pl.col("value").filter(pl.col("value").is_finite())
    try:
        scores = pl.scan_csv(path, schema_overrides={"value": pl.Float64()})
        drives = scores.group_by([*keys, "drive"], maintain_order=True).agg(pl.col("value").mean())
        found = drives.group_by(keys, maintain_order=True).agg(
            *[value.quantile(q, "linear").alias(name) for name, q in QUANTILES.items()],
            (~pl.col("value").is_finite()).sum().alias("failed"),
        )
        return [Spread(**row) for row in found.drop_nulls().collect().to_dicts()]
    except (pl.exceptions.PolarsError, OSError):
        raise InputError(f"{path}: not readable; repeat `sigmaswarm study` with --resume") from None


def read_timings(folder: Path) -> dict[str, dict[str, float]]:
    """By filter; nothing where they were not taken."""
    path = folder / "timings.json"
    return load(Timings, path).live_filter if path.exists() else {}
