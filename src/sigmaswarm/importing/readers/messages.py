"""Logs of messages: each topic is a table, and each number of a message is a column named by the field's path.

``received`` is the receive time and ``stamp`` the time in the message, mostly in its header, both in ns.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import guess_roles
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.readers.fields import getter, has_header
from sigmaswarm.importing.readers.px4 import AXES_NOTE, part_of
from sigmaswarm.importing.readers.topics import (
    STANDARD,
    Topics,
    frame_of,
    placement,
    prefix,
    static_topic,
)
from sigmaswarm.importing.source import (
    CHUNK,
    SAMPLE_ROWS,
    Batch,
    Guess,
    Log,
    Part,
    Placement,
    Role,
    Table,
    TableChoice,
    Wanted,
    errors_as_damage,
)
from sigmaswarm.importing.times import time_of

MIN_DELAY = 0.1  # s; a larger median difference between receive times and header stamps is reported
Message = tuple[str, int, Any]  # topic, receive time in ns, and message with its fields as attributes or keys
# Yields the decoded messages of the given topics
Stream = Callable[[Collection[str]], Iterator[Message]]


def message_log(path: Path, tables: Mapping[str, Table], stream: Stream, unread: Sequence[str] = ()) -> Log:
    """Make a log of messages. ``unread`` contains topics that can't be decoded."""
    messages = _Messages(path, tables, stream)

    def guess(choice: TableChoice) -> Guess:
        found = messages.guess(choice)
        left = (f"{topic} can't be decoded and is left out" for topic in unread)
        return replace(found, notes=tuple(dict.fromkeys((*found.notes, *left))))

    return Log(path, tables, messages.batches, guess, messages.remarks, mixed=True)


@dataclass(frozen=True)
class _Messages:
    path: Path
    tables: Mapping[str, Table]
    stream: Stream
    remarks: list[str] = field(default_factory=list[str])

    def batches(self, wanted: Wanted) -> Iterator[Batch]:
        total = sum(self.tables[topic].rows or 0 for topic in wanted)
        collectors = {topic: _Collector(topic, list(columns)) for topic, columns in wanted.items()}
        for seen, (topic, received, message) in enumerate(self._messages(wanted), 1):
            collectors[topic].add(received, message)
            if seen % CHUNK == 0:
                for name, collector in collectors.items():
                    if collector.rows:
                        yield name, collector.take(), min(seen / max(total, 1), 1.0)
        for topic, collector in collectors.items():
            if collector.rows:
                yield topic, collector.take(), 1.0
            self.remarks.extend(collector.remarks())

    def _messages(self, topics: Collection[str]) -> Iterator[Message]:
        with errors_as_damage(self.path):
            yield from self.stream(topics)

    def guess(self, choice: TableChoice) -> Guess:
        """Guess roles of standard messages from fields and topic names, and of other messages from column names."""
        own: dict[str, str] = {}
        for role, chosen in choice.tables.items():
            topic = next((t for t in (chosen, "/" + chosen.lstrip("/")) if t in self.tables), "")
            if topic and all(prefix(self.tables[topic], paths) is None for paths in STANDARD.get(role, ())):
                own |= {role: topic} if role in STANDARD else {}
        rest = replace(choice, tables={r: t for r, t in choice.tables.items() if r not in own})
        first = Topics(self.path, self.tables, rest, lambda topic: next(self._messages([topic]), None))
        guess = first.guess()
        for role in ("imu", "gps"):
            if role in own or role not in guess.roles:
                other = self._of_other_types(role, own.get(role), choice)
                if role in other.roles:
                    guess = replace(
                        guess,
                        roles={**guess.roles, role: other.roles[role]},
                        notes=guess.notes + other.notes + self._received(other.roles[role]),
                        downward=other.downward if role == "imu" else guess.downward,
                        faults=guess.faults + tuple(f for f in other.faults if f.role == role),
                    )
        return replace(guess, placed=self._placement(guess))

    def _received(self, parts: Iterable[Part]) -> tuple[str, ...]:
        topics = [part.table for part in parts if "received" in part.columns.get("t", "")]
        no_stamp = {True: "the header stamps are not set", False: "the messages have no header"}
        why = {topic: no_stamp["stamp" in self.tables[topic].columns] for topic in topics}
        return tuple(f"{topic}: {reason}, so receive times are used" for topic, reason in why.items())

    def _placement(self, guess: Guess) -> Placement | None:
        static = static_topic(self.tables)
        if static is None or "imu" not in guess.roles:
            return None
        topics = [guess.roles[role][0].table if role in guess.roles else "" for role in ("imu", "gps")]
        first = (next(self._messages([topic]), None) if topic else None for topic in topics)
        imu, antenna = (frame_of(message[2]) if message else "" for message in first)
        sent = islice(self._messages([static]), self.tables[static].rows)
        return placement((message for _, _, message in sent), imu, antenna)

    def _of_other_types(self, role: Role, topic: str | None, choice: TableChoice) -> Guess:
        """Guess a role's part from PX4's types or from column names.

        If the user maps columns of this role and the names are not recognized, guess only the time.
        """
        wanted = {"lat", "lon"} if role == "gps" else {"ax", "ay", "gz"}
        topics = [topic] if topic else list(self.tables)
        for name in topics:
            if (part := part_of(name, self.tables[name], role)) is not None:
                return Guess({role: (part,)}, (AXES_NOTE,) if role == "imu" else ())
        named = {t: {read_name(c).meaning for c in self.tables[t].columns} for t in topics}
        samples = {t: self._sample(t) for t in topics if wanted <= named[t]}
        if samples:
            return guess_roles(samples, {role: topic} if topic else {})
        if topic is None:
            return Guess({})
        if role not in choice.mapped:
            raise InputError(
                f"{self.path}: {topic} ({self.tables[topic].kind}) has no fields with recognized names for "
                f"{', '.join(sorted(wanted))}; choose another topic, or map the fields with --map"
            )
        time = time_of(self._sample(topic), role)
        return Guess({role: (Part(topic, {"t": time} if time else {}),)})

    def _sample(self, topic: str) -> pl.DataFrame:
        collector = _Collector(topic, list(self.tables[topic].columns))
        for _, received, message in islice(self._messages([topic]), SAMPLE_ROWS):
            collector.add(received, message)
        empty = pl.DataFrame(schema=dict.fromkeys(collector.columns, pl.Float64))
        return collector.take() if collector.rows else empty


@dataclass
class _Collector:
    topic: str
    columns: list[str]
    rows: list[list[Any]] = field(default_factory=list[list[Any]])
    delays: list[float] = field(default_factory=list[float])

    def __post_init__(self) -> None:
        self.getters = [None if c == "received" else getter(c) for c in self.columns]
        self.stamp = self.columns.index("stamp") if "stamp" in self.columns else None

    def add(self, received: int, message: Any) -> None:
        row = [get(message) if get else received for get in self.getters]
        self.rows.append(row)
        if (
            self.stamp is not None and row[self.stamp] and has_header(message)
        ):  # 0 means that the stamp is not set
            self.delays.append((received - row[self.stamp]) * 1e-9)

    def take(self) -> pl.DataFrame:
        rows, self.rows = self.rows, []
        self.delays = self.delays[:: max(len(self.delays) // 20_000, 1)]
        values = zip(*rows, strict=True)
        return pl.DataFrame({c: _numbers(v) for c, v in zip(self.columns, values, strict=True)})

    def remarks(self) -> Iterator[str]:
        delay = float(np.median(self.delays)) if self.delays else 0.0
        if abs(delay) > MIN_DELAY:
            when = "before" if delay > 0 else "after"
            yield (
                f"{self.topic}: the header stamps are {abs(delay):.3f} s {when} the receive times (median). "
                "If the stamps are wrong, add --receive-times"
            )


def _numbers(values: Sequence[Any]) -> pl.Series:
    """Make a column (n,). Integers remain integers, since times in ns have more digits than a float."""
    if {type(v) for v in values} <= {int, type(None)}:
        try:
            return pl.Series(values, dtype=pl.Int64)
        except (OverflowError, TypeError, pl.exceptions.PolarsError):  # beyond 64 bits
            pass
    return pl.Series([_float(v) for v in values], dtype=pl.Float64)


def _float(value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except OverflowError:  # an integer of 400 digits
        return None
