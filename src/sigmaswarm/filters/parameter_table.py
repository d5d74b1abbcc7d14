"""Many parameter sets as columns of numbers, since building one object per set takes as long as running the filters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.drives.tables import Indices
from sigmaswarm.filters.parameters import FilterParameters, described
from sigmaswarm.filters.requirements import measured_by

_ABSENT: dict[str, float] = described("absent")
"""Number that represents None in a column, for each field that may be None."""


@dataclass(frozen=True, eq=False)
class ParameterTable(Sequence[FilterParameters]):
    """Parameter sets with the same model and measurements; indexing builds a `FilterParameters`.

    ``like`` contains the fields that are equal in all ``size`` = n sets; ``columns`` contains the other fields, (n,) or
    (n, k).
    """

    like: FilterParameters
    columns: dict[str, NDArray[Any]]
    size: int

    @classmethod
    def of(cls, parameter_sets: Sequence[FilterParameters]) -> "ParameterTable":
        if isinstance(parameter_sets, ParameterTable):
            return parameter_sets
        columns = dict[str, NDArray[Any]]()
        for name, first in vars(parameter_sets[0]).items():
            values = [getattr(p, name) for p in parameter_sets]
            if any(value is not first and value != first for value in values):
                columns[name] = np.array([_ABSENT[name] if value is None else value for value in values])
        return cls(parameter_sets[0], columns, len(parameter_sets))

    def field(self, name: str) -> Any:
        """Return the values of a field, (n,) or (n, k), or the shared value; None becomes inf or 0."""
        if name in self.columns:
            return self.columns[name]
        value = getattr(self.like, name)
        return _ABSENT[name] if value is None else value

    def column(self, name: str) -> Array:
        """Return `field` for each set, (n,) or (n, k)."""
        value = np.asarray(self.field(name), dtype=np.float64)
        return value if name in self.columns else np.repeat(value[np.newaxis], self.size, axis=0)

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, at: int) -> FilterParameters: ...
    @overload
    def __getitem__(self, at: slice) -> "ParameterTable": ...
    def __getitem__(self, at: int | slice) -> "FilterParameters | ParameterTable":
        places = range(self.size)[at]
        part = {name: column[at] for name, column in self.columns.items()}
        if isinstance(places, range):
            return ParameterTable(self.like, part, len(places))
        values = {name: value.tolist() for name, value in part.items()}
        return replace(self.like, **{k: None if v == _ABSENT.get(k) else v for k, v in values.items()})


def group_tables(parameter_sets: Sequence[FilterParameters]) -> list[tuple[Indices, ParameterTable]]:
    """Return a table for each kernel and choice of measurements, and the indices of its sets."""
    if isinstance(parameter_sets, ParameterTable):
        return [(np.arange(len(parameter_sets)), parameter_sets)]
    alike: dict[tuple[str, frozenset[str]], list[int]] = {}
    for i, p in enumerate(parameter_sets):
        alike.setdefault((p.kernel, measured_by(p)), []).append(i)
    return [(np.array(at), ParameterTable.of([parameter_sets[i] for i in at])) for at in alike.values()]
