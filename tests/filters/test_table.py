"""A table of parameter sets equals the sets that it contains, one by one and in the kernel."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.filters.kernel_array import (
    MAX_CACHED_STARTS,
    MAX_STARTS,
    KernelArray,
    ParameterTable,
    _shared_starts,
)
from sigmaswarm.filters.names import FilterKind, ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import run_passes
from sigmaswarm.scoring.targets import tracking_pass
from sigmaswarm.tuning.config import Option
from sigmaswarm.tuning.receiver import prior_costs
from sigmaswarm.tuning.space import OPTIONS, search_space
from support import make_drive

SPACES: list[tuple[ModelName, FilterKind, tuple[Option, ...]]] = [
    ("planar5", "ukf", ()),
    ("planar5", "fuzzy-ukf", ()),
    ("planar8", "adaptive-ukf", ()),
    (
        "planar8",
        "ukf",
        tuple(option for option in OPTIONS if option not in ("gate", "imu-gate", "fix-error")),
    ),
    ("tilted12", "ekf", ("lateral", "gate")),
    ("robot-localization", "ekf", ("lateral", "odometer", "gate", "imu-gate")),
]


def table_of(model: ModelName, kind: FilterKind, use: Sequence[Option], n: int) -> ParameterTable:
    space = search_space(model, "log10", 0.02, kind=kind, use=use)
    return space.decode(np.random.default_rng(1).uniform(space.low, space.high, (n, len(space.names))))


@pytest.mark.parametrize(("model", "kind", "use"), SPACES)
@pytest.mark.parametrize("n", [1, 30, 70])
def test_a_table_is_packed_as_its_sets_are(model: ModelName, kind: FilterKind, use: Sequence[Option], n: int):
    table, start = table_of(model, kind, use, n), initial_state(make_drive(duration=12))
    arrays = [KernelArray(sets) for sets in (table, list(table))]
    ours, theirs = (array.start([start, start], [0.01, 0.005]) for array in arrays)
    assert ours.tobytes() == theirs.tobytes()
    assert np.array_equal(arrays[0].plausible, arrays[1].plausible)
    alone = [KernelArray([p]).start([start], [0.01])[0, :, :1] for p in table]
    side_by_side = np.concatenate(list(ours[::2]), axis=1)  # the first start of each block
    assert side_by_side[:, :n].tobytes() == np.concatenate(alone, axis=1).tobytes()
    part = KernelArray(table[n // 3 : n]).start([start], [0.01])
    assert np.concatenate(list(part), axis=1)[:, : n - n // 3].tobytes() == (
        np.concatenate(alone[n // 3 :], axis=1).tobytes()
    )


def test_shared_values_of_a_table_need_no_column():
    # as many sets as states, so that a vector in place of a column would have a valid shape
    p = FilterParameters(0.5, 2.0, 0.0, (1e-4, 2e-4, 3e-4, 4e-4, 5e-4), (1.0, 2.0))
    table = ParameterTable(p, {"latency": np.linspace(0.0, 0.1, 5)}, 5)
    start = initial_state(make_drive(duration=12))
    ours, theirs = (KernelArray(sets).start([start], [0.01]) for sets in (table, list(table)))
    assert ours.tobytes() == theirs.tobytes()


@pytest.mark.parametrize("vary_bias_std", [False, True])
def test_starts_computed_in_advance_equal_those_computed_on_use(vary_bias_std: bool):
    start, other = initial_state(make_drive(duration=12)), initial_state(make_drive(duration=20))
    table = table_of("tilted12", "ekf", (), 20)
    sets = list(table) if vary_bias_std else [replace(p, bias_std=(0.3, 0.01)) for p in table]
    array = KernelArray(sets)
    later = array.start([other, start], [0.01, 0.01])
    array.compute_starts([start, other])
    assert array.start([other, start], [0.01, 0.01]).tobytes() == later.tobytes()


def test_a_few_starts_are_cached_for_the_next_generation():
    start = initial_state(make_drive(duration=12))
    p = FilterParameters(0.5, 2.0, 0.0, (1e-4,) * 5, (1.0, 2.0))
    _shared_starts.cache_clear()
    for n, kept in ((MAX_CACHED_STARTS, 1), (MAX_CACHED_STARTS + 1, 1), (MAX_STARTS + 1, 1)):
        many = [replace(start) for _ in range(n)]
        array = KernelArray([p])
        array.compute_starts(many)
        assert len(array._starts) == (n if n <= MAX_STARTS else 0)
        assert _shared_starts.cache_info().currsize == kept


def test_an_optional_field_may_be_used_by_some_sets_only():
    p = FilterParameters(0.5, 2.0, 0.0, (1e-4,) * 5, (1.0, 2.0))
    sets = [p, replace(p, gate=9.2), replace(p, robust_dof=4.0)]
    assert list(ParameterTable.of(sets)) == sets


def test_a_table_is_a_sequence_of_sets():
    table = table_of("planar8", "ukf", ("lateral",), 5)
    assert len(table) == len(table[1:]) + 1 == 5
    assert table[1:][0] == table[1] != table[0]
    assert isinstance(table[-1], FilterParameters)
    std = np.array([[1.0, 2.0]])
    assert prior_costs(table, std).tobytes() == prior_costs(list(table), std).tobytes()


def test_sets_of_several_kinds_are_returned_in_their_order():
    table = table_of("planar8", "ukf", ("lateral",), 40)
    mixed = [replace(p, lateral_noise=None) if i % 3 else p for i, p in enumerate(table)]
    drive_pass = tracking_pass(prepare_drive(make_drive(duration=12)))
    together = run_passes([drive_pass, drive_pass], mixed)
    for i in (0, 1, 20, 39):
        alone = run_passes([drive_pass], [mixed[i]])
        assert together["NIS"][1, i] == alone["NIS"][0, 0]
