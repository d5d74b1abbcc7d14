"""Parameter file for ROS's robot_localization from a filter.

Its UKF adds ``process_noise_covariance`` times the time step (ukf.cpp, predict), so ours, per nominal interval, is
divided by that interval; its gate is a Mahalanobis distance, the root of ours (filter_base.cpp); its state has 15
elements. Read from https://github.com/cra-ros-pkg/robot_localization, branch rolling-devel.
"""

import math

from sigmaswarm.exports.features import features_of, in_range, values_of
from sigmaswarm.exports.template import fill
from sigmaswarm.filters.parameters import FilterParameters

FILE = "robot_localization.yaml"
DEFAULT_PROCESS_NOISE = (
    *(0.05, 0.05, 0.06),
    *(0.03, 0.03, 0.06),
    *(0.025, 0.025, 0.04),
    *(0.01, 0.01, 0.02),
    *(0.01, 0.01, 0.015),
)
"""Its defaults, per second: x, y, z; roll, pitch, yaw; their rates; accelerations (filter_base.cpp, reset)."""
_X, _Y, _YAW, _VX, _VY = 0, 1, 5, 6, 7


def robot_localization(parameters: FilterParameters, interval: float, _: bool = False) -> dict[str, str]:
    """The parameter file, by file name; ``interval`` (s) is that of Q.

    ROS's filter has no rules that could be switched off.

    Raises
    ------
    InputError
        If a number of the filter is beyond the range of floating point once it is per second.
    """
    p, (r_east, r_north) = parameters, parameters.measurement_noise
    numbers = {
        "R_EAST": r_east,
        "R_NORTH": r_north,
        "R_UP": in_range(r_east + r_north, "the sum of measurement_noise"),
        "FREQUENCY": in_range(round(1 / interval, 3) or 1 / interval, "1 / nominal_interval"),
        "ALPHA": p.alpha,
        "BETA": p.beta,
        "KAPPA_15": p.kappa + p.n_states - len(DEFAULT_PROCESS_NOISE),
        "REJECTION_THRESHOLD": math.sqrt(p.gate or 0.0),
    }
    values = values_of(p, interval) | {name: yaml_number(value) for name, value in numbers.items()}
    values["NODE"] = "ekf_filter_node" if p.kind == "ekf" else "ukf_filter_node"
    values["PROCESS_NOISE"] = _diagonal(process_noise(p, interval))
    return {
        FILE: fill("robot_localization.yaml.in", features_of(p) | {"USE_LATENCY": p.latency != 0}, values)
    }


def process_noise(p: FilterParameters, interval: float) -> list[float]:
    """The diagonal in robot_localization's order, variances per second."""
    of = "process_noise / nominal_interval"
    x, y, vx, vy, theta = (in_range(variance / interval, of) for variance in p.process_noise[:5])
    diagonal = list(DEFAULT_PROCESS_NOISE)
    diagonal[_X], diagonal[_Y], diagonal[_YAW] = x, y, theta
    diagonal[_VX] = diagonal[_VY] = in_range((vx + vy) / 2, of)
    return diagonal


def yaml_number(value: float) -> str:
    """A number that every YAML reader takes for one: some read 1e-05, without a dot, as text."""
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _diagonal(values: list[float]) -> str:
    cells = [[yaml_number(v) if i == k else "0.0" for i in range(len(values))] for k, v in enumerate(values)]
    return ",\n".join("      " + ", ".join(row) for row in cells)
