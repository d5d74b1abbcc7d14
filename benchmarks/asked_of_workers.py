"""Functions that `fleet.py` calls on workers, in a module that they import; those of a script travel as code."""

import time
from collections.abc import Sequence
from typing import Any

from sigmaswarm.scoring import remote


def forget(drives: Sequence[Any], _: Any) -> int:
    """Drop all that was prepared."""
    for drive in drives:
        drive.results.clear()
    return len(drives)


def nothing(drives: Sequence[Any], _: Any) -> int:
    return 0


def timed(drives: Sequence[Any], pool: Any, *arguments: Any) -> tuple[Any, float]:
    """A worker's scores, and the seconds that they took there."""
    began = time.perf_counter()
    answer = remote._taken(drives, pool, *arguments)
    return answer, time.perf_counter() - began


def costs(scores: Any) -> Any:
    return scores.position_rmse
