"""Write a configuration of ROS's robot_localization, from a filter with the model robot-localization or another model.

robot_localization adds ``process_noise_covariance`` times the time step, so Q is divided by the nominal interval. Its
rejection thresholds are the square roots of limits of the NIS. Source:
https://github.com/cra-ros-pkg/robot_localization, branch rolling-devel, filter_base.cpp.
"""

import math
from typing import Any

from sigmaswarm.drives.mounting import Angles
from sigmaswarm.exports.features import context_of, fill, in_range
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.robot_yaml import STATE_INDICES

FILE = "robot_localization.yaml"
X, Y, VX, VY, YAW, AX, _, YAW_RATE = STATE_INDICES
DEFAULT_PROCESS_NOISE = (
    0.05, 0.05, 0.06,
    0.03, 0.03, 0.06,
    0.025, 0.025, 0.04,
    0.01, 0.01, 0.02,
    0.01, 0.01, 0.015,
)  # fmt: skip
"""Default process noise per second: x, y, z; roll, pitch, yaw; their rates; accelerations."""
SMALL, FIRST_FIX = 1e-6, 1.0
"""Initial variance of the states that `two_d_mode` keeps at 0, and smallest initial variance of x and y (m2)."""
START_VARIANCES = (0.25, 0.01, 0.0025, 1.0, 1.0, 0.1)
"""Initial variances of vx, vy, yaw, ax, ay, yaw rate, for an initial_state set as in README.md."""


def robot_localization(
    parameters: FilterParameters, interval: float, *, mounting: Angles | None = None
) -> dict[str, str]:
    """Return the text of each file by name. Raises `InputError` if a variance per second is not finite.

    Q refers to steps of ``interval`` s. For ``mounting`` see `export_texts`.
    """
    p, (r_east, r_north) = parameters, parameters.measurement_noise
    if MODELS[p.model].measures_imu:
        return _configuration(p, interval, mounting)
    numbers = {
        "r_east": r_east,
        "r_north": r_north,
        "r_up": in_range(r_east + r_north, "the sum of measurement_noise"),
    }
    values = context_of(p, interval) | _shared(p, interval, mounting)
    values |= {name: yaml_number(value) for name, value in numbers.items()}
    values["node"] = "ekf_filter_node" if p.kind == "ekf" else "ukf_filter_node"
    values["process_noise"] = _diagonal(process_noise(p, interval))
    return {FILE: fill(f"{FILE}.in", values)}


def _shared(p: FilterParameters, interval: float, mounting: Angles | None) -> dict[str, Any]:
    angles = zip(("roll", "pitch", "yaw"), map(math.radians, mounting or ()), strict=False)
    return {
        "mounting": mounting,
        "transform": " ".join(f"--{name} {angle:.9g}" for name, angle in angles),
        "frequency": yaml_number(in_range(round(1 / interval, 3) or 1 / interval, "1 / nominal_interval")),
        "rejection_threshold": yaml_number(math.sqrt(p.gate or 0.0)),
        "fix_entries": _entries("odom0", X, Y),
    }


def _configuration(p: FilterParameters, interval: float, mounting: Angles | None) -> dict[str, str]:
    of = "process_noise / nominal_interval"
    noise, start = list(DEFAULT_PROCESS_NOISE), [SMALL] * len(DEFAULT_PROCESS_NOISE)
    first = (*(max(r, FIRST_FIX) for r in p.measurement_noise), *START_VARIANCES)
    for place, variance, unknown in zip(STATE_INDICES, p.process_noise, first, strict=True):
        noise[place], start[place] = in_range(variance / interval, of), unknown
    (r_x, r_y), lateral = p.measurement_noise, yaml_number(p.lateral_noise or 1.0)
    stated = (
        "" if p.accuracy_scale is None else f"{p.accuracy_scale:.6g} times the receiver's variance, plus "
    )
    numbers = {
        **dict(zip(("r_gyro", "r_accel"), p.imu_noise, strict=False)),
        "r_odometer": p.odometer_noise or 1.0,
        "r_heading": p.heading_noise or 1.0,
        "gyro_threshold": math.sqrt(p.imu_gate[0]),
        "accel_threshold": math.sqrt(p.imu_gate[1]),
    }
    values = context_of(p, interval) | _shared(p, interval, mounting)
    values |= {
        **{name: yaml_number(value) for name, value in numbers.items()},
        "imu_entries": _entries("imu0", YAW_RATE, AX),
        "heading_entries": _entries("imu1", YAW),
        "wheel_entries": _entries("odom1", VX),
        "lateral_entries": _entries("twist0", VY),
        "imu_gate": math.isfinite(max(p.imu_gate)),
        "initial_covariance": _diagonal(start),
        "process_noise": _diagonal(noise),
        "twist_covariance": ", ".join(lateral if k % 7 == 0 else "0.0" for k in range(36)),
        "r_lateral": lateral,
        "fix_covariance": f"{stated}{r_x!r} and {r_y!r} m2",
    }
    names = {"ekf.yaml": "ekf.yaml.in", "ekf.launch.py": "ekf.launch.py.in", "README.md": "ekf_readme.md.in"}
    return {file: fill(template, values) for file, template in names.items()}


def process_noise(p: FilterParameters, interval: float) -> list[float]:
    """Return the diagonal of Q per second, in the order of robot_localization."""
    of = "process_noise / nominal_interval"
    x, y, vx, vy, theta = (in_range(variance / interval, of) for variance in p.process_noise[:5])
    diagonal = list(DEFAULT_PROCESS_NOISE)
    diagonal[0], diagonal[1], diagonal[5] = x, y, theta
    diagonal[6] = diagonal[7] = in_range((vx + vy) / 2, of)
    return diagonal


def yaml_number(value: float) -> str:
    """Return the text of a number with a dot, since some YAML readers read 1e-05 as text."""
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _entries(sensor: str, *measured: int) -> str:
    """Return the setting that selects the measured states of a sensor, as five rows of three values."""
    head = f"    {sensor}_config: ["
    cells = [("true," if k in measured else "false,").ljust(6) for k in range(15)]
    rows = [" ".join(cells[k : k + 3]).rstrip() for k in range(0, 15, 3)]
    return head + f"\n{' ' * len(head)}".join(rows).removesuffix(",") + "]"


def _diagonal(values: list[float]) -> str:
    cells = [[yaml_number(v) if i == k else "0.0" for i in range(len(values))] for k, v in enumerate(values)]
    return ",\n".join("      " + ", ".join(row) for row in cells)
