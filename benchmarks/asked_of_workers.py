"""Functions that `fleet.py` calls on workers. They are in a module, since Dask sends functions of a script as code."""

import time
from collections.abc import Sequence
from typing import Any

from sigmaswarm.scoring import remote


def forget(drives: Sequence[Any], _: Any) -> int:
    """Drop all prepared drives."""
    for drive in drives:
        drive.results.clear()
    return len(drives)


def nothing(drives: Sequence[Any], _: Any) -> int:
    return 0


def timed(drives: Sequence[Any], pool: Any, *arguments: Any) -> tuple[Any, float]:
    """Return a worker's result, and the time that the worker needed for it, s."""
    began = time.perf_counter()
    answer = remote._taken(drives, pool, *arguments)
    return answer, time.perf_counter() - began


def costs(scores: Any) -> Any:
    return scores.position_rmse
