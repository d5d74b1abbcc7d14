"""MCAP files of any profile: messages of ROS 2 (CDR), ROS 1, JSON and Protobuf."""

import json
import struct
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, cast

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.readers.fields import columns_of, stamp_of
from sigmaswarm.importing.readers.messages import Message, MessageLog, broken
from sigmaswarm.importing.source import Source, Table, first_bytes, library

Decode = Callable[[bytes], Any]

LOOKED_AT = 20
"""Messages in JSON, which no definition describes, by which a topic's columns are known."""

DEEPEST = 6
MOST_ELEMENTS = 36
"""Of a list in a message: a 6 x 6 covariance."""
_LZ4_RATIO = 255
"""No byte of LZ4 becomes more."""

MAGIC = b"\x89MCAP0\r\n"


def recognizes(path: Path) -> bool:
    """Return True if a file begins as MCAP does, or has its name."""
    return first_bytes(path, 8) == MAGIC or (path.is_file() and path.suffix == ".mcap")


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open an MCAP file by the index at its end."""
    reading = library("mcap.reader", "ros")
    with path.open("rb") as file:
        try:
            reader = reading.make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            if summary is None or not summary.channels:
                raise InputError(
                    f"{path}: has no index or no topics; run `mcap recover` on it, or record it again"
                )
            for chunk in summary.chunk_indexes:
                limits.check_unpacked(_unpacked(file, chunk.chunk_start_offset, limits), path)
            log = _log(path, reader, summary, limits)
        except InputError:
            raise
        except Exception as error:  # the library raises anything on damaged bytes
            raise broken(path, error) from None
        yield log


def _unpacked(file: BinaryIO, offset: int, limits: Limits) -> int:
    """Bytes that a chunk becomes, as its record and its packed data say themselves; LZ4 need not, and is tried."""
    file.seek(offset + 9 + 16)  # behind the opcode, the record's length, and the first and last time
    size, _, length = struct.unpack("<QII", file.read(16))
    kind = file.read(min(length, 16))
    (packed,) = struct.unpack("<Q", file.read(8))
    data = file.read(min(packed, 32))
    said = 0
    if kind == b"zstd":
        said = library("zstandard", "ros").frame_content_size(data)
    elif kind == b"lz4":
        said = library("lz4.frame", "ros").get_frame_info(data)["content_size"]
        if not said and packed * _LZ4_RATIO > limits.unpacked_mb * 1_000_000:
            said = _tried(data + file.read(packed - len(data)), limits)
    return max(size, said)


def _tried(packed: bytes, limits: Limits) -> int:
    """Bytes that LZ4 unpacks to, counted up to the limit."""
    unpacking = library("lz4.frame", "ros").LZ4FrameDecompressor()
    return len(unpacking.decompress(packed, max_length=limits.unpacked_mb * 1_000_000 + 1))


def _log(path: Path, reader: Any, summary: Any, limits: Limits) -> MessageLog:
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    store = library("rosbags.typesys", "ros").get_typestore(library("rosbags.typesys", "ros").Stores.EMPTY)
    tables: dict[str, Table] = {}
    decoders: dict[int, Decode] = {}
    unread: list[str] = []
    for number, channel in summary.channels.items():
        schema = summary.schemas.get(channel.schema_id)
        columns, decode = _decoder(channel, schema, store, reader, limits, path)
        limits = limits.less(len(columns))
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


def _decoder(
    channel: Any, schema: Any, store: Any, reader: Any, limits: Limits, path: Path
) -> tuple[tuple[str, ...], Decode | None]:
    """The columns of a channel's messages, and their decoder; None where there is none."""
    encoding = channel.message_encoding
    if encoding == "json":
        return limits.first_columns(_json_columns(reader, channel.topic, _json), path), _json
    if encoding == "protobuf" and schema is not None:
        decode = _protobuf(schema)
        return limits.first_columns(_json_columns(reader, channel.topic, decode), path), decode
    if encoding not in ("cdr", "ros1") or schema is None:
        return (), None
    typesys = library("rosbags.typesys", "ros")
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/", 1)
    try:
        text = schema.data.decode()
        parse = typesys.get_types_from_idl if schema.encoding == "ros2idl" else None
        types = parse(text) if parse else typesys.get_types_from_msg(text, name)
        store.register({k: v for k, v in types.items() if k not in store.fielddefs})
        deserialize = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
    except (typesys.TypesysError, UnicodeDecodeError, RecursionError):
        return (), None
    return columns_of(store, name, limits, path), lambda data: deserialize(data, name)


def _json(data: bytes) -> dict[str, Any]:
    """A message; one that is no object holds nothing."""
    content = json.loads(data)
    return cast("dict[str, Any]", content) if isinstance(content, dict) else {}


def _protobuf(schema: Any) -> Callable[[bytes], dict[str, Any]]:
    """Convert a message of Protobuf to one as in JSON."""
    parse = library("mcap_protobuf.decoder", "ros").DecoderFactory().decoder_for("protobuf", schema)

    def decode(data: bytes) -> dict[str, Any]:
        return _fields(parse(data), 0)

    return decode


def _fields(message: Any, depth: int) -> dict[str, Any]:
    """The fields of a Protobuf message; a Timestamp as a ROS stamp."""
    if message.DESCRIPTOR.full_name == "google.protobuf.Timestamp":
        return {"sec": message.seconds, "nanosec": message.nanos}
    content: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields if depth < DEEPEST else ():
        value = getattr(message, field.name)
        if field.message_type is None:
            many = not isinstance(value, int | float | str | bytes)
            content[field.name] = list(value)[:MOST_ELEMENTS] if many else value
        elif hasattr(value, "DESCRIPTOR"):
            content[field.name] = _fields(value, depth + 1)
    return content


def _json_columns(reader: Any, topic: str, decode: Callable[[bytes], dict[str, Any]]) -> Iterator[str]:
    """The paths of the numbers in a topic's first messages: lists may be empty in the very first."""
    known: set[str] = set()
    for _, _, message in islice(reader.iter_messages(topics=[topic]), LOOKED_AT):
        content = decode(message.data)
        if not known:
            yield "received"
            known.add("received")
        if "stamp" not in known and stamp_of(content) is not None:
            yield "stamp"
            known.add("stamp")
        for path in _json_paths(content, ""):
            if path and path not in known:
                known.add(path)
                yield path


def _json_paths(content: dict[str, Any], before: str) -> Iterator[str]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _json_paths(cast("dict[str, Any]", value), f"{before}{name}.")
        elif isinstance(value, int | float):
            yield before + name
        elif isinstance(value, list):
            first = enumerate(cast("list[Any]", value)[:MOST_ELEMENTS])
            yield from (f"{before}{name}[{i}]" for i, v in first if isinstance(v, int | float))
