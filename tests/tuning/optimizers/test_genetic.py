"""The genetic operators, compared with pymoo's, and the selection of the next population."""

import numpy as np
import pytest
from scipy.stats import ks_2samp

from sigmaswarm.tuning.optimizers.evolution import GeneticAlgorithm, _winners, mutated, offspring
from sigmaswarm.tuning.optimizers.swarms import GeneticSwarm

N = 20_000
BOX = (np.array([0.0]), np.array([1.0]))


@pytest.mark.parametrize("parents", [(0.3, 0.6), (0.02, 0.9), (0.97, 0.99)])
def test_children_are_distributed_as_in_pymoo(parents: tuple[float, float]):
    sbx = pytest.importorskip("pymoo.operators.crossover.sbx")
    couple = np.array(parents)[:, np.newaxis]
    ours = offspring(couple, np.zeros(2), N, BOX, np.random.default_rng(0), crossover=1.0)
    chance, full = np.random.default_rng(1), np.ones((N // 2, 1))
    X = np.broadcast_to(couple[:, np.newaxis], (2, N // 2, 1)).copy()
    theirs = sbx.cross_sbx(X, *BOX, 15.0 * full, 0.5, 0.5 * full, random_state=chance)
    moved = [values[~np.isin(values, parents)] for values in (ours.ravel(), theirs.ravel())]
    assert ks_2samp(*moved).pvalue > 0.01


def test_few_members_mate_with_themselves():
    parents = np.arange(8.0)[:, np.newaxis]
    children = offspring(
        parents, np.arange(8.0), 8, (np.zeros(1), np.full(1, 8.0)), np.random.default_rng(0), crossover=0.0
    )
    couples = children.reshape(2, 4).T
    assert np.all(couples[:, 0] != couples[:, 1])


@pytest.mark.parametrize("place", [0.5, 0.01, 1.0])
def test_mutants_are_distributed_as_in_pymoo(place: float):
    pm = pytest.importorskip("pymoo.operators.mutation.pm")
    points = np.full((N, 1), place)
    ours = mutated(points, BOX, np.random.default_rng(0))
    theirs = pm.mut_pm(
        points, *BOX, np.full(N, 20.0), np.ones(N), False, random_state=np.random.default_rng(1)
    )
    assert ks_2samp(ours.ravel(), theirs.ravel()).pvalue > 0.01


def test_one_coordinate_in_d_is_mutated():
    points = np.full((4000, 8), 0.5)
    box = (np.zeros(8), np.ones(8))
    changed = mutated(points, box, np.random.default_rng(0)) != points
    assert changed.mean() == pytest.approx(1 / 8, abs=0.01)


def test_every_member_competes_equally_often_and_the_better_wins():
    costs = np.array([3.0, 1.0, 2.0, 0.0, np.inf, 5.0])
    winners = np.concatenate([_winners(costs, 6, np.random.default_rng(seed)) for seed in range(300)])
    counts = np.bincount(winners, minlength=6) / 300
    assert counts[3] == 2.0  # always wins both of its tournaments
    assert counts[4] == 0.0
    assert counts[3] > counts[1] > counts[2] > counts[0] > counts[5]


def bowl(points: np.ndarray) -> np.ndarray:
    return np.sum(points**2, axis=1)


def test_the_best_of_parents_and_children_are_kept():
    search = GeneticAlgorithm(np.full(3, -1.0), np.ones(3), 7, np.random.default_rng(0))
    search.tell(bowl(search.ask()))
    for _ in range(20):
        before = np.concatenate([search.member_costs, bowl(children := search.ask())])
        assert not any((children[:, np.newaxis] == search.members).all(axis=2).ravel())  # no duplicates
        search.tell(bowl(children))
        np.testing.assert_array_equal(search.member_costs, np.sort(before)[:7])
        np.testing.assert_array_equal(bowl(search.members), search.member_costs)


@pytest.mark.parametrize("population", [2, 7, 8])
def test_the_better_half_of_the_hybrid_moves_as_a_swarm_and_the_rest_is_bred(population: int):
    d = 3
    search = GeneticSwarm(np.full(d, -1.0), np.ones(d), population, np.random.default_rng(0))
    search.tell(bowl(search.ask()))
    for _ in range(15):
        elites = np.argsort(search.costs, kind="stable")[: (population + 1) // 2]
        x, v, p = search.positions[elites], search.velocities[elites], search.personal_best[elites]
        g = search.global_best.copy()
        replay = np.random.default_rng()
        replay.bit_generator.state = search.rng.bit_generator.state
        r1, r2 = replay.random((2, len(elites), d))
        points = search.ask()
        flown = 0.7298 * v + 1.5 * r1 * (p - x) + 1.5 * r2 * (g - x)  # the paper's eq. 2
        np.testing.assert_allclose(search.velocities[: len(elites)], flown, rtol=1e-12, atol=1e-15)
        expected = np.clip(x + flown, -1, 1)  # eq. 3
        np.testing.assert_allclose(points[: len(elites)], expected, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(search.personal_best[: len(elites)], p)
        assert not search.velocities[len(elites) :].any()
        assert np.isinf(search.personal_cost[len(elites) :]).all()
        search.tell(bowl(points))
        np.testing.assert_array_equal(search.personal_best[len(elites) :], points[len(elites) :])
