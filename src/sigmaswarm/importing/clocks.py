"""Times inside the importer: whole nanoseconds of a log's own clock."""

import numpy as np
import polars as pl
from numpy.typing import NDArray

from sigmaswarm.importing.expressions import Expression, compile_expression, integer_scale, terms_of

Nanoseconds = NDArray[np.int64]

SECOND = 1_000_000_000
"""ns."""

LONG_AGO = 1_000_000 * SECOND
"""Clocks beyond this (12 days) count from 1970 or a phone's start: a drive then counts from its own beginning."""

_COUNTED = {"ms": 1000, "us": 1_000_000, "ns": SECOND}
"""A date's units in a second."""


def _whole(count: pl.Expr, factor: int) -> pl.Expr:
    """A count (64 bits) times a factor; null where that leaves 64 bits, instead of some other time."""
    most = (2**63 - 1) // max(factor, 1)
    return pl.when(count.is_between(-most, most)).then(count * factor)


def time_expression(text: str, frame: pl.DataFrame) -> pl.Expr:
    """The expression of a time (s) as whole nanoseconds; integer columns keep all their digits, also in a sum."""
    terms = terms_of(text)
    exact = [term for text in terms if (term := _term(text, frame)) is not None]
    if len(exact) == len(terms):
        return pl.sum_horizontal(exact, ignore_nulls=False) if len(exact) > 1 else exact[0]
    return _rounded(compile_expression(text, frame.columns))


def _rounded(expression: Expression) -> pl.Expr:
    return (expression.polars * float(SECOND)).round().cast(pl.Int64, strict=False)


def _term(text: str, frame: pl.DataFrame) -> pl.Expr | None:
    """One ``column * number`` in ns, where its column holds whole numbers or dates; else None."""
    scaled = integer_scale(text, frame.columns)
    if scaled is None:
        return None
    name, factor = scaled
    kind = frame.schema[name]
    if isinstance(kind, pl.Datetime) and factor == 1:
        return _whole(pl.col(name).dt.timestamp(kind.time_unit), SECOND // _COUNTED[kind.time_unit])
    whole = round(factor * SECOND)
    if abs(whole - factor * SECOND) >= 1e-9 * whole or whole > SECOND:
        return None
    if kind.is_integer():
        return _whole(pl.col(name).cast(pl.Int64, strict=False), whole)
    if kind == pl.String:  # padded or quoted cells
        exact = _whole(pl.col(name).str.strip_chars().cast(pl.Int64, strict=False), whole)
        return pl.coalesce(exact, _rounded(compile_expression(text, frame.columns)))
    return None
