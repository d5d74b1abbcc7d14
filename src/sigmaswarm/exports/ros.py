"""An estimate as a ROS 2 bag, optionally with the topics of a recorded one; needs the extra ``ros``.

The estimate is /sigmaswarm/odometry, nav_msgs/Odometry. Its pose is in ``map``, east-north-up; its twist in
``base_link``, forward and left along the road, as REP-105 and the message ask.
"""

import heapq
from collections.abc import Iterable, Iterator
from contextlib import nullcontext
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.exports.attitude import quaternions
from sigmaswarm.exports.beside import RawMessage, recording
from sigmaswarm.files import whole_folder
from sigmaswarm.filters import tilted
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.run import Estimate

TOPIC = "/sigmaswarm/odometry"
NOT_ESTIMATED = 1e6
"""Variance of quantities that a filter does not estimate: height, rates, and in the plane roll and pitch."""


def ros2(
    pieces: Iterable[Estimate],
    span: tuple[float, float],
    path: Path,
    *,
    time_origin: float = 0.0,
    beside: Path | None = None,
) -> None:
    """Write a bag, which is a folder, with MCAP storage.

    Parameters
    ----------
    pieces : iterable of Estimate
    span : (float, float)
        s, from the first of them to the last.
    path : Path
        Not there yet.
    time_origin : float
        s on the bag's clock at which the estimate's times are 0.
    beside : Path, optional
        A ROS 2 bag whose messages are copied unchanged into this one in the order of their times.

    Raises
    ------
    InputError
        If rosbags is not installed, a time is before 0, or ``beside`` is no bag of these times, is damaged, or has the
        topic already. Nothing is left behind then.

    Warns
    -----
    SigmaswarmWarning
        Of topics that could not be copied.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise InputError(f"{path}: a bag needs rosbags; install it with: pip install rosbags") from None
    first, last = (end + time_origin for end in span)
    if first < 0:
        raise InputError(f"{path}: a bag has no times before 0 (is {first:g} s); shift the drive's times")
    store = get_typestore(Stores.ROS2_HUMBLE)
    with recording(beside) if beside else nullcontext() as recorded:
        if recorded:
            recorded.require_span(round(first * 1e9), round(last * 1e9))
            if TOPIC in recorded.topics:
                raise InputError(f"{beside}: has {TOPIC} already; name the bag as it was recorded")
        with (
            whole_folder(path) as new,
            Writer(new, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
        ):
            originals = recorded.add_to(writer) if recorded else iter(())
            connection = writer.add_connection(TOPIC, "nav_msgs/msg/Odometry", typestore=store)
            estimates = _messages(pieces, store, connection, time_origin)
            for nanoseconds, to, raw in heapq.merge(originals, estimates, key=itemgetter(0)):
                writer.write(to, nanoseconds, raw)


def _messages(
    pieces: Iterable[Estimate], store: Any, connection: Any, time_origin: float
) -> Iterator[RawMessage]:
    for estimate in pieces:
        for t, mean, (pose, twist) in zip(estimate.time, estimate.mean, _covariances(estimate), strict=True):
            nanoseconds = round(float(t) * 1e9) + round(time_origin * 1e9)  # apart, so that no digit is lost
            message = _odometry(store.types, nanoseconds, mean, pose, twist)
            yield nanoseconds, connection, store.serialize_cdr(message, "nav_msgs/msg/Odometry")


def _covariances(estimate: Estimate) -> list[tuple[Array, Array]]:
    """Of the pose's states and of the velocity forward and left, at each time; zero where there are none."""
    n = estimate.mean.shape[1]
    covariance = estimate.covariance if estimate.covariance.size else np.zeros((len(estimate.time), n, n))
    of_pose, moving = [*_pose_of(n)], [2, 3, THETA, *_tilts_of(n)]
    pose = covariance[:, np.array(of_pose)[:, None], of_pose]
    inner = covariance[:, np.array(moving)[:, None], moving]
    jacobian = _twist_jacobian(estimate.mean)
    return list(zip(pose, jacobian @ inner @ jacobian.transpose(0, 2, 1), strict=True))


def _tilts_of(n: int) -> tuple[int, ...]:
    """Where roll and pitch stand in a state of n numbers; nowhere in the plane."""
    return tilted.ATTITUDE[:2] if n == tilted.N else ()


def _pose_of(n: int) -> dict[int, int]:
    """The states of the pose, and their rows in a message's covariance: x, y, z and rotations about fixed axes.

    Such rotations about x, y and z are what roll, pitch and theta are: R = Rz(theta) Ry(pitch) Rx(roll).
    """
    return {0: 0, 1: 1} | dict(zip(_tilts_of(n), (3, 4), strict=False)) | {THETA: 5}


def _level(mean: Array) -> tuple[Array, ...]:
    """Velocity ahead and to the left, m/s, in the plane; roll and pitch; of means (..., n)."""
    c, s = np.cos(mean[..., THETA]), np.sin(mean[..., THETA])
    ahead, left = c * mean[..., 2] + s * mean[..., 3], c * mean[..., 3] - s * mean[..., 2]
    tilts = _tilts_of(mean.shape[-1])
    roll, pitch = (mean[..., tilts[0]], mean[..., tilts[1]]) if tilts else (0 * c, 0 * c)
    return ahead, left, roll, pitch


def body_velocity(mean: Array) -> tuple[Array, Array]:
    """Velocity along the body's axes forward and left, m/s, of means (..., n).

    R' (vx, vy, vz) with the vz that keeps the car on its road, which its x and y axes span; so there is none upwards.
    """
    ahead, left, roll, pitch = _level(mean)
    return ahead / np.cos(pitch) - np.tan(pitch) * np.tan(roll) * left, left / np.cos(roll)


def _twist_jacobian(mean: Array) -> Array:
    """Of `body_velocity` with respect to vx, vy, theta and, of a tilted model, roll and pitch, (k, 2, 3 or 5)."""
    ahead, left, roll, pitch = _level(mean)
    c, s = np.cos(mean[:, THETA]), np.sin(mean[:, THETA])
    cr, cp, tr, tp = np.cos(roll), np.cos(pitch), np.tan(roll), np.tan(pitch)
    forwards = [c / cp + tp * tr * s, s / cp - tp * tr * c, left / cp + tp * tr * ahead]
    leftwards = [-s / cr, c / cr, -ahead / cr]
    if _tilts_of(mean.shape[1]):
        forwards += [-tp / cr**2 * left, tp / cp * ahead - tr / cp**2 * left]
        leftwards += [tr / cr * left, 0 * left]
    return np.stack([np.stack(forwards, axis=-1), np.stack(leftwards, axis=-1)], axis=1)


def _odometry(types: Any, nanoseconds: int, mean: Array, pose: Array, twist: Array) -> Any:
    """The message; covariances are 6 x 6: x, y, z and the rotations about them."""

    def vector(x: float, y: float) -> Any:
        return types["geometry_msgs/msg/Vector3"](x, y, 0.0)

    forward, left = (float(v) for v in body_velocity(mean))
    stamp = types["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
    position = types["geometry_msgs/msg/Point"](float(mean[0]), float(mean[1]), 0.0)
    orientation = types["geometry_msgs/msg/Quaternion"](*quaternions(mean).tolist())
    return types["nav_msgs/msg/Odometry"](
        types["std_msgs/msg/Header"](stamp, "map"),
        "base_link",
        types["geometry_msgs/msg/PoseWithCovariance"](
            types["geometry_msgs/msg/Pose"](position, orientation),
            _six(pose, [*_pose_of(len(mean)).values()]),
        ),
        types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](vector(forward, left), vector(0.0, 0.0)), _six(twist, [0, 1])
        ),
    )


def _six(known: Array, at: list[int]) -> Array:
    whole = NOT_ESTIMATED * np.eye(6)
    whole[np.ix_(at, at)] = known
    return whole.ravel()
