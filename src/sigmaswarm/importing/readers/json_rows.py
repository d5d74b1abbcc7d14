"""JSON: a list of objects, one object per line, or an object of named lists. Each kind of object is a table.

A folder may contain several such files.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.names import is_time, read_name
from sigmaswarm.importing.readers import columns as tables_of_columns
from sigmaswarm.importing.readers.columns import log_of_files
from sigmaswarm.importing.readers.fields import MAX_DEPTH, MAX_ELEMENTS
from sigmaswarm.importing.source import Limits, Log, first_bytes

KINDS = ("sensor", "type", "name", "topic", "kind", "_measurement")
MAX_KINDS = 50
_SUFFIXES = (".json", ".jsonl", ".ndjson")
Row = dict[str, Any]


def recognizes(path: Path) -> bool:
    if path.is_dir() and tables_of_columns.recognizes(path):  # settings may be next to tables
        return False
    return bool(_files(path))


def _files(path: Path) -> list[Path]:
    there = path.iterdir() if path.is_dir() else [path]
    files = sorted(f for f in there if f.is_file() and (f == path or f.suffix.lower() in _SUFFIXES))
    heads = {file: first_bytes(file, 256).lstrip(b"\xef\xbb\xbf \r\n\t") for file in files}
    return [file for file, head in heads.items() if re.match(rb'\[\s*\{\s*"|\{\s*"', head)]


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    frames: dict[str, pl.LazyFrame] = {}
    for file in _files(path) if path.is_dir() else [path]:
        for name, frame in _frames(file, limits).items():
            name = name if file in (path, path / name) else f"{file.stem}.{name}"
            name = f"{file.name}.{name}" if name in frames else name
            frames[name], limits = frame, limits.less(len(frame.collect_schema()))
    if not frames:
        raise InputError(f"{path}: contains no list of objects; write a list with an object for each sample")
    return log_of_files(path, frames, "JSON")


def _frames(path: Path, limits: Limits) -> dict[str, pl.LazyFrame]:
    limits.check_unpacked(path.stat().st_size, path)
    content = _parsed(path)
    content = _with_rows(cast("dict[str, Any]", content)) if isinstance(content, dict) else content
    named = cast("Mapping[str, Any]", content) if isinstance(content, dict) else {"": content}
    tables: dict[str, list[Row]] = {}
    for name, records in named.items():
        every = cast("list[Any]", records) if isinstance(records, list) else []
        rows = [dict(_flat(record)) for record in every if isinstance(record, dict)]
        for kind, some in _by_kind(rows).items():
            tables.setdefault(".".join(filter(None, (name, kind))) or path.name, []).extend(some)
    frames: dict[str, pl.LazyFrame] = {}
    for name, rows in {name: rows for name, rows in tables.items() if rows}.items():
        limits.check_rows(len(rows), path, name)
        columns = limits.first_columns(iter(dict.fromkeys(key for row in rows for key in row)), path)
        limits = limits.less(len(columns))
        cells = {c: pl.Series([row.get(c) for row in rows], strict=False) for c in columns}
        frames |= {name: pl.LazyFrame(cells)} if len(columns) > 1 else {}
    return frames


def _parsed(path: Path) -> Any:
    text = path.read_text("utf-8-sig", errors="replace")
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    try:
        if len(lines) < 2 or not lines[0][1].strip().endswith("}"):
            return json.loads(text)
        rows: list[Any] = []
        for number, line in lines:
            try:
                rows.append(json.loads(line))
            except ValueError:
                if number != lines[-1][0]:  # the last line of a log may be cut off
                    raise
        return rows
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:100]
        raise InputError(
            f"{path}: is not valid JSON ({reason}); correct the file, or export the log again"
        ) from None


def _with_rows(content: dict[str, Any], depth: int = 0) -> Any:
    """Convert columns to rows: lists of equal length, or objects by row number, as pandas writes them.

    Lists of another length than most are not columns. Next to lists of objects or other tables, there are no columns.
    """
    plain: dict[str, list[Any]] = {}
    for name, cells in content.items():
        column = [*cast("dict[str, Any]", cells).values()] if isinstance(cells, dict) else cells
        nested = (dict, list) if isinstance(cells, dict) else (dict,)
        if isinstance(column, list) and column and not isinstance(column[0], nested):
            plain[name] = column
    (length, columns), *_ = [*Counter(map(len, plain.values())).most_common(1), (0, 0)]
    tables = any(isinstance(part, dict | list) for name, part in content.items() if name not in plain)
    if length > 1 and columns > 1 and not tables:
        plain = {name: column for name, column in plain.items() if len(column) == length}
        return [dict(zip(plain, row, strict=True)) for row in zip(*plain.values(), strict=True)]
    if depth == MAX_DEPTH:
        return content
    return {
        name: _with_rows(cast("dict[str, Any]", part), depth + 1) if isinstance(part, dict) else part
        for name, part in content.items()
    }


def _by_kind(rows: list[Row]) -> dict[str, list[Row]]:
    """Group objects by the first key of `KINDS` that all objects have and that has 2 to `MAX_KINDS` values.

    If the objects have only a time and a value, each kind becomes a column of one table.
    """
    for key in KINDS:
        kinds = {row.get(key) for row in rows}
        if rows and None not in kinds and 1 < len(kinds) <= MAX_KINDS:
            rest = {k for row in rows for k in row} - {key}
            times = [k for k in rest if is_time(read_name(k).plain)]
            if len(rest) == 2 and len(times) == 1:
                (time,), (value,), at = times, rest - {*times}, dict[Any, Row]()
                for row in rows:
                    at.setdefault(row.get(time), {time: row.get(time)})[str(row[key])] = row.get(value)
                return {"": [*at.values()]}
            return {str(kind): [row for row in rows if row[key] == kind] for kind in sorted(kinds, key=str)}
    return {"": rows}


def _flat(record: Mapping[str, Any], before: str = "", depth: int = 0) -> Iterator[tuple[str, Any]]:
    for key, value in record.items():
        name = f"{before}{key}"
        if isinstance(value, dict) and depth < MAX_DEPTH:
            yield from _flat(cast("Mapping[str, Any]", value), f"{name}.", depth + 1)
        elif isinstance(value, list):
            elements = dict(enumerate(cast("list[Any]", value)[:MAX_ELEMENTS]))
            yield from ((f"{name}[{i}]", _cell(v)) for i, v in elements.items() if isinstance(v, int | float))
        elif not isinstance(value, dict):
            yield name, _cell(value)


def _cell(value: Any) -> Any:
    """Convert numbers in texts to numbers, and booleans and integers beyond 64 bits to floats."""
    if isinstance(value, str) and re.fullmatch(
        r"[+-]?\d{1,19}(?:\.\d*)?(?:[eE][+-]?\d{1,3})?", value.strip()
    ):
        value = float(value) if re.search(r"[.eE]", value) else int(value)
    if isinstance(value, int) and abs(value) >= 2**63:
        value = float(value) if abs(value) < 1e300 else None
    return float(value) if isinstance(value, bool) else value
