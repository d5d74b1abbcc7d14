"""Find the topics of a drive by name and by the fields of their messages (sensor_msgs, geometry_msgs, nav_msgs)."""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import roll_pitch_yaw
from sigmaswarm.importing.guess import points_down
from sigmaswarm.importing.readers.fields import getter, stamp_of
from sigmaswarm.importing.source import Guess, Part, Placement, Role, Table, TableChoice
from sigmaswarm.wording import list_names

_IMU = {
    **{f"a{i}": f"linear_acceleration.{i}" for i in "xyz"},
    **{f"g{i}": f"angular_velocity.{i}" for i in "xyz"},
}
_FIX = {"lat": "latitude", "lon": "longitude", "alt": "altitude"}
_VELOCITY = {"vx": "linear.x", "vy": "linear.y"}
_POSITION = {"x": "position.x", "y": "position.y"}
_ORIENTATION = {i: f"orientation.{i}" for i in "wxyz"}
# Paths of the wheel speed in nav_msgs, geometry_msgs, Autoware's reports, and other messages
_SPEEDS = ("twist.linear.x", "linear.x", "longitudinal_velocity", "speed")
_WHEELS = re.compile(r"wheel|vehicle|speedo|odometer|(?:^|[/_])can(?:[/_]|$)", re.IGNORECASE)
_TRUTH = re.compile(r"truth|ground|reference|(?:^|/)gt(?:/|$)", re.IGNORECASE)
_RECEIVER = re.compile(r"gps|gnss|fix|ublox|novatel|septentrio|(?:^|/)vel$", re.IGNORECASE)
_HEADING = re.compile(r"heading|compass", re.IGNORECASE)
_SATELLITES = re.compile(r"gps|gnss", re.IGNORECASE)
STANDARD: dict[str, tuple[Mapping[str, str], ...]] = {"imu": (_IMU,), "gps": (_FIX, _POSITION)}
# Names of the vehicle's frame, with x forward, y left, z up (REP-105)
BASES = ("base_link", "base_footprint")
Pose = tuple[Array, Array]  # rotation (3, 3) and translation (3,), m, of a frame in another
Tree = Mapping[str, tuple[str, Pose]]  # the parent of each frame, and the frame's pose in the parent


def _yaw(at: str) -> str:
    w, x, y, z = (at + i for i in "wxyz")
    return f"atan2(2*({w}*{z} + {x}*{y}), 1 - 2*({y}*{y} + {z}*{z}))"


def prefix(table: Table, paths: Mapping[str, str]) -> str | None:
    """Return the prefix with which a topic's columns contain all paths, such as "" or "imu."; otherwise None."""
    columns = set(table.columns)
    first = next(iter(paths.values()))
    for column in table.columns:
        before = column.removesuffix(first)
        starts = column.endswith(first) and before[-1:] in ("", ".")
        if starts and {before + path for path in paths.values()} <= columns:
            return before
    return None


@dataclass
class Topics:
    path: Path
    tables: Mapping[str, Table]
    choice: TableChoice
    first: Callable[[str], tuple[str, int, Any] | None]  # first message of a topic
    notes: list[str] = field(default_factory=list[str])

    def guess(self) -> Guess:
        roles: dict[Role, tuple[Part, ...]] = {}
        metadata, downward = dict[str, Any](), ""
        inertial = self._having(_IMU)
        if imu := self._topic("imu", {t for t in inertial if not _HEADING.search(t)} or inertial):
            part, metadata, downward = self._imu(imu)
            roles["imu"] = (part,)
        # navsat_transform_node publishes fixes as positions
        placed = {t for t in self._having(_POSITION) if _SATELLITES.search(t)}
        fixes = self._topic("gps", {t for t in self._having(_FIX) or placed if not _TRUTH.search(t)})
        if fixes:
            roles["gps"] = (self._part(fixes, self._position(fixes)),)
            moving = {t for t in self._having(_VELOCITY) - self._having(_POSITION) if _RECEIVER.search(t)}
            if velocity := self._topic("velocity", {t for t in moving if not re.search("cmd|odom", t)}):
                roles["gps"] += (self._part(velocity, self._named(velocity, _VELOCITY)),)
                self.notes.append(f"{velocity} is used as the receiver's velocity, m/s east and north")
            turning = {t for t in self._having(_ORIENTATION) if _HEADING.search(t)}
            if heading := self._topic("heading", turning):
                roles["gps"] += (self._part(heading, self._heading(heading)),)
                self.notes.append(f"{heading} is used as the dual-antenna heading")
        located = self._having(_POSITION) | self._having(_FIX)
        truth = self._topic("truth", {t for t in located if _TRUTH.search(t)})
        if truth:
            roles["truth"] = (self._part(truth, self._motion(truth)),)
        elif poses := sorted(
            t for t, table in self.tables.items() if "Odometry" in table.kind and t != fixes
        ):
            there = list_names(poses)
            self.notes.append(
                f"no topic's name indicates truth; to use {there} as truth, add --truth-topic TOPIC"
            )
        other = re.compile(f"{_TRUTH.pattern}|{_RECEIVER.pattern}|cmd|command", re.IGNORECASE)
        counted = {t for t in self.tables if self._speed(t) and _WHEELS.search(t) and not other.search(t)}
        if wheels := self._topic("odometer", counted - {fixes, truth}):
            if not (speed := self._speed(wheels)):
                raise InputError(
                    f"{self.path}: {wheels} ({self.tables[wheels].kind}) has none of the fields {', '.join(_SPEEDS)}; "
                    "choose another topic, or map odometer.speed"
                )
            roles["odometer"] = (self._part(wheels, {"speed": speed}),)
            self.notes.append(f"{wheels} is used as the wheel speed, m/s forward")
        return Guess(roles, tuple(self.notes), metadata=metadata, downward=downward)

    def _having(self, paths: Mapping[str, str]) -> set[str]:
        return {t for t, table in self.tables.items() if prefix(table, paths) is not None}

    def _topic(self, role: str, candidates: Collection[str]) -> str | None:
        """Return the topic that the user chose, or the topic with the most messages."""
        chosen = self.choice.tables.get(role)
        if chosen is not None:
            near = {chosen, "/" + chosen.lstrip("/")} & set(self.tables)
            if not near:
                there = list_names(self.tables)
                raise InputError(
                    f"{self.path}: has no topic {chosen!r} for --{role}-topic; choose from {there}"
                )
            return near.pop()
        ranked = sorted(candidates, key=lambda t: (-(self.tables[t].rows or 0), t))
        ranked = [t for t in ranked if self.tables[t].rows != 0]
        if len(ranked) > 1:
            # no option chooses the topic of the heading
            remedy = "" if role == "heading" else f"; choose another topic with --{role}-topic"
            self.notes.append(f"{ranked[0]} is used for the {role}, not {list_names(ranked[1:])}{remedy}")
        return ranked[0] if ranked else None

    def _named(self, topic: str, paths: Mapping[str, str]) -> dict[str, str]:
        at = prefix(self.tables[topic], paths)
        if at is None:
            wanted = ", ".join(paths.values())
            raise InputError(
                f"{self.path}: {topic} ({self.tables[topic].kind}) does not have all of the fields {wanted}; choose "
                "another topic, or map its fields"
            )
        return {name: at + path for name, path in paths.items()}

    def _speed(self, topic: str) -> str:
        found = ((prefix(self.tables[topic], {"speed": path}), path) for path in _SPEEDS)
        return next((at + path for at, path in found if at is not None), "")

    def _imu(self, topic: str) -> tuple[Part, dict[str, Any], str]:
        """Return the part of the IMU, keys of drive.toml, and a sentence if the z axis points down, otherwise "".

        The first message contains the direction of gravity and may state the variances of gz and ax.
        """
        found, there = self._named(topic, _IMU), {*self.tables[topic].columns}
        at = found["ax"].removesuffix(_IMU["ax"])
        rate, force = (f"{at}{kind}_covariance" for kind in ("angular_velocity", "linear_acceleration"))
        # the first covariance is -1 if the sensor does not measure the vector
        keep = (
            {"keep": f"{force}[0] != -1 and {rate}[0] != -1"}
            if {f"{force}[0]", f"{rate}[0]"} <= there
            else {}
        )
        part, first = self._part(topic, found | keep), self.first(topic)
        if first is None:
            return part, {}, ""
        message = first[2]
        if name := getattr(getattr(message, "header", None), "frame_id", ""):
            self.notes.append(
                f"{topic} is in the frame {name!r}, whose axes are assumed to be x forward, y left, z up (REP-103); "
                "specify other axes with --mount"
            )
        variances = (f"{rate}[8]", f"{force}[0]")
        stated = [getter(column)(message) for column in variances if {*variances} <= there]
        noise = [float(value) for value in stated if value is not None and 0 < value < math.inf]
        metadata = {"imu_stated_noise": noise} if len(noise) == len(variances) else {}
        forces = [getter(found[axis])(message) for axis in ("ax", "ay", "az")]
        down = all(isinstance(value, float) for value in forces) and forces[-1] < -0.5 * math.hypot(*forces)
        return part, metadata, points_down(found["az"]) if down else ""

    def _position(self, topic: str) -> dict[str, str]:
        """Return the columns of fixes (NavSatFix, or poses in m east and north), with their standard deviations."""
        columns = set(self.tables[topic].columns)
        if (at := prefix(self.tables[topic], _FIX)) is not None:
            found = self._named(topic, _FIX)
            if f"{at}position_covariance[0]" in columns:  # row by row: east, north, up
                known = f"{at}position_covariance_type > 0"
                found["std_x"] = f"where({known}, sqrt({at}position_covariance[0]), 0/0)"
                found["std_y"] = f"where({known}, sqrt({at}position_covariance[4]), 0/0)"
            if f"{at}status.status" in columns:
                found["keep"] = f"{at}status.status >= 0"
            return found
        found = self._named(topic, _POSITION)
        if "pose.covariance[0]" in columns:
            found |= {"std_x": "sqrt(pose.covariance[0])", "std_y": "sqrt(pose.covariance[7])"}
        self.notes.append(f"the positions of {topic} are read as m east and north")
        return found

    def _heading(self, topic: str) -> dict[str, str]:
        """Return the yaw of an Imu message; messages whose first covariance is -1 have no orientation."""
        at = self._named(topic, _ORIENTATION)["w"].removesuffix("w")
        covariance = at.removesuffix(".") + "_covariance"
        found = {"heading": _yaw(at)}
        if f"{covariance}[8]" in self.tables[topic].columns:
            found |= {"std_heading": f"sqrt({covariance}[8])", "keep": f"{covariance}[0] != -1"}
        return found

    def _motion(self, topic: str) -> dict[str, str]:
        """Return the columns of the truth: fixes in degrees, or poses with heading and, in Odometry, with velocity."""
        if prefix(self.tables[topic], _FIX) is not None:
            return {k: v for k, v in self._position(topic).items() if not k.startswith("std")}
        found = self._named(topic, _POSITION)
        at = found["x"].removesuffix("position.x") + "orientation."
        if at + "w" in self.tables[topic].columns:
            found["theta"] = _yaw(at)
            if prefix(self.tables[topic], _VELOCITY) is not None:
                velocity = self._named(topic, _VELOCITY)
                found |= {"forward": velocity["vx"], "left": velocity["vy"]}
        self.notes.append(
            f"{topic} is used as truth: position in m east and north of the origin, velocity in "
            "the body frame"
        )
        return found

    def _part(self, topic: str, columns: dict[str, str]) -> Part:
        """Make a part with its time: the header stamp, or the receive time if the user chose it or no stamp is set."""
        time = "received*1e-9"
        if "stamp" not in self.tables[topic].columns:
            self.notes.append(f"{topic}: the messages have no header, so receive times are used")
        elif not self.choice.receive_times:
            message = self.first(topic)
            if message and stamp_of(message[2]):
                time = "stamp*1e-9"
            else:
                self.notes.append(f"{topic}: the header stamps are not set, so receive times are used")
        return Part(topic, {"t": time, **columns})


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

    Return None if the transforms do not connect the IMU with such a frame. ``messages`` are of type tf2_msgs/TFMessage.
    A later transform of the same frame replaces an earlier one.
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
