"""Copies the messages of a ROS 2 bag unchanged into the bag of an estimate."""

import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sigmaswarm.errors import InputError, SigmaswarmWarning
from sigmaswarm.importing.readers.ros import bag_paths
from sigmaswarm.importing.source import broken, library

RawMessage = tuple[int, Any, Any]
"""Time in ns, rosbags' connection of the bag that is written, and the message's bytes."""


@dataclass(frozen=True)
class Recording:
    """An open bag, read by rosbags.

    Attributes
    ----------
    path : Path
    reader : rosbags.highlevel.AnyReader
    """

    path: Path
    reader: Any

    @property
    def topics(self) -> set[str]:
        """The topics that it has."""
        return set(self.reader.topics)

    def require_span(self, first: int, last: int) -> None:
        """Refuse a bag that was recorded at another time than ``first`` to ``last``, ns.

        Raises
        ------
        InputError
        """
        begin, end = self.reader.start_time, self.reader.end_time
        if last < begin or first > end:
            raise InputError(
                f"{self.path}: covers {begin / 1e9:.3f} to {end / 1e9:.3f} s, the estimate {first / 1e9:.3f} to "
                f"{last / 1e9:.3f} s; name the bag that the drive was imported from"
            )

    def add_to(self, writer: Any) -> Iterator[RawMessage]:
        """Add its topics to a bag that is written; gives its messages by time, read as they are asked for.

        Warns
        -----
        SigmaswarmWarning
            For a topic whose type neither the bag nor the latest ROS defines; it is omitted.
        """
        added: dict[tuple[str, str], Any] = {}
        for old in self.reader.connections:
            kind = old.topic, old.msgtype
            if kind in added:  # a bag in several files
                continue
            if old.msgtype not in self.reader.typestore.fielddefs:
                warnings.warn(
                    f"{self.path}: {old.topic} left out: nothing defines its type {old.msgtype}",
                    SigmaswarmWarning,
                    stacklevel=2,
                )
                continue
            own = {"msgdef": old.msgdef.data, "rihs01": old.digest} if old.msgdef.data and old.digest else {}
            added[kind] = writer.add_connection(
                *kind,
                typestore=self.reader.typestore,
                serialization_format=old.ext.serialization_format,
                offered_qos_profiles=old.ext.offered_qos_profiles,
                **own,
            )
        return self._messages(added)

    def _messages(self, added: dict[tuple[str, str], Any]) -> Iterator[RawMessage]:
        wanted = [c for c in self.reader.connections if (c.topic, c.msgtype) in added]
        try:
            for old, time, raw in self.reader.messages(connections=wanted) if wanted else ():
                yield time, added[old.topic, old.msgtype], raw
        except Exception as error:  # the library raises anything on damaged bytes
            raise broken(self.path, error) from None


@contextmanager
def recording(path: Path) -> Generator[Recording]:
    """Open a ROS 2 bag: a folder, or a .db3 or .mcap file.

    Raises
    ------
    InputError
        If it is none, is damaged, or rosbags is not installed.
    """
    highlevel, typesys = library("rosbags.highlevel", "ros"), library("rosbags.typesys", "ros")
    if not path.exists():
        raise InputError(f"{path}: no such bag; name the one that the drive was imported from")
    paths = bag_paths(path)
    if not paths:
        raise InputError(f"{path}: holds no bag; name the folder with metadata.yaml, or a .db3 or .mcap file")
    if paths[0].suffix == ".bag":
        raise InputError(
            f"{path}: is a ROS 1 bag, whose messages ROS 2 reads only when they are rewritten; convert it first: "
            f"rosbags-convert --src {path} --dst {path.with_suffix('')}"
        )
    try:
        reader = highlevel.AnyReader(paths, default_typestore=typesys.get_typestore(typesys.Stores.LATEST))
        reader.open()
    except Exception as error:  # the library raises anything on damaged bytes
        if "rofile" in str(error):
            raise InputError(
                f"{path}: is an MCAP file that ROS 2 did not write; its messages have no place in a ROS 2 bag, so "
                "leave --beside out"
            ) from None
        raise broken(path, error) from None
    try:
        yield Recording(path, reader)
    finally:
        reader.close()
