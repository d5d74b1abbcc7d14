"""Measures of a comparison, and their display names."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH, OUTAGE_LENGTH, SHORT_OUTAGE_LENGTH


@dataclass(frozen=True)
class Measure:
    title: str
    unit: str
    of: Callable[[Score], float]

    @property
    def heading(self) -> str:
        return f"{self.title}, {self.unit}"


def measures(outage_length: float = OUTAGE_LENGTH) -> dict[str, Measure]:
    """Return the measures in display units; ``outage_length`` (s): length of the medium outages.

    The measure of short or long outages is left out if the medium outages have the same length.
    """
    short, medium, long = (
        f"{length:g} s outage drift" for length in (SHORT_OUTAGE_LENGTH, outage_length, LONG_OUTAGE_LENGTH)
    )
    known = {
        "position_rmse_m": Measure("position RMSE", "m", lambda s: s.position_rmse),
        "position_median_m": Measure("position 50%", "m", lambda s: s.position_median),
        "position_95_m": Measure("position 95%", "m", lambda s: s.position_95),
        "heading_rmse_deg": Measure("heading error", "deg", lambda s: float(np.degrees(s.heading_rmse))),
        "short_outage_drift_m": Measure(short, "m", lambda s: s.short_outage_drift),
        "outage_drift_m": Measure(medium, "m", lambda s: s.outage_drift),
        "long_outage_drift_m": Measure(long, "m", lambda s: s.long_outage_drift),
    }
    return {name: one for name, one in known.items() if name == "outage_drift_m" or one.title != medium}


MEASURES = measures()
DRIFTS = ("short_outage_drift_m", "outage_drift_m", "long_outage_drift_m")
"""Measures in which a filter with an IMU should be better than the fixes alone."""
NO_OUTAGES = ("raw_gps", "imu_only")
"""Methods whose outage drifts are not shown.

In files, the drift of imu_only is the error that has accumulated since the start of the run.
"""
POSITION_MEASURES = {"position_rmse_m": "RMSE", "position_median_m": "50%", "position_95_m": "95%"}
"""Measures by which a filter is compared with the raw fixes, and the names of these measures in sentences."""


def with_outages(method: str, values: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return a method's values by measure; omit the drifts of a method in `NO_OUTAGES`."""
    return {m: v for m, v in values.items() if method not in NO_OUTAGES or m not in DRIFTS}
