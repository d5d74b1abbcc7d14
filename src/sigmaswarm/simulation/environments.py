"""Environments: what the road grips, and what weather might do to satellite navigation.

Weather does not change traction in CARLA (carla-simulator/carla#655), darkness and fog do not in reality
either: clear, night and fog share one physics. They remain as labels, so that the paper's 25 conditions can
be named; only three of the five differ.
"""

from dataclasses import dataclass

from sigmaswarm.errors import InputError


@dataclass(frozen=True)
class Environment:
    """One weather.

    Attributes
    ----------
    name : str
    friction : float
        Peak friction of tire on road.
    gnss_noise_factor : float
        **An assumption, not a measurement**: by how much the weather multiplies the receiver's errors. Used
        only when a simulation asks for it.
    source : str
        Of the friction.
    """

    name: str
    friction: float
    gnss_noise_factor: float
    source: str

    @property
    def physics(self) -> str:
        """Which environments share their physics: dry, wet or snow."""
        return {0.85: "dry", 0.65: "wet", 0.25: "snow"}.get(self.friction, f"friction {self.friction:g}")


_DRY = "Bosch Automotive Handbook: new tires, dry, 50 km/h"

ENVIRONMENTS = {
    e.name: e
    for e in (
        Environment("clear", 0.85, 1.0, _DRY),
        Environment("night", 0.85, 1.0, _DRY),
        Environment("rain", 0.65, 1.3, "Bosch Automotive Handbook: new tires, wet, 50 km/h"),
        Environment("fog", 0.85, 1.1, _DRY),
        Environment("slippery", 0.25, 1.2, "packed snow, 0.2-0.3: recalled, not verified"),
    )
}
"""Environments by name, in the paper's order."""


def find_environment(environment: str | Environment) -> Environment:
    """Return an environment given by name or as a record; InputError for an unknown name."""
    if isinstance(environment, Environment):
        return environment
    if environment not in ENVIRONMENTS:
        raise InputError(f"no environment is called {environment!r}; there are {', '.join(ENVIRONMENTS)}")
    return ENVIRONMENTS[environment]
