"""Logs of messages on topics: each topic is a table, each number in its messages a column named by its path.

``received`` is the time of recording and ``stamp`` that of the header, both in ns.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.guess import SAMPLE, guess_roles, time_of
from sigmaswarm.importing.names import read_name
from sigmaswarm.importing.readers.fields import getter
from sigmaswarm.importing.readers.topics import guess_topics, standard
from sigmaswarm.importing.readers.uorb import TURNED, part_of
from sigmaswarm.importing.source import CHUNK, Batch, Choice, Guess, Part, Role, Table
from sigmaswarm.wording import shown

LATE = 0.1
"""s: header stamps that differ more from the receive times get a remark."""

Message = tuple[str, int, Any]
"""Topic, receive time in ns, and the message with its fields as attributes or keys."""


@dataclass(frozen=True)
class MessageLog:
    """An open log of messages.

    Attributes
    ----------
    stream : the messages of some topics, decoded, in the order of the log
    interleaved : tables come mixed, so that a part of the log shows them all
    """

    path: Path
    tables: Mapping[str, Table]
    stream: Callable[[Collection[str]], Iterator[Message]]
    unread: tuple[str, ...] = ()
    remarks: list[str] = field(default_factory=list[str])
    interleaved: ClassVar[bool] = True

    def batches(self, wanted: Mapping[str, Collection[str]]) -> Iterator[Batch]:
        """Some thousand messages at a time."""
        total = sum(self.tables[topic].rows or 0 for topic in wanted)
        collectors = {topic: _Collector(topic, list(columns)) for topic, columns in wanted.items()}
        for seen, (topic, received, message) in enumerate(self.messages(wanted), 1):
            collectors[topic].add(received, message)
            if seen % CHUNK == 0:
                for name, collector in collectors.items():
                    if collector.rows:
                        yield Batch(name, collector.take(), min(seen / max(total, 1), 1.0))
        for topic, collector in collectors.items():
            if collector.rows:
                yield Batch(topic, collector.take(), 1.0)
            self.remarks.extend(collector.remarks())

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """The messages; whatever a decoder stumbles over becomes one line."""
        try:
            yield from self.stream(topics)
        except InputError:
            raise
        except Exception as error:  # decoders raise anything on damaged bytes
            raise broken(self.path, error) from None

    def guess(self, choice: Choice) -> Guess:
        """By message types, and topics' names; of messages of an author's own, by the names of their numbers."""
        roles = ("imu", "gps")
        there = {
            role: next((t for t in (n, "/" + n.lstrip("/")) if t in self.tables), "")
            for role, n in choice.tables.items()
        }
        own = {
            role: t for role, t in there.items() if t and role in roles and not standard(self.tables, t, role)
        }
        rest = replace(choice, tables={r: t for r, t in choice.tables.items() if r not in own})
        guess = guess_topics(self.tables, rest, lambda topic: next(self.messages([topic]), None), self.path)
        found, faults = dict(guess.roles), guess.faults
        notes = list(guess.notes)
        for role in roles:
            if role in own or role not in found:
                other = self._own_messages(role, own.get(role), choice)
                found |= {r: parts for r, parts in other.roles.items() if r == role}
                faults += tuple(f for f in other.faults if f.role == role)
                notes += other.notes if role in other.roles else ()
        notes += [f"{u} can't be decoded and is left out" for u in self.unread]
        return replace(guess, roles=found, notes=tuple(dict.fromkeys(notes)), faults=faults)

    def _own_messages(self, role: Role, topic: str | None, choice: Choice) -> Guess:
        """A role's part of other messages, by PX4's types or by names; the time alone if the rest is mapped."""
        wanted = {"lat", "lon"} if role == "gps" else {"ax", "ay", "gz"}
        topics = [topic] if topic else list(self.tables)
        for name in topics:
            if (part := part_of(name, self.tables[name], role)) is not None:
                return Guess({role: (part,)}, (TURNED,) if role == "imu" else ())
        named = {t: {read_name(c).meaning for c in self.tables[t].columns} for t in topics}
        samples = {t: self._sample(t) for t in topics if wanted <= named[t]}
        if samples:
            return guess_roles(samples, {role: topic} if topic else {})
        if topic is None:
            return Guess({})
        if role not in choice.mapped:
            raise InputError(
                f"{self.path}: {topic} ({self.tables[topic].kind}) has nothing that gives "
                f"{' and '.join(sorted(wanted))} by its name; choose another topic, or map it"
            )
        time = time_of(self._sample(topic), role)
        return Guess({role: (Part(topic, {"t": time} if time else {}),)})

    def _sample(self, topic: str) -> pl.DataFrame:
        """The first messages of a topic."""
        columns = list(self.tables[topic].columns)
        collector = _Collector(topic, columns)
        for _, received, message in islice(self.messages([topic]), SAMPLE):
            collector.add(received, message)
        return collector.take() if collector.rows else pl.DataFrame(schema=dict.fromkeys(columns, pl.Float64))


@dataclass
class _Collector:
    """Rows of one topic, and how far its stamps are from the receive times."""

    topic: str
    columns: list[str]
    rows: list[tuple[Any, ...]] = field(default_factory=list[tuple[Any, ...]])
    delays: list[float] = field(default_factory=list[float])

    def __post_init__(self) -> None:
        self.getters = [getter(c) for c in self.columns if c != "received"]

    def add(self, received: int, message: Any) -> None:
        """Take the wanted numbers out of a message."""
        values = iter([get(message) for get in self.getters])
        self.rows.append(tuple(received if c == "received" else next(values) for c in self.columns))
        if "stamp" in self.columns:
            stamp = self.rows[-1][self.columns.index("stamp")]
            if stamp:  # 0 where it is not set
                self.delays.append((received - stamp) * 1e-9)

    def take(self) -> pl.DataFrame:
        """Return the rows so far and clear them."""
        rows, self.rows = self.rows, []
        self.delays = self.delays[:: max(len(self.delays) // 20_000, 1)]
        values = zip(*rows, strict=True)
        return pl.DataFrame({c: _numbers(v) for c, v in zip(self.columns, values, strict=True)})

    def remarks(self) -> Iterator[str]:
        """Return True if stamps and receive times differ."""
        delay = float(np.median(self.delays)) if self.delays else 0.0
        if abs(delay) > LATE:
            when = "before" if delay > 0 else "after"
            yield (
                f"{self.topic}: header stamps are {abs(delay):.3f} s {when} the receive times (median); "
                "were the stamps wrong, take --receive-times"
            )


def _numbers(values: Sequence[Any]) -> pl.Series:
    """A column (n,) of whole numbers as such, a time has more digits than a float holds; of any others as floats."""
    if {type(v) for v in values} <= {int, type(None)}:
        try:
            return pl.Series(values, dtype=pl.Int64)
        except (OverflowError, TypeError, pl.exceptions.PolarsError):  # beyond 64 bits
            pass
    return pl.Series([_float(v) for v in values], dtype=pl.Float64)


def _float(value: Any) -> float | None:
    try:
        return None if value is None else float(value)
    except OverflowError:  # a whole number of 400 digits
        return None


def broken(path: Path, error: Exception) -> InputError:
    """Return the error of a library about a damaged file in one line."""
    said = " ".join(str(error).split()) or type(error).__name__
    said = shown(re.sub(r"^b'|'$", "", said), 160)
    return InputError(f"{path}: is cut short or broken ({said}); record or copy it again")
