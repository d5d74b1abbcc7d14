"""All conditions times all runs, in threads: the compiled car leaves the interpreter free."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

from sigmaswarm.drives.drive import Drive
from sigmaswarm.simulation.environments import ENVIRONMENTS
from sigmaswarm.simulation.maneuvers import MANEUVERS
from sigmaswarm.simulation.scenarios import simulate

PAPER_MANEUVERS = tuple(name for name in MANEUVERS if name != "urban")
"""The paper's five."""


def simulate_many(
    maneuvers: Sequence[str] = PAPER_MANEUVERS,
    environments: Sequence[str] = tuple(ENVIRONMENTS),
    runs: int = 20,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    use: Callable[[Drive], Any] | None = None,
    **options: Any,
) -> Iterator[Any]:
    """Simulate every maneuver in every environment `runs` times, in threads.

    Parameters
    ----------
    maneuvers, environments : sequence of str
        Names; the paper's 25 conditions by default.
    runs : int
        Drives of each condition.
    executor : concurrent.futures.Executor, optional
        Where to work; a pool of threads of its own by default.
    workers : int, optional
        Threads of that pool; as many as the machine has cores by default.
    use : callable, optional
        Called with each drive where it was made, for example to write it; its result is yielded instead of
        the drive.
    **options
        As for `simulate`.

    Yields
    ------
    Drive, or what `use` made of it
        In the order maneuver, environment, run, whatever the number of workers; as soon as each is ready.
    """

    def one(maneuver: str, environment: str, run: int) -> Any:
        drive = simulate(maneuver, environment, run=run, **options)
        return drive if use is None else use(drive)

    names = [(m, e, r) for m in maneuvers for e in environments for r in range(runs)]
    pool = executor if executor is not None else ThreadPoolExecutor(workers or os.cpu_count())
    try:
        yield from _in_order(pool, one, names)
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)


def _in_order(
    pool: Executor, work: Callable[..., Any], names: list[tuple[str, str, int]], ahead: int = 16
) -> Iterator[Any]:
    """Results in the order of the names, with at most `ahead` drives waiting, so that memory stays small."""
    waiting: deque[Future[Any]] = deque()
    for name in names:
        waiting.append(pool.submit(work, *name))
        if len(waiting) > ahead:
            yield waiting.popleft().result()
    for future in waiting:
        yield future.result()
