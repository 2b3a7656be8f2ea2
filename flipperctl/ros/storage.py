"""The messages of a bag, of which each channel is read by itself.

In: an ``.mcap``, a ``.db3``, a folder of either, or a ``.bag`` of ROS 1. Out: its channels, and the
messages of some of them. A channel's encoding and the definition of its type matter only to who
reads its messages: recorders store events of services, JSON and Protobuf beside what is needed.
"""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from heapq import merge
from pathlib import Path, PurePath
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Schema
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from zstandard import ZstdError

from flipperctl.errors import RequestError
from flipperctl.ros.messages import typestore

METADATA = "metadata.yaml"
_END = b"\x89MCAP0\r\n"
_FORMATS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}
"""Encoding of a definition → its format; without one, the type is that of ROS 2 Jazzy."""
_IDL = "=" * 80 + "\n"
"""Line between the definitions of an IDL of several files."""
_DAMAGED = (
    *(ArithmeticError, AssertionError, EOFError, LookupError, MemoryError, OSError, RuntimeError),
    *(TypeError, ValueError, struct.error, sqlite3.Error, McapError, ZstdError),
    *(rosbag1.ReaderError, rosbag2.ReaderError, SerdeError, TypesysError),
)
"""What readers raise at bytes that make no sense."""


class Bag:
    """A bag that is open until ``stack`` closes."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        """Open the bag.

        Raises:
            RequestError: it cannot be read; so do the methods.
        """
        self._path, self._is_ros1 = path, path.suffix == ".bag"
        self._stores: dict[str, Any] = {}  # type → how its messages are read
        with self._named():
            storages = list(_storages(path, stack))
        self.connections: list[Connection] = [c for each in storages for c in each.connections]

    def messages(
        self, connections: Sequence[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording [ns] and bytes of messages, by time."""
        by_storage: dict[int, list[Connection]] = {}
        for connection in connections:
            by_storage.setdefault(id(connection.owner), []).append(connection)
        streams = [each[0].owner.messages(each) for each in by_storage.values()]  # type: ignore[attr-defined]  # storages
        with self._named():
            yield from merge(*streams, key=lambda message: message[1])

    def deserialize(self, data: bytes, msgtype: str) -> Any:
        """Return the message of a type that bytes hold."""
        with self._named(f": {msgtype}"):
            if msgtype not in self._stores:
                self._stores[msgtype] = self._store(msgtype)
            store = self._stores[msgtype]
            read = store.deserialize_ros1 if self._is_ros1 else store.deserialize_cdr
            return read(data, msgtype)

    def _store(self, msgtype: str) -> Any:
        """Return the types that a message consists of, by the bag's definition if it has one."""
        none = MessageDefinitionFormat.NONE
        has = (c for c in self.connections if c.msgtype == msgtype and c.msgdef.format != none)
        connection = next(has, None)
        if connection is None:
            return typestore()
        text, store = connection.msgdef.data, get_typestore(Stores.EMPTY)
        if connection.msgdef.format == MessageDefinitionFormat.MSG:
            store.register(get_types_from_msg(text, msgtype))
        else:
            # Of several files, each begins with a line of its name.
            several = text.startswith(f"{_IDL}IDL: ")
            files = (
                [file.partition("\n")[2] for file in text.split(_IDL)[1:]] if several else [text]
            )
            store.register({k: v for file in files for k, v in get_types_from_idl(file).items()})
        if digest := connection.digest:
            ros1 = self._is_ros1
            actual = store.generate_msgdef(msgtype)[1] if ros1 else store.hash_rihs01(msgtype)
            if actual != digest:
                raise ValueError(f"its definition has the digest {actual}; the bag states {digest}")
        return store

    @contextmanager
    def _named(self, what: str = "") -> Iterator[None]:
        try:
            yield
        except _DAMAGED as error:
            text = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise RequestError(f"{self._path} cannot be read as a bag{what}: {text}") from error


def _storages(path: Path, stack: ExitStack) -> Iterator[Any]:
    """Yield the files of a bag, open; each has ``connections`` and ``messages``."""
    if path.suffix == ".bag":
        yield stack.enter_context(rosbag1.Reader(path))
        return
    files = [path]
    if path.is_dir():
        import yaml

        content = yaml.safe_load((path / METADATA).read_text())
        try:
            information = content["rosbag2_bagfile_information"]
            files = [path / PurePath(file).name for file in information["relative_file_paths"]]
        except (KeyError, TypeError):
            raise ValueError(f"its {METADATA} names no files of a bag") from None
        if (information.get("compression_mode") or "none").lower() != "none":
            yield stack.enter_context(rosbag2.Reader(path))
            return
    for file in files:
        if (storage := STORAGES.get(file.suffix)) is None or file.suffix == ".bag":
            raise ValueError(f"{file.name} is none of {', '.join(STORAGES)}")
        yield storage(file, stack)


def _connection(
    storage: object,
    number: int,
    topic: str,
    kind: str,
    encoding: str,
    definition: tuple[str, str],
    digest: str = "",
) -> Connection:
    """Return a channel; the type of one that is not in CDR says so, and so is no other's.

    ``definition``: its encoding and text.
    """
    if encoding != "cdr":
        kind = f"{kind or 'a message'} in {encoding or 'no encoding'}"
    form = _FORMATS.get(definition[0], MessageDefinitionFormat.NONE)
    stated = MessageDefinition(
        form if definition[1] else MessageDefinitionFormat.NONE, definition[1]
    )
    extension = ConnectionExtRosbag2(encoding, [])
    return Connection(number, topic, kind, stated, digest, 0, extension, storage)


class _Mcap:
    """An ``.mcap``."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self._file = stack.enter_context(path.open("rb"))
        self._reader = make_reader(self._file)
        self._file.seek(-len(_END), 2)
        if self._file.read() != _END:
            raise ValueError(
                f"it is cut off, since it does not end as an MCAP does; 'mcap recover {path} "
                "-o whole.mcap' mends it"
            )
        summary = self._reader.get_summary()
        channels, schemas = ({}, {}) if summary is None else (summary.channels, summary.schemas)
        pairs = {c.id: (schemas.get(c.schema_id), c) for c in channels.values()}
        # A summary may leave out what its channels need; the file is then read from its start.
        self._is_indexed = bool(pairs) and all(s or not c.schema_id for s, c in pairs.values())
        if not self._is_indexed:
            pairs = {c.id: (s, c) for s, c, _ in self._all(None)}
        self.connections = [self._of(*pair) for pair in pairs.values()]

    def messages(
        self, connections: Sequence[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording [ns] and bytes, by time."""
        by_number = {c.id: c for c in connections}
        for _, channel, message in self._all({c.topic for c in connections}):
            if channel.id in by_number:
                yield by_number[channel.id], message.log_time, message.data

    def _all(self, topics: set[str] | None) -> Iterator[Any]:
        if self._is_indexed:
            return self._reader.iter_messages(topics)
        self._file.seek(0)
        return NonSeekingReader(self._file).iter_messages(topics)

    def _of(self, schema: Schema | None, channel: Channel) -> Connection:
        name, definition = ("", ("", "")) if schema is None else (schema.name, ("", ""))
        if schema is not None and schema.encoding in _FORMATS:
            definition = schema.encoding, schema.data.decode(errors="replace")
        encoding = channel.message_encoding
        return _connection(self, channel.id, channel.topic, name, encoding, definition)


class _Sqlite:
    """A ``.db3``."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        address = f"{path.resolve().as_uri()}?immutable=1"
        self._base = stack.enter_context(closing(sqlite3.connect(address, uri=True)))
        self._base.row_factory = sqlite3.Row
        self._base.text_factory = lambda text: text.decode(errors="replace")
        tables = {name for (name,) in self._base.execute("SELECT name FROM sqlite_master")}
        if not {"topics", "messages"} <= tables:
            raise ValueError("it has no tables of topics and messages")
        stated = {}
        if "message_definitions" in tables:  # since Iron
            for row in self._base.execute("SELECT * FROM message_definitions ORDER BY id"):
                stated[row["topic_type"]] = row["encoding"], row["encoded_message_definition"]
        self.connections = [
            _connection(
                *(self, row["id"], row["name"], row["type"], row["serialization_format"]),
                stated.get(row["type"], ("", "")),
                dict(row).get("type_description_hash", ""),
            )
            for row in self._base.execute("SELECT * FROM topics ORDER BY id")
        ]

    def messages(
        self, connections: Sequence[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording [ns] and bytes, by time."""
        by_number = {c.id: c for c in connections}
        rows = self._base.execute(
            "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN "
            "(SELECT value FROM json_each(?)) ORDER BY timestamp",
            (json.dumps([*by_number]),),
        )
        for number, time, data in rows:
            yield by_number[number], time, data


STORAGES: dict[str, Any] = {".mcap": _Mcap, ".db3": _Sqlite, ".bag": rosbag1.Reader}
"""Suffix of a bag's file → what reads it."""
