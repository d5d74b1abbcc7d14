"""Racing: exact numbers of steps, full costs for finished candidates, and higher costs for all others."""

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
from sigmaswarm.tuning.search import (
    FIRST_DIVISOR,
    MIN_RACED_DRIVES,
    Leader,
    Progress,
    TrialRunner,
    leader_at,
    race,
    rungs,
)
from sigmaswarm.tuning.store import ResultFolder
from sigmaswarm.tuning.tune import tune as tune_by_default
from support import make_drive, quickly

pytestmark = pytest.mark.usefixtures("undiagnosed")

DRIVES = [make_drive(duration=15.0 + 2 * s, seed=s, name=f"d{s}", imu_rate=50.0) for s in range(5)]
SMALL = {"particles": 9, "generations": 4, "seed": 3}
tune = partial(tune_by_default, model="planar5", objective="truth-rmse")


class MeanOverDrives:
    """A problem whose cost is the mean over drives, and whose parameters are the point."""

    def combined(self, each: np.ndarray) -> np.ndarray:
        return each.mean(axis=1)

    def parameters(self, point: np.ndarray) -> np.ndarray:
        return point


class Table(MeanOverDrives):
    """A problem with given costs of shape (n, m); a point is the number of its row. It records the evaluations."""

    def __init__(self, costs: np.ndarray) -> None:
        self.table, self.steps = costs, 100 + np.arange(costs.shape[1])
        self.asked: list[tuple[int, int]] = []

    def costs_by_drive(self, points: np.ndarray, drives, executor) -> np.ndarray:
        rows = points[:, 0].astype(int)
        self.asked += [(row, drive) for row in rows for drive in drives]
        return self.table[np.ix_(rows, drives)]


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
def test_a_race_agrees_with_a_plain_implementation(n: int, m: int, seed: int, failing: float):
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
    assert sorted(table.asked) == sorted(took)  # each candidate once on each drive of its rungs
    assert result.steps == sum(100 + d for _, d in took)
    for i in alive:  # full costs, bit for bit
        assert result.costs[i] == costs[i].mean()
    assert result.failures == sum(
        bool(np.isinf([costs[i, d] for j, d in took if j == i]).any()) for i in range(n)
    )
    best_behind = max((result.costs[i] for i in alive if np.isfinite(result.costs[i])), default=np.inf)
    for level in reversed(levels):  # dropped candidates are behind, in their own order
        assert all(result.costs[i] > best_behind or np.isinf(result.costs[i]) for i in level)
        best_behind = max([best_behind, *(c for c in result.costs[level] if np.isfinite(c))])
    if len(alive) < n and np.isfinite(result.costs).any():
        assert int(np.argmin(result.costs)) in alive


def test_the_rungs_of_successive_halving():
    assert rungs(30, 6) == [(30, 1), (15, 2), (8, 4), (4, 6)]
    assert rungs(30, 1) == [(30, 1)]
    assert rungs(1, 4) == [(1, 1), (1, 2), (1, 4)]  # a single candidate is evaluated on all drives
    _, result = raced(np.ones((30, 8)), range(8))
    assert result.steps < 0.36 * 30 * sum(100 + d for d in range(8))


def test_candidates_dropped_together_keep_their_differences():
    costs = np.array([[1.0, 5.0], [2.0, 6.0], [3.0, 0.0], [3.5, 0.0]])
    _, result = raced(costs, [0, 1])
    assert result.costs.tolist() == pytest.approx([3.0, 4.0, 4.0, 4.5])  # 3 and 3.5 are shifted by 1
    assert result.costs[2] > result.costs[1]


def test_if_all_finished_candidates_fail_no_dropped_candidate_wins():
    _, result = raced(np.array([[1.0, np.inf], [2.0, 0.0]]), [0, 1])
    assert np.isinf(result.costs).all()
    assert result.failures == 1


def test_steps_agree_with_a_plain_count(monkeypatch: pytest.MonkeyPatch):
    """Count the steps of all filters that are run, over all passes, from the timelines."""
    config = TuneConfig(objective="truth-pose", racing=True, **SMALL)
    problem = car_problem(DRIVES, config)
    single = car_problem(DRIVES, TuneConfig(objective="truth-rmse")).steps
    for drive, steps in zip(
        DRIVES, single, strict=True
    ):  # a step ends at each sample and each fix after the start
        moments = np.union1d(drive.imu.time, drive.gps.time[drive.gps.time < drive.imu.time[-1]])
        assert steps == np.sum(moments > initial_state(drive).time)
    asked = []
    each = CarProblem.costs_by_drive

    def counted(self, points, drives, executor):
        asked.append(len(points) * sum(int(problem.steps[d]) for d in drives))
        return each(self, points, drives, executor)

    monkeypatch.setattr(CarProblem, "costs_by_drive", counted)
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


@pytest.mark.parametrize(
    "optimizer",
    quickly([(name,) for name in OPTIMIZERS], lambda name: name == "de"),
)
def test_every_optimizer_can_race(optimizer: str, tmp_path: Path):
    asked = {**SMALL, "optimizer": optimizer, "racing": True, "polish": 9}
    tuning = tune(DRIVES, **asked)
    assert tuning.cost == run_batch(DRIVES, [tuning.parameters]).costs[0]  # on all drives
    assert tuning.trials[0].evaluations <= 36
    with ThreadPoolExecutor(3) as pool:
        assert bits(tune(DRIVES, executor=pool, **asked)) == bits(tuning)

    def stop(progress: Progress):
        if progress.generation == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune(DRIVES, out=tmp_path, progress=stop, **asked)
    assert bits(tune(DRIVES, out=tmp_path, resume=True, **asked)) == bits(tuning)


class Bowls(MeanOverDrives):
    """A problem with a bowl for each drive; some points fail on one drive. It counts evaluations."""

    def __init__(self, n_drives: int) -> None:
        rng = np.random.default_rng(7)
        self.bottoms = rng.normal(0.3, 0.1, (n_drives, 3))
        self.hard, self.steps = rng.uniform(1, 5, n_drives), np.full(n_drives, 100)
        self.space, self.config = Box3(), TuneConfig()
        self.asked = 0

    def costs_by_drive(self, points: np.ndarray, drives, executor) -> np.ndarray:
        self.asked += len(points) * len(drives)
        costs = self.hard[list(drives)] + ((points[:, None] - self.bottoms[list(drives)]) ** 2).sum(axis=2)
        costs[np.ix_(points[:, 0] < -0.8, [k for k, drive in enumerate(drives) if drive == 5])] = np.inf
        return costs

    def costs(self, points: np.ndarray, executor) -> np.ndarray:
        return self.combined(self.costs_by_drive(points, range(len(self.steps)), executor))


class Box3:
    low, high = np.full(3, -1.0), np.full(3, 1.0)


def searched(problem: Bowls, folder: ResultFolder | None = None, progress=None, **options):
    problem.config = TuneConfig(particles=20, generations=30, racing=True, optimizer="pso", **options)
    return TrialRunner(problem, None, folder, progress).trial(0)


def test_with_many_drives_the_first_rung_has_several():
    assert rungs(30, 350) == [(30, 29), (15, 58), (8, 116), (4, 232), (2, 350)]
    assert (rungs(30, MIN_RACED_DRIVES)[0], rungs(30, MIN_RACED_DRIVES - 1)[0]) == ((30, 8), (30, 1))


def test_a_candidate_that_is_clearly_worse_than_the_best_is_dropped():
    """Drives differ much more than candidates, so that only a comparison on the same drives is conclusive."""
    rng = np.random.default_rng(0)
    hard = rng.uniform(0, 100, 120)
    noise = rng.normal(0, 0.1, (6, 120))
    costs = hard + np.array([1.0, 2.0, 3.0, 4.0, 5.0, 0.5])[:, None] + noise
    leader = Leader(float(costs[0].mean()), costs[0])
    order = rng.permutation(120)
    table = Table(costs[1:5])
    result = race(table, np.arange(4.0)[:, None], order, None, leader)
    assert {drive for _, drive in table.asked} == set(
        order[: 120 // FIRST_DIVISOR].tolist()
    )  # no candidate reached the second rung
    assert result.leader is leader
    assert result.costs == pytest.approx(costs[1:5].mean(axis=1), abs=1.0)  # extrapolated to all drives
    assert (result.costs > leader.cost).all()

    table = Table(costs[[1, 5, 2]])
    result = race(table, np.arange(3.0)[:, None], order, None, leader)
    assert result.costs[1] == costs[5].mean()
    assert result.leader is not None
    assert result.leader.cost == result.costs[1]
    assert np.array_equal(result.leader.costs_by_drive, costs[5])
    assert result.steps < 0.55 * 3 * table.steps.sum()


def test_without_a_best_or_with_one_candidate_all_drives_are_evaluated():
    costs = np.random.default_rng(1).normal(size=(4, MIN_RACED_DRIVES))
    costs[2, 3] = np.inf
    table, result = raced(costs, range(MIN_RACED_DRIVES))
    assert result.steps == 4 * table.steps.sum()
    assert result.costs.tolist() == costs.mean(axis=1).tolist()
    _, failed = raced(np.full((4, MIN_RACED_DRIVES), np.inf), range(MIN_RACED_DRIVES))
    assert failed.leader is None
    best = Leader(-10.0, np.full(MIN_RACED_DRIVES, -10.0))
    alone = race(table, np.zeros((1, 1)), range(MIN_RACED_DRIVES), None, best)
    assert (alone.costs[0], alone.leader) == (costs[0].mean(), best)


def test_of_equal_costs_the_first_remains_the_leader():
    costs = np.tile(np.random.default_rng(2).normal(size=MIN_RACED_DRIVES), (2, 1))
    first = Leader(float(costs[0].mean()), costs[0])
    alone = race(Table(costs), np.zeros((1, 1)), range(MIN_RACED_DRIVES), None, first)
    assert alone.leader is first


def test_many_drives_need_a_fraction_of_the_evaluations_and_the_best_is_found():
    raced_, plain = Bowls(100), Bowls(100)
    found = searched(raced_)
    best = float(plain.costs(plain.bottoms.mean(axis=0)[None], None)[0])
    assert found.steps[-1] == 100 * raced_.asked
    assert raced_.asked < 0.25 * 20 * 30 * 100
    assert found.cost == plain.costs(found.point[None], None)[0]
    assert found.cost - best < 0.01 < 0.1 < found.best[0] - best


@pytest.mark.parametrize("polish", [0, 40])
def test_with_many_drives_it_resumes_with_the_same_bits(tmp_path: Path, polish: int):
    whole = searched(Bowls(100), polish=polish)
    for stopped in (1, 7, 29):
        folder = ResultFolder(tmp_path / f"{polish}-{stopped}", {}, resume=True)

        def stop(progress: Progress, at: int = stopped):
            if progress.generation == at:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            searched(Bowls(100), folder, stop, polish=polish)
        again = searched(Bowls(100), folder, polish=polish)
        for name in ("point", "best", "median", "steps"):
            assert getattr(again, name).tobytes() == getattr(whole, name).tobytes()


def test_the_leader_is_restored_with_the_same_bits():
    problem = Bowls(120)
    points = np.random.default_rng(3).uniform(-0.5, 0.5, (9, 3))
    result = race(problem, points, np.random.default_rng(4).permutation(120), None)
    assert result.leader is not None
    again = leader_at(problem, points[np.argmin(result.costs)], None)
    assert again.cost == result.leader.cost
    assert again.costs_by_drive.tobytes() == result.leader.costs_by_drive.tobytes()
