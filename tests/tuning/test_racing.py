"""Racing: steps counted exactly, full costs for those that finish, everybody else behind them."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.tuning.batch import run_batch
from sigmaswarm.tuning.config import TuneConfig
from sigmaswarm.tuning.optimizers import OPTIMIZERS
from sigmaswarm.tuning.problem import CarProblem, car_problem
from sigmaswarm.tuning.racing import race, rungs
from sigmaswarm.tuning.search import Progress
from sigmaswarm.tuning.tune import tune as tune_by_default
from support import make_drive

DRIVES = [make_drive(duration=15.0 + 2 * s, seed=s, name=f"d{s}") for s in range(5)]
SMALL = {"particles": 9, "generations": 4, "seed": 3}
tune = partial(tune_by_default, model="planar5", objective="truth-rmse")


class Table:
    """Costs that are written down, shape (n, m); a point is its row's number. Remembers what it was asked."""

    def __init__(self, costs: np.ndarray) -> None:
        self.table, self.steps = costs, 100 + np.arange(costs.shape[1])
        self.asked: list[tuple[int, int]] = []

    def each(self, points: np.ndarray, drives, executor) -> np.ndarray:
        rows = points[:, 0].astype(int)
        self.asked += [(row, drive) for row in rows for drive in drives]
        return self.table[np.ix_(rows, drives)]

    def mean(self, each: np.ndarray) -> np.ndarray:
        return each.mean(axis=1)


def raced(costs: np.ndarray, order):
    table = Table(costs)
    points = np.arange(len(costs), dtype=float)[:, None]
    return table, race(table, points, np.asarray(order), executor=None)


@given(
    st.integers(1, 40),
    st.integers(1, 9),
    st.integers(0, 2**32),
    st.floats(0, 0.5),
)
def test_against_a_race_in_plain_words(n: int, m: int, seed: int, failing: float):
    rng = np.random.default_rng(seed)
    costs = rng.normal(size=(n, m))
    costs[rng.random((n, m)) < failing / m] = np.inf
    order = rng.permutation(m).tolist()
    table, result = raced(costs, order)

    alive, seen, levels = list(range(n)), 1, []
    while True:
        partial = {i: np.mean([costs[i, d] for d in sorted(order[:seen])]) for i in alive}
        if seen == m:
            break
        better = sorted(alive, key=lambda i: (partial[i], i))[: (len(alive) + 1) // 2]
        levels.append([i for i in alive if i not in better])
        alive, seen = better, min(2 * seen, m)
    took = {(i, d) for i in alive for d in range(m)}
    reach = 1
    for level in levels:
        took |= {(i, d) for i in level for d in order[:reach]}
        reach *= 2
    assert sorted(table.asked) == sorted(took)  # each candidate once on each drive that it reached
    assert result.steps == sum(100 + d for _, d in took)
    for i in alive:  # full costs, bit for bit
        assert result.costs[i] == costs[i].mean()
    assert result.failures == sum(
        bool(np.isinf([costs[i, d] for j, d in took if j == i]).any()) for i in range(n)
    )
    best_behind = max((result.costs[i] for i in alive if np.isfinite(result.costs[i])), default=np.inf)
    for level in reversed(levels):  # behind, and in their own order
        assert all(result.costs[i] > best_behind or np.isinf(result.costs[i]) for i in level)
        best_behind = max([best_behind, *(c for c in result.costs[level] if np.isfinite(c))])
    if len(alive) < n and np.isfinite(result.costs).any():
        assert int(np.argmin(result.costs)) in alive


def test_the_rungs_of_successive_halving():
    assert rungs(30, 6) == [(30, 1), (15, 2), (8, 4), (4, 6)]
    assert rungs(30, 1) == [(30, 1)]
    assert rungs(1, 4) == [(1, 1), (1, 2), (1, 4)]  # who is alone goes all the way
    _, result = raced(np.ones((30, 8)), range(8))
    assert result.steps < 0.36 * 30 * sum(100 + d for d in range(8))


def test_dropped_together_they_keep_their_distances():
    costs = np.array([[1.0, 5.0], [2.0, 6.0], [3.0, 0.0], [3.5, 0.0]])
    _, result = raced(costs, [0, 1])
    assert result.costs.tolist() == pytest.approx([3.0, 4.0, 4.0, 4.5])  # 3 and 3.5 are shifted by 1
    assert result.costs[2] > result.costs[1]


def test_if_all_that_finish_fail_nobody_wins_by_having_seen_less():
    _, result = raced(np.array([[1.0, np.inf], [2.0, 0.0]]), [0, 1])
    assert np.isinf(result.costs).all()
    assert result.failures == 1


def test_steps_are_counted_as_a_naive_count_does(monkeypatch: pytest.MonkeyPatch):
    """Every step of every filter that is run, over passes, from the time lines themselves."""
    config = TuneConfig(objective="truth-pose", racing=True, **SMALL)
    problem = car_problem(DRIVES, config)
    single = car_problem(DRIVES, TuneConfig(objective="truth-rmse")).steps
    for drive, steps in zip(
        DRIVES, single, strict=True
    ):  # a step ends at each sample and each fix after the start
        moments = np.union1d(drive.imu.time, drive.gps.time[drive.gps.time < drive.imu.time[-1]])
        assert steps == np.sum(moments > initial_state(drive).time)
    asked = []
    each = CarProblem.each

    def counted(self, points, drives, executor):
        asked.append(len(points) * sum(int(problem.steps[d]) for d in drives))
        return each(self, points, drives, executor)

    monkeypatch.setattr(CarProblem, "each", counted)
    rng = np.random.default_rng(0)
    points = rng.uniform(problem.space.low, problem.space.high, (9, 10))
    with ThreadPoolExecutor(1) as pool:
        result = race(problem, points, np.array([3, 1, 0, 4, 2]), pool)
    s = problem.steps
    assert result.steps == sum(asked) == 9 * s[3] + 5 * s[1] + 3 * (s[0] + s[4]) + 2 * s[2]
    tuning = tune(DRIVES, objective="truth-pose", racing=True, **SMALL)
    assert tuning.full_steps == 36 * s.sum()
    assert tuning.steps < 0.55 * tuning.full_steps
    assert tuning.to_dict()["result"]["filter_steps"] == tuning.steps


def bits(tuning) -> list[bytes]:
    return [a.tobytes() for t in tuning.trials for a in (t.point, t.best, t.median, t.steps)]


def test_with_one_drive_it_changes_no_bit():
    assert bits(tune(DRIVES[0], racing=True, **SMALL)) == bits(tune(DRIVES[0], **SMALL))
    without = tune(DRIVES, **SMALL)
    assert without.steps == without.full_steps
    assert bits(tune(DRIVES, racing=True, **SMALL)) != bits(without)


@pytest.mark.parametrize("optimizer", OPTIMIZERS)
def test_every_optimizer_can_race(optimizer: str, tmp_path: Path):
    asked = {**SMALL, "optimizer": optimizer, "racing": True, "polish": 9}
    tuning = tune(DRIVES, **asked)
    assert tuning.cost == run_batch(DRIVES, [tuning.parameters]).costs[0]  # the best went all the way
    assert tuning.trials[0].evaluations <= 36
    with ThreadPoolExecutor(3) as pool:
        assert bits(tune(DRIVES, executor=pool, **asked)) == bits(tuning)

    def stop(progress: Progress):
        if progress.generation == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune(DRIVES, out=tmp_path, progress=stop, **asked)
    assert bits(tune(DRIVES, out=tmp_path, resume=True, **asked)) == bits(tuning)
