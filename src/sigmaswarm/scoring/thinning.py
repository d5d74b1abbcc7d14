"""Limit the number of points of a series that arrives in pieces."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[np.floating[Any]]]


class ThinnedSeries:
    """A limited number of rows of a series, including the peaks of the position error or of the NIS.

    The first and the last row are kept. The rows in between are divided into equal parts. In each part, the rows with
    the smallest and the largest error or NIS are kept; for a series with neither, the first and the last row.
    """

    def __init__(self, n: int, most: int) -> None:
        self._ends: NDArray[np.intp] | None = None
        if n > most:
            parts, inner = most // 2 - 1, n - 2
            sizes = inner // parts + (np.arange(parts) < inner % parts)
            self._ends = np.concatenate([[1], 1 + np.cumsum(sizes), [n]])
        self._first = 0  # index in the series of the first waiting row
        self._waiting: dict[str, NDArray[np.floating[Any]]] = {}
        self._kept: list[Columns] = []

    def add(self, columns: Columns) -> None:
        if self._ends is None:
            self._kept.append({name: np.array(values) for name, values in columns.items()})
            return
        if self._waiting:
            columns = {name: np.concatenate([self._waiting[name], v]) for name, v in columns.items()}
        ends = self._ends[self._ends > self._first] - self._first
        whole = ends[ends <= len(columns["time"])]
        if len(whole):
            rows = _extremes(columns, whole)
            self._kept.append({name: values[rows] for name, values in columns.items()})
            columns = {name: values[whole[-1] :] for name, values in columns.items()}
            self._first += int(whole[-1])
        self._waiting = {name: np.array(values) for name, values in columns.items()}

    @property
    def columns(self) -> Columns:
        """Kept rows; complete after the last piece."""
        if not self._kept:
            return {"time": np.empty(0)}
        return {name: np.concatenate([part[name] for part in self._kept]) for name in self._kept[0]}


def _extremes(columns: Columns, ends: NDArray[np.intp]) -> NDArray[np.intp]:
    order = np.arange(len(columns["time"]), dtype=np.float64)
    key = np.nan_to_num(columns.get("position_error", columns.get("nis", order)), nan=0.0)
    parts = [(first, key[first:end]) for first, end in pairwise([0, *ends.tolist()])]
    rows = [first + int(at) for first, part in parts for at in (part.argmin(), part.argmax())]
    return np.unique(rows)


class CloseUp:
    """All rows of a series that lie in a region, with a gap wherever the series leaves the region.

    ``center`` is the middle of the region, m, shape (2,). ``side`` is the side of the plotted square, m.
    The region is twice as wide, since a plot with equal scales may show more than this square.
    """

    def __init__(self, center: NDArray[np.float64], side: float) -> None:
        self._center, self._reach = center, side
        self._kept: list[NDArray[np.float64]] = []
        self._was_near = True

    def add(self, columns: Columns) -> None:
        if "x" not in columns:
            return
        points = np.column_stack([columns["x"], columns["y"]]).astype(np.float64)
        near = np.all(np.abs(points - self._center) <= self._reach, axis=1)
        leaves = ~near & np.append(self._was_near, near[:-1])
        points[~near] = np.nan
        self._kept.append(points[near | leaves])
        self._was_near = bool(near[-1])

    @property
    def columns(self) -> Columns:
        points = np.concatenate(self._kept) if self._kept else np.empty((0, 2))
        return {"x": points[:, 0], "y": points[:, 1]}
