"""How a batch is shared out: everything once, and well."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.filters.compiled.layout import LANES, WIDEST, most_lanes
from sigmaswarm.scoring.jobs import HELD, TOGETHER, Job, jobs_for, makespan


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
