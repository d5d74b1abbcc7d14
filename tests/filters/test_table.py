"""A table of parameter sets is the sets that it stands for, to whoever looks at one and to the kernel."""

import pickle
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.prepared import prepared
from sigmaswarm.filters.groups import (
    KEPT_INTERVALS,
    KEPT_STARTS,
    MANY_STARTS,
    Chunk,
    Group,
    Sets,
    _shared,  # pyright: ignore[reportPrivateUsage]
    start_rows,
)
from sigmaswarm.filters.names import FilterKind, ModelName
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.replay import run_replays
from sigmaswarm.filters.table import ParameterTable
from sigmaswarm.scoring.targets import tracking_replay
from sigmaswarm.tuning.options import Option
from sigmaswarm.tuning.prior import prior_costs
from sigmaswarm.tuning.space import OPTIONS, search_space
from support import make_drive

SPACES: list[tuple[ModelName, FilterKind, tuple[Option, ...]]] = [
    ("planar5", "ukf", ()),
    ("planar5", "fuzzy-ukf", ()),
    ("planar8", "adaptive-ukf", ()),
    ("planar8", "ukf", tuple(option for option in OPTIONS if option != "gate")),
    ("tilted12", "ekf", ("lateral", "gate")),
]


def table_of(model: ModelName, kind: FilterKind, use: Sequence[Option], n: int) -> ParameterTable:
    space = search_space(model, "log10", 0.02, kind=kind, use=use)
    return space.decode(np.random.default_rng(1).uniform(space.low, space.high, (n, len(space.names))))


@pytest.mark.parametrize(("model", "kind", "use"), SPACES)
@pytest.mark.parametrize("n", [1, 30, 70])
def test_a_table_packs_as_its_sets_do(model: ModelName, kind: FilterKind, use: Sequence[Option], n: int):
    table, start = table_of(model, kind, use, n), initial_state(make_drive(duration=12))
    chunks = [Sets(sets).packed(range(n))[0][1] for sets in (table, list(table))]
    ours, theirs = (start_rows([start, start], [0.01, 0.005], chunk) for chunk in chunks)
    assert ours.tobytes() == theirs.tobytes()
    assert np.array_equal(chunks[0].plausible, chunks[1].plausible)
    alone = np.concatenate([start_rows([start], [0.01], Chunk.of([p]))[0, :, :1] for p in table], axis=1)
    side_by_side = np.concatenate(list(ours[::2]), axis=1)  # of each block the first start
    assert side_by_side[:, :n].tobytes() == alone.tobytes()


def test_what_sets_of_a_table_share_need_no_column():
    # as many sets as states, where a vector in place of a column would fit by chance
    p = FilterParameters(0.5, 2.0, 0.0, (1e-4, 2e-4, 3e-4, 4e-4, 5e-4), (1.0, 2.0))
    table, start = (
        ParameterTable(p, {"latency": np.linspace(0.0, 0.1, 5)}),
        initial_state(make_drive(duration=12)),
    )
    ours, theirs = (start_rows([start], [0.01], Chunk.of(sets)) for sets in (table, list(table)))
    assert ours.tobytes() == theirs.tobytes()


def test_a_group_keeps_rows_of_few_intervals():
    table, start = table_of("planar5", "ukf", (), 3), initial_state(make_drive(duration=12))
    chunk, intervals = Chunk.of(table), np.linspace(0.01, 0.02, KEPT_INTERVALS + 8).tolist()
    together = start_rows([start] * len(intervals), intervals, chunk)
    for rows, interval in zip(together, intervals, strict=True):
        assert rows.tobytes() == start_rows([start], [interval], Chunk.of(table))[0].tobytes()
    assert len(chunk.group._fresh) == KEPT_INTERVALS  # pyright: ignore[reportPrivateUsage]


def test_known_starts_are_those_that_are_found():
    table, start = table_of("tilted12", "ekf", (), 20), initial_state(make_drive(duration=12))
    group = Group(table)
    found = group.starts([start], slice(0, 16))
    group.keep_starts([start])
    for kept, one in zip(group.starts([start], slice(0, 16))[start], found[start], strict=True):
        assert kept.tobytes() == one.tobytes()


def test_what_one_group_has_kept_serves_the_next_where_it_is_the_same():
    start = initial_state(make_drive(duration=12))
    p = FilterParameters(0.5, 2.0, 0.0, (1e-4,) * 8, (1.0, 2.0), "planar8")
    others = [replace(p, alpha=0.1), replace(p, bias_std=(0.5, 0.02)), replace(p, process_noise=(2e-4,) * 8)]
    _shared.cache_clear()
    alone = [start_rows([start], [0.01], Chunk.of([one]))[0, :, :1] for one in [p, *others]]
    first = Group([p, *others[::2]])
    first.keep_starts([start])
    assert [*_shared(p).starts] == [start]
    for sets in ([p, *others], [p, *others[::2]], [p] * 8):
        group = Group(sets)
        group.keep_starts([start])
        rows = start_rows([start], [0.01], Chunk(group, 0, len(sets)))[0]
        wanted = [alone[[p, *others].index(one)] for one in sets]
        assert rows[:, : len(sets)].tobytes() == np.concatenate(wanted, axis=1).tobytes()
    Group([p]).keep_starts([replace(start) for _ in range(50)])
    later = Group([p] * 8)
    later.keep_starts([start])
    assert len(pickle.dumps(later)) < 1.1 * len(pickle.dumps(group))  # what travels is its own


def test_few_starts_are_kept_for_the_next():
    start, p = (
        initial_state(make_drive(duration=12)),
        FilterParameters(0.5, 2.0, 0.0, (1e-4,) * 5, (1.0, 2.0)),
    )
    _shared.cache_clear()
    for n in (KEPT_STARTS - 5, 10, KEPT_STARTS + 1, MANY_STARTS + 1):
        many = [replace(start) for _ in range(n)]
        group = Group([p])
        group.keep_starts(many)
        assert len(_shared(p).starts) <= KEPT_STARTS
        assert [*group.starts(many[-2:], slice(0, 8))] == many[-2:]
    assert not group._starts  # pyright: ignore[reportPrivateUsage]


def test_a_table_is_a_sequence_of_sets():
    table = table_of("planar8", "ukf", ("lateral",), 5)
    assert len(table) == len(table[1:]) + 1 == 5
    assert table[1:][0] == table[1] != table[0]
    assert isinstance(table[-1], FilterParameters)
    std = np.array([[1.0, 2.0]])
    assert prior_costs(table, std).tobytes() == prior_costs(list(table), std).tobytes()


def test_sets_of_several_kinds_come_back_in_their_order():
    table = table_of("planar8", "ukf", ("lateral",), 40)
    mixed = [replace(p, lateral_noise=None) if i % 3 else p for i, p in enumerate(table)]
    replay = tracking_replay(prepared(make_drive(duration=12)))
    together = run_replays([replay, replay], mixed)
    for i in (0, 1, 20, 39):
        alone = run_replays([replay], [mixed[i]])
        assert together.nis[1, i] == alone.nis[0, 0]
