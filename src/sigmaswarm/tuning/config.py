"""What a tuning is asked for."""

from typing import Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sigmaswarm.errors import InputError, first_mistake
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.names import FilterKind, ModelName
from sigmaswarm.tuning.options import DEFAULTS, OptimizerName, Option, Scale, require_packages

SWARM = ("inertia", "cognitive", "social", "zero_velocity_at_bounds")
"""The coefficients of the swarm, which no other optimizer has."""
C = TypeVar("C", bound="SearchConfig")


class SearchConfig(BaseModel):
    """What any tuning is asked for, checked; saved with every result. `SearchOptions` says what each option means."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    objective: str = DEFAULTS["objective"]
    """A name in `OBJECTIVES` or a weighted sum."""
    scale: Scale = DEFAULTS["scale"]
    particles: int = Field(default=DEFAULTS["particles"], ge=2)
    generations: int = Field(default=DEFAULTS["generations"], ge=1)
    trials: int = Field(default=DEFAULTS["trials"], ge=1)
    seed: int = Field(default=DEFAULTS["seed"], ge=0)
    worst: float = Field(default=DEFAULTS["worst"], gt=0, le=1)
    optimizer: OptimizerName = DEFAULTS["optimizer"]
    polish: int = Field(default=DEFAULTS["polish"], ge=0)
    racing: bool = DEFAULTS["racing"]
    inertia: float = DEFAULTS["inertia"]
    cognitive: float = DEFAULTS["cognitive"]
    social: float = DEFAULTS["social"]
    zero_velocity_at_bounds: bool = DEFAULTS["zero_velocity_at_bounds"]
    patience: int | None = Field(default=DEFAULTS["patience"], ge=1)

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
    """What the tuning of a filter for cars is asked for, once model and use are settled; else they are the paper's."""

    model: ModelName = "planar5"
    kind: FilterKind = "ukf"
    use: tuple[Option, ...] = ()
    outage_seed: int = Field(default=DEFAULTS["outage_seed"], ge=0)
    as_recorded: bool = DEFAULTS["as_recorded"]
    prior: float | None = Field(default=DEFAULTS["prior"], ge=0, le=100)
    """None: 1 where the fixes' likelihood alone decides, else 0; `tune` settles it before it begins, else it is 0."""
    margin: float | None = Field(default=DEFAULTS["margin"], ge=0, le=1)
    """None: `MARGIN` or `TILTED_MARGIN` where the fixes' likelihood alone decides, else 0; likewise."""

    @model_validator(mode="before")
    @classmethod
    def _usual_kind(cls, asked: Any) -> Any:
        """Where none is asked for, the kind that is usual for the model."""
        model = (
            MODELS.get(asked.get("model", cls.model_fields["model"].default))
            if isinstance(asked, dict)
            else None
        )  # pyright: ignore
        return {"kind": model.kinds[0], **asked} if model else asked

    @model_validator(mode="after")
    def _margin_needs_logarithms(self) -> Self:
        if self.margin and self.scale != "log10":
            raise ValueError("margin raises noises by one factor, which needs scale = log10")
        return self


class ModelTuneConfig(SearchConfig):
    """What the tuning of a model of the user's own is asked for."""

    model: dict[str, Any]
    """What `Model.identity` says of it."""


def validated_config(kind: type[C], config: dict[str, Any]) -> C:
    """The configuration of a tuning, or an `InputError` that names the option, or the package that it needs."""
    try:
        valid = kind(**config)
    except ValidationError as error:
        name, value, _, message = first_mistake(error)
        raise InputError(f"{name} = {value!r}: {message}" if name else message) from None
    require_packages(valid.optimizer)
    return valid
