"""An estimate as a ROS 2 bag, perhaps beside the topics of one that was recorded; needs the extra ``ros``.

The estimate is /sigmaswarm/odometry, nav_msgs/Odometry. Its pose is in ``map``, east-north-up; its twist in
``base_link``, forward and left, as REP-105 and the message ask.
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
from sigmaswarm.export.attitude import quaternions
from sigmaswarm.export.beside import RawMessage, recording
from sigmaswarm.files import whole_folder
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.run import Estimate

TOPIC = "/sigmaswarm/odometry"
NOT_ESTIMATED = 1e6
"""The variance that is stated for what a filter in the plane says nothing of: height, roll, pitch, the rates."""


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
        A ROS 2 bag whose messages are copied into this one, byte for byte, in the order of their times.

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
        for t, mean, (pose, twist) in zip(estimate.time, estimate.mean, _planes(estimate), strict=True):
            nanoseconds = round(float(t) * 1e9) + round(time_origin * 1e9)  # apart, so that no digit is lost
            message = _odometry(store.types, nanoseconds, mean, pose, twist)
            yield nanoseconds, connection, store.serialize_cdr(message, "nav_msgs/msg/Odometry")


def _planes(estimate: Estimate) -> list[tuple[Array, Array]]:
    """Covariances of x, y, theta, and of the velocity forward and left, at each time; zero where there are none."""
    n = estimate.mean.shape[1]
    covariance = estimate.covariance if estimate.covariance.size else np.zeros((len(estimate.time), n, n))
    pose = covariance[:, [[0], [1], [THETA]], [0, 1, THETA]]
    theta = estimate.mean[:, THETA]
    c, s = np.cos(theta), np.sin(theta)
    forward, left = body_velocity(estimate.mean)
    jacobian = np.stack([np.stack([c, s, left], axis=-1), np.stack([-s, c, -forward], axis=-1)], axis=1)
    inner = covariance[:, [[2], [3], [THETA]], [2, 3, THETA]]
    return list(zip(pose, jacobian @ inner @ jacobian.transpose(0, 2, 1), strict=True))


def body_velocity(mean: Array) -> tuple[Array, Array]:
    """Velocity forward and left, m/s, of means (..., n)."""
    c, s = np.cos(mean[..., THETA]), np.sin(mean[..., THETA])
    return c * mean[..., 2] + s * mean[..., 3], c * mean[..., 3] - s * mean[..., 2]


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
            types["geometry_msgs/msg/Pose"](position, orientation), _six(pose, [0, 1, 5])
        ),
        types["geometry_msgs/msg/TwistWithCovariance"](
            types["geometry_msgs/msg/Twist"](vector(forward, left), vector(0.0, 0.0)), _six(twist, [0, 1])
        ),
    )


def _six(known: Array, at: list[int]) -> Array:
    whole = NOT_ESTIMATED * np.eye(6)
    whole[np.ix_(at, at)] = known
    return whole.ravel()
