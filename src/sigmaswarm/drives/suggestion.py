"""Choose the default filter of `tune` by the sensors of the logs."""

from collections.abc import Sequence
from dataclasses import dataclass

from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.sensors import LogProperties, log_properties


@dataclass(frozen=True)
class SuggestedFilter:
    """A filter: its model, its measurements other than positions, and the reason for the choice."""

    model: str
    use: tuple[str, ...]
    because: str

    @property
    def options(self) -> str:
        return f"--model {self.model} --use {' '.join(self.use)}"


def suggest_filter(drives: Sequence[Drive | LogProperties]) -> SuggestedFilter:
    """Choose the filter for cars from the sensors that all drives have, without running filters.

    - **tilted12** if every IMU has six axes, with gravity in az. This model estimates roll and pitch, so gravity on
      hills and during braking is not mistaken for acceleration. Otherwise **planar8**.
    - **lateral** and **standstill** always. These constraints make the heading observable, which position fixes alone
      do not.
    - **odometer** if every log has one.
    - **accuracy** if every receiver states standard deviations, and these vary.
    - **robust** always. This option hardly changes results without outliers, and is needed with outliers.

    The gate is not used, since a gate that was tuned on one receiver rejects good fixes of another receiver. The
    receiver's velocity and heading are not used, since no drive with truth contained them. Latency is not estimated.
    The choice of the model does not depend on scores. The errors of models chosen by held-out likelihood and
    predictions exceeded those of the best model by 18 to 24% on average, and by 61 to 122% at worst. With one good
    model for all drives, they exceeded those of the best model by 4 to 12%.
    """
    logs = [log_properties(drive) for drive in drives]
    six = bool(logs) and all(log.attitude for log in logs)
    wheels = bool(logs) and all(log.odometer for log in logs)
    quantiles = [log.std_quantiles for log in logs if log.std_quantiles]
    stated = bool(logs) and len(quantiles) == len(logs)
    reasons = ["the IMU has six axes" if six else "an IMU lacks az, gx or gy"]
    if not six and all(len(log.axes) == 6 for log in logs):
        reasons = ["az does not show gravity, or gx or gy is constant"]
    if wheels:
        reasons.append("there is an odometer")
    if stated:
        low, high = min(low for low, _ in quantiles), max(high for _, high in quantiles)
        reasons.append(f"the stated standard deviations range from {low:.2g} to {high:.2g} m")
    use = ("lateral", "standstill", *["odometer"] * wheels, *["accuracy"] * stated, "robust")
    return SuggestedFilter("tilted12" if six else "planar8", use, ", and ".join(reasons))
