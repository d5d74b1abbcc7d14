"""The keys of drive.toml that describe how the raw IMU samples were converted: axes and mounting."""

from collections.abc import Iterable, Mapping
from typing import Any, cast

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.geodesy import roll_pitch_yaw, rotation_of

KEY = "imu_mounting_deg"
# key of a table: for each axis of the IMU before the rotation, an expression over a log's columns
AXES_KEY = "imu_axes"
Angles = tuple[float, float, float]  # roll, pitch and yaw of the IMU, deg, as in ``import --mount``
MAX_SPREAD = 3.0  # deg, largest angle from the mean mounting to that of a drive with the same mounting
ANGLE_DECIMALS = 9  # of angles in drive.toml, deg; the rotation matrix then has errors below 1e-10
NO_ROTATION = (0.0, 0.0, 0.0)


def with_rotation(metadata: Mapping[str, Any], rotation: Array | None) -> dict[str, Any]:
    """Return a drive's metadata after a further rotation (3, 3) of its IMU.

    ``rotation`` is None if the change of the axes was not a rotation. In this case the keys of axes and
    mounting are removed, since no rotation relates the samples to the sensor's axes.
    """
    if rotation is not None and np.allclose(rotation, np.eye(3), rtol=0, atol=1e-12):
        return {**metadata}
    kept = {key: value for key, value in metadata.items() if key != KEY}
    if rotation is None:
        return without_axes(kept)
    angles = roll_pitch_yaw(rotation @ rotation_of(*metadata.get(KEY, NO_ROTATION)), ANGLE_DECIMALS)
    return kept | {KEY: [*angles]} if any(angles) else kept


def without_axes(metadata: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in metadata.items() if key != AXES_KEY}


def axes_of(metadata: Mapping[str, Any]) -> dict[str, str]:
    """Return the expressions of the IMU's axes in a drive's metadata, or nothing if there are none."""
    stated = metadata.get(AXES_KEY)
    axes = cast("dict[str, Any]", stated if isinstance(stated, dict) else {})
    return {axis: str(text) for axis, text in axes.items()}


def common_axes(stated: Iterable[Mapping[str, str]]) -> dict[str, str]:
    """Return the expressions of the IMU's axes if all drives state the same expressions; empty if the drives differ."""
    first, *others = [*stated] or [{}]
    return {**first} if all(other == first for other in others) else {}


def common_mounting(stated: Iterable[Angles | None]) -> Angles | None:
    """Return the mean mounting; None if none is stated, or if a mounting differs from the mean by over `MAX_SPREAD`.

    A drive without a mounting counts as not rotated.
    """
    mountings = [*stated]
    if not any(mountings):
        return None
    rotations = np.array([rotation_of(*(angles or NO_ROTATION)) for angles in mountings])
    u, _, vt = np.linalg.svd(rotations.sum(axis=0))
    mean = u @ vt
    cosines = (np.einsum("kij,ij->k", rotations, mean) - 1) / 2
    return roll_pitch_yaw(mean, ANGLE_DECIMALS) if np.min(cosines) >= np.cos(np.radians(MAX_SPREAD)) else None
