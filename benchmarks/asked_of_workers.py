"""What `fleet.py` asks workers, in a module that they import: a function of a script travels as code instead."""

import time
from collections.abc import Sequence
from typing import Any

from sigmaswarm.scoring import fleet as scoring


def forget(kept: Sequence[Any], _: Any) -> None:
    for one in kept:
        one.made.clear()


def timed(kept: Sequence[Any], pool: Any, *sent: Any) -> tuple[Any, float]:
    """A worker's answer, and the seconds that it took there."""
    began = time.perf_counter()
    answer = scoring._taken(kept, pool, *sent)
    return answer, time.perf_counter() - began


def costs(scores: Any) -> Any:
    return scores.position_rmse
