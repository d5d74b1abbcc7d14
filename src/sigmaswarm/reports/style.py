"""One look for all pictures: colors that color-blind readers can distinguish, and lines that stay legible in grey."""

from sigmaswarm.reports.views.charts import Dash, Look
from sigmaswarm.scoring.drifts import FIXES, OWN, UNTUNED
from sigmaswarm.scoring.measures import ALSO, METHODS, method_names

# M. Okabe and K. Ito's palette (2008), P. Tol's indigo, and greys.
BLACK, BLUE, ORANGE, GREEN = "#000000", "#0072B2", "#E69F00", "#009E73"
VERMILION, PURPLE, SKY, INDIGO = "#D55E00", "#CC79A7", "#56B4E9", "#332288"
CHARCOAL, SLATE, GREY, SILVER, MIST = "#4d4d4d", "#51585f", "#999999", "#cccccc", "#e5e5e5"

MANY = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY, BLACK)
"""Colors of many lines; `DASHES` distinguishes those that repeat a color."""
DASHES: tuple[Dash, ...] = ("solid", "dash", "dot", "dashdot")

# Line styles differ, too, so that a grey print stays legible.
LOOKS: dict[str, Look] = {
    "truth": Look(BLACK, 1.2),
    "tuned": Look(BLUE, 2.2),
    "smoothed": Look(INDIGO, 1.6),
    "swarm": Look(VERMILION, 1.4, "dash"),
    "outage-lstm": Look(SKY, 1.6, "dash"),
    "noise-gru": Look(PURPLE, 1.6, "dash"),
    "against": Look(SKY, 1.6),
    UNTUNED: Look(PURPLE, 1.2, "dashdot"),
    FIXES: Look(ORANGE, 1.2, "dash"),
    "imu_only": Look(VERMILION, 1.2, "dot"),
    "raw_gps": Look(GREEN, 0.0, "none", "dot", 4.0, 0.7),
}
STUDY_LOOKS: dict[str, Look] = {
    "truth": LOOKS["truth"],
    "honest-pso-ukf": LOOKS["tuned"],
    "paper-pso-ukf": Look(VERMILION, 1.4, "dashdot"),
    "honest-pso-ekf": Look(SKY, 1.4),
    "honest-pso-planar8": Look(INDIGO, 1.4, "dash"),
    "ukf-datasheet": LOOKS[UNTUNED],
    "ukf-defaults": Look(ORANGE, 0.8, "dash", opacity=0.5),
    "imu_only": Look("#51585F", 1.2, "dot"),
    "raw_gps": LOOKS["raw_gps"],
}
"""Of the series in a study's tracks, the first one on top."""
LABELS = {"truth": "truth", **method_names(also=(OWN, *ALSO)), **METHODS}
