"""MCAP files of any profile, with messages of ROS 2 (CDR), ROS 1, JSON or Protobuf."""

import json
import struct
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, cast

from sigmaswarm.errors import InputError
from sigmaswarm.importing.readers.fields import MAX_DEPTH, MAX_ELEMENTS, columns_of, json_columns
from sigmaswarm.importing.readers.messages import Message, message_log
from sigmaswarm.importing.source import Limits, Log, Table, errors_as_damage, first_bytes, import_library

Decode = Callable[[bytes], Any]
SAMPLE_MESSAGES = 20  # number of first messages that determine the columns of JSON and Protobuf topics
_LZ4_RATIO = 255  # largest expansion ratio of LZ4
MAGIC = b"\x89MCAP0\r\n"


def recognizes(path: Path) -> bool:
    return first_bytes(path, 8) == MAGIC or (path.is_file() and path.suffix == ".mcap")


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    reading = import_library("mcap.reader", "ros")
    file = stack.enter_context(path.open("rb"))
    with errors_as_damage(path):
        reader = reading.make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None or not summary.channels:
            raise InputError(
                f"{path}: has no index or no topics; run `mcap recover` on it, or record it again"
            )
        for chunk in summary.chunk_indexes:
            limits.check_unpacked(_unpacked(file, chunk.chunk_start_offset, limits), path)
        return _log(path, reader, summary, limits)


def _unpacked(file: BinaryIO, offset: int, limits: Limits) -> int:
    """Return the size of a chunk after unpacking, bytes.

    A large LZ4 chunk without a stated size is unpacked to count.
    """
    file.seek(offset + 9 + 16)  # after the opcode, the record's length, and the first and last time
    size, _, length = struct.unpack("<QII", file.read(16))
    kind = file.read(min(length, 16))
    (packed,) = struct.unpack("<Q", file.read(8))
    data = file.read(min(packed, 32))
    stated, most = 0, limits.unpacked_mb * 1_000_000
    if kind == b"zstd":
        stated = import_library("zstandard", "ros").frame_content_size(data)
    elif kind == b"lz4":
        lz4 = import_library("lz4.frame", "ros")
        stated = lz4.get_frame_info(data)["content_size"]
        if not stated and packed * _LZ4_RATIO > most:
            data += file.read(packed - len(data))
            stated = len(lz4.LZ4FrameDecompressor().decompress(data, max_length=most + 1))
    return max(size, stated)


def _log(path: Path, reader: Any, summary: Any, limits: Limits) -> Log:
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    store = import_library("rosbags.typesys", "ros").get_typestore(
        import_library("rosbags.typesys", "ros").Stores.EMPTY
    )
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

    return message_log(path, tables, stream, unread)


def _decoder(
    channel: Any, schema: Any, store: Any, reader: Any, limits: Limits, path: Path
) -> tuple[tuple[str, ...], Decode | None]:
    encoding = channel.message_encoding
    if encoding == "json" or (encoding == "protobuf" and schema is not None):
        decode = _json if encoding == "json" else _protobuf(schema)
        first = islice(reader.iter_messages(topics=[channel.topic]), SAMPLE_MESSAGES)
        contents = (decode(message.data) for _, _, message in first)
        return limits.first_columns(json_columns(contents), path), decode
    if encoding not in ("cdr", "ros1") or schema is None:
        return (), None
    typesys = import_library("rosbags.typesys", "ros")
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/", 1)
    try:
        text = schema.data.decode()
        idl = schema.encoding == "ros2idl"
        types = typesys.get_types_from_idl(text) if idl else typesys.get_types_from_msg(text, name)
        store.register({k: v for k, v in types.items() if k not in store.fielddefs})
    except (typesys.TypesysError, UnicodeDecodeError, RecursionError):
        return (), None
    deserialize = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1

    def first_message() -> Any:
        found = next(reader.iter_messages(topics=[channel.topic]), None)
        return found and deserialize(found[2].data, name)

    return columns_of(store, name, limits, path, first_message), lambda data: deserialize(data, name)


def _json(data: bytes) -> dict[str, Any]:
    content = json.loads(data)
    return cast("dict[str, Any]", content) if isinstance(content, dict) else {}


def _protobuf(schema: Any) -> Callable[[bytes], dict[str, Any]]:
    parse = import_library("mcap_protobuf.decoder", "ros").DecoderFactory().decoder_for("protobuf", schema)
    return lambda data: _fields(parse(data), 0)


def _fields(message: Any, depth: int) -> dict[str, Any]:
    """Return the fields of a Protobuf message; a Timestamp becomes a dict with the fields of a ROS stamp."""
    if message.DESCRIPTOR.full_name == "google.protobuf.Timestamp":
        return {"sec": message.seconds, "nanosec": message.nanos}
    content: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields if depth < MAX_DEPTH else ():
        value = getattr(message, field.name)
        if field.message_type is None:
            many = not isinstance(value, int | float | str | bytes)
            content[field.name] = list(value)[:MAX_ELEMENTS] if many else value
        elif hasattr(value, "DESCRIPTOR"):
            content[field.name] = _fields(value, depth + 1)
    return content
