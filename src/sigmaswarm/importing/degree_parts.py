"""Latitude and longitude in two or three columns each: degrees, minutes and perhaps seconds."""

from collections.abc import Mapping

import polars as pl

from sigmaswarm.importing.names import read_names, split_words
from sigmaswarm.importing.times import column_numbers, quoted_column

_PLACES = {"lat": {"lat", "latitude"}, "lon": {"lon", "lng", "long", "longitude"}}
_PARTS = {
    **dict.fromkeys(("d", "deg", "degs", "degree", "degrees"), 1),
    **dict.fromkeys(("m", "min", "mins", "minute", "minutes"), 60),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 3600),
}


def degree_parts(frame: pl.DataFrame) -> dict[str, tuple[str, str]]:
    """Return the column of degrees and the expression of the sum, deg, for lat and lon; {} if either is not found.

    If the table also has latitude and longitude in one column each, these columns are returned, with an empty
    expression, since the parts may lack the sign.
    """
    found: dict[str, tuple[str, str]] = {}
    whole: dict[str, tuple[str, str]] = {}
    for what, names in _PLACES.items():
        groups: dict[tuple[str, ...], dict[int, str]] = {}
        for column in frame.columns:
            words = split_words(column)
            if words[-1:] and words[-1] in _PARTS and names & {*words[:-1]}:
                groups.setdefault((*words[:-1],), {}).setdefault(_PARTS[words[-1]], column)
        fitting = [parts for parts in groups.values() if _fits(frame, parts)]
        sums = [(parts[1], _sum(parts)) for parts in fitting]
        found |= {what: sums[0]} if sums else {}
        used = {column for parts in fitting for column in parts.values()}
        others = [n.column for n in read_names(frame.columns) if n.meaning == what and n.column not in used]
        others = [column for column in others if (column_numbers(frame[column]) != 0).any()]
        whole |= {what: (others[0], "")} if others else {}
    return {} if len(found) < len(_PLACES) else whole if len(whole) == len(_PLACES) else found


def _fits(frame: pl.DataFrame, parts: Mapping[int, str]) -> bool:
    if not {1, 60} <= parts.keys():
        return False
    values = {part: column_numbers(frame[column]) for part, column in parts.items()}
    whole = [values[part] for part in sorted(values)[:-1]]
    below = all(v.is_between(0, 60).all() for part, v in values.items() if part > 1)
    return below and all(len(v) and (v == v.round()).all() for v in whole)


def _sum(parts: Mapping[int, str]) -> str:
    degrees = quoted_column(parts[1])
    rest = " + ".join(f"{quoted_column(column)}/{part}" for part, column in sorted(parts.items()) if part > 1)
    return f"{degrees} + where({degrees} < 0, -1, 1)*({rest})"
