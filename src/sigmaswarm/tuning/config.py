"""What a tuning is asked for."""

from typing import Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sigmaswarm.errors import InputError, first_mistake
from sigmaswarm.filters.parameters import FilterKind, ModelName
from sigmaswarm.tuning.optimizers.pso import ACCELERATION, INERTIA
from sigmaswarm.tuning.space import Option, Scale

OptimizerName = Literal["pso", "ga", "ga-pso", "de", "cma-es", "nelder-mead", "random", "sobol"]
SWARM = ("inertia", "cognitive", "social", "zero_velocity_at_bounds")
"""The coefficients of the swarm, which no other optimizer has."""
C = TypeVar("C", bound="SearchConfig")


class SearchConfig(BaseModel):
    """What any tuning is asked for; saved with every result. Defaults are the paper's where it gives them."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    objective: str = "auto"
    """A name in `OBJECTIVES` or a weighted sum; auto: truth-rmse where all drives have truth, else innovation-nll."""
    scale: Scale = "log10"
    particles: int = Field(default=30, ge=2)
    generations: int = Field(default=50, ge=1)
    trials: int = Field(default=1, ge=1)
    seed: int = Field(default=0, ge=0)
    worst: float = Field(default=1.0, gt=0, le=1)
    """Share of the drives that counts, the worst ones; 1: the mean over all."""
    optimizer: OptimizerName = "de"
    """Loses the heading less often than the paper's pso at the same budget (docs/optimizers.md)."""
    polish: int = Field(default=0, ge=0)
    """Evaluations, of particles x generations, that are kept for a Nelder-Mead search from the best point."""
    racing: bool = False
    """Try each generation on one drive first, its better half on two, and so on: see `racing`."""
    inertia: float = INERTIA
    cognitive: float = ACCELERATION
    social: float = ACCELERATION
    zero_velocity_at_bounds: bool = False
    patience: int | None = Field(default=None, ge=1)
    """Stop a trial, but for its polish, after that many generations without a better cost; None: never."""

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
                    f"{name} is a coefficient of pso, not of {self.optimizer}; choose pso, or leave it out"
                )
        return self

    def optimizer_options(self) -> dict[str, Any]:
        """What the optimizer is told beside its budget: the swarm's own coefficients."""
        return {name: getattr(self, name) for name in SWARM} if self.optimizer == "pso" else {}


class TuneConfig(SearchConfig):
    """What the tuning of a filter for cars is asked for."""

    model: ModelName = "planar5"
    kind: FilterKind = "ukf"
    use: tuple[Option, ...] = ()
    """What the filter uses beside position fixes: velocity, lateral, standstill, gate, latency."""
    outage_seed: int = Field(default=0, ge=0)


class ModelTuneConfig(SearchConfig):
    """What the tuning of a model of the user's own is asked for."""

    model: dict[str, Any]
    """What `Model.identity` says of it."""


def validated_config(kind: type[C], config: dict[str, Any]) -> C:
    """The configuration of a tuning, or an `InputError` that names the option."""
    try:
        return kind(**config)
    except ValidationError as error:
        name, value, _, message = first_mistake(error)
        raise InputError(f"{name} = {value!r}: {message}" if name else message) from None
