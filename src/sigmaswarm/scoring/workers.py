"""Who runs jobs: the threads or processes of an executor, and the thread that waits for them."""

import os
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

Result = TypeVar("Result")


def cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_turn(
    function: Callable[..., Result], asked: Sequence[tuple[Any, ...]], executor: Executor | None, workers: int
) -> list[Result]:
    """The function of each, begun in their order, by the executor and the caller, who is one of the ``workers``.

    Threads that are all woken at once may find themselves on one core; the caller is awake. It waits for nobody who has
    not begun, so it may be the executor's own. Where one fails, none begins another, and all have ended when the error
    comes out.
    """
    if executor is None or not asked:
        return [function(*arguments) for arguments in asked]
    if isinstance(executor, ThreadPoolExecutor):
        return _by_threads(function, asked, executor, workers)
    return _by_futures(function, asked, executor)


def _by_threads(
    function: Callable[..., Result], asked: Sequence[tuple[Any, ...]], pool: ThreadPoolExecutor, workers: int
) -> list[Result]:
    """No more threads than workers, however many the pool has; each takes what is next until nothing is left."""
    left = deque(enumerate(asked))
    done = dict[int, Result]()
    others = list[Future[None]]()

    def work() -> None:
        try:
            while left:
                try:
                    k, arguments = left.popleft()
                except IndexError:  # another was quicker
                    return
                done[k] = function(*arguments)
        finally:
            left.clear()  # where one fails

    try:
        for _ in range(min(workers, len(asked)) - 1):
            others.append(pool.submit(work))
        work()
    finally:
        left.clear()
        _let_end(others)
    for other in others:
        if not other.cancelled():
            other.result()
    return [
        done.pop(k) for k in range(len(asked))
    ]  # a busy pool keeps what was canceled, and ``done`` with it


def _by_futures(
    function: Callable[..., Result], asked: Sequence[tuple[Any, ...]], executor: Executor
) -> list[Result]:
    """Each by itself, for they may go to other processes."""
    others = list[Future[Result]]()
    try:
        for arguments in asked[1:]:
            others.append(executor.submit(function, *arguments))
        mine = {0: function(*asked[0])}
        for k, other in enumerate(others, 1):
            if other.cancel():
                mine[k] = function(*asked[k])
        return [mine[k] if k in mine else others[k - 1].result() for k in range(len(asked))]
    finally:
        _let_end(others)


def _let_end(futures: Sequence[Future[Any]]) -> None:
    """Cancel them, and wait for those that have begun, even when interrupted (once)."""
    begun = [future for future in futures if not future.cancel()]
    try:
        wait(begun)
    except BaseException:
        wait(begun)
        raise
