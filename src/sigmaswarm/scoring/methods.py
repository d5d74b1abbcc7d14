"""Methods of a comparison: their keys in files, and their display names."""

from collections.abc import Collection

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
LEGEND = "baseline: the same model with typical noise; fixes alone: a filter without an IMU"
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

    ``also``: optional rows from `OPTIONAL_METHODS`; `AGAINST` adds the row of another filter. ``against``: description
    of this other filter, if known.
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
