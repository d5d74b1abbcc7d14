"""Environments: friction of the road, and the assumed effect of weather on satellite navigation.

Darkness and fog do not change traction; in CARLA no weather changes traction (carla-simulator/carla#655). Clear, night
and fog have the same friction. Therefore, without ``gnss_degradation``, only three of the paper's five environments
differ.
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

from sigmaswarm.errors import InputError


class _Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T")
N = TypeVar("N", bound=_Named)


def by_name(*records: N) -> dict[str, N]:
    return {record.name: record for record in records}


@dataclass(frozen=True)
class Environment:
    """Friction and weather of a drive.

    Attributes
    ----------
    name : str
    friction : float
        Peak friction between tire and road.
    gnss_noise_factor : float
        Factor by which the weather multiplies the receiver's errors if ``gnss_degradation`` is set: **an assumption,
        not a measurement**.
    source : str
        Source of the friction.
    """

    name: str
    friction: float
    gnss_noise_factor: float
    source: str

    @property
    def physics(self) -> str:
        """Description of the friction: dry, wet, snow, or its value."""
        return {0.85: "dry", 0.65: "wet", 0.25: "snow"}.get(self.friction, f"friction {self.friction:g}")


_DRY = "Bosch Automotive Handbook: new tires, dry, 50 km/h"

# In the paper's order
ENVIRONMENTS = by_name(
    Environment("clear", 0.85, 1.0, _DRY),
    Environment("night", 0.85, 1.0, _DRY),
    Environment("rain", 0.65, 1.3, "Bosch Automotive Handbook: new tires, wet, 50 km/h"),
    Environment("fog", 0.85, 1.1, _DRY),
    Environment("slippery", 0.25, 1.2, "packed snow, 0.2-0.3: from memory, not verified"),
)


def lookup(value: str | T, table: dict[str, T], what: str) -> T:
    """Look up a name in a table, or return a record unchanged; raise `InputError` for an unknown name."""
    if not isinstance(value, str):
        return value
    if value not in table:
        raise InputError(f"no {what} is called {value!r}; choose from {', '.join(table)}")
    return table[value]
