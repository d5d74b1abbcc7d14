"""Differential evolution, compared with its equations for each member."""

import numpy as np
import pytest

from sigmaswarm.tuning.optimizers.evolution import DifferentialEvolution

LOW, HIGH = np.array([-5.0, 0.0, 1.0, -1.0]), np.array([5.0, 2.0, 1.5, 1.0])


def bowl(points: np.ndarray) -> np.ndarray:
    return np.sum((points - [1.0, 3.0, 1.2, 0.0]) ** 2, axis=1)


@pytest.mark.parametrize("base", ["best", "rand"])
@pytest.mark.parametrize("population", [4, 6])
def test_trials_are_combinations_of_members(base: str, population: int):
    search = DifferentialEvolution(LOW, HIGH, population, np.random.default_rng(1), base=base)
    search.tell(bowl(search.ask()))
    copied = scaled = outside = 0
    for _ in range(30):
        x, costs = search.members.copy(), search.member_costs.copy()
        replay = np.random.default_rng()
        replay.bit_generator.state = search.rng.bit_generator.state
        factor = replay.uniform(0.5, 1.0)
        trials = search.ask()
        for i in range(population):
            # every coordinate is the parent's, or base + F (x_r1 - x_r2) of one choice of members, or redrawn
            own = trials[i] == x[i]
            others = [k for k in range(population) if k != i]
            bases = [int(np.argmin(costs))] if base == "best" else others
            fits = []
            for b in bases:
                for r1 in others:
                    for r2 in others:
                        if r1 != r2 and (base == "best" or b not in (r1, r2)):
                            mutant = x[b] + factor * (x[r1] - x[r2])
                            wide = (mutant < LOW) | (mutant > HIGH)
                            same = np.isclose(trials[i], mutant, rtol=1e-12, atol=1e-15)
                            fits.append((np.all(own | same | wide), np.sum(same), np.sum(wide & ~own)))
            assert any(fit for fit, _, _ in fits)
            _, most, put_back = max(fits)
            copied, scaled, outside = copied + own.sum(), scaled + most, outside + put_back
        told = bowl(trials)
        search.tell(told)
        for i in range(population):
            wins = told[i] <= costs[i]
            np.testing.assert_array_equal(search.members[i], trials[i] if wins else x[i])
            assert search.member_costs[i] == min(told[i], costs[i])
    assert min(copied, scaled, outside) > 0


def test_the_mutant_contributes_the_fraction_cr():
    search = DifferentialEvolution(LOW, HIGH, 500, np.random.default_rng(1))
    search.tell(bowl(search.ask()))
    own = search.ask() == search.members
    assert own.mean() == pytest.approx(0.3 * 0.75, abs=0.02)  # (1 - CR) (1 - 1/d)
    assert not own.all(axis=1).any()


def test_the_other_members_are_three_different_ones():
    search = DifferentialEvolution(LOW, HIGH, 7, np.random.default_rng(0))
    counts = np.zeros((7, 7))
    for _ in range(2000):
        r1, r2, r3 = search._others()
        for i in range(7):
            assert len({i, r1[i], r2[i], r3[i]}) == 4
        counts[np.arange(7), r1] += 1
    off = counts[~np.eye(7, dtype=bool)] / 2000
    np.testing.assert_allclose(off, 1 / 6, atol=0.04)


def test_coordinates_outside_the_bounds_are_redrawn_within_them():
    search = DifferentialEvolution(np.zeros(2), np.ones(2), 40, np.random.default_rng(0), scale=(1.9, 1.9))
    search.tell(np.sum(search.ask(), axis=1))
    points = np.concatenate([search._next() for _ in range(50)])
    assert points.min() > 0 and points.max() < 1  # clipping would put some on the bounds
    assert np.mean(points) > 0.3  # although the best point is in the corner
