"""What is compared with what: methods and measures, and what people call them."""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from sigmaswarm.scoring.drifts import LEARNED, OWN, SMOOTHED, SWARM, UNTUNED
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH, OUTAGE_LENGTH

METHODS = {
    "tuned": "tuned filter",
    UNTUNED: "data-sheet filter",
    "raw_gps": "raw GPS",
    "imu_only": "IMU only",
}
"""The rows of every comparison: what files and what people call them."""
HOW_UNTUNED = (
    "The data-sheet filter has the tuned one's model and parts, and noises that nobody tuned: R from the stated "
    "accuracy of the fixes (else 2.1 m), Q from the IMU's noise density (else an MPU-6050's), usual guesses of the rest"
)
"""In a sentence, for people must not take it for what a good engineer reaches in a week."""
HOW_AGAINST = "Another tuning, or a filter of your own, beside it: sigmaswarm evaluate --against TUNING"
"""In a sentence, for who does not look for it."""

KIND_NAMES = {
    "ukf": "UKF",
    "ekf": "EKF",
    "adaptive-ukf": "adaptive UKF",
    "strong-tracking-ukf": "strong tracking UKF",
    "fuzzy-ukf": "fuzzy UKF",
}
"""What people call the kinds of filters."""


ALSO = {SMOOTHED: "tuned, smoothed", SWARM: "tuned, as a swarm"} | {
    name: f"tuned, {name}" for name in LEARNED
}
"""The rows behind the tuned filter that are there if they are asked for."""


def filter_called(kind: str, model: str) -> str:
    """What people call a filter: its kind, and its model where that is not the paper's."""
    return KIND_NAMES.get(kind, kind) + ("" if model == "planar5" else f", {model}")


def method_names(
    kind: str = "ukf",
    model: str = "planar5",
    *,
    also: Collection[str] = (),
    against: tuple[str, str] | None = None,
) -> dict[str, str]:
    """`METHODS`, the tuned filter called after its kind and model.

    ``also``: what there is beside them: `OWN`, the filter to compare with, which comes first, and of `ALSO`.
    ``against``: kind and model of `OWN`, where they are known.
    """
    first = {OWN: f"other {filter_called(*against) if against else 'filter'}"} if OWN in also else {}
    first |= {"tuned": f"tuned {filter_called(kind, model)}"}
    return first | {method: name for method, name in ALSO.items() if method in also} | METHODS | first


@dataclass(frozen=True)
class Measure:
    """Something that is compared: what people call it, its unit, and how it is taken from a score."""

    title: str
    unit: str
    of: Callable[[Score], float]

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title}, {self.unit}"


def measures(outage_length: float = OUTAGE_LENGTH) -> dict[str, Measure]:
    """What is compared, in the units in which people read it; ``outage_length``, s, is that of the shorter outages."""
    return {
        "position_rmse_m": Measure("position RMSE", "m", lambda s: s.position_rmse),
        "position_median_m": Measure("position 50%", "m", lambda s: s.position_median),
        "position_95_m": Measure("position 95%", "m", lambda s: s.position_95),
        "heading_rmse_deg": Measure("heading error", "deg", lambda s: float(np.degrees(s.heading_rmse))),
        "outage_drift_m": Measure(f"{outage_length:g} s outage drift", "m", lambda s: s.outage_drift),
        "long_outage_drift_m": Measure(
            f"{LONG_OUTAGE_LENGTH:g} s outage drift", "m", lambda s: s.long_outage_drift
        ),
    }


MEASURES = measures()
POSITION_MEASURES = {"position_rmse_m": "RMSE", "position_median_m": "50%", "position_95_m": "95%"}
"""Those in which a filter is held against the raw fixes, and what a sentence calls them."""
