"""The names of the models and kinds of filters; without imports, for the command line's help."""

from typing import Literal

ModelName = Literal["planar5", "planar8", "tilted12", "robot-localization"]
FilterKind = Literal["ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf"]
NetworkName = Literal["outage-lstm", "noise-gru"]
