"""Read the time stamps of messages, and numbers by path, such as ``linear_acceleration.x`` or ``covariance[0]``."""

import re
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

from sigmaswarm.importing.source import Limits

MAX_DEPTH = 6
MAX_ELEMENTS = 36  # largest number of elements of a list that become columns: a 6 x 6 covariance has 36


def getter(column: str) -> Callable[[Any], Any]:
    """Return a function that reads a column's number from a message. Its result is None if the number is missing."""
    if column == "stamp":
        return stamp_of
    element = re.fullmatch(r"(.*)\[(\d{1,9})\]", column, re.DOTALL)
    path, i = (element[1], int(element[2])) if element else (column, None)
    take = attrgetter(path)

    def number(message: Any) -> Any:
        if isinstance(message, dict):
            return number_in(message, path, i)
        value = take(message)
        return value if i is None else float(value[i]) if i < len(value) else None

    return number


def number_in(message: Any, path: str, i: int | None = None) -> int | float | None:
    """Return the number at a path of a JSON message, or None, since keys may be missing and lists vary in length."""
    for name in path.split("."):
        message = message.get(name) if isinstance(message, dict) else None
    if i is not None:
        message = message[i] if isinstance(message, list) and i < len(message) else None
    return message if isinstance(message, int | float) else None


def has_header(message: Any) -> bool:
    return isinstance(message, dict) or hasattr(getattr(message, "header", None), "stamp")


def stamp_of(message: Any) -> int | None:
    """Return the stamp of a message, ns, from its header or its own field; None if it is missing or exceeds 64 bits."""
    if not isinstance(message, dict):
        if not has_header(message):
            return message.stamp
        stamp = message.header.stamp
        return stamp.sec * 10**9 + stamp.nanosec
    for at in ("header.stamp", "timestamp"):
        seconds = number_in(message, f"{at}.sec")
        if isinstance(seconds, int):
            rest = number_in(message, f"{at}.nanosec") or number_in(message, f"{at}.nsec") or 0
            stamp = seconds * 10**9 + int(rest) if abs(rest) < 2**63 else 2**63
            return stamp if abs(stamp) < 2**63 else None
    return None


def columns_of(
    typestore: Any, msgtype: str, limits: Limits, path: Path, first: Callable[[], Any]
) -> tuple[str, ...]:
    """List the columns: ``received``, ``stamp`` if the message has a header, and one for each number.

    The number of columns is limited, since a definition of 2 kB can nest hundreds of millions of fields. The first
    message, which ``first`` returns, determines the length of lists, for example in Float64MultiArray.
    """
    if msgtype not in typestore.fielddefs:
        return ()
    paths = limits.first_columns(_paths(typestore, msgtype, "", 0), path)
    lists = [name for name, kind in typestore.fielddefs[msgtype][1] if _is_list(kind)]
    message = first() if lists else None
    for name in lists:
        length = len(getattr(message, name, ()))
        paths += tuple(f"{name}[{i}]" for i in range(length if length <= MAX_ELEMENTS else 0))
    stamped = ("stamp",) if "header.stamp.sec" in paths else ()
    return ("received", *stamped, *(p for p in paths if not re.match(r"(.*\.)?header\.", p)))


def _is_list(field: Any) -> bool:
    """Return True for a list of float32 or float64 of variable length."""
    from rosbags.interfaces import Nodetype

    node, detail = field
    return node == Nodetype.SEQUENCE and detail[0][0] == Nodetype.BASE and detail[0][1][0].startswith("float")


def _paths(typestore: Any, msgtype: str, before: str, depth: int) -> Iterator[str]:
    """Yield the paths of the numbers, depth first, and "" for each field, so that the limit counts all fields."""
    from rosbags.interfaces import Nodetype

    if depth > MAX_DEPTH or msgtype not in typestore.fielddefs:
        return
    for name, (node, detail) in typestore.fielddefs[msgtype][1]:
        path = before + name
        yield ""
        if node == Nodetype.BASE and detail[0] != "string":
            yield path
        elif node == Nodetype.NAME:
            yield from _paths(typestore, detail, path + ".", depth + 1)
        elif node == Nodetype.ARRAY and detail[1] <= MAX_ELEMENTS:
            (kind, about), length = detail
            if kind == Nodetype.BASE and about[0] != "string":
                yield from (f"{path}[{i}]" for i in range(length))


def json_columns(messages: Iterator[dict[str, Any]]) -> Iterator[str]:
    """Yield ``received``, ``stamp``, and the paths of the numbers in a topic's first messages."""
    known: set[str] = set()
    for content in messages:
        stamp = ("stamp",) if stamp_of(content) is not None else ()
        for path in ("received", *stamp, *_json_paths(content, "")):
            if path and path not in known:
                known.add(path)
                yield path


def _json_paths(content: dict[str, Any], before: str) -> Iterator[str]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _json_paths(value, f"{before}{name}.")
        elif isinstance(value, int | float):
            yield before + name
        elif isinstance(value, list):
            first: list[Any] = value[:MAX_ELEMENTS]
            yield from (f"{before}{name}[{i}]" for i, v in enumerate(first) if isinstance(v, int | float))
