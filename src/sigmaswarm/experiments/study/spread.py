"""The spread of scores over drives: quantiles of every variant's measures."""

from pathlib import Path

import polars as pl
from pydantic import BaseModel, ConfigDict

from sigmaswarm.errors import InputError

QUANTILES = {"low": 0.05, "first": 0.25, "median": 0.5, "third": 0.75, "high": 0.95}


class Spread(BaseModel):
    """One value a drive, the mean over the trials that held it back: quantiles over drives.

    Drives that the method failed on are counted and left out.
    """

    model_config = ConfigDict(frozen=True)

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
    """The spread of every variant's measures over the drives, of the long table of scores."""
    keys = ["protocol", "method", "measure"]
    value = pl.col("value").filter(pl.col("value").is_finite())
    drives = scores.lazy().group_by([*keys, "drive"], maintain_order=True).agg(pl.col("value").mean())
    found = drives.group_by(keys, maintain_order=True).agg(
        *[value.quantile(q, "linear").alias(name) for name, q in QUANTILES.items()],
        (~pl.col("value").is_finite()).sum().alias("failed"),
    )
    return [Spread(**row) for row in found.drop_nulls().collect().to_dicts()]


def read_spreads(folder: Path) -> list[Spread]:
    """The same from scores.csv.

    Raises
    ------
    InputError
        If the file can't be read.
    """
    path = folder / "scores.csv"
    try:
        return spreads_of(pl.scan_csv(path, glob=False, schema_overrides={"value": pl.Float64()}))
    except (pl.exceptions.PolarsError, OSError):
        raise InputError(f"{path}: not readable; repeat `sigmaswarm study` with --resume") from None
