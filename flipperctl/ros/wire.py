"""Topics of ROS 2 for this process: bytes of messages out and in, over rclpy or over DDS alone.

Messages are those of rosbags; both ways carry them as serialised bytes. rclpy is used where it can
be imported. Without it, the extra ``dds`` (Cyclone DDS, x86_64) does, which is experimental.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from importlib import import_module
from typing import Any, Protocol

from flipperctl.errors import MissingExtraError
from flipperctl.ros.messages import typestore

Receive = Callable[[Any], object]
_SPIN = 0.05
"""Time after which a thread that waits for messages looks whether it shall end [s]."""


class Wire(Protocol):
    """A node of ROS 2."""

    def publisher(
        self, topic: str, kind: str, *, best_effort: bool = False, latched: bool = False
    ) -> Callable[[Any], None] | None:
        """Return what publishes a message of rosbags; None if the type is not installed.

        ``kind``: its type, as ``std_msgs/msg/Bool``; ``latched``: the last one is kept for later
        subscribers.
        """

    def subscribe(self, topic: str, kind: str, receive: Receive) -> None:
        """Call ``receive`` with each message, in a thread of its own."""

    def close(self) -> None:
        """End the node."""


def open_wire(name: str) -> Wire:
    """Return a node called ``name``.

    Raises:
        MissingExtraError: neither rclpy nor the extra ``dds`` is there.
    """
    try:
        import rclpy  # noqa: F401
    except ImportError:
        pass
    else:
        return _Rclpy(name)
    try:
        import cyclonedds  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            "topics of ROS 2 need rclpy, as of a sourced ROS 2 installation, or Cyclone DDS: run "
            "pip install 'flipperctl[ros,dds]'"
        ) from error
    from flipperctl.ros.dds import CycloneWire

    wire: Wire = CycloneWire(name)
    return wire


class _Rclpy:
    """A node of rclpy, which spins in a thread."""

    def __init__(self, name: str) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        self._types = typestore()
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node(name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._ended.is_set():
            self._executor.spin_once(_SPIN)

    def publisher(
        self, topic: str, kind: str, *, best_effort: bool = False, latched: bool = False
    ) -> Callable[[Any], None] | None:
        """See ``Wire``."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        try:
            message = self._class(kind)
        except ImportError:
            return None
        profile = QoSProfile(depth=1 if latched else 1000)
        if best_effort:
            profile.reliability = ReliabilityPolicy.BEST_EFFORT
        if latched:
            profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
        publisher = self._node.create_publisher(message, topic, profile)
        return lambda sent: publisher.publish(bytes(self._types.serialize_cdr(sent, kind)))

    def subscribe(self, topic: str, kind: str, receive: Receive) -> None:
        """See ``Wire``."""

        def take(data: bytes) -> None:
            receive(self._types.deserialize_cdr(data, kind))

        self._node.create_subscription(self._class(kind), topic, take, 1000, raw=True)

    def close(self) -> None:
        """See ``Wire``."""
        self._ended.set()
        self._thread.join()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _class(self, kind: str) -> Any:
        package, _, name = kind.split("/")
        return getattr(import_module(f"{package}.msg"), name)
