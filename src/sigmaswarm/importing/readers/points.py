"""Positions in well-known text, POINT (8.0 50.0), as PostGIS and GeoPandas write them to a column of a table."""

import re

import numpy as np
import polars as pl

from sigmaswarm.importing.guess import TRUTH
from sigmaswarm.importing.names import read_name

_NUMBER = r"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)"
_BEGIN = r"(?i)^\s*(?:SRID=\d+;)?\s*POINT\s*(?:Z|M|ZM)?\s*"
_POINT = rf"{_BEGIN}\(\s*{_NUMBER}\s+{_NUMBER}[^()]*\)\s*$"
_NO_POINT = rf"{_BEGIN}(?:EMPTY|\(\s*nan\s+nan[^()]*\))\s*$|^\s*$"  # the cell of a row without a fix
_WORDS = re.compile(r"_?(?:geom(?:etry)?|points?|wkt|position|location)$", re.IGNORECASE)
_DEGREES = 180.0, 90.0  # largest longitude and latitude
# Points are in degrees if their median step is below _STEP, and the range of a coordinate is below _RANGE times its
# size. Coordinates of a site in m have larger steps or begin near zero.
_STEP, _RANGE = 0.01, 0.1


def with_points(rows: pl.LazyFrame) -> pl.LazyFrame:
    """Replace each column of points by two columns of numbers: longitude and latitude, or x and y in m.

    A new name is the old name with the axis in place of a word for points: gt_geom becomes gt_x and gt_y. The names are
    the axes alone if the table has only one column of points, this column is not truth, and the new names would have
    no meaning.
    """
    schema = rows.collect_schema()
    texts = [name for name, kind in schema.items() if kind == pl.String]
    cells = [pl.col(text).filter(~pl.col(text).str.contains(_NO_POINT)).first() for text in texts]
    first = rows.select(cells).collect().row(0) if texts else ()
    points = [name for name, cell in zip(texts, first, strict=True) if cell and _is_point(cell)]
    for name in points:
        numbers = [pl.col(name).str.extract(_POINT, k).cast(pl.Float64, strict=False) for k in (1, 2)]
        places = rows.select(n.alias(axis) for n, axis in zip(numbers, "xy", strict=True)).collect()
        axes = ("lon", "lat") if _in_degrees(places) else ("x", "y")
        begin = _WORDS.sub("", name)
        names = [f"{begin}_{axis}".lstrip("_") for axis in axes]
        plain = (
            len(points) == 1 and not TRUTH.search(name) and all(read_name(n).meaning is None for n in names)
        )
        names = [*axes] if plain else names
        names = names if schema.keys().isdisjoint(names) else [f"{name}_{axis}" for axis in axes]
        new = [number.alias(n) for number, n in zip(numbers, names, strict=True)]
        rows = rows.with_columns(new).drop(name)
    return rows


def _is_point(cell: str) -> bool:
    return bool(pl.Series([cell]).str.contains(_POINT)[0])


def _in_degrees(places: pl.DataFrame) -> bool:
    values = places.drop_nulls().to_numpy()
    size = np.max(np.abs(values), axis=0)
    if (size > _DEGREES).any():
        return False
    steps = np.abs(np.diff(values, axis=0))
    usual = [np.median(step[step > 0]) if step.any() else 0.0 for step in steps.T]
    return max(usual) < _STEP and bool((np.ptp(values, axis=0) < _RANGE * size).any())
