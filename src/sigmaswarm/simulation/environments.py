"""Environments of a drive: friction of the road, and the assumed effect of weather on satellite navigation.

In CARLA, weather does not change traction (carla-simulator/carla#655); in reality, darkness and fog do not. So clear,
night and fog have the same physics and are only labels in the paper's 25 conditions; three of the five environments
differ.
"""

from dataclasses import dataclass
from typing import TypeVar

from sigmaswarm.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Environment:
    """One environment.

    Attributes
    ----------
    name : str
    friction : float
        Peak friction of tire on road.
    gnss_noise_factor : float
        **An assumption, not a measurement**: factor of the weather on the receiver's errors, used by simulations
        with ``gnss_degradation``.
    source : str
        Source of the friction.
    """

    name: str
    friction: float
    gnss_noise_factor: float
    source: str

    @property
    def physics(self) -> str:
        """Name of the physics of environments with this friction: dry, wet or snow."""
        return {0.85: "dry", 0.65: "wet", 0.25: "snow"}.get(self.friction, f"friction {self.friction:g}")


_DRY = "Bosch Automotive Handbook: new tires, dry, 50 km/h"

ENVIRONMENTS = {
    e.name: e
    for e in (
        Environment("clear", 0.85, 1.0, _DRY),
        Environment("night", 0.85, 1.0, _DRY),
        Environment("rain", 0.65, 1.3, "Bosch Automotive Handbook: new tires, wet, 50 km/h"),
        Environment("fog", 0.85, 1.1, _DRY),
        Environment("slippery", 0.25, 1.2, "packed snow, 0.2-0.3: from memory, not verified"),
    )
}
"""Environments by name, in the paper's order."""


def named(value: str | T, table: dict[str, T], what: str) -> T:
    """Look up a name in a table of records; return a record unchanged. Raise `InputError` if the name is unknown."""
    if not isinstance(value, str):
        return value
    if value not in table:
        raise InputError(f"no {what} is called {value!r}; choose from {', '.join(table)}")
    return table[value]
