"""Reads the messages of a bag, each channel by itself.

In: an ``.mcap``, a ``.db3``, a folder of either, or a ``.bag`` of ROS 1. Out: its channels, and the
messages of some of them. A channel's encoding and the definition of its type matter only to who
reads its messages: recorders store events of services, JSON and Protobuf beside what is needed.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from heapq import merge
from pathlib import Path, PurePath
from typing import Any

from mcap.reader import NonSeekingReader, make_reader
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

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
_Messages = Iterator[tuple[Connection, int, bytes]]
"""Connection, time of recording [ns] and bytes of messages, by time."""
_Storage = tuple[list[Connection], Callable[[Sequence[Connection]], _Messages]]
"""The channels of a file, and what reads some of them."""


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
            self._storages = list(_storages(path, stack))
        self.connections = [c for channels, _ in self._storages for c in channels]

    def messages(self, connections: Sequence[Connection]) -> _Messages:
        """Yield connection, time of recording [ns] and bytes of messages, by time."""
        parts = [([c for c in channels if c in connections], r) for channels, r in self._storages]
        with self._named():
            yield from merge(*(read(part) for part, read in parts if part), key=lambda row: row[1])

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
        channels = [c for c in self.connections if c.msgtype == msgtype and c.msgdef.data]
        if not channels:
            return typestore()
        # The bag's own definition, since a type may have changed since it was recorded
        text, store = channels[0].msgdef.data, get_typestore(Stores.EMPTY)
        if channels[0].msgdef.format == MessageDefinitionFormat.MSG:
            store.register(get_types_from_msg(text, msgtype))
        else:  # of several files, each begins with a line of its name
            several = text.startswith(f"{_IDL}IDL: ")
            files = [f.partition("\n")[2] for f in text.split(_IDL)[1:]] if several else [text]
            store.register({k: v for file in files for k, v in get_types_from_idl(file).items()})

        # A definition that is not of the recorded type would give wrong numbers.
        stated, ros1 = channels[0].digest, self._is_ros1
        actual = store.generate_msgdef(msgtype)[1] if ros1 else store.hash_rihs01(msgtype)
        if stated not in ("", actual):
            raise ValueError(f"its definition has the digest {actual}; the bag states {stated}")
        return store

    @contextmanager
    def _named(self, what: str = "") -> Iterator[None]:
        try:
            yield
        except Exception as error:  # each reader has its own errors for damaged bytes
            text = " ".join(str(error).split()).rstrip(".") or type(error).__name__
            raise RequestError(f"{self._path} cannot be read as a bag{what}: {text}") from error


def _storages(path: Path, stack: ExitStack) -> Iterator[_Storage]:
    """Yield the files of a bag, open."""
    files = [path]
    whole: Any = rosbag1.Reader if path.suffix == ".bag" else None
    if path.is_dir():
        import yaml

        # A folder names its files; compressed ones are read by rosbags.
        content = yaml.safe_load((path / METADATA).read_text())
        try:
            information = content["rosbag2_bagfile_information"]
            files = [path / PurePath(file).name for file in information["relative_file_paths"]]
        except (KeyError, TypeError):
            raise ValueError(f"its {METADATA} names no files of a bag") from None
        if (information.get("compression_mode") or "none").lower() != "none":
            whole = rosbag2.Reader
    if whole is not None:
        reader = stack.enter_context(whole(path))
        yield reader.connections, reader.messages
        return
    for file in files:
        if file.suffix not in _OPENED:
            raise ValueError(f"{file.name} is none of {', '.join(STORAGES)}")
        yield _OPENED[file.suffix](file, stack)


def _connection(
    file: Path, number: int, topic: str, kind: str, encoding: str, form: str, text: str, digest: str
) -> Connection:
    """Return a channel; the type of one that is not in CDR says so, and so is no other's.

    ``form``: the encoding of its definition, the ``text``.
    """
    if encoding != "cdr":
        kind = f"{kind or 'a message'} in {encoding or 'no encoding'}"
    known = form in _FORMATS and bool(text)
    stated = MessageDefinition(
        _FORMATS[form] if known else MessageDefinitionFormat.NONE, text if known else ""
    )
    return Connection(
        number, topic, kind, stated, digest, 0, ConnectionExtRosbag2(encoding, []), file
    )


def _mcap(path: Path, stack: ExitStack) -> _Storage:
    file = stack.enter_context(path.open("rb"))
    reader = make_reader(file)
    file.seek(-len(_END), 2)
    if file.read() != _END:
        raise ValueError(
            f"it is cut off, since it does not end as an MCAP does; 'mcap recover {path} "
            "-o whole.mcap' mends it"
        )
    # The summary lists the channels without a reading of the whole file.
    summary = reader.get_summary()
    channels, schemas = ({}, {}) if summary is None else (summary.channels, summary.schemas)
    pairs = {c.id: (schemas.get(c.schema_id), c) for c in channels.values()}
    # A summary may leave out what its channels need; the file is then read from its start.
    is_indexed = bool(pairs) and all(s or not c.schema_id for s, c in pairs.values())

    def messages(topics: set[str] | None) -> Iterator[Any]:
        if is_indexed:
            return reader.iter_messages(topics)
        file.seek(0)
        return NonSeekingReader(file).iter_messages(topics)

    def read(connections: Sequence[Connection]) -> _Messages:
        by_number = {c.id: c for c in connections}
        for _, channel, message in messages({c.topic for c in connections}):
            if channel.id in by_number:
                yield by_number[channel.id], message.log_time, message.data

    if not is_indexed:
        pairs = {c.id: (s, c) for s, c, _ in messages(None)}

    # Channels with the definitions of their types
    stated = {
        number: (s.name, s.encoding, s.data.decode(errors="replace")) if s else ("", "", "")
        for number, (s, _) in pairs.items()
    }
    return [
        _connection(path, c.id, c.topic, stated[c.id][0], c.message_encoding, *stated[c.id][1:], "")
        for _, c in pairs.values()
    ], read


def _sqlite(path: Path, stack: ExitStack) -> _Storage:
    address = f"{path.resolve().as_uri()}?immutable=1"
    base = stack.enter_context(closing(sqlite3.connect(address, uri=True)))
    # Broken bytes in a text of no interest shall not stop the reading.
    base.text_factory = lambda text: text.decode(errors="replace")
    base.row_factory = sqlite3.Row
    stated = {}
    if list(base.execute("PRAGMA table_info(message_definitions)")):  # since Iron
        for row in base.execute("SELECT * FROM message_definitions ORDER BY id"):
            stated[row["topic_type"]] = row["encoding"], row["encoded_message_definition"]

    def read(connections: Sequence[Connection]) -> _Messages:
        by_number = {c.id: c for c in connections}
        rows = base.execute(
            "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN "
            "(SELECT value FROM json_each(?)) ORDER BY timestamp",
            (json.dumps([*by_number]),),
        )
        for number, time, data in rows:
            yield by_number[number], time, data

    # Channels by their topics, with their types' definitions since Iron
    channels = []
    for row in map(dict, base.execute("SELECT * FROM topics ORDER BY id")):
        encoding, digest = row["serialization_format"], row.get("type_description_hash", "")
        definition = *stated.get(row["type"], ("", "")), digest
        channels.append(
            _connection(path, row["id"], row["name"], row["type"], encoding, *definition)
        )
    return channels, read


_OPENED = {".mcap": _mcap, ".db3": _sqlite}
STORAGES = (*_OPENED, ".bag")
"""Suffixes of the files of a bag."""
