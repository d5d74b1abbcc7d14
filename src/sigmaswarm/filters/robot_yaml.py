"""Read the ekf.yaml of robot_localization as parameters of the model robot-localization.

The file contains the process noise, rejection thresholds, and flags for the fused entries of each message. The
variances of measurements are in the messages: see `presets.filter_for`.
"""

import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from sigmaswarm.errors import InputError, SigmaswarmWarning, not_installed
from sigmaswarm.file_sizes import read_toml_text
from sigmaswarm.wording import printable

YAML = (".yaml", ".yml")
STATE_INDICES = (0, 1, 6, 7, 5, 12, 13, 11)  # the eight states among robot_localization's 15
PROCESS_NOISE = (0.05, 0.05, 0.025, 0.025, 0.06, 0.01, 0.01, 0.02)
"""robot_localization's default process noise per second: x, y, vx, vy, yaw, ax, ay, yaw rate."""
IMU_NOISE = (1e-4, 1e-2)  # typical variances of gz, (rad/s)2, and ax, (m/s2)2
HEADING_NOISE = math.radians(0.5) ** 2  # rad2, typical of a dual-antenna heading
SPEED_NOISE = 0.1**2  # (m/s)2, typical of a measured speed
MIN_VARIANCE = 1e-9  # lower limit of measurement variances in robot_localization
NOT_FUSED = 1e9  # variance of an IMU entry that a configuration does not fuse

_X, _YAW, _VX, _VY, _VYAW, _AX, _AY = 0, 5, 6, 7, 11, 12, 13
_CONFIG = re.compile(r"((odom|pose|twist|imu)\d+)_config")
_BLOCK = re.compile(rf"{_CONFIG.pattern}|process_noise_covariance")
Block = Mapping[str, Any]


def read_configuration(path: Path) -> dict[str, Any]:
    """Read fields of `FilterParameters` from an ekf.yaml of ROS 1 or 2, with typical variances of measurements.

    Raises `InputError` if the file is not such a configuration; warns if the model does not support a setting in it.
    """
    block = _chosen(_loaded(path), path)
    inputs = {found[1]: _entries(block[key], path, key) for key in block if (found := _CONFIG.fullmatch(key))}
    inertial = [name for name in inputs if name.startswith("imu")]
    imu = [inputs[name] for name in inertial]
    other = {name: entries for name, entries in inputs.items() if not name.startswith("imu")}
    fixes = next((name for name, entries in other.items() if entries[_X]), None)
    gyro, accel = (any(entries[k] for entries in imu) for k in (_VYAW, _AX))
    wheels, no_slip = (any(entries[k] for entries in other.values()) for k in (_VX, _VY))
    noise = _process_noise(block, path)
    if left_out := "; ".join(_left_out(block, inputs)):
        warnings.warn(f"{path}: {left_out}", SigmaswarmWarning, stacklevel=4)
    r_gyro, r_accel = IMU_NOISE
    r_imu = (r_gyro if gyro else NOT_FUSED, r_accel if accel else NOT_FUSED)
    return {
        "process_noise": noise,
        "imu_noise": (*r_imu, r_accel) if any(entries[_AY] for entries in imu) else r_imu,
        "gate": _threshold(block, path, fixes and [f"{fixes}_pose", fixes]),
        "imu_gate": (
            _threshold(block, path, [f"{name}_twist" for name in inertial]) or math.inf,
            _threshold(block, path, [f"{name}_linear_acceleration" for name in inertial]) or math.inf,
        ),
        "lateral_noise": SPEED_NOISE if no_slip else None,
        "odometer_noise": SPEED_NOISE if wheels else None,
        "heading_noise": HEADING_NOISE if any(e[_YAW] for e in inputs.values()) else None,
    }


def _loaded(path: Path) -> Any:
    try:
        import yaml
    except ModuleNotFoundError:
        raise not_installed(f"{path}: a YAML file", "PyYAML") from None
    try:
        return yaml.safe_load(read_toml_text(path))
    except OSError as error:
        raise InputError(
            f"{path}: can't be read ({error.strerror}); pass the path of a "
            "robot_localization parameter file (ekf.yaml)"
        ) from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: is not valid YAML ({printable(reason, 160)}); correct this file") from None


def _chosen(content: Any, path: Path) -> Block:
    """Return the parameters of the first filter node with "gps" in the name of an input topic, or of the first node."""
    blocks = [*_blocks(content, set())]
    if not blocks:
        raise InputError(
            f"{path}: has neither process_noise_covariance nor a setting like imu0_config; specify the ekf.yaml of "
            "robot_localization"
        )
    return max(blocks, key=lambda block: any("gps" in str(v) for k, v in block.items() if k[-1:].isdigit()))


def _blocks(content: Any, visited: set[int]) -> Iterator[Block]:
    """Yield the mappings with settings of a filter, at any depth; aliases may make a mapping contain itself."""
    if isinstance(content, dict) and id(content) not in visited:
        visited.add(id(content))
        block = {str(key): value for key, value in cast("dict[Any, Any]", content).items()}
        if any(_BLOCK.fullmatch(key) for key in block):
            yield block
        for inner in block.values():
            yield from _blocks(inner, visited)


def _entries(value: Any, path: Path, key: str) -> list[bool]:
    if isinstance(value, list) and [type(v) for v in cast("list[Any]", value)] == [bool] * 15:
        return value
    raise InputError(f"{path}: {key} must be 15 booleans; list true or false for each state")


def _process_noise(block: Block, path: Path) -> tuple[float, ...]:
    """Return the variances per second of the eight states, or the defaults if the file contains none."""
    key = "process_noise_covariance"
    if key not in block:
        return PROCESS_NOISE
    given = block[key]
    try:  # YAML 1.1 reads 1e-9 as text
        values = [float(value) for value in given]
    except (TypeError, ValueError):
        values = []
    if len(values) not in (15, 225):
        raise InputError(f"{path}: {key} must be 225 numbers, or 15 for the diagonal; change the list")
    diagonal = values if len(values) == 15 else values[::16]
    noise = tuple(diagonal[index] for index in STATE_INDICES)
    if not all(0 <= variance < math.inf for variance in noise):
        raise InputError(f"{path}: {key} has a variance that is negative or not finite; change this variance")
    return noise


def _threshold(block: Block, path: Path, names: Sequence[str] | None) -> float | None:
    """Return the squared Mahalanobis threshold of the first of ``names`` that has a threshold in the file, or None."""
    keys = [key for name in names or () if (key := f"{name}_rejection_threshold") in block]
    if not keys:
        return None
    try:
        limit = float(block[keys[0]])
    except (TypeError, ValueError):
        limit = math.nan
    if not limit > 0:
        raise InputError(f"{path}: {keys[0]} must be a positive number; change this value")
    return limit**2 if limit < 1e100 else None  # the default is the largest double


def _left_out(block: Block, inputs: Mapping[str, list[bool]]) -> Iterator[str]:
    if block.get("two_d_mode") is not True:
        yield "two_d_mode is assumed, although the file does not set it to true"
    if block.get("dynamic_process_noise_covariance") is True:
        yield "the setting dynamic_process_noise_covariance is ignored"
    if "alpha" in block:
        yield "an EKF is assumed, although the file has settings of the UKF"
    for name, entries in inputs.items():
        if block.get(f"{name}_differential") is True or block.get(f"{name}_relative") is True:
            yield f"{name}: the settings differential and relative are ignored"
        if entries[_YAW]:
            yield f"{name}: the yaw is replaced by the heading of the fixes, or ignored if the fixes have no heading"
        if entries[_VYAW] and not name.startswith("imu"):
            yield f"{name}: the yaw rate is not used"
