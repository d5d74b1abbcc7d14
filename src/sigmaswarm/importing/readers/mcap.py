"""MCAP files of any profile: messages of ROS 2 (CDR), ROS 1 and JSON."""

import json
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.readers.definitions import columns_of
from sigmaswarm.importing.readers.messages import Message, MessageLog, broken
from sigmaswarm.importing.source import Source, Table, first_bytes, library

Decode = Callable[[bytes], Any]

MAGIC = b"\x89MCAP0\r\n"


def recognizes(path: Path) -> bool:
    """Whether a file begins as MCAP does, or has its name."""
    return first_bytes(path, 8) == MAGIC or (path.is_file() and path.suffix == ".mcap")


@contextmanager
def open_log(path: Path) -> Generator[Source]:
    """Open an MCAP file by the index at its end."""
    reading = library("mcap.reader", "ros")
    with path.open("rb") as file:
        try:
            reader = reading.make_reader(file)
            summary = reader.get_summary()
        except Exception as error:  # the library raises anything on damaged bytes
            raise broken(path, error) from None
        if summary is None or not summary.channels:
            raise InputError(
                f"{path}: has no index or no topics; run `mcap recover` on it, or record it again"
            )
        yield _log(path, reader, summary)


def _log(path: Path, reader: Any, summary: Any) -> MessageLog:
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    store = library("rosbags.typesys", "ros").get_typestore(library("rosbags.typesys", "ros").Stores.EMPTY)
    tables: dict[str, Table] = {}
    decoders: dict[int, Decode] = {}
    unread: list[str] = []
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        columns, decode = _decoder(channel, schema, store, reader)
        kind = schema.name if schema else channel.message_encoding
        if decode is None or not columns:
            unread.append(f"{channel.topic} ({channel.message_encoding} {kind})")
            continue
        decoders[number] = decode
        rows = counts.get(number, 0) + ((tables[channel.topic].rows or 0) if channel.topic in tables else 0)
        tables[channel.topic] = Table(columns, kind, rows if summary.statistics else None)

    def stream(topics: Collection[str]) -> Iterator[Message]:
        for _, channel, message in reader.iter_messages(topics=list(topics), log_time_order=False):
            if channel.id in decoders:
                yield channel.topic, message.log_time, decoders[channel.id](message.data)

    return MessageLog(path, tables, stream, tuple(unread))


def _decoder(channel: Any, schema: Any, store: Any, reader: Any) -> tuple[tuple[str, ...], Decode | None]:
    """The columns of a channel's messages, and what decodes them; None where nothing here does."""
    encoding = channel.message_encoding
    if encoding == "json":
        return _json_columns(reader, channel.topic), json.loads
    if encoding not in ("cdr", "ros1") or schema is None:
        return (), None
    typesys = library("rosbags.typesys", "ros")
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/", 1)
    text = schema.data.decode()
    try:
        parse = typesys.get_types_from_idl if schema.encoding == "ros2idl" else None
        types = parse(text) if parse else typesys.get_types_from_msg(text, name)
        store.register({k: v for k, v in types.items() if k not in store.fielddefs})
        deserialize = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
        return columns_of(store, name), lambda data: deserialize(data, name)
    except typesys.TypesysError:
        return (), None


def _json_columns(reader: Any, topic: str) -> tuple[str, ...]:
    """The paths of the numbers in a topic's first message."""
    for _, _, message in reader.iter_messages(topics=[topic]):
        content = json.loads(message.data)
        paths = tuple(_json_paths(content, "")) if isinstance(content, dict) else ()
        stamped = any(p.endswith(("header.stamp.sec", "timestamp.sec")) for p in paths)
        return ("received", *(("stamp",) if stamped else ()), *paths)
    return ()


def _json_paths(content: Any, before: str) -> Iterator[str]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _json_paths(value, f"{before}{name}.")
        elif isinstance(value, int | float):
            yield before + name
        elif isinstance(value, list):
            yield from (
                f"{before}{name}[{i}]" for i, v in enumerate(value[:36]) if isinstance(v, int | float)
            )
