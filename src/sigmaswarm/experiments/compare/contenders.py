"""The contenders of a comparison: optimizers and, where wanted, settings of their own, as ``pso:polish=300``."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.tuning.config import TuneConfig, validated_config
from sigmaswarm.tuning.optimizers import OPTIMIZERS

OWN = (
    *("particles", "generations", "trials", "polish", "racing"),
    *("inertia", "cognitive", "social", "zero_velocity_at_bounds"),
)
"""Options that contenders may differ in, beside their optimizer and scale."""


@dataclass(frozen=True)
class Contender:
    """One row of a comparison.

    Attributes
    ----------
    name : str
        As it was asked for: the optimizer's name and its settings.
    scale : str
    config : TuneConfig
        What `tune` is asked for, but for the seed.
    """

    name: str
    scale: str
    config: TuneConfig

    @property
    def label(self) -> str:
        """Name and scale."""
        return f"{self.name}, {self.scale}"

    @property
    def folder(self) -> str:
        """A name for files."""
        return f"{self.name}-{self.scale}".replace(":", "-").replace(",", "-").replace("=", "")


def contenders(names: Sequence[str], scales: Sequence[str], shared: dict[str, Any]) -> list[Contender]:
    """Every optimizer at every scale, all with the same budget of evaluations.

    Raises
    ------
    InputError
        If a name or setting is not known, is there twice, or asks for another budget than the first.
    """
    if not names or not scales:
        raise InputError("nothing to compare: name at least one optimizer and one scale")
    found = [_contender(name, scale, shared) for scale in scales for name in names]
    if len({c.label for c in found}) < len(found):
        raise InputError("an optimizer or scale is named twice; name each of them once")
    first = found[0]
    for other in found:
        if budget(other.config) != budget(first.config):
            raise InputError(
                f"{other.name} has {budget(other.config)} evaluations (particles x generations x trials), "
                f"{first.name} has {budget(first.config)}; give all of them the same"
            )
    return found


def budget(config: TuneConfig) -> int:
    """Evaluations that a tuning may take."""
    return config.particles * config.generations * config.trials


def _contender(name: str, scale: str, shared: dict[str, Any]) -> Contender:
    optimizer, _, settings = name.partition(":")
    if optimizer not in OPTIMIZERS:
        raise InputError(f"no optimizer is called {optimizer!r}; choose from {', '.join(OPTIMIZERS)}")
    own: dict[str, Any] = {}
    for setting in settings.split(",") if settings else []:
        key, _, value = setting.partition("=")
        if key not in OWN or not value:
            raise InputError(
                f"{name}: {setting!r} is no setting; write NAME=VALUE after the colon, with a name of {', '.join(OWN)}"
            )
        own[key] = value
    config = validated_config(TuneConfig, {**shared, "optimizer": optimizer, "scale": scale, **own})
    return Contender(name, scale, config)
