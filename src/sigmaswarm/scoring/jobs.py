"""How a batch of filters is shared out: jobs of some replays and some lanes each, the longest first.

A kernel takes up to `most_lanes` filters at once; fewer take less time together, but more each. Beside it a job holds
Python's lock for a moment, in which no other job gets on. So few large jobs suit few workers, and many small ones many:
`jobs_for` looks what each way of sharing would take, by the model of `makespan`, and takes the shortest.
"""

import heapq
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import NamedTuple

from sigmaswarm.filters.compiled.layout import WIDEST, lanes_for, most_lanes
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.names import ModelName

STEP, STEP_MORE = 20e-9, 3.2e-9
"""s: a step, and more for each lane of planar5; a lane of another model, of n states, costs (n / 5)^2 times as much."""
HELD, HELD_MORE = 70e-6, 25e-6
"""s: how long a job holds Python's lock, and how much longer for each replay."""
MANY = 16
"""Jobs of each worker: with more it does not matter how they are shared out."""
TOGETHER = 64
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
        Of the parameter sets; at most `most_lanes`, or of one worker TOGETHER.
    seconds : float
        What it takes, about.
    """

    name: str
    replays: range
    sets: range
    seconds: float


def jobs_for(steps: Mapping[str, Sequence[int]], n_sets: int, model: ModelName, workers: int) -> list[Job]:
    """All replays by all sets, in the order of passes, replays and sets.

    ``steps`` : by each pass's name, how many each of its replays has
    """
    most = most_lanes(model)
    if workers == 1:  # nobody else waits: the fewest are the best
        return list(_jobs(list(_parts(steps, math.inf)), n_sets, model, (TOGETHER, TOGETHER), wide=0))
    parts = list(_parts(steps, SHORT))
    if len(parts) >= MANY * workers:
        return list(_jobs(parts, n_sets, model, (most, most), wide=0))
    widths = range(most, 0, -WIDEST)
    ways = list[list[Job]]()
    for short, (wide, narrow) in product((SHORT, 0), combinations_with_replacement(widths, 2)):
        parts = list(_parts(steps, short))
        rounds = len(parts) // workers * workers  # of what all workers have one each of
        ways.append(list(_jobs(parts, n_sets, model, (wide, narrow), wide=rounds)))
    return min(ways, key=lambda jobs: makespan(jobs, workers))


def makespan(jobs: Iterable[Job], workers: int) -> float:
    """s that the jobs take, about, if each worker takes the longest that is left; never less than the lock is held."""
    each = sorted((job.seconds for job in jobs), reverse=True)
    busy = [0.0] * workers
    for seconds in each:
        heapq.heapreplace(busy, busy[0] + seconds)
    return max(max(busy), len(each) * HELD)


class _Part(NamedTuple):
    """Replays of one pass that go into a job together, and their steps."""

    name: str
    replays: range
    steps: int


def _jobs(
    parts: Sequence[_Part], n_sets: int, model: ModelName, lanes: tuple[int, int], *, wide: int
) -> Iterator[Job]:
    """The parts by all sets: so many of the longest parts by the first number of lanes, the others by the second."""
    more, most = STEP_MORE * (len(MODELS[model].states) / 5) ** 2, most_lanes(model)
    longest = set(sorted(range(len(parts)), key=lambda k: parts[k].steps, reverse=True)[:wide])
    for k, part in enumerate(parts):
        width = lanes[0] if k in longest else lanes[1]
        for first in range(0, n_sets, width):
            sets = range(first, min(first + width, n_sets))
            blocks = -(-len(sets) // most)
            step = blocks * STEP + more * lanes_for(len(sets))
            held = HELD + len(part.replays) * HELD_MORE
            yield Job(part.name, part.replays, sets, held + step * part.steps)


def _parts(steps: Mapping[str, Sequence[int]], short: float) -> Iterator[_Part]:
    """Replays, in their order, in parts that are worth a job each."""
    for name, of in steps.items():
        first, so_far = 0, 0
        for last, more in enumerate(of):
            so_far += more
            if so_far >= short or last == len(of) - 1:
                yield _Part(name, range(first, last + 1), so_far)
                first, so_far = last + 1, 0
