"""Run the tasks of an experiment side by side: on the threads of an executor, or in forked processes.

A task leaves its results in a folder. When a grid runs again, a finished task is read from there, an interrupted one
continues and the others start, so an interrupted experiment ends in the same bytes.

Forked processes take three quarters of the time of threads: a tuning spends a quarter of its time in the interpreter,
which one thread holds at a time. A fork inherits drives and prepared time lines without a copy.
"""

import ctypes
import gc
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from multiprocessing.sharedctypes import RawArray
from typing import Any, TypeVar

from sigmaswarm.errors import SigmaswarmError

T = TypeVar("T", bound=Hashable)
R = TypeVar("R")
Report = Callable[[int], None]
"""Takes the number of finished rounds of a task; raises where the grid was interrupted."""
PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that Linux sends to a process when its parent dies."""
POLL = 0.05
"""s between two looks at the progress of the tasks."""
KILLED = "a process of this experiment was killed, perhaps for lack of memory; continue with --resume"
_run: Callable[[int], Any] | None = None
"""In a forked process: runs a task, given by its index."""


def run_grid(
    tasks: Sequence[T],
    run: Callable[[T, Report], R],
    executor: Executor,
    *,
    processes: int = 0,
    rounds: int = 1,
    effort: Callable[[T], float] = lambda _: 0.0,
    progress: Callable[[int, int, T], None] | None = None,
) -> dict[T, R]:
    """Run every task of a grid; the first failure or interruption stops the others.

    Parameters
    ----------
    tasks, run : sequence, callable
        Runs one task. Its second argument is a function that it calls with the number of finished rounds.
    executor : concurrent.futures.Executor
        Threads that run the tasks where there are no processes.
    processes : int
        Fork so many processes (Linux only). Results and errors are pickled; compile kernels before.
    rounds : int
        Of each task.
    effort : callable
        Duration of a task in any unit: the longest start first, so that workers end together.
    progress : callable, optional
        Called in this thread with the finished rounds of all tasks, their total, and a task that advanced.

    Returns
    -------
    dict of task to result, in the order of the tasks
    """
    done, stop = RawArray("q", len(tasks)), RawArray("b", 1)  # shared with forked processes
    one = partial(_one, tasks, run, rounds, done, stop)
    order = sorted(range(len(tasks)), key=lambda k: -effort(tasks[k]))
    pool, shown, futures = executor, [0] * len(tasks), dict[int, Future[R]]()
    if processes:
        context, inherited = get_context("fork"), (one, stop, os.getpid())
        pool = ProcessPoolExecutor(processes, context, initializer=_begin, initargs=inherited)
    try:
        futures |= _submitted(pool, _in_fork if processes else one, order)
        left = set(futures.values())
        while left:
            finished, left = wait(futures.values(), POLL, FIRST_EXCEPTION)
            for future in finished:
                future.result()  # raises the error of its task
            for k, task in enumerate(tasks):
                if progress and shown[k] != (now := done[k]):
                    shown[k] = now
                    progress(sum(shown), len(tasks) * rounds, task)
        return {task: futures[k].result() for k, task in enumerate(tasks)}
    except BaseException as error:
        stop[0] = 1
        for future in futures.values():
            future.cancel()
        if isinstance(error, BrokenProcessPool):
            raise SigmaswarmError(KILLED) from None
        raise
    finally:
        if processes:
            pool.shutdown()


def _one(tasks: Sequence[T], run: Callable[[T, Report], R], rounds: int, done: Any, stop: Any, k: int) -> R:
    """Run a task, given by its index, and note its finished rounds in shared memory."""

    def report(finished: int) -> None:
        if stop[0]:
            raise InterruptedError("the experiment was interrupted")
        done[k] = finished

    report(0)
    result = run(tasks[k], report)
    report(rounds)
    return result


def _submitted(pool: Executor, run: Callable[[int], R], order: Sequence[int]) -> dict[int, Future[R]]:
    try:
        with warnings.catch_warnings():  # of a fork with threads: they hold no lock that the child needs
            warnings.simplefilter("ignore", DeprecationWarning)
            return {k: pool.submit(run, k) for k in order}
    except OSError as error:
        raise SigmaswarmError(f"can't start processes ({error.strerror}); choose --workers 1") from None


def _begin(run: Callable[[int], Any], stop: Any, parent: int) -> None:
    """Prepare a forked process, which ends at once with its parent or with the grid: files are written whole."""
    global _run
    _run = run
    # Before a resumed run removes unfinished files, which must not be written any more.
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    gc.freeze()  # a collection would copy all inherited objects

    def watch() -> None:
        while not stop[0] and os.getppid() == parent:
            time.sleep(POLL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _in_fork(k: int) -> Any:
    assert _run is not None
    return _run(k)
