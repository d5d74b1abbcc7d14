"""Write bags of a drive with rosbags and mcap, like a recorder in a vehicle."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from importing.logs import EPOCH
from sigmaswarm.drives.drive import Drive

pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
CUSTOM = "std_msgs/Header header\nsensor_msgs/Imu imu\nfloat32 temperature\nuint8[] blob\n"
"""A vendor's own message, which only the bag defines."""
for store in (ROS1, ROS2):
    store.register(get_types_from_msg(CUSTOM, "vendor_msgs/msg/Packet"))
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))

Message = tuple[str, float, Any]
"""Topic, time in s from EPOCH, message."""


def messages(drive: Drive, store: Any = ROS2, custom: bool = False, delay: float = 0.0) -> Iterator[Message]:
    """The drive as messages; header stamps are its times, or ``delay`` s before them."""
    t = store.types
    vector, quaternion = t["geometry_msgs/msg/Vector3"], t["geometry_msgs/msg/Quaternion"]

    def header(time: float, frame: str) -> Any:
        ns = round((time - delay) * 1e9) + EPOCH * 10**9
        stamp = t["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        sequence = {"seq": 0} if store is ROS1 else {}
        return t["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **sequence)

    nine = np.zeros(9)
    for i, time in enumerate(drive.imu.time):
        imu = drive.imu
        message = t["sensor_msgs/msg/Imu"](
            header=header(time, "imu_link"),
            orientation=quaternion(0.0, 0.0, 0.0, 1.0),
            orientation_covariance=nine,
            angular_velocity=vector(imu.gx[i], imu.gy[i], imu.gz[i]),
            angular_velocity_covariance=nine,
            linear_acceleration=vector(imu.ax[i], imu.ay[i], imu.az[i]),
            linear_acceleration_covariance=nine,
        )
        if custom:
            blob = np.zeros(5, np.uint8)
            message = t["vendor_msgs/msg/Packet"](header(time, "imu_link"), message, 20.0, blob)
        yield "/imu/data", time, message
    for i, time in enumerate(drive.gps.time):
        gps = drive.gps
        covariance = np.diag([gps.std_x[i] ** 2, gps.std_y[i] ** 2, 9.0]).ravel()
        status = t["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
        fix = t["sensor_msgs/msg/NavSatFix"](
            header(time, "gps"), status, gps.lat[i], gps.lon[i], gps.alt[i], covariance, 3
        )
        yield "/gps/fix", time, fix
        east, north = gps.speed[i] * np.cos(gps.course[i]), gps.speed[i] * np.sin(gps.course[i])
        twist = t["geometry_msgs/msg/Twist"](vector(east, north, 0.0), vector(0.0, 0.0, 0.0))
        yield "/gps/vel", time, t["geometry_msgs/msg/TwistStamped"](header(time, "gps"), twist)
    for i, time in enumerate(drive.truth.time):
        yield "/ground_truth", time, odometry(drive, i, header(time, "map"), t)
    text = t["std_msgs/msg/String"]
    yield "/rosout_text", float(drive.imu.time[0]), text("hello")


def odometry(drive: Drive, i: int, header: Any, t: Any) -> Any:
    """The truth as nav_msgs/Odometry: the pose in the map, the velocity in the body (REP-147)."""
    truth = drive.truth
    half = truth.theta[i] / 2
    body = (truth.vx[i] + 1j * truth.vy[i]) * np.exp(-1j * truth.theta[i])
    vector = t["geometry_msgs/msg/Vector3"]
    pose = t["geometry_msgs/msg/Pose"](
        t["geometry_msgs/msg/Point"](truth.x[i], truth.y[i], 0.0),
        t["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(half), np.cos(half)),
    )
    twist = t["geometry_msgs/msg/Twist"](vector(body.real, body.imag, 0.0), vector(0.0, 0.0, 0.0))
    return t["nav_msgs/msg/Odometry"](
        header,
        "base_link",
        t["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        t["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )


def write_ros(path: Path, sent: Iterator[Message], kind: str = "sqlite3") -> Path:
    """Write messages with rosbags, in the order of their times: "ros1", "sqlite3" or "mcap"."""
    ordered = sorted(sent, key=lambda message: message[1])
    store = ROS1 if kind == "ros1" else ROS2
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Writer1(path) if kind == "ros1" else Writer2(path, version=9, storage_plugin=plugin)
    with writer:
        connections: dict[str, Any] = {}
        for topic, time, message in ordered:
            name = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=store)
            serialize = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
            writer.write(connections[topic], round(time * 1e9) + EPOCH * 10**9, serialize(message, name))
    return path


def write_mcap(path: Path, sent: Iterator[Message], encoding: str = "cdr") -> Path:
    """Write messages with the mcap library: "cdr" with ros2msg schemas, or "json"; no ROS profile."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels: dict[str, int] = {}
        for topic, time, message in sorted(sent, key=lambda m: m[1]):
            name = message.__msgtype__
            if topic not in channels:
                text = ROS2.generate_msgdef(name)[0] if encoding == "cdr" else "{}"
                form = "ros2msg" if encoding == "cdr" else "jsonschema"
                schema = writer.register_schema(name, form, text.encode())
                channels[topic] = writer.register_channel(topic, encoding, schema)
            cdr = bytes(ROS2.serialize_cdr(message, name)) if encoding == "cdr" else b""
            data = cdr or json.dumps(message, default=plain).encode()
            ns = round(time * 1e9) + EPOCH * 10**9
            writer.add_message(channels[topic], ns, data, ns)
        writer.finish()
    return path


def plain(value: Any) -> Any:
    """A message as JSON has it."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return {k: v for k, v in vars(value).items() if not k.startswith("__")}
