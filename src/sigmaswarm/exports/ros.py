"""Write an estimate as a ROS 2 bag with a layout for Foxglove. This needs the package rosbags.

The topic /sigmaswarm/odometry, nav_msgs/Odometry, has the pose in ``map`` (east-north-up) and the twist in
``base_link`` (x forward, y left): see REP-105 and the definition of the message.
"""

import heapq
import warnings
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.exports.attitude import body_velocity, quaternions, tilt_indices
from sigmaswarm.exports.foxglove import LAYOUT_FILE, layout
from sigmaswarm.files import atomic_folder, write_json
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.packing import definite
from sigmaswarm.filters.run import Estimate, Innovations
from sigmaswarm.geodesy import Origin, enu_to_geodetic
from sigmaswarm.importing.readers.ros import bag_paths
from sigmaswarm.importing.source import damage_error, import_library

TOPIC = "/sigmaswarm/odometry"
SIGMA, FIX = "/sigmaswarm/sigma", "/sigmaswarm/fix"
INNOVATION, INNOVATION_SIGMA, NIS = (
    f"/sigmaswarm/{name}" for name in ("innovation", "innovation_sigma", "nis")
)
INTERVAL = 0.1  # s between messages of the topics SIGMA and FIX
NOT_ESTIMATED = 1e6
"""Variance of quantities that are not estimated: height, vertical velocity, rates; in planar models roll and pitch."""
RawMessage = tuple[int, Any, Any]  # ns, connection in the new bag, bytes
Message = tuple[int, str, Any]  # ns, topic, message


def ros2(
    pieces: Iterable[Estimate],
    span: tuple[float, float],
    path: Path,
    *,
    time_origin: float = 0.0,
    origin: Origin | None = None,
    innovations: Innovations | None = None,
    merge: Path | None = None,
    replace: bool = False,
) -> None:
    """Write a bag (a folder with MCAP storage) and a layout for Foxglove, with parameters as in `write_pieces`.

    Without ``replace``, ``path`` must not exist. Topics of the bag ``merge`` that have an unknown type are omitted with
    a warning. Raises `InputError` if rosbags is not installed, if a time is before 0, or if ``merge`` is damaged,
    covers other times, or already contains /sigmaswarm/odometry. In these cases no file remains.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise InputError(f"{path}: a bag needs rosbags; install it with: pip install rosbags") from None
    first, last = (end + time_origin for end in span)
    if first < 0:
        raise InputError(
            f"{path}: a bag can't contain times before 0 (start is {first:g} s); shift the times of the drive"
        )
    store = get_typestore(Stores.ROS2_HUMBLE)
    with (
        _reader(merge, first, last) if merge else nullcontext() as recorded,
        atomic_folder(path, replace=replace) as new,
        Writer(new, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        originals = _copied(merge, recorded, writer) if merge else iter(())
        factory = MessageFactory(store.types, time_origin)
        own = heapq.merge(
            _messages(pieces, factory, origin), _of_innovations(innovations, factory), key=itemgetter(0)
        )
        added: dict[str, Any] = {}
        estimates = _serialized(own, store, writer, added)
        for nanoseconds, to, raw in heapq.merge(originals, estimates, key=itemgetter(0)):
            writer.write(to, nanoseconds, raw)
        write_json(new / LAYOUT_FILE, layout(added))


# ---- the recorded bag ----


@contextmanager
def _reader(path: Path, first: float, last: float) -> Generator[Any]:
    """Open a ROS 2 bag (folder, .db3 or .mcap file) that overlaps the time from ``first`` to ``last``, s."""
    highlevel, typesys = import_library("rosbags.highlevel", "ros"), import_library("rosbags.typesys", "ros")
    if not path.exists():
        raise InputError(f"{path}: no such bag; specify the bag from which the drive was imported")
    paths = bag_paths(path)
    if not paths:
        raise InputError(
            f"{path}: contains no bag; specify the folder with metadata.yaml, or a .db3 or .mcap file"
        )
    if paths[0].suffix == ".bag":
        raise InputError(
            f"{path}: is a ROS 1 bag, which ROS 2 cannot read; convert it first: "
            f"rosbags-convert --src {path} --dst {path.with_suffix('')}"
        )
    try:
        reader = highlevel.AnyReader(paths, default_typestore=typesys.get_typestore(typesys.Stores.LATEST))
        reader.open()
    except Exception as error:  # for damaged bytes, the library raises any error
        if "rofile" in str(error):
            raise InputError(
                f"{path}: is an MCAP file that ROS 2 did not write, so a ROS 2 bag can't contain its messages; "
                "omit --merge"
            ) from None
        raise damage_error(path, error) from None
    try:
        begin, end = reader.start_time, reader.end_time
        if round(last * 1e9) < begin or round(first * 1e9) > end:
            raise InputError(
                f"{path}: covers {begin / 1e9:.3f} to {end / 1e9:.3f} s, but the estimate covers {first:.3f} to "
                f"{last:.3f} s; specify the bag from which the drive was imported"
            )
        if TOPIC in reader.topics:
            raise InputError(f"{path}: already contains {TOPIC}; specify the original bag")
        yield reader
    finally:
        reader.close()


def _copied(path: Path, reader: Any, writer: Any) -> Iterator[RawMessage]:
    """Add the topics of a bag to the new bag. Return an iterator of their messages, sorted by time.

    A topic is omitted with a warning if neither the bag nor the latest ROS defines its type.
    """
    added: dict[tuple[str, str], Any] = {}
    for old in reader.connections:
        kind = old.topic, old.msgtype
        if kind in added:  # a bag of several files repeats its topics
            continue
        if old.msgtype not in reader.typestore.fielddefs:
            warnings.warn(
                f"{path}: {old.topic} is left out, since the type {old.msgtype} is not defined",
                SigmaswarmWarning,
                stacklevel=2,
            )
            continue
        own = {"msgdef": old.msgdef.data, "rihs01": old.digest} if old.msgdef.data and old.digest else {}
        added[kind] = writer.add_connection(
            *kind,
            typestore=reader.typestore,
            serialization_format=old.ext.serialization_format,
            offered_qos_profiles=old.ext.offered_qos_profiles,
            **own,
        )
    wanted = [c for c in reader.connections if (c.topic, c.msgtype) in added]

    def messages() -> Iterator[RawMessage]:
        try:
            for old, time, raw in reader.messages(connections=wanted) if wanted else ():
                yield time, added[old.topic, old.msgtype], raw
        except Exception as error:  # for damaged bytes, the library raises any error
            raise damage_error(path, error) from None

    return messages()


# ---- the estimate ----


def _serialized(
    messages: Iterable[Message], store: Any, writer: Any, added: dict[str, Any]
) -> Iterator[RawMessage]:
    """Yield messages as bytes. A topic is added to the bag before its first message."""
    for nanoseconds, topic, message in messages:
        kind = message.__msgtype__
        if topic not in added:
            added[topic] = writer.add_connection(topic, kind, typestore=store)
        yield nanoseconds, added[topic], store.serialize_cdr(message, kind)


@dataclass(frozen=True)
class MessageFactory:
    """Create ROS messages. ``types`` contains the message classes by name. For ``time_origin`` see `write_pieces`."""

    types: Any
    time_origin: float

    def message(self, name: str, *fields: Any) -> Any:
        return self.types[name.replace("/", "/msg/")](*fields)

    def nanoseconds(self, time: float) -> int:
        """Return a time on the clock of the bag, ns. Origin and time are rounded separately to keep all digits."""
        return round(float(time) * 1e9) + round(self.time_origin * 1e9)

    def header(self, nanoseconds: int) -> Any:
        stamp = self.message("builtin_interfaces/Time", nanoseconds // 10**9, nanoseconds % 10**9)
        return self.message("std_msgs/Header", stamp, "map")

    def vector(self, nanoseconds: int, x: float, y: float, z: float = 0.0) -> Any:
        vector = self.message("geometry_msgs/Vector3", float(x), float(y), float(z))
        return self.message("geometry_msgs/Vector3Stamped", self.header(nanoseconds), vector)


def _messages(
    pieces: Iterable[Estimate], factory: MessageFactory, origin: Origin | None
) -> Iterator[Message]:
    """Yield estimates and, once per `INTERVAL`, standard deviations (if known) and the NavSatFix (with ``origin``)."""
    before = -1
    for estimate in pieces:
        velocity, jacobian = body_velocity(estimate.mean)
        n = estimate.mean.shape[1]
        covariance = estimate.covariance if estimate.covariance.size else np.zeros((len(velocity), n, n))
        moving, of_pose = [2, 3, THETA, *tilt_indices(n)], [*_pose_of(n)]
        twists = jacobian @ covariance[:, np.array(moving)[:, None], moving] @ jacobian.transpose(0, 2, 1)
        poses = covariance[:, np.array(of_pose)[:, None], of_pose]
        columns = (estimate.time, estimate.mean, poses, velocity, twists)
        for t, mean, pose, *moves in zip(*columns, strict=True):
            nanoseconds = factory.nanoseconds(t)
            yield nanoseconds, TOPIC, _odometry(factory, nanoseconds, mean, pose, *moves)
            if (slot := int(np.floor(t / INTERVAL + 1e-6))) > before:
                before, (x, y, *_, heading) = slot, np.sqrt(np.diagonal(pose))
                if estimate.covariance.size:
                    yield nanoseconds, SIGMA, factory.vector(nanoseconds, x, y, heading)
                if origin is not None:
                    yield nanoseconds, FIX, _fix(factory, nanoseconds, mean, pose, origin)


def _of_innovations(innovations: Innovations | None, factory: MessageFactory) -> Iterator[Message]:
    """Yield innovations (m east and north), their standard deviations (m) and NIS for the fixes before a failure."""
    if innovations is None:
        return
    sound = definite(innovations.covariance)  # False after a failure of the filter
    innovations = Innovations(
        innovations.time[sound], innovations.innovation[sound], innovations.covariance[sound]
    )
    sigma = np.sqrt(np.diagonal(innovations.covariance, axis1=1, axis2=2))
    for t, nu, std, nis in zip(innovations.time, innovations.innovation, sigma, innovations.nis, strict=True):
        nanoseconds = factory.nanoseconds(t)
        yield nanoseconds, INNOVATION, factory.vector(nanoseconds, *nu)
        yield nanoseconds, INNOVATION_SIGMA, factory.vector(nanoseconds, *std)
        yield nanoseconds, NIS, factory.message("std_msgs/Float64", float(nis))


def _fix(factory: MessageFactory, nanoseconds: int, mean: Array, pose: Array, origin: Origin) -> Any:
    """Build a NavSatFix with the height of the origin, since no model estimates height."""
    lat, lon, alt = map(float, enu_to_geodetic(np.array([[mean[0], mean[1], 0.0]]), origin)[0])
    covariance = NOT_ESTIMATED * np.eye(3)
    covariance[:2, :2] = pose[:2, :2]
    status = factory.message("sensor_msgs/NavSatStatus", 0, 1)
    fields = status, lat, lon, alt, covariance.ravel(), 3  # COVARIANCE_TYPE_KNOWN
    return factory.message("sensor_msgs/NavSatFix", factory.header(nanoseconds), *fields)


def _pose_of(n: int) -> dict[int, int]:
    """Return a mapping from the states of the pose to rows in the covariance of a message.

    The rows are x, y, z, and the rotations about the fixed axes x, y, z. These rotations are roll, pitch and theta,
    since R = Rz(theta) Ry(pitch) Rx(roll).
    """
    return {0: 0, 1: 1} | dict(zip(tilt_indices(n), (3, 4), strict=False)) | {THETA: 5}


def _odometry(
    factory: MessageFactory, nanoseconds: int, mean: Array, pose: Array, velocity: Array, twist: Array
) -> Any:
    """Build an Odometry message. Its covariances are 6 x 6: x, y, z and rotations about these axes."""
    still = factory.message("geometry_msgs/Vector3", 0.0, 0.0, 0.0)
    moves = factory.message("geometry_msgs/Vector3", *map(float, velocity), 0.0)
    position = factory.message("geometry_msgs/Point", *map(float, mean[:2]), 0.0)
    orientation = factory.message("geometry_msgs/Quaternion", *quaternions(mean).tolist())
    placed = factory.message("geometry_msgs/Pose", position, orientation)
    return factory.message(
        "nav_msgs/Odometry",
        factory.header(nanoseconds),
        "base_link",
        factory.message(
            "geometry_msgs/PoseWithCovariance", placed, _six(pose, [*_pose_of(len(mean)).values()])
        ),
        factory.message(
            "geometry_msgs/TwistWithCovariance",
            factory.message("geometry_msgs/Twist", moves, still),
            _six(twist, [0, 1]),
        ),
    )


def _six(known: Array, at: list[int]) -> Array:
    whole = NOT_ESTIMATED * np.eye(6)
    whole[np.ix_(at, at)] = known
    return whole.ravel()
