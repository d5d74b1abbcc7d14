"""Style of all pictures, suitable for color-blind readers and for gray prints."""

from dataclasses import dataclass, replace
from typing import Any

from sigmaswarm.scoring.methods import AGAINST, BASELINE, FIXES, METHODS, OPTIONAL_METHODS, method_names


@dataclass(frozen=True)
class Look:
    """Style of a line, with line style and marker of matplotlib; sizes are in points.

    ``visible`` is True if static plots contain the line and a page shows it initially.
    """

    color: str
    width: float = 1.2
    style: str = "-"
    marker: str = ""
    size: float = 4.0
    opacity: float = 1.0
    visible: bool = True

    @property
    def line(self) -> dict[str, Any]:
        marker = {"marker": self.marker, "ms": self.size} if self.marker else {}
        return {"color": self.color, "lw": self.width, "ls": self.style, "alpha": self.opacity, **marker}


# M. Okabe and K. Ito's palette (2008), P. Tol's indigo, and shades of gray.
BLACK, BLUE, ORANGE, GREEN = "#000000", "#0072B2", "#E69F00", "#009E73"
VERMILION, PURPLE, SKY, INDIGO = "#D55E00", "#CC79A7", "#56B4E9", "#332288"
CHARCOAL, SLATE, GREY, SILVER, MIST = "#4d4d4d", "#51585f", "#999999", "#cccccc", "#e5e5e5"
NO_LINE = "none"

# Series from top to bottom. The line styles also differ, so that a gray print stays legible.
STYLES: dict[str, Look] = {
    "truth": Look(BLACK, 1.2),
    "smoothed": Look(INDIGO, 1.6),
    "swarm": Look(VERMILION, 1.4, "--"),
    "outage-lstm": Look(SKY, 1.6, "--"),
    "noise-gru": Look(PURPLE, 1.6, "--"),
    "tuned": Look(BLUE, 2.2),
    "against": Look(SKY, 1.6),
    BASELINE: Look(PURPLE, 1.2, "-."),
    FIXES: Look(ORANGE, 1.2, "--", visible=False),
    "imu_only": Look(VERMILION, 1.2, ":", visible=False),
    "raw_gps": Look(GREEN, 0.0, NO_LINE, ".", 4.0, 0.7),
}
# Styles of the series in the tracks of a study, from top to bottom.
STUDY_STYLES: dict[str, Look] = {
    "truth": STYLES["truth"],
    "honest-pso-ukf": STYLES["tuned"],
    "paper-pso-ukf": Look(VERMILION, 1.4, "-."),
    "honest-pso-ekf": Look(SKY, 1.4, visible=False),
    "honest-pso-planar8": Look(INDIGO, 1.4, "--", visible=False),
    "ukf-datasheet": replace(STYLES[BASELINE], visible=False),
    "ukf-defaults": Look(ORANGE, 0.8, "--", opacity=0.5, visible=False),
    "imu_only": Look(SLATE, 1.2, ":", visible=False),
    "raw_gps": STYLES["raw_gps"],
}
LABELS = {"truth": "truth", **method_names(also=(AGAINST, *OPTIONAL_METHODS)), **METHODS}


def many_styles(n: int, width: float) -> list[Look]:
    """Return ``n`` styles. Line styles distinguish lines of equal color."""
    colors, styles = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY, BLACK), ("-", "--", ":", "-.")
    return [Look(colors[i % 7], width, styles[i // 7 % 4]) for i in range(n)]
