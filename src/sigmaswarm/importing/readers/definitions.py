"""Message definitions, as rosbags' type store has them: which numbers a message holds, by their paths."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sigmaswarm.importing.limits import Limits

_DEEPEST = 6
_LONGEST = 36
"""A fixed array up to this length (a 6 x 6 covariance) has a column for each element."""


def columns_of(typestore: Any, msgtype: str, limits: Limits, path: Path) -> tuple[str, ...]:
    """``received``, ``stamp`` where the message has a header, and a column for each number.

    Raises
    ------
    InputError
        There are too many: a definition of 2 kB can nest to hundreds of millions.
    """
    if msgtype not in typestore.fielddefs:
        return ()
    paths = limits.first_columns(_paths(typestore, msgtype, "", 0), path)
    stamped = "header.stamp.sec" in paths
    own = [p for p in paths if not p.startswith("header.") and ".header." not in p]
    return ("received", *(("stamp",) if stamped else ()), *own)


def _paths(typestore: Any, msgtype: str, before: str, depth: int) -> Iterator[str]:
    """Depth first; lists of unknown length and texts are no columns, but count as empty names."""
    from rosbags.interfaces import Nodetype

    if depth > _DEEPEST or msgtype not in typestore.fielddefs:
        return
    for name, (node, detail) in typestore.fielddefs[msgtype][1]:
        path = before + name
        yield ""
        if node == Nodetype.BASE and detail[0] != "string":
            yield path
        elif node == Nodetype.NAME:
            yield from _paths(typestore, detail, path + ".", depth + 1)
        elif node == Nodetype.ARRAY and detail[1] <= _LONGEST:
            (kind, about), length = detail
            if kind == Nodetype.BASE and about[0] != "string":
                yield from (f"{path}[{i}]" for i in range(length))
