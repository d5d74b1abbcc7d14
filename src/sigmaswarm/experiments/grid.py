"""The grid of an experiment: its tunings side by side, each on one worker, counted as they go and stopped together.

A grid leaves what it has done in the folders of its tunings: asked to run again, a tuning is looked up where it is
finished, gone on with where it was interrupted, and started where it was not. So an interrupted experiment ends in the
same bytes.
"""

import threading
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Executor
from typing import Generic, TypeVar

T = TypeVar("T", bound=Hashable)
R = TypeVar("R")
Tell = Callable[[int], None]
"""Takes the number of rounds that a task has done; raises where the grid was interrupted."""


def run_grid(
    tasks: Sequence[T],
    run: Callable[[T, Tell], R],
    executor: Executor,
    *,
    rounds: int = 1,
    effort: Callable[[T], float] | None = None,
    progress: Callable[[int, int, T], None] | None = None,
) -> dict[T, R]:
    """Run every task of a grid; where one fails or is interrupted, the others stop when they next tell.

    Parameters
    ----------
    tasks : sequence
    run : callable
        Runs one task; is handed the function that it tells how many rounds are done.
    executor : concurrent.futures.Executor
    rounds : int
        Of each task.
    effort : callable, optional
        How long a task takes, in any unit: the longest begin first, so that workers end together.
    progress : callable, optional
        Called with the rounds done, and of all tasks, and with the task that told.

    Returns
    -------
    dict of task to what ``run`` returned, in the order of the tasks
    """
    tally = _Tally(len(tasks) * rounds, progress)

    def one(task: T) -> R:
        tell = tally.of(task)
        try:
            tell(0)
            result = run(task, tell)
            tell(rounds)
        except BaseException as error:
            tally.stop(error)
            raise
        return result

    queue = sorted(tasks, key=effort, reverse=True) if effort else tasks
    futures = {task: executor.submit(one, task) for task in queue}
    try:
        return {task: futures[task].result() for task in tasks}
    except BaseException as error:
        first = tally.stop(error)
        for future in futures.values():
            future.cancel()
        if first is not error:
            raise first from None
        raise


class _Tally(Generic[T]):
    """Adds up what tasks tell from their threads."""

    def __init__(self, total: int, progress: Callable[[int, int, T], None] | None) -> None:
        self._lock, self._done, self._total, self._progress = threading.Lock(), 0, total, progress
        self._stopped_by: BaseException | None = None

    def stop(self, error: BaseException) -> BaseException:
        """Stop all tasks; returns what stopped them first."""
        with self._lock:
            self._stopped_by = self._stopped_by or error
            return self._stopped_by

    def of(self, task: T) -> Tell:
        """The function that one task tells its rounds; those before the first it tells are done."""
        told = 0

        def tell(rounds: int) -> None:
            nonlocal told
            if self._stopped_by:
                raise InterruptedError("the experiment was interrupted")
            with self._lock:
                if rounds == told:
                    return
                self._done += rounds - told
                told = rounds
                if self._progress:
                    self._progress(self._done, self._total, task)

        return tell
