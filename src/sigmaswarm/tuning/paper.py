"""The paper's setting, and what contradicts it."""

from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.tuning.optimizers.pso import ACCELERATION

PAPER: dict[str, Any] = {
    "optimizer": "pso",
    "scale": "linear",
    "objective": "gps-rmse",
    "model": "planar5",
    "kind": "ukf",
    "particles": 30,
    "generations": 50,
    "polish": 0,
    "racing": False,
    "use": (),
    "as_recorded": True,
    "prior": 0.0,
    "margin": 0.0,
    "worst": 1.0,
    "cognitive": ACCELERATION,
    "social": ACCELERATION,
    "patience": None,
}
"""What the paper says of one tuning. It repeats it 20 times; inertia, seed and velocities at bounds are open."""


def papers_config(given: dict[str, Any]) -> dict[str, Any]:
    """The paper's setting with the options that it leaves open.

    Raises
    ------
    InputError
        If an option contradicts the paper.
    """
    for name, value in given.items():
        if name in PAPER and (tuple(value) if name == "use" else value) != PAPER[name]:
            meant = PAPER[name] if PAPER[name] not in ((), None) else "nothing"
            raise InputError(
                f"{name} = {value!r}: contradicts the paper's setting, which has {meant}; "
                f"leave out {name} or the paper's setting"
            )
    return {**given, **PAPER}
