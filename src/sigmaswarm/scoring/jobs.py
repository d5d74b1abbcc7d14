"""How a batch of filters is shared out: jobs of some replays and some lanes each, the longest first.

A kernel takes LANES filters at once, or WIDEST, which take less time together but more each. Beside it a job holds
Python's lock for a moment, in which no other job gets on. So few large jobs suit few workers, and many small ones many:
`jobs_for` looks what each way of sharing would take, by the model of `makespan`, and takes the shortest.
"""

import heapq
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from sigmaswarm.filters.compiled.layout import LANES, WIDEST
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.names import ModelName

STEP = {LANES: 86e-9, WIDEST: 60e-9}
"""s: a step of so many lanes of planar5; by the power of 1.5 of the number of states more of another model."""
HELD, HELD_MORE = 70e-6, 25e-6
"""s: how long a job holds Python's lock, and how much longer for each replay."""
TOGETHER = 4 * LANES
"""Parameter sets that one worker alone takes in a job: more would take more memory."""
SHORT = 20_000
"""Steps: replays that are shorter may be run one after the other in one job."""


@dataclass(frozen=True)
class Job:
    """Some replays of one pass, by some of the parameter sets.

    Attributes
    ----------
    name : of the pass
    replays : range
        Of the pass.
    sets : range
        Of the parameter sets; at most LANES, or of one worker TOGETHER.
    seconds : float
        What it takes, about.
    """

    name: str
    replays: range
    sets: range
    seconds: float


def cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def jobs_for(steps: Mapping[str, Sequence[int]], n_sets: int, model: ModelName, workers: int) -> list[Job]:
    """All replays by all sets, in the order of passes, replays and sets.

    ``steps`` : by each pass's name, how many each of its replays has
    """
    if workers == 1:  # nobody else waits: the fewest are the best
        return list(_jobs(steps, n_sets, model, lanes=TOGETHER, short=None))
    ways = [
        list(_jobs(steps, n_sets, model, lanes=lanes, short=short))
        for lanes, short in product((LANES, WIDEST), (SHORT, 0))
    ]
    return min(ways, key=lambda jobs: makespan(jobs, workers))


def makespan(jobs: Iterable[Job], workers: int) -> float:
    """s that the jobs take, about, if each worker takes the longest that is left; never less than the lock is held."""
    each = sorted((job.seconds for job in jobs), reverse=True)
    busy = [0.0] * workers
    for seconds in each:
        heapq.heapreplace(busy, busy[0] + seconds)
    return max(max(busy), len(each) * HELD)


def _jobs(
    steps: Mapping[str, Sequence[int]], n_sets: int, model: ModelName, *, lanes: int, short: int | None
) -> Iterator[Job]:
    each = STEP[min(lanes, LANES)] * max(lanes // LANES, 1) * (len(MODELS[model].states) / 5) ** 1.5
    for name, of in steps.items():
        for part in _parts(of, short):
            held = HELD + len(part) * HELD_MORE
            for first in range(0, n_sets, lanes):
                yield Job(
                    name,
                    part,
                    range(first, min(first + lanes, n_sets)),
                    held + each * sum(of[part.start : part.stop]),
                )


def _parts(steps: Sequence[int], short: int | None) -> Iterator[range]:
    """Replays, in their order, in parts that are worth a job each; all together if nothing is."""
    if short is None:
        short = sum(steps)
    first, so_far = 0, 0
    for last, more in enumerate(steps):
        so_far += more
        if so_far >= short or last == len(steps) - 1:
            yield range(first, last + 1)
            first, so_far = last + 1, 0
