"""How a batch is shared out: everything once, and well."""

import threading
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.filters.compiled.layout import LANES, WIDEST, most_lanes
from sigmaswarm.scoring.jobs import HELD, TOGETHER, Job, in_turn, jobs_for, makespan


def passes(*lengths: list[int]) -> dict[str, list[int]]:
    return {f"pass {k}": each for k, each in enumerate(lengths)}


@given(
    st.lists(st.lists(st.integers(1, 60_000), min_size=1, max_size=6), min_size=1, max_size=3),
    st.integers(1, 100),
    st.integers(1, 20),
)
def test_every_replay_meets_every_set_once_and_in_order(lengths: list[list[int]], n_sets: int, workers: int):
    jobs = jobs_for(passes(*lengths), n_sets, "planar8", workers)
    met = [(job.name, r, s) for job in jobs for r in job.replays for s in job.sets]
    assert set(Counter(met).values()) == {1}
    assert len(met) == n_sets * sum(map(len, lengths))
    assert all(1 <= len(job.sets) <= (TOGETHER if workers == 1 else most_lanes("planar8")) for job in jobs)
    # `Replayer` joins them in this order: the sets of a part side by side, the parts one after the other
    assert jobs == sorted(jobs, key=lambda job: (job.name, job.replays.start, job.sets.start))


@given(st.lists(st.floats(0.001, 1.0), min_size=1, max_size=30), st.integers(1, 8))
def test_a_makespan_lies_between_its_bounds(seconds: list[float], workers: int):
    jobs = [Job("tracking", range(1), range(1), s) for s in seconds]
    found = makespan(jobs, workers)
    least = max(sum(seconds) / workers, max(seconds), len(seconds) * HELD)
    assert least - 1e-9 <= found <= sum(seconds) / workers + max(seconds) + 1e-9


@pytest.mark.parametrize(("workers", "sets"), [(1, 30), (2, LANES), (8, WIDEST)])
def test_many_workers_take_fewer_lanes_each(workers: int, sets: int):
    jobs = jobs_for(passes([60_000]), 30, "planar5", workers)
    assert len(jobs[0].sets) == sets


@pytest.mark.parametrize("workers", [2, 3, 4, 8])
def test_what_is_left_over_after_whole_rounds_is_shared_by_all(workers: int):
    drives = [60_000] * (workers + 1)
    jobs = jobs_for(passes(drives), 32, "planar5", workers)
    alone = sum(job.seconds for job in jobs_for(passes(drives), 32, "planar5", 1))
    whole_rounds_alone = max(job.seconds for job in jobs_for(passes(drives), 32, "planar5", 1)) * 2
    assert makespan(jobs, workers) < 0.9 * whole_rounds_alone
    assert makespan(jobs, workers) >= alone / workers


def test_short_replays_share_a_job_unless_workers_would_wait():
    short = passes([5_000] * 12)
    assert len(jobs_for(short, LANES, "planar5", 1)) == 1
    assert len(jobs_for(short, LANES, "planar5", 12)) >= 12


# --- In turn -----------------------------------------------------------------------------------------------


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


def test_a_pool_whose_threads_are_all_busy_holds_nobody_up():
    enough, begun = threading.Event(), list[int]()
    with ThreadPoolExecutor(2) as pool:
        busy = [pool.submit(enough.wait) for _ in range(2)]
        try:
            in_turn(begun.append, [(k,) for k in range(9)], pool, 3)
            assert begun == [*range(9)]  # by this thread
        finally:
            enough.set()
    assert all(one.result() for one in busy)


@pytest.mark.parametrize("in_the_caller", [True, False])
@pytest.mark.parametrize("kind", [ValueError, KeyboardInterrupt])
def test_an_error_arrives_and_nothing_goes_on_behind_it(in_the_caller: bool, kind: type[BaseException]):
    caller, begun = threading.get_ident(), list[int]()
    both = threading.Barrier(2, timeout=10)

    def fails(k: int) -> None:
        begun.append(k)
        if k < 2:
            both.wait()
            if (threading.get_ident() == caller) == in_the_caller:
                raise kind(k)
            time.sleep(0.05)  # long after the other has failed

    with ThreadPoolExecutor(2) as pool:
        with pytest.raises(kind):
            in_turn(fails, [(k,) for k in range(30)], pool, 2)
        assert sorted(begun) == [0, 1]
        assert in_turn(abs, [(-1,), (-2,)], pool, 2) == [1, 2]  # the pool lives


def test_other_executors_do_it_all():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert in_turn(divmod, [(7, 2), (9, 4)], pool, 2) == [(3, 1), (2, 1)]
