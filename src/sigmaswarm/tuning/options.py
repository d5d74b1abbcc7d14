"""What a tuning can be asked for: names, types, meanings and defaults, for Python and for the command line.

`TuneConfig` checks what is asked; a test holds the two together. Nothing heavy is imported here, since the command
line's help is made of it.
"""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Annotated, Any, Literal, TypedDict

from typing_extensions import Doc

from sigmaswarm.errors import InputError
from sigmaswarm.filters.names import FilterKind, ModelName

Scale = Literal["log10", "linear"]
OptimizerName = Literal["pso", "ga", "ga-pso", "de", "cma-es", "bo", "nelder-mead", "random", "sobol"]
Option = Literal["velocity", "lateral", "standstill", "odometer", "gate", "latency", "accuracy", "robust"]

INERTIA = 0.7298
"""w: the paper gives none; this is the constriction coefficient of Clerc and Kennedy (2002)."""
ACCELERATION = 1.5
"""c1 = c2, from the paper."""
SEEDS = 20
"""Runs of each optimizer in a comparison."""


class SharedOptions(TypedDict, total=False):
    """Options of any search, but for what a comparison compares."""

    objective: Annotated[
        str,
        Doc(
            "truth-rmse: position error. truth-pose: position, heading and outage drift together. innovation-nll: how "
            "likely each fix is before it is absorbed; needs no truth, and makes the filter honest about its errors. "
            "innovation-t: the same where some fixes lie far off; for filters that use robust. forecast-t: the same of "
            "hidden fixes. "
            "outage-rmse: forecasts of hidden fixes; needs no truth. nis, nees: consistency, to be added to others. "
            "gps-rmse: the paper's, which rewards copying the GPS. Sums like `truth-pose + 0.2 nees` are objectives, "
            "too. auto: truth-pose + 0.2 nees where all drives have truth; else innovation-t, and where fixes err anew "
            "each time half and half with forecast-t."
        ),
    ]
    worst: Annotated[
        float, Doc("Share of the drives that counts, the worst ones; by default the mean over all.")
    ]
    particles: Annotated[int, Doc("Size of the swarm, or evaluations a generation.")]
    generations: Annotated[int, Doc("Moves of the swarm, the first placement included.")]
    trials: Annotated[int, Doc("Independent runs; the best one is kept, all are reported.")]
    polish: Annotated[
        int,
        Doc(
            "How many of the particles x generations evaluations a Nelder-Mead search from the best point may have."
        ),
    ]
    racing: Annotated[
        bool,
        Doc(
            "Try each generation on one drive first, its better half on two, and so on: fewer filter steps, with a "
            "part of the drives deciding who goes on. With one drive it changes nothing; of 96 and more it begins with "
            "a twelfth, and only who is better there than the best so far goes on."
        ),
    ]
    inertia: Annotated[float, Doc("The w of pso.")]
    cognitive: Annotated[float, Doc("The c1 of pso.")]
    social: Annotated[float, Doc("The c2 of pso.")]
    zero_velocity_at_bounds: Annotated[
        bool, Doc("pso: stop particles in the coordinates in which they hit the box.")
    ]
    patience: Annotated[
        int | None,
        Doc("End a trial after that many generations without progress; by default never."),
    ]


class SearchOptions(SharedOptions, total=False):
    """Options of any search."""

    scale: Annotated[Scale, Doc("How variances are searched; linear is the paper's way.")]
    optimizer: Annotated[
        OptimizerName,
        Doc(
            "pso: particle swarm. ga: genetic algorithm. ga-pso: both in turn. de: differential evolution. cma-es: "
            "covariance matrix adaptation. bo: Bayesian optimization, for a hundred evaluations; needs "
            "scikit-learn. nelder-mead, random, sobol: to compare with."
        ),
    ]
    seed: Annotated[int, Doc("Decides everything that is left to chance.")]


class FilterOptions(TypedDict, total=False):
    """Which filter for cars is tuned."""

    model: Annotated[
        ModelName,
        Doc(
            "The filter's process model: planar5 is the paper's, planar8 also estimates the IMU's biases, tilted12 "
            "also roll and pitch, for roads that are not flat; it needs an IMU with az, gx and gy. By default tilted12 "
            "where all logs have these, else planar8."
        ),
    ]
    kind: Annotated[
        FilterKind,
        Doc("Unscented, extended (all that tilted12 has), adaptive (Sage-Husa), strong tracking or fuzzy."),
    ]
    use: Annotated[
        Sequence[Option],
        Doc(
            "What the filter uses beside position fixes; its parameters are tuned with the rest. velocity: the "
            "receiver's speed and course. lateral: a car does not slide sideways. standstill: it stands still when "
            "it stands. odometer: the speed that the wheels tell, with its scale. gate: turn outlying fixes away. "
            "latency: fixes may be older than they say. accuracy: what the receiver states of each fix. robust: "
            "outlying fixes count less, by Student's t; in place of gate. By default lateral, standstill and robust, "
            "and odometer and accuracy where all logs have them; nothing with --model planar5."
        ),
    ]
    outage_seed: Annotated[int, Doc("Places the outages of objectives that have some.")]
    as_recorded: Annotated[
        bool,
        Doc(
            "Absorb frozen fixes, and cross gaps in the IMU as if they were steps like others: for diagnosis, and for "
            "the paper's protocol."
        ),
    ]


class TuneOptions(SearchOptions, FilterOptions, total=False):
    """What `tune` takes for a filter for cars."""

    prior: Annotated[
        float | None,
        Doc(
            "How much the receiver's stated accuracy counts beside each fix, as a prior on R: a log without truth "
            "can't tell errors that last from the car's way. 0: not at all. By default 1 where the fixes' likelihood "
            "alone decides, else 0."
        ),
    ]
    margin: Annotated[
        float | None,
        Doc(
            "Share by which the cost may rise on up to 100 s of driving (half of it on 200 s) while all process noises "
            "are raised together, of tilted12 the walks of its biases and, by half as many decades, the noises of "
            "position and velocity: a filter that doubts its model more bears roads and IMUs that the tuning has not "
            "seen. tilted12 is also left no less than a little doubt of its biases and of roll and pitch. By default "
            "0.05, of tilted12 0.02, where the fixes' likelihood alone decides, else 0."
        ),
    ]


class CompareOptions(SharedOptions, FilterOptions, total=False):
    """What `compare` takes for all that are compared."""


DEFAULTS: dict[str, Any] = {
    "objective": "auto",
    "worst": 1.0,
    "particles": 30,
    "generations": 50,
    "trials": 1,
    "polish": 0,
    "racing": False,
    "inertia": INERTIA,
    "cognitive": ACCELERATION,
    "social": ACCELERATION,
    "zero_velocity_at_bounds": False,
    "patience": None,
    "scale": "log10",
    "optimizer": "de",  # loses the heading less often than the paper's pso at the same budget (docs/optimizers.md)
    "seed": 0,
    "model": None,  # what suits the logs: `defaults.with_filter`
    "kind": None,  # the first that the model is compiled as
    "use": None,  # like the model
    "outage_seed": 0,
    "as_recorded": False,
    "prior": None,
    "margin": None,
}
"""The paper's where it gives them; None where the data or another option decides."""


def require_packages(optimizer: str) -> None:
    """Say in one line what an optimizer needs and is not installed.

    Raises
    ------
    InputError
        If a package is missing.
    """
    if optimizer == "bo" and find_spec("sklearn") is None:
        raise InputError(
            "optimizer = 'bo': needs scikit-learn, which is not installed; run: pip install scikit-learn"
        )
