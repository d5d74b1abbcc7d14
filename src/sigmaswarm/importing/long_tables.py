"""Propose a command that converts a long table, in which a column names the kind of each row."""

import re
from collections import Counter
from pathlib import Path
from shlex import quote

import polars as pl

from sigmaswarm.importing.names import is_time, read_name, read_names
from sigmaswarm.importing.source import Log, first_bytes
from sigmaswarm.importing.table_columns import column_numbers
from sigmaswarm.wording import printable

MAX_KINDS = 20
# Sentences of a board's own; others are those of NMEA 0183, or of the makers of receivers
_OWN = r"\$(?!PASHR|PUBX|PQTM|PMTK|PTNL|PSTM|PGRM|PSAT|PAIR)(?:P[A-Z]{2,}|[A-Z]*(?:IMU|ACC|GYR)[A-Z]*)"
MIN_NUMBERS = 6  # smallest count of numbers in a row of an IMU


def describe_kinds(log: Log) -> str:
    """Describe a long table (one value or sensor per row) and a command that converts it; "" for other tables."""
    if found := _between_sentences(log.path):
        return found
    for table, about in log.tables.items():
        _, frame, _ = next(iter(log.batches({table: about.columns})), ("", pl.DataFrame(), 0.0))
        kinds = [name for name in frame.columns if _is_kind(frame[name])]
        kinds.sort(key=lambda name: frame[name].n_unique())
        times = [name.column for name in read_names(frame.columns) if is_time(name.plain)]
        numbers = [name for name in frame.columns if name not in times and len(column_numbers(frame[name]))]
        changing = [name for name in numbers if frame[name].n_unique() > MAX_KINDS]
        file = log.path.name if log.path.is_file() else table
        if not (kinds and times and changing):
            continue
        if not all(map(_is_harmless, (file, *kinds, times[0], changing[0]))):
            continue
        read = f"import os,polars as pl;f=pl.read_csv({file!r},comment_prefix='#',glob=False)"
        if len(changing) == 1:
            write = f"f.with_columns(k=pl.concat_str({kinds},separator='_')).pivot('k',index={times[0]!r},"
            write += (
                f"values={changing[0]!r},aggregate_function='first').sort({times[0]!r}).write_csv('new.csv')"
            )
            command, then = f"{read};{write}", "import new.csv"
        else:
            name = f"'kinds/' + p.item(0, {kinds[0]!r}) + '.csv'"
            parts = f"[p.write_csv({name}) for p in f.partition_by({kinds[0]!r})]"
            command, then = f"{read};os.makedirs('kinds',exist_ok=True);{parts}", "import the folder kinds"
            placed = (
                n
                for n, t in log.tables.items()
                if {"lat", "lon"} <= {read_name(c).meaning for c in t.columns}
            )
            then += next((f" with --gps {quote(other)}" for other in placed if other != table), "")
        there = ", ".join(map(str, frame[kinds[0]].drop_nulls().unique(maintain_order=True)[:4]))
        return f'{table} has rows of several kinds ({there}); run: python -c "{command}", and {then}'
    return ""


def _is_harmless(name: str) -> bool:
    """Return True if a shell takes a name in double quotes literally."""
    return re.fullmatch(r"[^\\\"'`$!\n\r]*", name) is not None


def _is_kind(values: pl.Series) -> bool:
    if values.dtype != pl.String:
        return False
    known = values.drop_nulls().unique()
    return 1 < len(known) <= MAX_KINDS < len(values) and bool(known.str.contains(r"^[A-Za-z]\w*$").all())


def _between_sentences(path: Path) -> str:
    """Describe rows of numbers, or of a board's own, between NMEA sentences, and a command that separates them."""
    lines = first_bytes(path, 65536).decode("utf-8", "replace").split("\n")[:-1] if path.is_file() else []
    rows = [line for line in lines if len(re.findall(r"\d+\.?\d*", line)) >= MIN_NUMBERS]
    sentences = [found[1] for line in lines if (found := re.match(r"\$([A-Z]{4,6}),", line))]
    kinds = Counter(line.partition(",")[0] for line in rows if "$" in line)
    own, count = next(((k, n) for k, n in kinds.most_common(1) if re.fullmatch(_OWN, k)), ("", 0))
    rows = [line for line in rows if line.startswith(f"{own},") or (not own and "$" not in line)]
    if not sentences or max(count, len(rows)) < 0.2 * len(lines):
        return ""
    name = quote(path.name)
    what = f"the sentences {own}" if own else "the lines between the NMEA sentences"
    command = rf"sed -nE 's/^[$]{own[1:]},([^*]*).*$/\1/p' {name}" if own else f"grep -av '[$]' {name}"
    return (
        f"{what} may be IMU samples ({printable(rows[0], 60)}); write them to a file "
        f"with: {command} > imu.csv, and import imu.csv with --gps {name}"
    )
