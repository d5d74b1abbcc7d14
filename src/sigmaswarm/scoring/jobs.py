"""Jobs of a batch; each job runs some of the parameter sets over some of the passes.

A kernel runs up to `most_lanes` parameter sets at once. With fewer sets at once, the time per set is longer.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, wait
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from sigmaswarm.filters.compiled.layout import WIDEST, most_lanes

Result = TypeVar("Result")

MAX_SETS = 64  # largest number of parameter sets in a job if there is only one worker, to limit the memory
MIN_JOB_STEPS = 20_000  # filter steps; drives with fewer steps share a job unless workers would be idle


@dataclass(frozen=True)
class Job:
    """A range of drives of the pass ``name``, and a range of parameter sets."""

    name: str
    drives: range
    sets: range
    steps: int

    @property
    def work(self) -> int:
        return self.steps * len(self.sets)


def jobs_for(steps: Mapping[str, Sequence[int]], n_sets: int, kernel: str, workers: int) -> list[Job]:
    """Divide a batch into jobs; ``steps`` contains the number of steps on each drive, by pass."""
    total = sum(map(sum, steps.values()))
    parts = list(_parts(steps, total if workers == 1 else min(MIN_JOB_STEPS, total / workers)))
    most = MAX_SETS if workers == 1 else most_lanes(kernel)
    # The shortest parts do not fill a round of all workers, so their parameter sets are divided among the workers.
    left_over = sorted(parts, key=lambda part: part.steps)[: len(parts) % workers]
    narrow = min(most, -(-n_sets // workers // WIDEST) * WIDEST)
    widths = [(part, narrow if part in left_over else most) for part in parts]
    return [
        replace(part, sets=range(first, min(first + width, n_sets)))
        for part, width in widths
        for first in range(0, n_sets, width)
    ]


def _parts(steps: Mapping[str, Sequence[int]], least: float) -> Iterator[Job]:
    """Group consecutive drives of each pass into parts of at least ``least`` steps; the last part may be shorter."""
    for name, lengths in steps.items():
        first, total = 0, 0
        for last, length in enumerate(lengths):
            total += length
            if total >= least or last == len(lengths) - 1:
                yield Job(name, range(first, last + 1), range(0), total)
                first, total = last + 1, 0


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_jobs(
    function: Callable[..., Result], jobs: Sequence[tuple[Any, ...]], executor: Executor | None
) -> list[Result]:
    """Call a function with each tuple of arguments, in ``executor`` or in this thread.

    After an exception or an interrupt, no further job starts, and the function waits for running jobs.
    """
    if executor is None:
        return [function(*job) for job in jobs]
    futures = list[Future[Result]]()
    try:
        for job in jobs:
            futures.append(executor.submit(function, *job))
        # Jobs start in order. If a job has not started when its result is needed, the executor is busy with other
        # work, perhaps in this thread, so the job runs in this thread.
        pairs = zip(jobs, futures, strict=True)
        return [function(*job) if future.cancel() else future.result() for job, future in pairs]
    finally:
        begun = [future for future in futures if not future.cancel()]
        try:
            wait(begun)
        except BaseException:  # a second interrupt must not leave jobs running
            wait(begun)
            raise
