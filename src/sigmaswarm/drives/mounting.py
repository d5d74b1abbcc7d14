"""The mounting of the IMU in drive.toml: the rotation that turned its samples to the axes of the vehicle."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from sigmaswarm.drives.tables import Array
from sigmaswarm.geodesy import roll_pitch_yaw, rotation_of

KEY = "imu_mounting_deg"
Angles = tuple[float, float, float]
"""Roll, pitch and yaw of the IMU in the vehicle, deg, as ``import --mount`` takes them."""
AGREE = 3.0
"""Largest angle, deg, between the mounting of a drive and the mean at which the mountings of drives agree."""
DIGITS = 9
"""Decimals of a stated angle, deg; the error of the rotation is below 1e-10."""
NOT_TURNED = (0.0, 0.0, 0.0)


def with_rotation(metadata: Mapping[str, Any], rotation: Array | None) -> dict[str, Any]:
    """Return a drive's metadata after its IMU was turned by a further rotation (3, 3).

    None: the axes were changed in a way that is no rotation. No mounting then describes the way from the raw samples.
    """
    if rotation is not None and np.allclose(rotation, np.eye(3), rtol=0, atol=1e-12):
        return {**metadata}
    kept = {key: value for key, value in metadata.items() if key != KEY}
    if rotation is None:
        return kept
    angles = roll_pitch_yaw(rotation @ rotation_of(*metadata.get(KEY, NOT_TURNED)), DIGITS)
    return kept | {KEY: [*angles]} if any(angles) else kept


def common_mounting(stated: Iterable[Angles | None]) -> Angles | None:
    """Return the mean mounting of drives if each drive is within `AGREE` of it and not all state none, else None.

    A drive that states no mounting is treated as if its IMU were not rotated.
    """
    each = [*stated]
    if not any(each):
        return None
    rotations = np.array([rotation_of(*(angles or NOT_TURNED)) for angles in each])
    u, _, vt = np.linalg.svd(rotations.sum(axis=0))
    mean = u @ vt
    cosines = (np.einsum("kij,ij->k", rotations, mean) - 1) / 2
    return roll_pitch_yaw(mean, DIGITS) if np.min(cosines) >= np.cos(np.radians(AGREE)) else None
