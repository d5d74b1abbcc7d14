"""A driven maneuver: the car's states at each millisecond, before any sensor looks at them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.simulation.dynamics import Vehicle, run_closed_loop, start_state
from sigmaswarm.simulation.environments import Environment
from sigmaswarm.simulation.maneuvers import Maneuver, Road, find_maneuver, urban
from sigmaswarm.simulation.planning import LOOK, SPACING, draw_sway, lay_path, plan_speed

Array = NDArray[np.float64]

STAND = 1.0
"""s, that the car stands before it pulls away."""
URBAN_DURATION = 180.0
"""s, of "urban" unless told otherwise."""


@dataclass(frozen=True)
class Journey:
    """A driven maneuver.

    Attributes
    ----------
    maneuver : Maneuver
    path : ndarray, shape (p, 4)
        East m, north m, heading rad, curvature 1/m: what the driver wanted to follow.
    record : ndarray, shape (n, 21)
        The car's states at each millisecond, see `sigmaswarm.simulation.dynamics`.
    start : float
        s, when the maneuver itself started, after the warm-up.
    outages : list of (start, end)
        s, without fixes.
    """

    maneuver: Maneuver
    path: Array
    record: Array
    start: float
    outages: list[tuple[float, float]]


def take_journey(
    name: str,
    where: Environment,
    car: Vehicle,
    rng: np.random.Generator,
    duration: float | None = None,
    warm_up: bool = True,
) -> Journey:
    """Draw a maneuver and let the driver drive it; parameters as in `simulate`."""
    road = Road(where.friction)
    seconds = URBAN_DURATION if duration is None else duration
    drawn = urban(road, rng, seconds) if name == "urban" else find_maneuver(name)(road, rng)
    heading, sway = float(rng.uniform(-np.pi, np.pi)), draw_sway(rng)
    legs, first = (drawn.legs, drawn.first) if warm_up else (drawn.legs[drawn.first :], 0)
    path = lay_path(legs, heading, sway)
    plan = plan_speed(legs, sway, stand=STAND if warm_up else None)
    if name == "urban":
        plan = plan[: round(seconds / LOOK)]
    own = int(np.searchsorted(plan[:, 2], sum(leg.length for leg in legs[:first]))) * LOOK
    start = start_state(path[0, 0], path[0, 1], path[0, 2], plan[0, 0], car)
    record = run_closed_loop(car, where.friction, start, path, SPACING, plan)
    outages = [(round(own + begin, 3), round(own + end, 3)) for begin, end in drawn.outages]
    return Journey(drawn, path, record, own, outages)
