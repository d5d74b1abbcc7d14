"""Find the topics of a drive by name and by the fields of their messages (sensor_msgs, geometry_msgs, nav_msgs)."""

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import points_down
from sigmaswarm.importing.readers.fields import getter, stamp_of
from sigmaswarm.importing.source import Guess, Part, Role, Table, TableChoice
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
        metadata: dict[str, Any] = {}
        inertial = self._having(_IMU)
        if imu := self._topic("imu", {t for t in inertial if not _HEADING.search(t)} or inertial):
            roles["imu"] = (self._part(imu, self._imu(imu)),)
            self._note_frame(imu)
            metadata = self._stated_noise(imu)
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
        return Guess(roles, tuple(self.notes), metadata=metadata, downward=self._downward(imu) if imu else "")

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

    def _imu(self, topic: str) -> dict[str, str]:
        found = self._named(topic, _IMU)
        at = found["ax"].removesuffix(_IMU["ax"])
        covariances = [f"{at}{kind}_covariance[0]" for kind in ("linear_acceleration", "angular_velocity")]
        # the first covariance is -1 if the sensor does not measure the vector
        if set(covariances) <= set(self.tables[topic].columns):
            found["keep"] = " and ".join(f"{c} != -1" for c in covariances)
        return found

    def _stated_noise(self, topic: str) -> dict[str, Any]:
        """Return the variances of gz and ax that the first message states, for drive.toml; {} if it states none."""
        before = self._named(topic, _IMU)["ax"].removesuffix(_IMU["ax"])
        columns = [f"{before}angular_velocity_covariance[8]", f"{before}linear_acceleration_covariance[0]"]
        message = self.first(topic)
        if message is None or not set(columns) <= set(self.tables[topic].columns):
            return {}
        stated = [getter(column)(message[2]) for column in columns]
        known = all(value is not None and 0 < value < math.inf for value in stated)
        return {"imu_stated_noise": [float(value) for value in stated]} if known else {}

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
        """Make a part with its time: the header stamp, or receive times if the user chose them or no stamp is set."""
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

    def _downward(self, topic: str) -> str:
        """Return a sentence if the z axis points down according to the first message of an IMU; otherwise ""."""
        message = self.first(topic)
        columns = [self._named(topic, _IMU)[axis] for axis in ("ax", "ay", "az")]
        force = [getter(column)(message[2]) for column in columns] if message else [0.0]
        known = all(isinstance(value, float) for value in force)
        return points_down(columns[2]) if known and force[-1] < -0.5 * math.hypot(*force) else ""

    def _note_frame(self, topic: str) -> None:
        message = self.first(topic)
        header = getattr(message[2], "header", None) if message else None
        if name := getattr(header, "frame_id", ""):
            self.notes.append(
                f"{topic} is in the frame {name!r}, whose axes are assumed to be x forward, y left, z up (REP-103); "
                "specify other axes with --mount"
            )
