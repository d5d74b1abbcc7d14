"""Find the poses of the IMU and the antenna in the vehicle from the static transforms of ROS (/tf_static)."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.geodesy import roll_pitch_yaw
from sigmaswarm.importing.source import Placement, Table

# Names of the vehicle's frame, with x forward, y left, z up (REP-105)
BASES = ("base_link", "base_footprint")
Pose = tuple[Array, Array]  # rotation (3, 3) and translation (3,), m, of a frame in another
Tree = Mapping[str, tuple[str, Pose]]  # the parent of each frame, and the frame's pose in the parent


def static_topic(tables: Mapping[str, Table]) -> str | None:
    return next(
        (t for t, table in tables.items() if t.endswith("tf_static") and "tf" in table.kind.lower()), None
    )


def frame_of(message: Any) -> str:
    """Return the frame in a message's header; for Odometry, child_frame_id, or base_link if this is empty."""
    child = getattr(message, "child_frame_id", None)
    name = child if child is not None else getattr(getattr(message, "header", None), "frame_id", "")
    return name.strip("/") or (BASES[0] if child is not None else "")


def placement(messages: Iterable[Any], imu: str, antenna: str) -> Placement | None:
    """Find the poses of IMU and antenna in the vehicle's frame or, without it, in a common ancestor of their frames.

    Return None if the transforms do not connect the IMU with such a frame. ``messages`` are of type tf2_msgs/TFMessage;
    a later transform of the same frame replaces an earlier one.
    """
    tree: dict[str, tuple[str, Pose]] = {}
    for message in messages:
        for stamped in getattr(message, "transforms", ()):
            if (pose := _pose_of(stamped.transform)) is not None:
                tree[stamped.child_frame_id.strip("/")] = stamped.header.frame_id.strip("/"), pose
    known = {*tree, *(parent for parent, _ in tree.values())}
    of_imu, of_antenna = (_ancestors(tree, name) if name in known else {} for name in (imu, antenna))
    shared = [name for name in of_imu if name in of_antenna]
    base = next((name for name in (*BASES, *shared) if name in of_imu), None)
    if base is None:
        return None
    rotation, at = of_imu[base]
    lever = of_antenna[base][1] - at if base in of_antenna else None
    return Placement(
        mount=",".join(f"{angle:.9g}" for angle in roll_pitch_yaw(rotation, 6)),
        lever_arm=None if lever is None else (float(lever[0]), float(lever[1]), float(lever[2])),
        frames=(base, imu, antenna),
    )


def _pose_of(transform: Any) -> Pose | None:
    """Convert a transform to rotation and translation; None if it is not finite or its quaternion is not normalized."""
    r, t = transform.rotation, transform.translation
    x, y, z, w = q = np.array([r.x, r.y, r.z, r.w], dtype=np.float64)
    translation, norm = np.array([t.x, t.y, t.z], dtype=np.float64), float(np.linalg.norm(q))
    if not (np.isfinite(translation).all() and abs(norm - 1.0) < 0.01):
        return None
    x, y, z, w = q / norm
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2 * (w * cross + cross @ cross), translation


def _ancestors(tree: Tree, frame: str) -> dict[str, Pose]:
    """Return the pose of a frame in itself and in each of its ancestors, the nearest first."""
    found, pose = dict[str, Pose](), (np.eye(3), np.zeros(3))
    while frame not in found:  # transforms may form a cycle
        found[frame] = pose
        if frame not in tree:
            break
        frame, (rotation, translation) = tree[frame]
        pose = rotation @ pose[0], rotation @ pose[1] + translation
    return found
