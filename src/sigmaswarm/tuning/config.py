"""Options of a tuning run, for the command line, `tune`, tuning.toml and the reference manual.

PEP 692 requires a TypedDict for the types of ``**options``; a test compares these types with the configuration."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib.util import find_spec
from typing import Annotated, Any, Literal, Self, TypedDict, TypeVar

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, ValidationError, model_validator

from sigmaswarm.errors import InputError, not_installed, warn_deprecated
from sigmaswarm.filters.names import FilterKind, ModelName
from sigmaswarm.wording import first_mistake

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


SWARM = ("inertia", "cognitive", "social", "zero_velocity_at_bounds")
"""Options that only the optimizer pso has."""
DEFERRED_OPTIONS = ("model", "kind", "use")
"""Options whose default depends on the drives or on the model."""
RENAMED = {"margin": "inflation"}
"""Options that have another name in version 0.3.0: old name, current name."""
SYNONYMS = {
    **dict.fromkeys(("n_trials", "restarts", "n_restarts", "repeats"), "trials"),
    **dict.fromkeys(("random_state", "random_seed", "rng"), "seed"),
    **dict.fromkeys(("max_iter", "maxiter", "n_iterations", "iterations", "n_iter", "epochs"), "generations"),
    **dict.fromkeys(("population", "popsize", "population_size", "n_particles", "swarm_size"), "particles"),
    **dict.fromkeys(("loss", "cost", "metric", "scoring"), "objective"),
    **dict.fromkeys(("algorithm", "method", "solver"), "optimizer"),
    **dict.fromkeys(("early_stopping", "n_iter_no_change"), "patience"),
    **dict.fromkeys(("n_jobs", "jobs", "threads", "n_workers"), "workers"),
    "workers": "executor",
    **dict.fromkeys(("filter", "filter_type"), "kind"),
    **dict.fromkeys(("output", "output_dir", "folder"), "out"),
}
"""Names that other libraries use for these options."""
C = TypeVar("C", bound="SearchConfig")


def _qualified_name(optimizer: Any) -> str:
    return optimizer if isinstance(optimizer, str) else f"{optimizer.__module__}:{optimizer.__qualname__}"


OwnOptimizer = Annotated[Callable[..., Any], PlainSerializer(_qualified_name, return_type=str)]
OwnOptimizerName = Annotated[str, Field(pattern=r"^[\w.]+:[\w.<>]+$")]


class SearchConfig(BaseModel):
    """Options of any search; saved with every result."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    objective: str = "auto"
    """Objective: truth-rmse, truth-pose, innovation-nll, innovation-t, forecast-t, outage-rmse, nis, nees,
    gps-rmse, or a weighted sum."""
    scale: Scale = "log10"
    """Scale of searched variances and other parameters whose range spans powers of ten; the paper uses linear."""
    particles: int = Field(default=30, ge=2)
    """Size of the swarm: number of evaluations per generation."""
    generations: int = Field(default=50, ge=1)
    """Number of generations of each trial, including the initial generation."""
    trials: int = Field(default=1, ge=1)
    """Number of independent searches. The result is that of the search with the lowest cost; all costs are reported."""
    seed: int = Field(default=0, ge=0)
    """Seed of all random numbers. The same seed gives the same result."""
    worst: float = Field(default=1.0, gt=0, le=1)
    """Average the cost over this fraction of the drives, those with the highest costs; 1 means all drives."""
    # At the same budget, de-qpso is at least as good as de and better than the paper's pso (docs/optimizers.md).
    optimizer: OptimizerName | OwnOptimizer | OwnOptimizerName = "de-qpso"
    """Search algorithm; bo needs scikit-learn. In Python, a custom class is also possible. See docs/optimizers.md."""
    polish: int = Field(default=0, ge=0)
    """Number of evaluations reserved for a final Nelder-Mead search from the best point."""
    racing: bool = False
    """Stop evaluating the worse candidates of a generation after a few drives; saves time with many drives."""
    inertia: float = INERTIA
    """Weight w of pso."""
    cognitive: float = ACCELERATION
    """Coefficient c1 of pso."""
    social: float = ACCELERATION
    """Coefficient c2 of pso."""
    zero_velocity_at_bounds: bool = False
    """For pso: stop particles along the coordinates in which they reach a bound."""
    patience: int | None = Field(default=None, ge=1)
    """End a trial after this many generations without a lower cost; never by default."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.polish >= self.particles * self.generations:
            raise ValueError(
                f"polish = {self.polish} must be less than particles x generations = "
                f"{self.particles * self.generations}"
            )
        for name in SWARM if self.optimizer != "pso" else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(
                    f"{name} is an option of the optimizer pso, not of {_qualified_name(self.optimizer)}; choose "
                    f"pso, or omit {name}"
                )
        return self


class TuneConfig(SearchConfig):
    """Options for tuning a built-in model; `defaults.default_filter_options` adds missing ``model`` and ``use``."""

    model: ModelName = "planar5"
    """Process model: planar5 (paper), planar8 (IMU biases), tilted12 (roll, pitch). Default: depends on the sensors."""
    kind: FilterKind = "ukf"
    """Filter type: unscented, extended, adaptive (Sage-Husa), strong tracking, fuzzy. Default: depends on the model."""
    use: tuple[Option, ...] = ()
    """Measurements and constraints added to position fixes. Default: depends on the sensors. See docs/method.md."""
    outage_seed: int = Field(default=0, ge=0)
    """Seed of the outage windows, for objectives that hide fixes."""
    as_recorded: bool = False
    """Run without preprocessing (for diagnosis and the paper): use stale fixes, treat IMU gaps as ordinary steps."""
    prior: float | None = Field(default=None, ge=0, le=100)
    """Weight of priors; 0: none.

    Default: 1 for likelihoods without truth, 0.3 for tilted12 with fix-error and truth, otherwise 0.
    """
    inflation: float | None = Field(default=None, ge=0, le=1)
    """Relative cost increase allowed for inflating process noise; 0 disables it.

    Default: 0 to 0.05, depending on model and truth.
    """

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, options: Any) -> Any:
        """Accept old names of options, and add the default filter type of the model."""
        from sigmaswarm.filters.models import MODELS  # imported here, since it would slow down the help

        if not isinstance(options, Mapping):
            return options
        model = MODELS.get(options.get("model", "planar5"))
        kind = {"kind": model.filter_types[0]} if model else {}
        return kind | {RENAMED.get(name, name): value for name, value in options.items()}

    @model_validator(mode="after")
    def _inflation_needs_logarithms(self) -> Self:
        if self.inflation and self.scale != "log10":
            raise ValueError(
                "inflation needs scale = log10, since it multiplies process noise variances by a factor"
            )
        return self


class ModelTuneConfig(SearchConfig):
    model: dict[str, Any]
    """Result of `Model.identity`."""


MODEL_REMEDIES = {
    "use": "add the sensor to h, measurement_noise and the logs",
    "kind": "specify kind in Model",
    "prior": "narrow the bounds of the parameters of measurement_noise",
    "start": "narrow the bounds of the parameters",
}
"""Remedies for options of built-in models that are passed with a custom model. Other such options must be left out."""


_PAPER_DEFAULTS = (
    "kind", "particles", "generations", "polish", "racing", "use", "worst", "cognitive", "social", "patience",
)  # fmt: skip
PAPER_OPTIONS: dict[str, Any] = {
    **{name: TuneConfig.model_fields[name].default for name in _PAPER_DEFAULTS},
    "optimizer": "pso",
    "scale": "linear",
    "objective": "gps-rmse",
    "model": "planar5",
    "as_recorded": True,
    "prior": 0.0,
    "inflation": 0.0,
}
"""Options that ``paper=True`` sets. The paper repeats the tuning 20 times, and states neither inertia nor seed."""


def paper_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Add the paper's settings, and reject options that contradict them."""
    for name, value in options.items():
        if name in PAPER_OPTIONS and (tuple(value) if name == "use" else value) != PAPER_OPTIONS[name]:
            papers = "nothing" if PAPER_OPTIONS[name] in ((), None) else PAPER_OPTIONS[name]
            raise InputError(
                f"{name} = {value!r} contradicts the paper's setting, which is {papers}; "
                f"omit {name}, or --paper (in Python: paper=True)"
            )
    return {**options, **PAPER_OPTIONS}


def current_options(
    config: type[SearchConfig], options: Mapping[str, Any], arguments: Iterable[str]
) -> dict[str, Any]:
    """Return options under their current names. An unknown option is refused, and a similar name is suggested.

    ``config`` defines the options. ``arguments`` are further names that can be suggested.
    """
    known, current = config.model_fields, dict[str, Any]()
    for name, value in options.items():
        if name in RENAMED and RENAMED[name] in known:
            warn_deprecated(f"the option {name}", RENAMED[name])
        elif config is ModelTuneConfig and name not in known and name in TuneConfig.model_fields:
            remedy = MODEL_REMEDIES.get(name, f"omit {name}")
            raise InputError(f"{name} = {value!r} is only possible with built-in models; {remedy}")
        elif name not in known:
            nearest = similar_name(name, [*known, *arguments])
            hint = f"did you mean {nearest}?" if nearest else f"choose from {', '.join(known)}"
            raise InputError(f"{name} = {value!r}: no such option; {hint}")
        current[RENAMED.get(name, name)] = value
    return current


def option_words(name: str, value: Any) -> list[str]:
    """Return an option of ``tune`` as words of a command line."""
    option = name.replace("_", "-")
    if isinstance(value, list | tuple):
        return [f"--{option}", *map(str, value)] if value else [f"--{option}-nothing"]
    if isinstance(value, bool):
        return [f"--{option}" if value else f"--no-{option}"]
    return [f"--{option}", str(value)]


def similar_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known option that is most similar to a name, or None."""
    names = [*known]
    synonym = SYNONYMS.get(name.lower().replace("-", "_"))
    for candidate in (synonym, SYNONYMS.get(synonym or "")):
        if candidate in names:
            return candidate
    return next(iter(get_close_matches(name, names, n=1)), None)


def validated_config(kind: type[C], options: Mapping[str, Any]) -> C:
    """Check the options of a tuning run. Raises `InputError` for the first invalid option."""
    try:
        config = kind(**options)
    except ValidationError as error:
        name, value, _, message = first_mistake(error)
        raise InputError(f"{name.split('.')[0]} = {value}: {message}" if name else message) from None
    require_packages(config.optimizer)
    return config
