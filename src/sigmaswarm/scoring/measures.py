"""Methods and measures of a comparison, and their display names."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from sigmaswarm.scoring.drifts import BANK, BASELINE, FIXES, LEARNED, OWN, SMOOTHED
from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH, OUTAGE_LENGTH, SHORT_OUTAGE_LENGTH

METHODS = {
    "tuned": "tuned filter",
    BASELINE: "baseline",
    FIXES: "fixes alone",
    "raw_gps": "raw GPS",
    "imu_only": "IMU only",
}
"""Display names of the rows of every comparison."""
HOW_FIXES = "Fixes alone is a constant-velocity filter without the IMU; its noise parameters are fitted to {}"
HOW_TO_COMPARE = (
    "To compare with another tuning or a filter of your own: sigmaswarm evaluate --against TUNING"
)
ALSO = {SMOOTHED: "tuned, smoothed", BANK: "tuned, filter bank"} | {
    name: f"tuned, {name}" for name in LEARNED
}
"""Optional rows after the tuned filter."""


def filter_called(kind: str, model: str) -> str:
    name = kind.replace("-", " ").replace("ukf", "UKF").replace("ekf", "EKF")
    return name if model == "planar5" else f"{name}, {model}"


def method_names(
    kind: str = "ukf",
    model: str = "planar5",
    *,
    also: Collection[str] = (),
    against: tuple[str, str] | None = None,
) -> dict[str, str]:
    """Return the display names of the methods.

    ``also``: optional rows from `ALSO`; `OWN` adds the row of another filter. ``against``: type and model of that
    filter, if known.
    """
    first = {OWN: f"other {filter_called(*against) if against else 'filter'}"} if OWN in also else {}
    first |= {"tuned": f"tuned {filter_called(kind, model)}"}
    return first | {method: name for method, name in ALSO.items() if method in also} | METHODS | first


def baseline_note(tuned: str) -> str:
    if tuned.endswith("robot-localization"):
        return (
            "The baseline is robot_localization with its default process noise, the IMU's variances 0.0001 rad2/s2 "
            "and 0.01 m2/s4, and the stated accuracy of the fixes (else 2.1 m)"
        )
    return (
        "The baseline is the tuned filter's model without tuning: R is from the stated or observed accuracy of "
        "the fixes (else 2.1 m), and Q is from the IMU's noise density (else that of an MPU-6050) and typical "
        "errors of the model"
    )


@dataclass(frozen=True)
class Measure:
    title: str
    unit: str
    of: Callable[[Score], float]

    @property
    def heading(self) -> str:
        return f"{self.title}, {self.unit}"


def measures(outage_length: float = OUTAGE_LENGTH) -> dict[str, Measure]:
    """Return the measures in display units; ``outage_length``, s, is that of the medium outages."""
    return {
        "position_rmse_m": Measure("position RMSE", "m", lambda s: s.position_rmse),
        "position_median_m": Measure("position 50%", "m", lambda s: s.position_median),
        "position_95_m": Measure("position 95%", "m", lambda s: s.position_95),
        "heading_rmse_deg": Measure("heading error", "deg", lambda s: float(np.degrees(s.heading_rmse))),
        "short_outage_drift_m": Measure(
            f"{SHORT_OUTAGE_LENGTH:g} s outage drift", "m", lambda s: s.short_outage_drift
        ),
        "outage_drift_m": Measure(f"{outage_length:g} s outage drift", "m", lambda s: s.outage_drift),
        "long_outage_drift_m": Measure(
            f"{LONG_OUTAGE_LENGTH:g} s outage drift", "m", lambda s: s.long_outage_drift
        ),
    }


MEASURES = measures()
DRIFTS = ("short_outage_drift_m", "outage_drift_m", "long_outage_drift_m")
"""Measures in which a filter with an IMU should be better than the fixes alone."""
NO_OUTAGES = ("raw_gps", "imu_only")
"""Methods whose outage drifts are not shown; files contain that of IMU only, which is its error since the start."""
POSITION_MEASURES = {"position_rmse_m": "RMSE", "position_median_m": "50%", "position_95_m": "95%"}
"""Measures by which a filter is compared with the raw fixes, and their names in sentences."""


def with_outages(method: str, values: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return a method's values by measure, without drifts if it has no outages."""
    return {m: v for m, v in values.items() if method not in NO_OUTAGES or m not in DRIFTS}
