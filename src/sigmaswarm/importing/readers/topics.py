"""Which topics a drive is made of, by what their messages hold (sensor_msgs, geometry_msgs, nav_msgs)."""

import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.readers.fields import stamp_of
from sigmaswarm.importing.source import Choice, Guess, Part, Role, Table
from sigmaswarm.wording import names_shown

_IMU = {
    "ax": "linear_acceleration.x",
    "ay": "linear_acceleration.y",
    "az": "linear_acceleration.z",
    "gx": "angular_velocity.x",
    "gy": "angular_velocity.y",
    "gz": "angular_velocity.z",
}
_FIX = {"lat": "latitude", "lon": "longitude", "alt": "altitude"}
_VELOCITY = {"vx": "linear.x", "vy": "linear.y"}
_POSITION = {"x": "position.x", "y": "position.y"}
_SPEEDS = ("twist.linear.x", "linear.x", "longitudinal_velocity", "speed")
"""Where messages have the speed of the wheels: nav_msgs and geometry_msgs, Autoware's reports, and others."""
_WHEELS = re.compile(r"wheel|vehicle|speedo|odometer|(?:^|[/_])can(?:[/_]|$)", re.IGNORECASE)
_TRUTH = re.compile(r"truth|ground|reference|(?:^|/)gt(?:/|$)", re.IGNORECASE)
_RECEIVER = re.compile(r"gps|gnss|fix|ublox|novatel|septentrio|(?:^|/)vel$", re.IGNORECASE)

_FIELDS: dict[str, tuple[Mapping[str, str], ...]] = {"imu": (_IMU,), "gps": (_FIX, _POSITION)}

First = Callable[[str], tuple[str, int, Any] | None]
"""The first message of a topic."""


def guess_topics(tables: Mapping[str, Table], choice: Choice, first: First, path: Path) -> Guess:
    """The topics of IMU, fixes with their velocity, and truth.

    Raises
    ------
    InputError
        A topic that the user chose is not there, or holds something else.
    """
    notes: list[str] = []
    pick = _Picker(tables, choice, first, path, notes)
    roles: dict[Role, tuple[Part, ...]] = {}
    imu = pick.topic("imu", {t for t in tables if pick.prefix(t, _IMU) is not None})
    if imu:
        roles["imu"] = (pick.part(imu, _imu(tables[imu].columns, pick.needed(imu, _IMU))),)
        pick.tell_frame(imu)
    located = {t for t in tables if pick.prefix(t, _FIX) is not None and not _TRUTH.search(t)}
    fixes = pick.topic("gps", located)
    if fixes:
        roles["gps"] = (pick.part(fixes, pick.position(fixes)),)
        moving = {t for t in tables if pick.prefix(t, _VELOCITY) is not None and _RECEIVER.search(t)}
        moving -= {t for t in moving if re.search(r"cmd|odom", t) or pick.prefix(t, _POSITION) is not None}
        velocity = pick.topic("velocity", moving)
        if velocity:
            columns = pick.named(velocity, _VELOCITY)
            roles["gps"] = (*roles["gps"], pick.part(velocity, columns))
            notes.append(f"{velocity} taken as the receiver's velocity, m/s east and north")
    named = {
        t
        for t in tables
        if _TRUTH.search(t) and (pick.prefix(t, _POSITION) or pick.prefix(t, _FIX)) is not None
    }
    truth = pick.topic("truth", named)
    if truth:
        roles["truth"] = (pick.part(truth, pick.motion(truth)),)
    elif poses := sorted(t for t in tables if "Odometry" in tables[t].kind):
        notes.append(
            f"{names_shown(poses)} not taken as truth, since no name says so; choose one with --truth-topic"
        )
    told = {t for t in tables if pick.speed(t) is not None and _WHEELS.search(t)}
    told -= {t for t in told if _TRUTH.search(t) or _RECEIVER.search(t) or re.search(r"cmd|command", t)}
    wheels = pick.topic("odometer", told - {fixes, truth})
    if wheels:
        speed = pick.speed(wheels)
        if speed is None:
            raise InputError(
                f"{path}: {wheels} ({tables[wheels].kind}) has none of {', '.join(_SPEEDS)}; choose another topic, or "
                "map odometer.speed"
            )
        roles["odometer"] = (pick.part(wheels, {"speed": speed}),)
        notes.append(f"{wheels} taken as the wheels' speed, m/s forward")
    return Guess(roles, tuple(notes))


def standard(tables: Mapping[str, Table], topic: str, role: str) -> bool:
    """Return True if a topic holds what the standard messages of a role do."""
    columns = set(tables[topic].columns)
    return any(
        column.endswith(first) and {column.removesuffix(first) + p for p in paths.values()} <= columns
        for paths in _FIELDS.get(role, ())
        for first in [next(iter(paths.values()))]
        for column in columns
    )


def _imu(columns: Collection[str], at: str) -> dict[str, str]:
    found = {name: at + path for name, path in _IMU.items()}
    covariances = [f"{at}{kind}_covariance[0]" for kind in ("linear_acceleration", "angular_velocity")]
    if set(covariances) <= set(
        columns
    ):  # sensor_msgs/Imu: -1 there means that the sensor gives no such value
        found["keep"] = " and ".join(f"{c} != -1" for c in covariances)
    return found


class _Picker:
    """Finds topics and the paths of their numbers, and notes choices among several."""

    def __init__(
        self, tables: Mapping[str, Table], choice: Choice, first: First, path: Path, notes: list[str]
    ) -> None:
        self.tables, self.choice, self.first, self.path, self.notes = tables, choice, first, path, notes

    def topic(self, role: str, candidates: Collection[str]) -> str | None:
        """The topic that the user chose, or the one with the most messages."""
        chosen = self.choice.tables.get(role)
        if chosen is not None:
            near = {chosen, "/" + chosen.lstrip("/")} & set(self.tables)
            if not near:
                there = names_shown(self.tables)
                raise InputError(
                    f"{self.path}: has no topic {chosen!r} for --{role}-topic; there are {there}"
                )
            return near.pop()
        ranked = sorted(candidates, key=lambda t: (-(self.tables[t].rows or 0), t))
        ranked = [t for t in ranked if self.tables[t].rows != 0]
        if len(ranked) > 1:
            others = names_shown(ranked[1:])
            self.notes.append(f"{ranked[0]} taken for the {role}, not {others}; choose with --{role}-topic")
        return ranked[0] if ranked else None

    def prefix(self, topic: str, paths: Mapping[str, str]) -> str | None:
        """Prefix of the paths in a topic's columns: "" in the message itself, "imu." in a field of it."""
        columns = set(self.tables[topic].columns)
        first = next(iter(paths.values()))
        for column in self.tables[topic].columns:
            before = column.removesuffix(first)
            at_start = not before or before.endswith(".")
            if column.endswith(first) and at_start and {before + p for p in paths.values()} <= columns:
                return before
        return None

    def speed(self, topic: str) -> str | None:
        """The path of a speed forward in a topic's messages."""
        return next((at + p for p in _SPEEDS if (at := self.prefix(topic, {"speed": p})) is not None), None)

    def needed(self, topic: str, paths: Mapping[str, str]) -> str:
        """The prefix, of a topic that must have it."""
        at = self.prefix(topic, paths)
        if at is None:
            wanted = ", ".join(paths.values())
            raise InputError(
                f"{self.path}: {topic} ({self.tables[topic].kind}) has no {wanted}; choose another topic, or map it"
            )
        return at

    def named(self, topic: str, paths: Mapping[str, str]) -> dict[str, str]:
        """The columns with their prefix."""
        at = self.needed(topic, paths)
        return {name: at + path for name, path in paths.items()}

    def position(self, topic: str) -> dict[str, str]:
        """Fixes: NavSatFix in degrees, or a pose in metres east and north; deviations where they are stated."""
        columns = set(self.tables[topic].columns)
        if (at := self.prefix(topic, _FIX)) is not None:
            found = self.named(topic, _FIX)
            if f"{at}position_covariance[0]" in columns:  # row by row, east, north, up
                known = f"{at}position_covariance_type > 0"
                found["std_x"] = f"where({known}, sqrt({at}position_covariance[0]), 0/0)"
                found["std_y"] = f"where({known}, sqrt({at}position_covariance[4]), 0/0)"
            if f"{at}status.status" in columns:
                found["keep"] = f"{at}status.status >= 0"
            return found
        found = self.named(topic, _POSITION)
        if "pose.covariance[0]" in columns:
            found |= {"std_x": "sqrt(pose.covariance[0])", "std_y": "sqrt(pose.covariance[7])"}
        self.notes.append(f"{topic} taken as metres east and north")
        return found

    def motion(self, topic: str) -> dict[str, str]:
        """Truth: a pose with its heading and, in Odometry, the velocity in the body; or fixes in degrees."""
        if self.prefix(topic, _FIX) is not None:
            return {k: v for k, v in self.position(topic).items() if not k.startswith("std")}
        found = self.named(topic, _POSITION)
        at = found["x"].removesuffix("position.x") + "orientation."
        if at + "w" in self.tables[topic].columns:
            w, x, y, z = (at + i for i in "wxyz")
            found["theta"] = f"atan2(2*({w}*{z} + {x}*{y}), 1 - 2*({y}*{y} + {z}*{z}))"
        if self.prefix(topic, _VELOCITY) is not None and "theta" in found:
            velocity = self.named(topic, _VELOCITY)
            found |= {"forward": velocity["vx"], "left": velocity["vy"]}
        self.notes.append(f"{topic} taken as truth, m east and north of the origin, velocity in the body")
        return found

    def part(self, topic: str, columns: dict[str, str]) -> Part:
        """The part with its time: the header's stamp, unless it is unset or not wanted."""
        stamped = "stamp" in self.tables[topic].columns and not self.choice.receive_times
        if stamped and not _stamp(self.first(topic)):
            stamped = False
            self.notes.append(f"{topic}: header stamps are not set; receive times taken")
        elif "stamp" not in self.tables[topic].columns:
            self.notes.append(f"{topic}: messages have no header; receive times taken")
        return Part(topic, {"t": "stamp*1e-9" if stamped else "received*1e-9", **columns})

    def tell_frame(self, topic: str) -> None:
        """Note the frame that an IMU's values are in."""
        message = self.first(topic)
        header = getattr(message[2], "header", None) if message else None
        name = getattr(header, "frame_id", "")
        if name:
            self.notes.append(
                f"{topic} is in the frame {name!r}, axes as REP-103 has them unless --mount says more"
            )


def _stamp(message: tuple[str, int, Any] | None) -> int | None:
    return stamp_of(message[2]) if message else None
