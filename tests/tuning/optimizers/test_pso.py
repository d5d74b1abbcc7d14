"""The particle swarm, compared with the paper's equations 2 and 3 for each particle."""

import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from oracles.particle_swarm import by_equations
from sigmaswarm.tuning.optimizers.swarms import ACCELERATION, INERTIA, ParticleSwarm

LOW, HIGH = np.array([-5.0, 0.0, 1.0]), np.array([5.0, 2.0, 1.5])


def bowl(points: np.ndarray) -> np.ndarray:
    return np.sum((points - [1.0, 3.0, 1.2]) ** 2, axis=1)  # minimum outside the bounds


@pytest.mark.parametrize("stop_at_bounds", [False, True])
@pytest.mark.parametrize("constants", [{}, {"w": 0.4, "c1": 2.0, "c2": 0.5}], ids=["paper", "others"])
def test_the_swarm_moves_by_equations_2_and_3(stop_at_bounds: bool, constants: dict):
    names = {"w": "inertia", "c1": "cognitive", "c2": "social"}
    swarm = ParticleSwarm(
        LOW,
        HIGH,
        7,
        np.random.default_rng(3),
        zero_velocity_at_bounds=stop_at_bounds,
        **{names[k]: v for k, v in constants.items()},
    )
    expected = by_equations(bowl, LOW, HIGH, 7, 3, 25, stop_at_bounds=stop_at_bounds, **constants)
    for x, v, g, cost in expected:
        points = swarm.ask()
        np.testing.assert_allclose(points, x, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(swarm.velocities, v, rtol=1e-12, atol=1e-12)
        swarm.tell(bowl(points))
        np.testing.assert_allclose(swarm.global_best, g, rtol=1e-12, atol=1e-12)
        assert swarm.global_cost == pytest.approx(cost, rel=1e-12)


def test_the_constants_are_the_paper_s():
    assert (INERTIA, ACCELERATION) == (0.7298, 1.5)


@given(seed=st.integers(0, 2**32), low=st.floats(-1e3, 1e3), width=st.floats(1e-6, 1e3), n=st.integers(2, 9))
def test_no_particle_leaves_the_bounds(seed: int, low: float, width: float, n: int):
    low, high = np.array([low, -1.0]), np.array([low + width, 1.0])
    swarm = ParticleSwarm(low, high, n, np.random.default_rng(seed))
    for _ in range(6):
        points = swarm.ask()
        assert np.all((points >= low) & (points <= high))
        swarm.tell(-points[:, 0])  # the minimum is at the upper bound
    assert np.all((swarm.global_best >= low) & (swarm.global_best <= high))


def test_the_velocity_at_a_bound_is_kept_or_set_to_zero():
    for zeroed in (False, True):
        swarm = ParticleSwarm(LOW, HIGH, 8, np.random.default_rng(0), zero_velocity_at_bounds=zeroed)
        stopped = 0
        for _ in range(10):
            points = swarm.ask()
            at_bound = (points == LOW) | (points == HIGH)
            stopped += at_bound.sum()
            assert np.all((swarm.velocities[at_bound] == 0) == zeroed)
            assert np.all(swarm.velocities[~at_bound] != 0)
            swarm.tell(bowl(points))
        assert stopped > 5


@given(seed=st.integers(0, 1000), data=st.data())
def test_nan_and_infinity_are_never_best(seed: int, data):
    swarm = ParticleSwarm(LOW, HIGH, 6, np.random.default_rng(seed))
    cost = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([np.nan, np.inf, -np.inf]))
    best = np.inf
    for _ in range(5):
        points = swarm.ask()
        costs = np.array(data.draw(st.lists(cost, min_size=6, max_size=6)))
        swarm.tell(costs)
        finite = costs[np.isfinite(costs)]
        if len(finite) and finite.min() < best:
            best = finite.min()
            winners = points[costs == best]
            assert swarm.global_best.tolist() in winners.tolist()
        assert swarm.global_cost == best
        assert not np.isnan(swarm.personal_cost).any()
        assert np.isfinite(swarm.positions).all()


def test_a_swarm_of_failures_continues():
    swarm = ParticleSwarm(LOW, HIGH, 5, np.random.default_rng(0))
    for _ in range(4):
        swarm.ask()
        swarm.tell(np.full(5, np.nan))
    assert swarm.global_cost == np.inf
    swarm.tell(bowl(swarm.ask()))
    assert np.isfinite(swarm.global_cost)


def test_calling_ask_twice_moves_once():
    swarm = ParticleSwarm(LOW, HIGH, 5, np.random.default_rng(0))
    np.testing.assert_array_equal(swarm.ask(), swarm.ask())
    swarm.tell(bowl(swarm.ask()))
    first = swarm.ask()
    np.testing.assert_array_equal(swarm.ask(), first)
    first[:] = 99.0  # changing the returned points does not change the swarm
    assert np.all(swarm.ask() <= HIGH)


@pytest.mark.parametrize("generation", range(6))
@pytest.mark.parametrize("told", [True, False])
def test_a_restored_swarm_continues_bit_for_bit(generation: int, told: bool):
    def run(swarm: ParticleSwarm, times: int) -> list[bytes]:
        seen = []
        for _ in range(times):
            swarm.tell(bowl(swarm.ask()))
            seen.append(b"".join(v.tobytes() for v in swarm.state().values() if isinstance(v, np.ndarray)))
        return seen

    swarm = ParticleSwarm(LOW, HIGH, 6, np.random.default_rng(1))
    run(swarm, generation)
    if not told:
        swarm.ask()
    state = copy.deepcopy(swarm.state())
    other = ParticleSwarm(LOW, HIGH, 6, np.random.default_rng(777))
    other.restore(state)
    assert run(other, 8) == run(swarm, 8)
    assert other.global_cost == swarm.global_cost


def test_it_finds_the_minimum_of_a_bowl():
    dimensions = 10
    low, high = np.full(dimensions, -5.0), np.full(dimensions, 5.0)
    found = []
    for seed in range(5):
        swarm = ParticleSwarm(low, high, 30, np.random.default_rng(seed))
        for _ in range(200):
            swarm.tell(np.sum((swarm.ask() - 1.0) ** 2, axis=1))
        found.append(swarm.global_cost)
    assert max(found) < 1e-6
