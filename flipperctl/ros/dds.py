"""Topics of ROS 2 over Cyclone DDS alone, without a ROS installation: experimental, x86_64.

Samples are the bytes that rosbags serialises; the types serve only to be recognised by other nodes.
Names, types and qualities are those of ROS 2: a topic ``/points`` is ``rt/points``, and a node is
listed by ``ros_discovery_info``. Kilted's Fast DDS ignores such writers unless its setting
``fastdds.type_propagation`` is ``disabled``.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

# Bytes go in and out by functions that the package does not document; the extra pins its version.
from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import (
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, make_idl_struct
from cyclonedds.idl import types as idl
from cyclonedds.pub import DataWriter, Publisher
from cyclonedds.sub import DataReader, Subscriber
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from flipperctl.ros.messages import typestore

_GRAPH, _NODES = "ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo"
_NUMBERS = {
    **{n: getattr(idl, n) for n in ("int8", "uint8", "int16", "uint16", "int32", "uint32")},
    **{n: getattr(idl, n) for n in ("int64", "uint64", "float32", "float64")},
    **{"bool": bool, "byte": idl.byte, "char": idl.uint8, "string": str},
}
_ANY = InstanceState.Any | ViewState.Any
_SPIN = 0.05
"""Time after which the thread looks whether it shall end [s]."""


class CycloneWire:
    """A node of ROS 2 on Cyclone DDS, whose messages arrive in a thread; see ``Wire``."""

    def __init__(self, name: str) -> None:
        self._types, self._kinds = typestore(), dict[str, Any]()
        domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
        self._participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        self._publisher, self._subscriber = (
            Publisher(self._participant),
            Subscriber(self._participant),
        )
        self._topics: dict[str, Any] = {}
        self._name, self._writers, self._readers = name, list[Any](), dict[Any, Any]()
        latched = self._quality(_NODES, reliable=True, depth=1, latched=True)
        self._graph = DataWriter(self._publisher, self._topic(_GRAPH, _NODES), qos=latched)
        self._waiting, self._ended = WaitSet(self._participant), threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def publisher(
        self, topic: str, kind: str, *, best_effort: bool = False, latched: bool = False
    ) -> Callable[[Any], None]:
        """See ``Wire``."""
        depth = 1 if latched else 1000
        quality = self._quality(kind, reliable=not best_effort, depth=depth, latched=latched)
        writer = DataWriter(self._publisher, self._topic(_ros(topic), kind), qos=quality)
        self._writers.append(writer)
        self._announce()
        return lambda message: self._write(writer, message, kind)

    def subscribe(
        self, topic: str, kind: str, receive: Callable[[Any], object], *, latched: bool = False
    ) -> None:
        """See ``Wire``; ``latched``: the last message before is received, too."""
        quality = self._quality(kind, reliable=True, depth=1000, latched=latched)
        reader = DataReader(self._subscriber, self._topic(_ros(topic), kind), qos=quality)
        condition = ReadCondition(reader, _ANY | SampleState.NotRead)
        self._waiting.attach(condition)
        self._readers[reader] = condition, kind, receive
        self._announce()

    def close(self) -> None:
        """See ``Wire``."""
        self._ended.set()
        self._thread.join()

    def _spin(self) -> None:
        while not self._ended.is_set():
            self._waiting.wait(duration(seconds=_SPIN))
            for reader, (_, kind, receive) in list(self._readers.items()):
                taken = ddspy_take(reader._ref, int(_ANY | SampleState.Any), 100)
                for data, info in () if isinstance(taken, int) else taken:
                    if info.valid_data:
                        receive(self._types.deserialize_cdr(data, kind))

    def _write(self, writer: Any, message: Any, kind: str) -> None:
        raw = bytes(self._types.serialize_cdr(message, kind))
        result = ddspy_write(writer._ref, raw.ljust((len(raw) + 3) & ~3, b"\0"))
        if result < 0:
            raise OSError(f"Cyclone DDS did not send a message of {kind}: error {result}")

    def _announce(self) -> None:
        """Tell the graph which topics this node has."""
        types = self._types.types

        def named(entity: Any) -> Any:
            data = np.frombuffer(entity.guid.bytes, np.uint8).copy()
            return types["rmw_dds_common/msg/Gid"](data=data)

        node = types["rmw_dds_common/msg/NodeEntitiesInfo"](
            node_namespace="/",
            node_name=self._name,
            reader_gid_seq=[named(reader) for reader in self._readers],
            writer_gid_seq=[named(writer) for writer in self._writers],
        )
        nodes = types[_NODES](gid=named(self._participant), node_entities_info_seq=[node])
        self._write(self._graph, nodes, _NODES)

    def _topic(self, name: str, kind: str) -> Any:
        if name not in self._topics:
            self._topics[name] = Topic(self._participant, name, self._kind(kind))
        return self._topics[name]

    def _quality(self, kind: str, *, reliable: bool, depth: int, latched: bool) -> Any:
        """Return the qualities that ROS 2 asks for."""
        trust, keeps = Policy.Reliability, Policy.Durability
        return Qos(
            trust.Reliable(duration(milliseconds=100)) if reliable else trust.BestEffort,
            Policy.History.KeepLast(depth),
            keeps.TransientLocal if latched else keeps.Volatile,
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"typehash={self._types.hash_rihs01(kind)};".encode()),
        )

    def _kind(self, ros: str) -> Any:
        """Return a type with ROS 2's name and fields."""
        if ros not in self._kinds:
            package, _, name = ros.split("/")
            fields = {field: self._part(node) for field, node in self._types.fielddefs[ros][1]}
            kind = make_idl_struct(f"{name}_", f"{package}::msg::dds_::{name}_", fields)
            assert issubclass(kind, IdlStruct)
            self._kinds[ros] = kind
        return self._kinds[ros]

    def _part(self, node: Any) -> Any:
        kind, about = node
        if kind.name == "BASE":
            return _NUMBERS[about[0]]
        if kind.name == "NAME":
            return self._kind(about)
        part, count = about
        each = self._part(part)
        of: Any = idl
        return of.array[each, count] if kind.name == "ARRAY" else of.sequence[each]


def _ros(topic: str) -> str:
    return f"rt/{topic.lstrip('/')}"
