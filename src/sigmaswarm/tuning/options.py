"""Types of a tuning run's options, for type checkers; a test compares these types with `tuning.config`.

PEP 692 requires a TypedDict for the types of ``**options``.
"""

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any, Literal, TypedDict

from sigmaswarm.errors import not_installed
from sigmaswarm.filters.names import FilterKind, ModelName

Scale = Literal["log10", "linear"]
OptimizerName = Literal[
    "pso", "ga", "ga-pso", "de", "de-qpso", "cma-es", "bo", "nelder-mead", "random", "sobol"
]
Option = Literal[
    "velocity",
    "lateral",
    "slip",
    "standstill",
    "odometer",
    "heading",
    "gate",
    "imu-gate",
    "latency",
    "accuracy",
    "robust",
    "fix-error",
]

INERTIA = 0.7298
"""Inertia weight w. The paper states no value; this is the constriction coefficient of Clerc and Kennedy (2002)."""
ACCELERATION = 1.5
"""Acceleration coefficients c1 = c2, from the paper."""
SEEDS = 20
"""Default number of runs of each optimizer in a comparison."""


class SharedOptions(TypedDict, total=False):  # the same in all tuning runs of a comparison
    objective: str
    worst: float
    particles: int
    generations: int
    trials: int
    polish: int
    racing: bool
    inertia: float
    cognitive: float
    social: float
    zero_velocity_at_bounds: bool
    patience: int | None


class FilterOptions(TypedDict, total=False):
    model: ModelName
    kind: FilterKind
    use: Sequence[Option]
    outage_seed: int
    as_recorded: bool


class SearchOptions(SharedOptions, total=False):
    scale: Scale
    optimizer: OptimizerName | Callable[..., Any]
    seed: int


class TuneOptions(SearchOptions, FilterOptions, total=False):
    prior: float | None
    inflation: float | None


class CompareOptions(SharedOptions, FilterOptions, total=False):
    """Options of `compare`."""


def require_packages(optimizer: object) -> None:
    if optimizer == "bo" and find_spec("sklearn") is None:
        raise not_installed("optimizer = 'bo':", "scikit-learn")
