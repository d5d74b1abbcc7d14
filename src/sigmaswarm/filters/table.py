"""Many parameter sets as columns of numbers: to check and build an object for each would take as long as a drive."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.drives.drive import Array
from sigmaswarm.filters.parameters import FilterParameters


@dataclass(frozen=True, eq=False)
class ParameterTable(Sequence[FilterParameters]):
    """Parameter sets that differ in some numbers only; a set itself is made where it is asked for.

    Attributes
    ----------
    like : FilterParameters
        All else of each of them. What it leaves out, as a gate, they all leave out.
    columns : dict of str to ndarray, shapes (n,) or (n, k)
        The fields in which they differ, each of n numbers, or of as many tuples of k.
    """

    like: FilterParameters
    columns: dict[str, Array]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    @overload
    def __getitem__(self, at: int) -> FilterParameters: ...
    @overload
    def __getitem__(self, at: slice) -> "ParameterTable": ...
    def __getitem__(self, at: int | slice) -> "FilterParameters | ParameterTable":
        part = {name: column[at] for name, column in self.columns.items()}
        if isinstance(at, slice):
            return ParameterTable(self.like, part)
        return replace(self.like, **{name: value.tolist() for name, value in part.items()})


Fields = dict[str, Any]
"""Fields of n parameter sets by name: (n,) or (n, k); of a field that is the same in all sets, its value alone."""

MISSING: dict[str, float] = {
    **dict.fromkeys(
        ("velocity_noise", "lateral_noise", "standstill_noise", "odometer_noise", "gate"), math.inf
    ),
    **dict.fromkeys(("nominal_interval", "accuracy_scale", "robust_dof"), 0.0),
}
"""What stands for None in the fields that may be."""


def fields_of(parameter_sets: Sequence[FilterParameters], names: Sequence[str] | None = None) -> Fields:
    """Of some sets; of all fields, or those with the names."""
    like, columns = apart(parameter_sets, names)
    return shared_fields(like, names) | columns


def shared_fields(like: FilterParameters, names: Sequence[str] | None = None) -> Fields:
    """What sets that are like one have, where they do not differ."""
    of = vars(like)
    return {name: MISSING[name] if of[name] is None else of[name] for name in names or of}


def apart(
    parameter_sets: Sequence[FilterParameters], names: Sequence[str] | None = None
) -> tuple[FilterParameters, dict[str, NDArray[Any]]]:
    """One of some sets, and as columns the fields in which they differ; of a table it has them, all of them."""
    if isinstance(parameter_sets, ParameterTable):
        return parameter_sets.like, parameter_sets.columns
    each = [vars(p) for p in parameter_sets]
    columns = dict[str, NDArray[Any]]()
    for name in names or each[0]:
        of = [one[name] for one in each]
        first = of[0]
        if any(value is not first and value != first for value in of):
            columns[name] = np.array([MISSING[name] if value is None else value for value in of])
    return parameter_sets[0], columns
