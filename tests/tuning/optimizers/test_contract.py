"""Properties of every optimizer, with and without polish: resumable, reproducible, within bounds and budget."""

import random
from importlib.util import find_spec
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.errors import InputError
from sigmaswarm.tuning.config import OptimizerName
from sigmaswarm.tuning.optimizers import OPTIMIZERS, Optimizer, create_optimizer
from sigmaswarm.tuning.store import load_checkpoint, save_checkpoint
from support import quickly

LOW, HIGH = np.array([-5.0, 0.0, 1e-3]), np.array([5.0, 2.0, 1.5])
NEEDS = {"bo": pytest.mark.skipif(find_spec("sklearn") is None, reason="bo needs scikit-learn")}
everyone = pytest.mark.parametrize(
    "name", [pytest.param(name, marks=NEEDS.get(name, ()), id=name) for name in OPTIMIZERS]
)
# cheap settings of the Gaussian process; the tested properties do not depend on them
CHEAP = {"bo": {"batch": 6, "candidates": 30, "searches": 0}}
with_and_without = pytest.mark.parametrize("polish", [0, 25])
without_a_process = pytest.mark.parametrize(
    "name", quickly([(name,) for name in OPTIMIZERS], lambda name: name != "bo")
)


def made(name: str, seed: int = 3, **changes: Any) -> Optimizer:
    asked = {"population": 6, "budget": 64, **CHEAP.get(name, {}), **changes}
    return create_optimizer(name, LOW, HIGH, rng=np.random.default_rng(seed), **asked)


def bowl(points: np.ndarray) -> np.ndarray:
    costs = np.sum((points - [1.0, 3.0, 1.2]) ** 2, axis=1)  # minimum outside the bounds
    costs[points[:, 0] < -3] = np.nan
    costs[points[:, 0] > 3.5] = np.inf
    return costs


def generations(optimizer: Optimizer, cost=bowl, most: int = 200) -> list[bytes]:
    seen = []
    while len(seen) < most and len(points := optimizer.ask()):
        optimizer.tell(cost(points))
        best = np.append(optimizer.global_best, optimizer.global_cost)
        seen.append(points.tobytes() + best.tobytes())
    return seen


def reborn(optimizer: Optimizer, path: Path, **made_with: Any) -> Optimizer:
    """Return a new optimizer restored from a checkpoint that is written as `tune` writes it."""
    state = optimizer.state()
    save_checkpoint(path, state, {"rng": state.pop("rng")})
    arrays, notes = load_checkpoint(path) or pytest.fail("no checkpoint")
    fresh = made(seed=777, **made_with)
    fresh.restore(arrays | notes)
    return fresh


@everyone
@pytest.mark.parametrize(
    ("polish", "between"),
    quickly(
        [(0, "told"), (0, "asked"), (25, "told"), (25, "asked")],
        lambda polish, between: between == "asked",
    ),
)
def test_a_restored_optimizer_continues_bit_for_bit(name: str, polish: int, between: str, tmp_path: Path):
    whole = generations(made(name, polish=polish))
    optimizer, seen = made(name, polish=polish), []
    while True:
        if between == "asked":
            optimizer.ask()
        # restore in each generation, so that every generation comes from a checkpoint
        optimizer = reborn(optimizer, tmp_path / "checkpoint.npz", name=name, polish=polish)
        step = generations(optimizer, most=1)
        if not step:
            break
        seen += step
    assert seen == whole
    assert len(whole) >= 10


@without_a_process
@with_and_without
def test_restoring_overwrites_the_whole_state_of_an_optimizer(name: str, polish: int, tmp_path: Path):
    for stop in (3, 9) if name == "bo" else (2, 5, 9):
        optimizer, other = made(name, polish=polish), made(name, seed=9, polish=polish)
        generations(optimizer, most=stop)
        generations(other)  # to the end, so that its polish has started
        state = optimizer.state()
        save_checkpoint(tmp_path / "checkpoint.npz", state, {"rng": state.pop("rng")})
        arrays, notes = load_checkpoint(tmp_path / "checkpoint.npz") or pytest.fail("no checkpoint")
        other.restore(arrays | notes)
        assert generations(other) == generations(optimizer)


@without_a_process
@with_and_without
def test_one_seed_gives_one_result(name: str, polish: int):
    first = generations(made(name, polish=polish))
    assert first == generations(made(name, polish=polish))
    assert first != generations(made(name, seed=4, polish=polish))


@everyone
def test_calling_ask_twice_equals_calling_it_once(name: str):
    optimizer, patient = made(name, polish=20), made(name, polish=20)
    seen = []
    while len(points := optimizer.ask()):
        points[:] = 99.0  # changing the returned points does not change the optimizer
        again = optimizer.ask()
        optimizer.tell(bowl(again))
        seen.append(again.tobytes() + np.append(optimizer.global_best, optimizer.global_cost).tobytes())
    assert seen == generations(patient)


@everyone
@given(
    seed=st.integers(0, 2**32),
    population=st.integers(2, 12),
    dimensions=st.integers(1, 6),
    budget=st.integers(3, 60),
    polished=st.sampled_from([0.0, 0.5]),
    corner=st.floats(-1e3, 1e3),
    width=st.floats(1e-6, 1e3),
    failing=st.sampled_from([0.0, 0.3, 0.9]),
)
def test_bounds_and_budget_are_respected_and_failures_are_never_best(
    name, seed, population, dimensions, budget, polished, corner, width, failing
):
    chance = np.random.default_rng(seed)
    low = np.full(dimensions, corner)
    high = low + width * chance.uniform(0.5, 1, dimensions)
    pull = chance.uniform(-1, 1, dimensions)  # minimum in a corner of the bounds
    optimizer = create_optimizer(
        name,
        low,
        high,
        population=population,
        budget=budget,
        polish=int(polished * budget),
        rng=np.random.default_rng(seed),
        **CHEAP.get(name, {}),
    )
    spent, best, best_points = 0, np.inf, []
    while len(points := optimizer.ask()):
        assert np.all((points >= low) & (points <= high))
        costs = points @ pull
        fails = chance.random(len(costs)) < failing
        costs[fails] = chance.choice([np.nan, np.inf, -np.inf], fails.sum())
        optimizer.tell(costs)
        spent += len(points)
        fine = np.isfinite(costs)
        if fine.any() and costs[fine].min() < best:
            best = costs[fine].min()
            best_points = points[fine & (costs == best)].tolist()
        assert optimizer.global_cost == best
        assert not best_points or optimizer.global_best.tolist() in best_points
    assert spent <= budget
    if name != "nelder-mead" and not polished:
        assert spent == budget  # only a simplex may converge before the end


@everyone
@pytest.mark.parametrize("failure", [np.inf, np.nan, -np.inf])
@with_and_without
def test_a_function_that_fails_everywhere(name: str, failure: float, polish: int):
    optimizer = made(name, polish=polish, budget=300)
    asked = 0
    while len(points := optimizer.ask()):
        optimizer.tell(np.full(len(points), failure))
        asked += len(points)
    assert optimizer.global_cost == np.inf
    assert asked == 300 or name == "nelder-mead"


@everyone
def test_a_plateau(name: str):
    optimizer = made(name, budget=60 if name == "bo" else 600)
    while len(points := optimizer.ask()):
        assert np.all((points >= LOW) & (points <= HIGH))
        optimizer.tell(np.ones(len(points)))
    assert optimizer.global_cost == 1.0


@without_a_process
def test_it_continues_after_the_exact_optimum_is_found(name: str):
    optimizer = made(name, budget=120 if name == "bo" else 6000)
    while len(points := optimizer.ask()):
        assert np.isfinite(points).all()
        optimizer.tell(np.sum((points - [1.0, 1.0, 1.2]) ** 2, axis=1))
    assert optimizer.global_cost < (0.5 if name in ("random", "sobol", "bo") else 1e-3)


@everyone
def test_the_global_random_states_do_not_change(name: str):
    generations(made(name, polish=20))  # the import of a library may use random numbers
    numpys, pythons = np.random.get_state()[1].copy(), random.getstate()  # noqa: NPY002 (compared below)
    generations(made(name, polish=20))
    np.testing.assert_array_equal(np.random.get_state()[1], numpys)  # noqa: NPY002 (as above)
    assert random.getstate() == pythons


def test_options_and_optimizers_have_the_same_names():
    assert list(OPTIMIZERS) == list(get_args(OptimizerName))


@everyone
def test_costs_of_another_shape_are_rejected(name: str):
    optimizer = OPTIMIZERS[name](LOW, HIGH, 6, np.random.default_rng(0))
    n = len(optimizer.ask())
    for shape in ((n + 1,), (n, 1), ()):
        with pytest.raises(ValueError, match="but the costs have shape"):
            optimizer.tell(np.zeros(shape))


@pytest.mark.parametrize(
    ("name", "changes", "said"),
    [
        ("pos", {}, "optimizer = 'pos' is unknown; choose one of pso, ga, "),
        (
            "de",
            {"inertia": 0.5},
            "inertia is not an option of the optimizer de, which has base, scale, crossover",
        ),
        ("random", {"inertia": 0.5}, "which has none"),
        ("pso", {"population": 1}, "population = 1, .* at least 2"),
        ("pso", {"budget": 0}, "budget = 0"),
        ("pso", {"polish": 64}, "polish = 64"),
        ("pso", {"polish": -1}, "polish = -1"),
    ],
)
def test_wrong_options_are_reported(name: str, changes: dict, said: str):
    with pytest.raises(InputError, match=said):
        made(name, **changes)


@everyone
def test_a_search_starts_at_a_given_point(name: str):
    point = np.array([1.0, 1.9, 1.2])
    optimizer = made(name)
    optimizer.begin_near(point)
    first = optimizer.ask()
    if name == "cma-es":  # the first distribution is centered at the point
        assert np.abs(first - point).mean() < np.abs(made(name).ask() - point).mean()
    else:
        assert first[0].tolist() == point.tolist()
    assert min(generations(optimizer), key=lambda _: optimizer.global_cost)
    assert optimizer.global_cost <= bowl(point[np.newaxis])[0] + 0.5
