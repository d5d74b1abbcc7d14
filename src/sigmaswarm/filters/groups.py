"""Parameter sets side by side in the lanes of the compiled kernel, what they start with, and what they add up.

What is done once a drive and a chunk costs time beside a kernel that takes 0.2 ms, and it holds Python's lock while
other threads wait: so it is done for all sets, and all drives, together.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.alignment import InitialState
from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.filters.compiled.layout import (
    CONSTANT_ROWS,
    MEAN,
    N_KEPT,
    N_STATE,
    Q0,
    R,
    lanes_for,
    most_lanes,
)
from sigmaswarm.filters.constants import constants_of, write_constants
from sigmaswarm.filters.models import MODELS, THETA
from sigmaswarm.filters.names import ModelName
from sigmaswarm.filters.packing import SHOWN, pack_states, sound_lanes
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.schedule import Switches, starts_of, switches
from sigmaswarm.filters.student import OUTLIERS_SPAN
from sigmaswarm.filters.table import Fields, ParameterTable, apart, shared_fields

Starts = dict[InitialState, tuple[Array, Array]]
"""State rows (N_STATE, lanes) of filters at starts, and their headings (lanes,), rad; one lane where all are alike."""

KEPT_INTERVALS = 64
"""So many of the drives' intervals a group keeps rows for: each log has one of its own, and a fleet has thousands."""

MANY_STARTS = 20_000
"""More starts of lanes, 3 kB each, are found when it is their turn."""

KEPT_STARTS = 1_000
"""So many, 3 kB each, are kept from one generation to the next."""


class Group:
    """Any number of parameter sets of one model and with the same switches, which can run side by side.

    Each has a lane, and the last one `most_lanes`, so that any chunk that begins at one of them is full.

    Attributes
    ----------
    like : FilterParameters
        One of them, or one with the same model and switches.
    reads : tuple
        What it needs of a drive: the axes of its model; whether fixes state their accuracy; what `Switches` say.
    plausible : ndarray of bool, shape (lanes,)
        With Q >= 0 and R > 0 nothing but rounding can make P indefinite; otherwise it may go unnoticed for long.
    """

    def __init__(self, sets: Sequence[FilterParameters]) -> None:
        self.like, columns = apart(sets)
        kinds = MODELS[self.like.model].kinds
        if self.like.kind not in kinds:
            raise InputError(
                f"{self.like.model} is not compiled as {self.like.kind}; take kind {' or '.join(kinds)}, "
                "or run_textbook"
            )
        lanes = np.minimum(np.arange(len(sets) + most_lanes(self.like.model) - 1), len(sets) - 1)
        shared = _shared(self.like)
        of = shared.fields | columns
        constants = np.repeat(shared.constants, len(sets), axis=1)
        write_constants(constants, of, columns)
        self._constants = constants[:, lanes]
        self._interval = _in_lanes(of["nominal_interval"], lanes)
        self._bias_std = _in_lanes(of["bias_std"], lanes)
        q, r = (_in_lanes(of[name], lanes) for name in ("process_noise", "measurement_noise"))
        self.plausible = (q.min(axis=1) >= 0) & (r.min(axis=1) > 0)
        accuracy = bool(self._constants[R.ACCURACY - CONSTANT_ROWS.start].any())
        self.reads = self.like.model, accuracy, switches(self.like)
        self._fresh: dict[float, Array] = {}
        self._start_alike = "bias_std" not in columns
        self._starts: Starts = {}

    def fresh(self, nominal_interval: float) -> Array:
        """All that its filters are beside their state before they begin, shape (N_KEPT, lanes).

        ``nominal_interval`` (s) is the drive's: Q is converted where a set refers to another one.
        """
        rows = self._fresh.get(nominal_interval)
        if rows is None:
            own = self._interval
            rows = np.repeat(_FRESH, len(own), axis=1)
            rows[CONSTANT_ROWS] = self._constants
            rows[Q0 : Q0 + len(MEAN)] *= nominal_interval / np.where(own > 0.0, own, nominal_interval)
            # less a bit, whatever rounding does to times since 1970
            rows[R.PATIENCE] = (OUTLIERS_SPAN - 1e-6) / nominal_interval
            if len(self._fresh) < KEPT_INTERVALS:
                self._fresh[nominal_interval] = rows
        return rows

    def keep_starts(self, initial: Sequence[InitialState]) -> None:
        """Find out where all of them begin, and keep it: it takes as long as for a few of them."""
        shared = _shared(self.like)
        known = shared.starts if self._start_alike else {}
        unknown = [start for start in dict.fromkeys(initial) if start not in known]
        if len(unknown) * (1 if self._start_alike else len(self._bias_std)) > MANY_STARTS:
            return
        if unknown:
            found = self._starts_in(unknown, slice(None))
            known = known | found
            if self._start_alike and len(found) <= KEPT_STARTS:
                shared.starts = known if len(known) <= KEPT_STARTS else found
        self._starts = {start: known[start] for start in initial}

    def starts(self, initial: Sequence[InitialState], lanes: slice) -> Starts:
        """Where those in some lanes begin."""
        if self._start_alike:
            lanes = slice(None)
        if all(start in self._starts for start in initial):
            known = ((start, *self._starts[start]) for start in initial)
            return {start: (state[:, lanes], heading[lanes]) for start, state, heading in known}
        return self._starts_in([*dict.fromkeys(initial)], lanes)

    def _starts_in(self, initial: Sequence[InitialState], lanes: slice) -> Starts:
        bias_std = self._bias_std[:1] if self._start_alike else self._bias_std[lanes]
        mean, covariance = starts_of(initial, MODELS[self.like.model], bias_std)
        found = zip(pack_states(mean, covariance, self.like.model), mean[..., THETA], strict=True)
        return dict(zip(initial, found, strict=True))


@dataclass(eq=False)
class _Shared:
    """What is the same of all sets that are like one, but for what they have columns of.

    Attributes
    ----------
    fields : dict
        As `shared_fields` gives them.
    constants : ndarray, shape (N_CONSTANTS, 1)
    starts : dict
        As far as they were asked for; a new one takes its place, for others may be looking at it.
    """

    fields: Fields
    constants: Array
    starts: Starts


@lru_cache(8)
def _shared(like: FilterParameters) -> _Shared:
    """Kept, for generations are all alike."""
    of = shared_fields(like)
    return _Shared(of, constants_of(of), {})


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some sets of a group, to run side by side over any number of replays: up to `most_lanes` at a time, a block.

    Attributes
    ----------
    group : Group
    first, size : int
        Its first set's place in the group, and how many it has.
    """

    group: Group
    first: int
    size: int

    @classmethod
    def of(cls, sets: Sequence[FilterParameters]) -> "Chunk":
        """Of so many sets."""
        return cls(Group(sets), 0, len(sets))

    @property
    def like(self) -> FilterParameters:
        """One with the model and the switches of all its sets; of a single set, itself."""
        return self.group.like

    @property
    def model(self) -> ModelName:
        """Of all its sets."""
        return self.group.like.model

    @property
    def width(self) -> int:
        """Lanes of a block."""
        return lanes_for(-(-self.size // self.blocks))

    @property
    def blocks(self) -> int:
        """How many it takes."""
        return -(-self.size // most_lanes(self.model))

    @property
    def lanes(self) -> slice:
        """Of the group's: whole blocks. Those left have sets that do not belong to it."""
        return slice(self.first, self.first + self.blocks * self.width)

    @property
    def plausible(self) -> NDArray[np.bool_]:
        """See `Group`; shape (n_sets,)."""
        return self.group.plausible[self.first : self.first + self.size]


Packed = Sequence[tuple[NDArray[np.intp], Chunk]]
"""Parameter sets in chunks for the kernel, and where each chunk's sets stand among them all."""


class Sets:
    """Parameter sets in groups, and where each group's sets stand among them all."""

    def __init__(self, parameter_sets: Sequence[FilterParameters]) -> None:
        if isinstance(parameter_sets, ParameterTable):
            self.groups = [(np.arange(len(parameter_sets)), Group(parameter_sets))]
            return
        alike: dict[tuple[str, Switches], list[int]] = {}
        for i, p in enumerate(parameter_sets):
            alike.setdefault((p.model, switches(p)), []).append(i)
        each = alike.values()
        self.groups = [(np.array(places), Group([parameter_sets[i] for i in places])) for places in each]

    def packed(self, part: range) -> Packed:
        """Some of them; where they stand is counted from the first of these."""
        chunks: list[tuple[NDArray[np.intp], Chunk]] = []
        for places, group in self.groups:
            first, last = (int(places.searchsorted(end)) for end in (part.start, part.stop))
            if first < last:
                chunks.append((places[first:last] - part.start, Chunk(group, first, last - first)))
        return chunks


def pack(parameter_sets: Sequence[FilterParameters]) -> Packed:
    """All of some sets."""
    return Sets(parameter_sets).packed(range(len(parameter_sets)))


def _in_lanes(field: Any, lanes: NDArray[np.intp]) -> Array:
    """What each lane's set has of a field."""
    if isinstance(field, np.ndarray):
        return field[lanes]
    return np.repeat(np.array(field, dtype=np.float64)[np.newaxis], len(lanes), axis=0)


def pack_constants(parameter_sets: Sequence[FilterParameters], nominal_interval: float) -> Array:
    """The kernel's constants, shape (N_CONSTANTS, lanes), of some sets on a drive of that interval, s."""
    chunk = Chunk.of(parameter_sets)
    return chunk.group.fresh(nominal_interval)[CONSTANT_ROWS, chunk.lanes]


def start_rows(initial: Sequence[InitialState], nominal_intervals: Sequence[float], chunk: Chunk) -> Array:
    """All that a chunk's filters are at m starts, shape (blocks * m, N_KEPT, width); intervals (s) are the drives'."""
    group, lanes, blocks = chunk.group, chunk.lanes, chunk.blocks
    starts = group.starts(initial, lanes)
    rows = np.empty((blocks, len(initial), N_KEPT, chunk.width))
    for k, (start, interval) in enumerate(zip(initial, nominal_intervals, strict=True)):
        state, heading = starts[start]
        rows[:, k] = _in_blocks(group.fresh(interval)[:, lanes], blocks)
        rows[:, k, :N_STATE] = _in_blocks(state, blocks)
        rows[:, k, R.HEADING] = _in_blocks(heading[np.newaxis], blocks)[:, 0]
    return rows.reshape(-1, N_KEPT, chunk.width)


def _in_blocks(rows: Array, blocks: int) -> Array:
    """Rows (r, lanes) as (blocks, r, width), or (r, 1), of all, as (1, r, 1)."""
    return rows.reshape(len(rows), blocks if rows.shape[1] > 1 else 1, -1).swapaxes(0, 1)


_FRESH = np.zeros((N_KEPT, 1))
"""What a filter remembers that has done nothing yet."""
_FRESH[[R.DET, R.TAIL, R.OK, R.QUICK, R.SLOW, R.TIMES_R, R.TIMES_Q]] = 1.0
_FRESH[R.RECENT] = -1.0


def unpack_sums(rows: Array, chunk: Chunk) -> tuple[Array, NDArray[np.bool_]]:
    """The columns of `Sums`, (9, m, n_sets), NaN where a set failed, and where one did.

    ``rows``: the final ones of m replays, as `start_rows` has them
    """
    found, sums = sound_lanes(rows, chunk.model), rows[:, SHOWN].swapaxes(0, 1)
    if chunk.blocks > 1:  # all of a replay's side by side
        found, sums = _side_by_side(found, chunk.blocks), _side_by_side(sums, chunk.blocks)
    sound = found[:, : chunk.size] & chunk.plausible
    return np.where(sound, sums[..., : chunk.size], np.nan), ~sound


def _side_by_side(each: NDArray[Any], blocks: int) -> NDArray[Any]:
    """What is said of each block, (..., blocks * m, width), as (..., m, lanes)."""
    *more, rows, width = each.shape
    apart = each.reshape(*more, blocks, rows // blocks, width)
    return apart.swapaxes(-3, -2).reshape(*more, rows // blocks, blocks * width)


def plausible(p: FilterParameters) -> bool:
    """See `Group`."""
    return bool(Group([p]).plausible[0])
