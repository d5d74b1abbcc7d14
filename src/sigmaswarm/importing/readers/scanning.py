"""Scan a CSV or Parquet file as a table: dialect, types, decimal commas, duplicate names, and columns of points."""

import re
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from pathlib import Path
from typing import Any, cast

import numpy as np
import polars as pl

from sigmaswarm.drives.table_files import POLARS_ERRORS, one_file
from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import TRUTH
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.readers.dialect import BLANKS, MINUS, Dialect, dialect_of, uneven_row
from sigmaswarm.importing.source import Limits, first_bytes, require_filled
from sigmaswarm.wording import list_names, printable, quoted

# Positions in well-known text, POINT (8.0 50.0), as PostGIS and GeoPandas write them to a column of a table
_COORDINATE = r"([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?)"
_BEGIN = r"(?i)^\s*(?:SRID=\d+;)?\s*POINT\s*(?:Z|M|ZM)?\s*"
_POINT = rf"{_BEGIN}\(\s*{_COORDINATE}\s+{_COORDINATE}[^()]*\)\s*$"
_NO_POINT = rf"{_BEGIN}(?:EMPTY|\(\s*nan\s+nan[^()]*\))\s*$|^\s*$"  # the cell of a row without a fix
_WORDS = re.compile(r"_?(?:geom(?:etry)?|points?|wkt|position|location)$", re.IGNORECASE)
_DEGREES = 180.0, 90.0  # largest longitude and latitude
# Points are in degrees if their median step is below _STEP, and the range of a coordinate is below _RANGE times its
# size. Coordinates of a site in m have larger steps or begin near zero.
_STEP, _RANGE = 0.01, 0.1


def scan(file: Path, shown_as: Path, limits: Limits, remarks: list[str]) -> pl.LazyFrame:
    """Scan a table file. The types of a CSV's columns are determined from all rows.

    ``shown_as`` is the name of the file in messages. ``remarks`` receives sentences for the user.
    """
    require_filled(file, shown_as)
    if first_bytes(file, 4) == b"PAR1":
        _require_decodable(file, shown_as, limits)
        try:
            frame = pl.scan_parquet(**one_file(file))
            limits.check_rows(frame.select(pl.len()).collect().item(), shown_as, shown_as.name)
            names = frame.collect_schema().names()
        except (*POLARS_ERRORS, OSError) as error:
            raise broken_table(shown_as, shown_as.name, error) from None
        _check_names(names, shown_as, limits)
    else:
        _require_closed_quotes(file, shown_as)
        dialect = dialect_of(file, shown_as)
        names = dialect.names
        remarks += dialect.remarks
        _check_names(names, shown_as, limits)
        frame = _text(file, dialect, shown_as)
    # the integers that encode categories have no meaning
    frame = frame.with_columns(pl.col(pl.Categorical, pl.Enum).cast(pl.String))
    old = frame.collect_schema().names()
    frame = frame.rename(dict(zip(old, _plain(names, shown_as, remarks), strict=True)))
    try:
        return with_points(frame)
    except POLARS_ERRORS as error:
        raise broken_table(shown_as, shown_as.name, error) from None


_DECODE = """
import sys, polars
rows = polars.scan_parquet(sys.argv[1], glob=False)
count = rows.select(polars.len()).collect().item()
sys.exit(count <= int(sys.argv[2]) and count != sum(map(len, rows.collect_batches())))
"""


def _require_decodable(file: Path, shown_as: Path, limits: Limits) -> None:
    """Decode a Parquet file in another process, since damaged bytes may abort polars, or make it omit rows silently."""
    words = [sys.executable, "-c", _DECODE, str(file), str(limits.rows)]
    ended = subprocess.run(words, capture_output=True, check=False)
    if ended.returncode:
        raise InputError(f"{shown_as}: can't be decoded as a Parquet file; export it again")


def _check_names(names: Sequence[str], shown_as: Path, limits: Limits) -> None:
    if len(names) < 2:
        raise InputError(
            f"{shown_as}: has only one column, {quoted(''.join(names))}; specify the format with --format, or separate "
            "cells by commas"
        )
    limits.first_columns(iter(names), shown_as)


def _text(file: Path, dialect: Dialect, shown_as: Path) -> pl.LazyFrame:
    """Scan the rows of a text table as columns c1, c2, ..., with decimal points and without thousands separators."""
    columns = [f"c{k}" for k in range(1, len(dialect.names) + dialect.surplus + 1)]
    try:
        if dialect.separator == BLANKS:
            cells = (
                pl.col("line").str.strip_chars().str.replace_all(r"\s+", " ").str.splitn(" ", len(columns))
            )
            lines = text_lines(file, dialect.skip, comment_prefix="#", encoding="utf8")
            frame = lines.select(cells.struct.rename_fields(columns).alias("cells")).unnest("cells")
        else:
            frame = _separated(file, dialect, columns)
        there = frame.collect_schema()
        last = [
            pl.col(c).cast(pl.String).str.strip_chars().ne("").any() for c in columns[len(dialect.names) :]
        ]
        if last and any(frame.select(pl.any_horizontal(last)).collect().row(0)):
            raise pl.exceptions.ComputeError("a row has more cells than the header")
    except pl.exceptions.NoDataError:
        return pl.LazyFrame(schema=dict.fromkeys(columns[: len(dialect.names)], pl.String))
    except (*POLARS_ERRORS, OSError) as error:
        if (uneven := uneven_row(file, dialect)) is not None:
            row, cells = uneven
            raise InputError(
                f"{shown_as}, row {row}: has {cells} cells, but the header has {len(dialect.names)}; delete the row, "
                "or write a header with a name for each column"
            ) from None
        try:  # some rows may end with surplus empty cells
            frame = _separated(file, dialect, None, truncate_ragged_lines=True)
            frame = frame.rename(dict(zip(frame.collect_schema(), columns, strict=False)))
            there = frame.collect_schema()
        except POLARS_ERRORS:
            raise broken_table(shown_as, shown_as.name, error) from None
    missing = [pl.lit(None, pl.Float64).alias(c) for c in columns if c not in there]
    texts = [columns[k] for k in dialect.numeric if there.get(columns[k]) == pl.String]
    frame = frame.with_columns(pl.col(texts).str.replace_all(MINUS, "-", literal=True))
    grouped = _grouped(frame, texts, shown_as)
    commas = {columns[k] for k in dialect.comma_columns if columns[k] in texts}
    commas = commas - grouped.keys() | {c for c, group in grouped.items() if group != ","}
    plain = {c: pl.col(c).str.strip_chars() for c in (*commas, *grouped)}
    plain |= {c: plain[c].str.replace_all(group, "", literal=True) for c, group in grouped.items()}
    plain |= {c: plain[c].str.replace(",", ".", literal=True) for c in commas}
    return frame.with_columns(*missing, *plain.values()).select(columns[: len(dialect.names)])


def _grouped(frame: pl.LazyFrame, columns: Sequence[str], shown_as: Path) -> dict[str, str]:
    """Return the thousands separator of each column with a number such as 1.234,5, so that it can be removed."""
    forms = {
        **{
            group: rf"^[+-]?\d{{1,3}}(?:\{group}\d{{3}})+\{mark}\d+$"
            for group, mark in ((".", ","), (",", "."))
        },
        **{group: rf"^[+-]?\d{{1,3}}(?:{group}\d{{3}})+(?:[.,]\d+)?$" for group in "'’ \u00a0\u202f"},
    }
    two = {group: rf"|^[+-]?\d{{1,3}}(?:\{group}\d{{3}}){{2,}}$" for group in ".,"}
    found = frame.select(
        pl.col(c).str.strip_chars().str.contains(form + two.get(group, "")).any().alias(f"{c}{group}")
        for c in columns
        for group, form in forms.items()
    )
    seen = collect(found, shown_as, shown_as.name).row(0, named=True) if columns else {}
    return {c: group for c in columns for group in forms if seen[f"{c}{group}"]}


def _separated(file: Path, dialect: Dialect, columns: Sequence[str] | None, **options: Any) -> pl.LazyFrame:
    """Scan cells. The types are determined once, since polars would determine them again at each reading."""
    settings: dict[str, Any] = {
        "separator": dialect.separator,
        "has_header": False,
        "skip_lines": dialect.skip,
        "decimal_comma": bool(dialect.comma_columns) and dialect.separator != ",",
        "encoding": dialect.encoding,
        "comment_prefix": "#",
        **options,
    }
    cells = pl.scan_csv(**one_file(file), **settings, new_columns=columns, infer_schema_length=None)
    types = cells.collect_schema()
    return pl.scan_csv(**one_file(file), **settings, schema=types, missing_columns="insert")


def text_lines(file: Path, skip: int, encoding: str = "utf8-lossy", **options: Any) -> pl.LazyFrame:
    """Scan the lines of a text, without the first ``skip``, as a column ``line``. Empty lines are null."""
    return pl.scan_csv(
        **one_file(file),
        separator="\x1f",
        has_header=False,
        new_columns=["line"],
        quote_char=None,
        skip_lines=skip,
        infer_schema=False,
        encoding=cast("Any", encoding),
        **options,
    )


def _plain(names: Sequence[str], file: Path, remarks: list[str]) -> list[str]:
    plain: dict[str, None] = {}
    # Next suffix of each name; for 100,000 equal names, a search from 0 would take minutes
    numbers: dict[str, Iterator[int]] = {}
    others: dict[str, list[str]] = {}
    for name in names:
        bare = name.strip().replace("`", "'")  # expressions quote names with backticks
        first = re.sub(r"_duplicated_\d+$", "", bare) if bare not in plain else bare
        if first in plain:
            free = numbers.setdefault(first, count())
            bare = next(other for i in free if (other := f"{first}_duplicated_{i}") not in plain)
            others.setdefault(first, []).append(bare)
        plain[bare] = None
    for first, again in others.items():
        if first:
            often = "twice; the second is" if len(again) == 1 else f"{len(again) + 1} times; the others are"
            called = list_names(again, mark="'")
            remarks.append(f"{file.name}: column {quoted(first)} appears {often} called {called}")
    return list(plain)


def _require_closed_quotes(file: Path, shown_as: Path) -> None:
    """Refuse an odd number of quotes, since everything after an unclosed quote would be read as one cell."""
    with file.open("rb") as stream:
        quotes = sum(block.count(b'"') for block in iter(lambda: stream.read(1 << 20), b""))
    if quotes % 2:
        raise InputError(f'{shown_as}: a quote (") is not closed; close or delete it')


def collect(
    rows: pl.LazyFrame,
    path: Path,
    table: str,
    read: Callable[[pl.LazyFrame], pl.DataFrame] = pl.LazyFrame.collect,
) -> pl.DataFrame:
    """Read the rows that ``read`` selects, by default all.

    An error of polars is raised again as a one-line `InputError`.
    """
    try:
        return read(rows)
    except POLARS_ERRORS as error:
        raise broken_table(path, table, error) from None


def broken_table(path: Path, table: str, error: Exception) -> InputError:
    where = path if path.name == table else path / table
    reason = printable(" ".join(str(error).split("\n")[0].split()), 160)
    return InputError(f"{where}: can't be read as a table ({reason}); export it again")


def with_points(rows: pl.LazyFrame) -> pl.LazyFrame:
    """Replace each column of points by two columns of numbers: longitude and latitude, or x and y in m.

    A new name is the old name with the axis in place of the word for points: gt_geom becomes gt_x and gt_y. The names
    are the axes alone if the table has only one column of points, if this column is not truth, and if the new names
    would not be recognized.
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
