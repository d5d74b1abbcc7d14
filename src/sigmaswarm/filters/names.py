"""Names of models and filter types, in a module without imports, so that the command line's help is fast."""

from typing import Literal

ModelName = Literal["planar5", "planar8", "tilted12", "robot-localization"]
FilterKind = Literal["ukf", "ekf", "adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf"]
NetworkName = Literal["outage-lstm", "noise-gru"]
