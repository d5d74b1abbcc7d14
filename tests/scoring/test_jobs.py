"""A batch is divided into jobs that an executor runs once; no job runs after the call has ended."""

import heapq
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.filters.compiled.layout import LANES, WIDEST, lanes_for, most_lanes
from sigmaswarm.scoring.batch import MAX_SETS, Job, jobs_for, run_jobs


def passes(*lengths: list[int]) -> dict[str, list[int]]:
    return {f"pass {k}": each for k, each in enumerate(lengths)}


def makespan(jobs: list[Job], workers: int) -> float:
    """Return the total time if each worker takes the longest remaining job; time is per step and per lane."""
    busy = [0.0] * workers
    for job in sorted(jobs, key=lambda job: job.work, reverse=True):
        blocks = -(-len(job.sets) // most_lanes("planar5"))
        heapq.heapreplace(busy, busy[0] + job.steps * (20 * blocks + 3.2 * lanes_for(len(job.sets))))
    return max(busy)


@given(
    st.lists(st.lists(st.integers(1, 60_000), min_size=1, max_size=6), min_size=1, max_size=3),
    st.integers(1, 100),
    st.integers(1, 20),
)
def test_jobs_contain_every_pass_with_every_set_once_and_in_order(
    lengths: list[list[int]], n_sets: int, workers: int
):
    jobs = jobs_for(passes(*lengths), n_sets, "planar8", workers)
    met = [(job.name, r, s) for job in jobs for r in job.drives for s in job.sets]
    assert set(Counter(met).values()) == {1}
    assert len(met) == n_sets * sum(map(len, lengths))
    assert all(1 <= len(job.sets) <= (MAX_SETS if workers == 1 else most_lanes("planar8")) for job in jobs)
    # `BatchScorer` joins them in this order: the sets of a part as columns, the parts as rows
    assert jobs == sorted(jobs, key=lambda job: (job.name, job.drives.start, job.sets.start))


@pytest.mark.parametrize(("workers", "sets"), [(1, 30), (2, LANES), (8, WIDEST)])
def test_with_many_workers_a_job_has_fewer_lanes(workers: int, sets: int):
    jobs = jobs_for(passes([60_000]), 30, "planar5", workers)
    assert len(jobs[0].sets) == sets


@pytest.mark.parametrize("workers", [2, 3, 4, 8])
def test_the_remainder_after_whole_rounds_is_divided_among_all_workers(workers: int):
    drives = [60_000] * (workers + 1)
    jobs = jobs_for(passes(drives), 32, "planar5", workers)
    alone = makespan(jobs_for(passes(drives), 32, "planar5", 1), 1)
    whole_rounds_alone = alone / len(drives) * 2
    assert makespan(jobs, workers) < 0.9 * whole_rounds_alone
    assert makespan(jobs, workers) >= alone / workers


def test_short_passes_share_a_job_unless_workers_would_wait():
    short = passes([5_000] * 12)
    assert len(jobs_for(short, LANES, "planar5", 1)) == 1
    assert len(jobs_for(short, LANES, "planar5", 12)) >= 12


class Own(Executor):
    """An executor of a user, which has one thread."""

    def __init__(self, workers: int = 1) -> None:
        self.pool = ThreadPoolExecutor(1)

    def submit(self, fn, /, *args, **kwargs):
        return self.pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self.pool.shutdown(wait, cancel_futures=cancel_futures)


kinds = pytest.mark.parametrize("kind", [ThreadPoolExecutor, Own])


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Enable the interrupt, which nohup disables."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("n", [0, 1, 40])
def test_each_job_is_run_once(workers: int, n: int):
    begun = list[int]()

    def square(k: int, plus: int) -> int:
        begun.append(k)
        time.sleep(0.001)
        return k * k + plus

    with ThreadPoolExecutor(workers) as pool:
        assert run_jobs(square, [(k, 7) for k in range(n)], pool) == [k * k + 7 for k in range(n)]
    assert sorted(begun) == [*range(n)]


@pytest.mark.parametrize("workers", [2, 5])
def test_all_workers_run_at_the_same_time(workers: int):
    all_here = threading.Barrier(workers, timeout=60)
    with ThreadPoolExecutor(workers) as pool:
        run_jobs(lambda _: all_here.wait(), [(k,) for k in range(workers)], pool)


@kinds
def test_a_busy_executor_does_not_block_the_caller(kind: type[Executor]):
    enough, begun, caller = threading.Event(), list[int](), ThreadPoolExecutor(1)
    with kind() as pool:
        busy = [pool.submit(enough.wait) for _ in range(100)]
        try:
            jobs = [(k,) for k in range(9)]
            caller.submit(run_jobs, begun.append, jobs, pool).result(timeout=60)
            assert begun == [*range(9)]  # run by the caller's thread
        finally:
            enough.set()
            caller.shutdown()
    assert all(one.result() for one in busy)


@kinds
def test_a_thread_of_the_executor_can_use_the_executor(kind: type[Executor]):
    with kind() as pool:
        assert pool.submit(run_jobs, abs, [(-1,), (-2,)], pool).result(timeout=60) == [1, 2]


@pytest.mark.parametrize("failing", [0, 1])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
@kinds
def test_an_error_is_raised_and_no_job_runs_afterwards(
    kind: type[Executor], error: type[BaseException], failing: int
):
    begun, ended = list[int](), list[int]()

    def fails(k: int) -> None:
        begun.append(k)
        if k == failing:
            raise error(k)
        time.sleep(0.1)  # long after the other job has failed
        ended.append(k)

    with kind(2) as pool:
        with pytest.raises(error):
            run_jobs(fails, [(k,) for k in range(30)], pool)
        assert len(begun) < 10  # of 30; the number depends on the load
        assert sorted(ended) == sorted(set(begun) - {failing})
        after = len(begun)
        assert run_jobs(abs, [(-1,), (-2,)], pool) == [1, 2]  # the executor still works
        assert len(begun) == after


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="no thread can be interrupted")
@pytest.mark.usefixtures("interruptible")
@kinds
def test_an_interrupt_while_waiting_lets_started_jobs_end(kind: type[Executor]):
    begun, ended = list[int](), list[int]()

    def run(k: int) -> None:
        begun.append(k)
        if k == 0:
            time.sleep(0.3)  # until the caller waits
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        time.sleep(0.3)
        ended.append(k)

    with kind(2) as pool:
        with pytest.raises(KeyboardInterrupt):
            run_jobs(run, [(k,) for k in range(30)], pool)
        assert 0 in ended
        assert len(begun) < 10
        assert sorted(ended) == sorted(begun)
        time.sleep(0.1)
        assert len(begun) == len(ended)


def test_after_an_interrupt_while_submitting_no_job_runs():
    begun = list[int]()

    class Interrupted(ThreadPoolExecutor):
        def submit(self, fn, /, *args, **kwargs):
            super().submit(fn, *args, **kwargs)
            raise KeyboardInterrupt

    with Interrupted(1) as pool, pytest.raises(KeyboardInterrupt):
        run_jobs(lambda k: (begun.append(k), time.sleep(0.2)), [(k,) for k in range(9)], pool)
    assert len(begun) <= 1


def test_processes_run_jobs():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert run_jobs(divmod, [(7, 2), (9, 4)], pool) == [(3, 1), (2, 1)]
