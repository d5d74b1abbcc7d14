"""ROS 1 bags and ROS 2 bags (sqlite3 or MCAP), read with rosbags, without a ROS installation."""

import bz2
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.readers.fields import columns_of
from sigmaswarm.importing.readers.messages import Message, message_log
from sigmaswarm.importing.source import (
    Limits,
    Log,
    Table,
    damage_error,
    errors_as_damage,
    first_bytes,
    import_library,
)

_FILES = (".bag", ".db3", ".mcap")


def recognizes(path: Path) -> bool:
    """Return True for a bag, by first bytes or suffix, and for a folder that contains metadata.yaml or bags."""
    if path.is_dir():
        return bool(bag_paths(path))
    return first_bytes(path, 9) == b"#ROSBAG V" or path.suffix in (".bag", ".db3")


def bag_paths(path: Path) -> list[Path]:
    """Return the paths for rosbags: a file, a folder with metadata, or the bags in a folder without metadata."""
    if path.is_file() or (path / "metadata.yaml").exists():
        return [path]
    return sorted(f for f in path.iterdir() if f.suffix in _FILES)


def open_log(path: Path, limits: Limits, stack: ExitStack, definitions: Sequence[Path] = ()) -> Log:
    """Open a bag. The .msg files ``definitions`` replace the bag's definitions or, if it has none, those of ROS 2."""
    anyreader = import_library("rosbags.highlevel", "ros")
    typesys = import_library("rosbags.typesys", "ros")
    paths = bag_paths(path)
    if not paths:
        raise InputError(
            f"{path}: contains no bag; specify the folder with metadata.yaml, or a .bag, .db3 or .mcap file"
        )
    with errors_as_damage(path):
        store = typesys.get_typestore(typesys.Stores.LATEST)
        reader = anyreader.AnyReader(paths, default_typestore=store)
        reader.open()
        stack.callback(reader.close)
        _define(reader, definitions, typesys)
        _bound_chunks(reader, limits, path)
    return _log(path, reader, limits)


def _define(reader: Any, definitions: Sequence[Path], typesys: Any) -> None:
    """Add the definitions in .msg files to those of a bag.

    A file defines the types of the bag with the same name as the file. If there are none, the folder that contains
    ``msg/`` names the package.
    """
    kinds = {c.msgtype for c in reader.connections}
    for given in definitions:
        files = sorted(given.rglob("*.msg")) if given.is_dir() else [given]
        if not files or not files[0].is_file():
            raise InputError(
                f"--msg {given}: there is no .msg file; specify a file, or the folder of a package"
            )
        for file in files:
            in_bag = [kind for kind in kinds if kind.rpartition("/")[2] == file.stem]
            package = file.resolve().parent.parent.name if file.resolve().parent.name == "msg" else "own"
            for kind in in_bag or [f"{package}/msg/{file.stem}"]:
                try:
                    types = typesys.get_types_from_msg(file.read_text("utf-8"), kind)
                except (OSError, UnicodeDecodeError, typesys.TypesysError, RecursionError) as error:
                    reason = " ".join(str(error).split())[:160]
                    raise InputError(
                        f"--msg {file}: can't be read as a definition ({reason}); correct this file"
                    ) from None
                new = {k: v for k, v in types.items() if k not in reader.typestore.fielddefs or k == kind}
                for name in new:
                    reader.typestore.fielddefs.pop(name, None)
                reader.typestore.register(new)


def _bound_chunks(reader: Any, limits: Limits, path: Path) -> None:
    lz4 = import_library("lz4.frame", "ros")
    streams = {bz2.decompress: bz2.BZ2Decompressor, lz4.decompress: lz4.LZ4FrameDecompressor}
    for bag in reader.readers:
        chunks = getattr(bag, "chunks", {})  # a ROS 2 bag has no chunks
        for place, chunk in chunks.items():
            if stream := streams.get(chunk.decompressor):
                chunks[place] = chunk._replace(decompressor=_bounded(stream, limits, path))


def _bounded(stream: Callable[[], Any], limits: Limits, path: Path) -> Callable[[bytes], bytes]:
    def unpack(packed: bytes) -> bytes:
        unpacking = stream()
        content = unpacking.decompress(packed, max_length=limits.unpacked_mb * 1_000_000 + 1)
        limits.check_unpacked(len(content), path)
        if not unpacking.eof:
            raise EOFError("a chunk ends too early")
        return content

    return unpack


def _first(reader: Any, topic: str) -> Any:
    connections = [c for c in reader.connections if c.topic == topic]
    for connection, _, raw in reader.messages(connections=connections):
        return reader.deserialize(raw, connection.msgtype)
    return None


def _log(path: Path, reader: Any, limits: Limits) -> Log:
    tables: dict[str, Table] = {}
    unread: list[str] = []
    try:
        topics = reader.topics
    except TypeError as error:  # the count of messages in metadata.yaml is not a number
        raise damage_error(
            path, error, "its metadata.yaml is damaged", "run `ros2 bag reindex` on it"
        ) from None
    for topic, info in topics.items():
        kind = info.msgtype or "several types"
        first = partial(_first, reader, topic)
        if columns := columns_of(reader.typestore, kind, limits, path, first):
            tables[topic] = Table(columns, kind, info.msgcount)
            limits = limits.less(len(columns))
        else:
            unread.append(f"{topic} ({kind}; pass its definition with --msg {kind.rpartition('/')[2]}.msg)")

    def stream(topics: Collection[str]) -> Iterator[Message]:
        wanted = [c for c in reader.connections if c.topic in topics]
        for connection, received, raw in reader.messages(connections=wanted) if wanted else ():
            if not isinstance(received, int):
                raise InputError(
                    f"{path}: a message of {connection.topic} has the receive time {received!r}, not a number; record "
                    "the bag again"
                )
            yield connection.topic, received, reader.deserialize(raw, connection.msgtype)

    return message_log(path, tables, stream, unread)
