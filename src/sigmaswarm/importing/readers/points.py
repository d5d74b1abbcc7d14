"""Positions in well-known text, POINT (8.0 50.0), as PostGIS and GeoPandas write them to a column of a table."""

import polars as pl

from sigmaswarm.importing.names import read_name

_NUMBER = r"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)"
_POINT = rf"(?i)^\s*(?:SRID=\d+;)?\s*POINT\s*(?:Z|M|ZM)?\s*\(\s*{_NUMBER}\s+{_NUMBER}[^()]*\)\s*$"
_PLACES = (("x", 1), ("y", 2))  # coordinates and their numbers in a point
_DEGREES = 180.0, 90.0  # largest longitude and latitude


def with_points(rows: pl.LazyFrame) -> pl.LazyFrame:
    """Replace each column of points by two columns of numbers: longitude and latitude, or x and y in m.

    The names of the new columns begin with that of the column, unless this is the only column of points and these names
    would have no meaning.
    """
    schema = rows.collect_schema()
    texts = [name for name, kind in schema.items() if kind == pl.String]
    cells = rows.select(pl.col(texts).drop_nulls().first()).collect().row(0) if texts else ()
    points = [name for name, cell in zip(texts, cells, strict=True) if cell and _numbers(cell)]
    for name in points:
        number = {i: pl.col(name).str.extract(_POINT, k).cast(pl.Float64, strict=False) for i, k in _PLACES}
        largest = rows.select(n.abs().max().alias(i) for i, n in number.items()).collect().row(0)
        in_degrees = all((size or 0.0) <= most for size, most in zip(largest, _DEGREES, strict=True))
        axes = ("lon", "lat") if in_degrees else ("x", "y")
        names = [f"{name}_{axis}" for axis in axes]
        plain = len(points) == 1 and all(read_name(n).meaning is None for n in names)
        names = [*axes] if plain and schema.keys().isdisjoint(axes) else names
        rows = rows.with_columns(n.alias(new) for n, new in zip(number.values(), names, strict=True)).drop(
            name
        )
    return rows


def _numbers(cell: str) -> bool:
    found = pl.Series([cell]).str.extract(_POINT, 2)
    return found[0] is not None
