"""What a study's results.json holds, as far as its page shows it."""

from typing import Any

from pydantic import BaseModel

EVERYWHERE = "all"
"""The maneuver, the environment and the group of rows over all conditions."""
Interval = tuple[float | None, float | None]
UNKNOWN: Interval = (None, None)


class Summary(BaseModel):
    """A row of ``summary``."""

    protocol: str
    method: str
    measure: str
    maneuver: str
    environment: str
    mean: float | None
    sd: float | None
    drive_interval: Interval | None
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
    cost: float | None
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


class TuningConfig(BaseModel):
    """config.json of one of the tunings."""

    versions: dict[str, str]


class Drives(BaseModel):
    """The table ``drives``."""

    count: int
    strata: int


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

    def label(self, method: str) -> str:
        """What people call a method."""
        return self.methods.get(method, method)

    def means(self, measure: str) -> list[Summary]:
        """Of every method under every protocol, over all conditions."""
        wanted = (measure, EVERYWHERE, EVERYWHERE)
        return [r for r in self.summary if (r.measure, r.maneuver, r.environment) == wanted]
