"""Simulate many drives in threads; the compiled code releases the interpreter's lock."""

import os
from collections import deque
from collections.abc import Callable, Container, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.simulation.environments import ENVIRONMENTS, lookup
from sigmaswarm.simulation.maneuvers import MANEUVERS
from sigmaswarm.simulation.scenarios import check_duration, drive_name, simulate

PAPER_MANEUVERS = tuple(name for name in MANEUVERS if name != "urban")


def simulated_source(*what: Any, **options: Any) -> tuple[Drive, list[SigmaswarmWarning]]:
    return simulate(*what, **options), []


def simulate_many(
    maneuvers: Sequence[str] = PAPER_MANEUVERS,
    environments: Sequence[str] = tuple(ENVIRONMENTS),
    runs: int = 20,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    use: Callable[[Drive], Any] | None = None,
    ahead: int = 16,
    leave_out: Container[str] = (),
    **options: Any,
) -> Iterator[Any]:
    """Simulate every maneuver in every environment `runs` times, in threads.

    Parameters
    ----------
    maneuvers, environments : sequence of str
        Names; by default the paper's 25 conditions.
    runs : int
        Number of drives of each condition.
    executor : concurrent.futures.Executor, optional
        Executor of the simulations; by default a pool of threads.
    workers : int, optional
        Number of threads of the pool; by default one per core.
    use : callable, optional
        Function that is called with each drive in the thread of its simulation, for example to write the drive. The
        result of the function is yielded instead of the drive.
    ahead : int
        Largest number of drives that are simulated in advance. If it is less than ``workers``, some threads are idle.
    leave_out : container of str
        Names of drives to skip, for example after an interruption.
    **options
        Options of `simulate`; ``duration`` applies to "urban" only.

    Yields
    ------
    Drive, or the result of `use`
        The order is maneuver, environment, run, for any number of workers. A drive is yielded as soon as it and all
        earlier drives are ready.

    Raises
    ------
    InputError
        If an argument is invalid, as in `simulate`. The error is raised when the first drive is requested.
    """
    duration = options.pop("duration", None)
    _check_conditions(maneuvers, environments, runs, duration)

    def simulate_one(maneuver: str, environment: str, run: int) -> Any:
        seconds = duration if maneuver == "urban" else None
        drive = simulate(maneuver, environment, run=run, duration=seconds, **options)
        return drive if use is None else use(drive)

    names = ((m, e, r) for m in maneuvers for e in environments for r in range(runs))
    pool = executor if executor is not None else ThreadPoolExecutor(workers or os.cpu_count())
    waiting: deque[Future[Any]] = deque()  # at most `ahead` drives, which bounds memory
    try:
        for name in names:
            if drive_name(*name) not in leave_out:
                waiting.append(pool.submit(simulate_one, *name))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        for future in waiting:
            yield future.result()
    finally:
        if executor is None:
            pool.shutdown(cancel_futures=True)


def _check_conditions(
    maneuvers: Sequence[str], environments: Sequence[str], runs: int, duration: float | None
) -> None:
    for maneuver in maneuvers:
        lookup(maneuver, MANEUVERS, "maneuver")
    for environment in environments:
        lookup(environment, ENVIRONMENTS, "environment")
    if runs < 1:
        raise InputError(f"runs is {runs}; choose 1 or more")
    check_duration("urban" if "urban" in maneuvers else maneuvers[0], duration)
