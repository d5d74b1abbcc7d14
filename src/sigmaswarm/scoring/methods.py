"""Methods and measures of a comparison: their keys in files, and their display names."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from sigmaswarm.scoring.score import Score
from sigmaswarm.scoring.targets import LONG_OUTAGE_LENGTH, OUTAGE_LENGTH, SHORT_OUTAGE_LENGTH

SMOOTHED = "smoothed"  # the tuned filter, smoothed
BANK = "swarm"  # a filter bank of the tuned filter
LEARNED = ("outage-lstm", "noise-gru")
AGAINST = "against"  # another filter, given by the user
FIXES = "fixes_alone"  # a constant-velocity filter without an IMU
BASELINE = "untuned"  # the tuned filter's model with typical noise parameters

METHODS = {
    "tuned": "tuned filter",
    BASELINE: "baseline",
    FIXES: "fixes alone",
    "raw_gps": "raw GPS",
    "imu_only": "IMU only",
}
"""Display names of the rows of every comparison."""
LEGEND = "baseline: the same filter before tuning; fixes alone: a filter without the IMU"
FIXES_ALONE_NOTE = (
    'The method "fixes alone" is a constant-velocity filter without the IMU. '
    "Its noise parameters are fitted to {}"
)
HOW_TO_COMPARE = "To compare with another tuning or with your own filter, add --against TUNING"
OPTIONAL_METHODS = {SMOOTHED: "tuned, smoothed", BANK: "tuned, filter bank"} | {
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
    against: str | None = None,
) -> dict[str, str]:
    """Return the display names of the methods.

    ``also`` contains optional rows from `OPTIONAL_METHODS`; `AGAINST` adds the row of another filter. ``against`` is
    the description of this other filter, if known.
    """
    first = {AGAINST: f"other {against or 'filter'}"} if AGAINST in also else {}
    first |= {"tuned": f"tuned {filter_called(kind, model)}"}
    optional = {method: name for method, name in OPTIONAL_METHODS.items() if method in also}
    return first | optional | METHODS | first


def in_sentence(method: str, name: str) -> str:
    """Return the display name of a method for use within a sentence."""
    return {FIXES: "the filter that uses only the fixes", "raw_gps": name}.get(method, f"the {name}")


def baseline_note(tuned: str) -> str:
    if tuned.endswith("robot-localization"):
        return (
            "The baseline is robot_localization with its default process noise. The IMU's variances are those in the "
            "log, or 0.0001 rad2/s2 and 0.01 m2/s4. R is computed from the stated or observed accuracy of the fixes, "
            "or from 2.1 m if neither is known"
        )
    return (
        "The baseline has the tuned filter's model, with typical noise parameters. R is computed from the stated or "
        "observed accuracy of the fixes, or from 2.1 m if neither is known. Q is computed from the IMU's noise density "
        "(that of an MPU-6050 if none is stated) and from typical errors of the model"
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
    """Return the measures in display units. ``outage_length`` is the length of the medium outages, s.

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
    """Return a method's values by measure, without the drifts of a method in `NO_OUTAGES`."""
    return {m: v for m, v in values.items() if method not in NO_OUTAGES or m not in DRIFTS}
