"""The compiled models: the names of the kernels, and the model of each kernel."""

from sigmaswarm.filters.fix_error import SUFFIX, with_fix_error
from sigmaswarm.filters.models import MODELS

UNSCENTED = "tilted12, unscented"
"""Kernel of tilted12 with sigma points. A planar model has one kernel for all filter types."""
FILTERS = (
    MODELS
    | {name + SUFFIX: with_fix_error(model) for name, model in MODELS.items() if not model.measures_imu}
    | {UNSCENTED: MODELS["tilted12"]}
)
"""Compiled models, by the name of the kernel."""


def kernel_name(model: str, kind: str, fix_error: bool = False) -> str:
    name = UNSCENTED if model == "tilted12" and kind != "ekf" else model
    return name + SUFFIX if fix_error else name


def base_model_name(model: str) -> str:
    return model.removesuffix(SUFFIX)
