"""A message's numbers by their paths, ``linear_acceleration.x``, ``covariance[0]``, and its header's stamp."""

import re
from collections.abc import Callable
from operator import attrgetter
from typing import Any


def getter(column: str) -> Callable[[Any], Any]:
    """A function that reads the number of a column from a message; None where a message in JSON has none."""
    if column == "stamp":
        return stamp_of
    element = re.fullmatch(r"(.*)\[(\d{1,9})\]", column, re.DOTALL)
    path, i = (element[1], int(element[2])) if element else (column, None)
    take = attrgetter(path)

    def number(message: Any) -> Any:
        if isinstance(message, dict):
            return number_in(message, path, i)
        return take(message) if i is None else float(take(message)[i])

    return number


def number_in(message: Any, path: str, i: int | None = None) -> int | float | None:
    """The number at a path of a message in JSON: lists may be shorter than others, keys missing, values text."""
    for name in path.split("."):
        message = message.get(name) if isinstance(message, dict) else None
    if i is not None:
        message = message[i] if isinstance(message, list) and i < len(message) else None
    return message if isinstance(message, int | float) else None


def stamp_of(message: Any) -> int | None:
    """The stamp of a message's header, ns; None where a message in JSON states none."""
    if not isinstance(message, dict):
        stamp = message.header.stamp
        return stamp.sec * 10**9 + stamp.nanosec
    for at in ("header.stamp", "timestamp"):
        seconds = number_in(message, f"{at}.sec")
        if isinstance(seconds, int):
            rest = number_in(message, f"{at}.nanosec") or number_in(message, f"{at}.nsec") or 0
            stamp = seconds * 10**9 + int(rest) if abs(rest) < 2**63 else 2**63
            return stamp if abs(stamp) < 2**63 else None
    return None
