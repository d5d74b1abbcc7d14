"""Jobs are run once, by whoever is free, and nothing goes on when the caller has gone on."""

import signal
import threading
import time
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import pytest

from sigmaswarm.scoring.workers import in_turn


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("n", [0, 1, 40])
def test_each_is_done_once_whoever_does_it(workers: int, n: int):
    begun, by = list[int](), set[int]()

    def square(k: int, plus: int) -> int:
        begun.append(k)
        by.add(threading.get_ident())
        time.sleep(0.001)
        return k * k + plus

    with ThreadPoolExecutor(workers) as pool:
        assert in_turn(square, [(k, 7) for k in range(n)], pool, workers) == [k * k + 7 for k in range(n)]
    assert sorted(begun) == [*range(n)]
    assert len(by) <= workers
    assert (threading.get_ident() in by) == (n > 0)


@pytest.mark.parametrize("workers", [2, 5])
def test_all_workers_are_at_it_at_once(workers: int):
    all_here = threading.Barrier(workers, timeout=60)
    with ThreadPoolExecutor(workers) as pool:
        in_turn(lambda _: all_here.wait(), [(k,) for k in range(workers)], pool, workers)


class Own(Executor):
    """One of a user's, around a thread."""

    def __init__(self) -> None:
        self.pool = ThreadPoolExecutor(1)

    def submit(self, fn, /, *args, **kwargs):
        return self.pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self.pool.shutdown(wait, cancel_futures=cancel_futures)


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, Own])
def test_an_executor_whose_threads_are_all_busy_holds_nobody_up(kind: type[Executor]):
    enough, begun, caller = threading.Event(), list[int](), ThreadPoolExecutor(1)
    with kind() as pool:
        busy = [pool.submit(enough.wait) for _ in range(100)]
        try:
            asked = [(k,) for k in range(9)]
            caller.submit(in_turn, begun.append, asked, pool, 3).result(timeout=60)
            assert begun == [*range(9)]  # by that thread
        finally:
            enough.set()
            caller.shutdown()
    assert all(one.result() for one in busy)


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, Own])
def test_an_executors_own_thread_may_ask_it(kind: type[Executor]):
    with kind() as pool:
        assert pool.submit(in_turn, abs, [(-1,), (-2,)], pool, 2).result(timeout=60) == [1, 2]


@pytest.mark.parametrize("in_the_caller", [True, False])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@pytest.mark.parametrize("kind", [ThreadPoolExecutor, Own])
def test_an_error_arrives_and_nothing_goes_on_behind_it(
    kind: type[Executor], error: type[BaseException], in_the_caller: bool
):
    caller, begun, ended = threading.get_ident(), list[int](), list[int]()
    both = threading.Barrier(2, timeout=10)

    def fails(k: int) -> None:
        begun.append(k)
        if k < 2:
            both.wait()
            if (threading.get_ident() == caller) == in_the_caller:
                raise error(k)
            time.sleep(0.1)  # long after the other has failed
        ended.append(k)

    with kind() as pool:
        with pytest.raises(error):
            in_turn(fails, [(k,) for k in range(30)], pool, 2)
        assert len(ended) >= len(begun) - 1  # all but the one that failed
        assert kind is Own or sorted(begun) == [0, 1]
        after = len(begun)
        assert in_turn(abs, [(-1,), (-2,)], pool, 2) == [1, 2]  # it lives
        assert len(begun) == after


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no thread can be interrupted")
@pytest.mark.parametrize("kind", [ThreadPoolExecutor, Own])
def test_interrupted_while_it_waits_for_the_last_it_waits_for_that(kind: type[Executor]):
    both, ended = threading.Barrier(2, timeout=10), list[int]()

    def run(k: int) -> None:
        both.wait()
        if threading.current_thread() is not threading.main_thread():
            while not ended:
                time.sleep(0.01)
            time.sleep(0.3)  # until the caller waits
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
            time.sleep(0.3)
        ended.append(k)

    with kind() as pool:
        with pytest.raises(KeyboardInterrupt):
            in_turn(run, [(0,), (1,)], pool, 2)
        assert sorted(ended) == [0, 1]


def test_interrupted_while_it_asks_nothing_goes_on_behind_it():
    begun = list[int]()

    class Interrupted(ThreadPoolExecutor):
        def submit(self, fn, /, *args, **kwargs):
            super().submit(fn, *args, **kwargs)
            raise KeyboardInterrupt

    with Interrupted(1) as pool, pytest.raises(KeyboardInterrupt):
        in_turn(lambda k: (begun.append(k), time.sleep(0.2)), [(k,) for k in range(9)], pool, 2)
    assert len(begun) <= 1


def test_processes_take_their_part():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert in_turn(divmod, [(7, 2), (9, 4)], pool, 2) == [(3, 1), (2, 1)]
