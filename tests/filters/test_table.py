"""A table of parameter sets is the sets that it stands for, to whoever looks at one and to the kernel."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.prepared import prepared
from sigmaswarm.filters.groups import KEPT_INTERVALS, Chunk, Group, Sets, start_rows
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
