"""Bags beside whose needed messages recorders wrote what no one here can read."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from flipperctl.api import RobotState
from flipperctl.errors import RequestError
from flipperctl.ros.episode import BELTS, Stamped, write_bag
from flipperctl.ros.messages import Messages
from flipperctl.ros.reading import messages, opened

TWIST = "std_msgs/msg/Float64"
EVENT = """service_msgs/ServiceEventInfo info
a_msgs/srv/Set_Request[<=1] request
================================================================================
SRV: a_msgs/srv/Set
bool data
---
bool success
"""
STRANGE = {
    "an event of a service": ("a_msgs/srv/Set_Event", "ros2msg", EVENT.encode(), "cdr"),
    "JSON": ("foxglove.Log", "jsonschema", b'{"type": "object"}', "json"),
    "Protobuf": ("foxglove.Log", "protobuf", b"\x0a\xf3\xff\x01\x80", "protobuf"),
    "ROS 1": ("tf2_msgs/TFMessage", "ros1msg", b"Header header", "ros1"),
    "a type of ours in JSON": (TWIST, "jsonschema", b"{}", "json"),
    "an unknown definition": ("a_msgs/msg/A", "unknown", b"", "cdr"),
    "text that is none": ("a_msgs/msg/A", "ros2idl", b"\xff\xfe", "cdr"),
}
WRITERS = {
    "as recorded": {},
    "without an index": {"use_chunking": False},
    "without channels in the summary": {"repeat_channels": False},
    "without schemas in the summary": {"repeat_schemas": False},
    "without a summary": {"use_summary_offsets": False, "use_statistics": False},
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    make, still = Messages(), np.zeros(2)
    stamped = [
        stamp
        for time in np.arange(0, 2, 0.25).tolist()
        for stamp in (
            Stamped(time, "/tf", make.transforms(RobotState(still, 0, 0, 0, still, 0, time))),
            Stamped(time, BELTS, make.number(time)),
        )
    ]
    folder = tmp_path_factory.mktemp("bags") / "drive"
    write_bag(folder, stamped)
    return folder


def rewritten(bag: Path, file: Path, strange: tuple[str, str, bytes, str], **options) -> None:
    """Write the bag's file anew, with a channel of this type, definition and encoding first."""
    name, kind, definition, encoding = strange
    with (bag / "drive.mcap").open("rb") as source, file.open("wb") as target:
        writer = Writer(target, **options)
        writer.start(profile="", library="")
        schema = writer.register_schema(name, kind, definition)
        channel = writer.register_channel("/strange", encoding, schema)
        writer.add_message(channel, 10**18, b"\0\1\0\0" + bytes(8), 10**18)
        channels = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                topic = channel.topic, channel.message_encoding
                channels[channel.id] = writer.register_channel(*topic, schema_id)
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time
            )
        writer.finish()


def content(path: Path) -> list[tuple[str, float, float]]:
    """Return topic, time and the number, or the place, of the messages that are needed."""
    kinds = TWIST, "tf2_msgs/msg/TFMessage"
    with opened(path) as reader:
        return [
            (topic, time, getattr(message, "data", None) or len(message.transforms))
            for topic, time, message in messages(reader, kinds=kinds)
            if topic == "/tf" or message.data
        ]


@pytest.mark.parametrize("strange", STRANGE)
def test_a_channel_that_is_not_needed_does_no_harm(bag, tmp_path, strange) -> None:
    rewritten(bag, tmp_path / "more.mcap", STRANGE[strange])
    assert content(tmp_path / "more.mcap") == content(bag)
    (tmp_path / "folder").mkdir()
    (tmp_path / "more.mcap").rename(tmp_path / "folder" / "drive.mcap")
    metadata = (bag / "metadata.yaml").read_text()
    (tmp_path / "folder" / "metadata.yaml").write_text(metadata)
    assert len(content(tmp_path / "folder")) == 15


@pytest.mark.parametrize("options", WRITERS)
def test_an_mcap_may_leave_out_its_index(bag, tmp_path, options) -> None:
    rewritten(bag, tmp_path / "more.mcap", STRANGE["Protobuf"], **WRITERS[options])
    assert content(tmp_path / "more.mcap") == content(bag)


def test_a_definition_that_is_needed_is_named(bag, tmp_path) -> None:
    rewritten(bag, tmp_path / "more.mcap", STRANGE["an event of a service"])
    with (
        opened(tmp_path / "more.mcap") as reader,
        pytest.raises(RequestError, match=r"as a bag: a_msgs/srv/Set_Event: Could not parse") as no,
    ):
        list(messages(reader, ["/strange"]))
    assert "recover" not in str(no.value)
    rewritten(bag, tmp_path / "json.mcap", STRANGE["a type of ours in JSON"])
    with opened(tmp_path / "json.mcap") as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
    assert kinds["/strange"] == "std_msgs/msg/Float64 in json"


def numbers(writer, path: Path, stores: Stores, serialize: str, **more) -> None:
    """Write three numbers on /belts, and three on a topic of a type of one's own."""
    store = get_typestore(stores)
    with writer(path, **more) as file:
        own = file.add_connection("/strange", "a_msgs/msg/A", msgdef="uint8 a", **DIGEST[serialize])
        belts = file.add_connection(BELTS, TWIST, typestore=store)
        for time in (1, 2, 3):
            message = store.types[TWIST](float(time))
            file.write(own, time * 10**9, bytes(8))
            file.write(belts, time * 10**9, getattr(store, serialize)(message, TWIST))


DIGEST = {
    "serialize_cdr": {"rihs01": "RIHS01_" + "0" * 64},
    "serialize_ros1": {"md5sum": "0" * 32},
}


def test_other_storages_read_each_channel_by_itself_as_well(tmp_path) -> None:
    more = {"version": 9, "storage_plugin": rosbag2.StoragePlugin.SQLITE3}
    numbers(rosbag2.Writer, tmp_path / "two", Stores.ROS2_JAZZY, "serialize_cdr", **more)
    numbers(rosbag1.Writer, tmp_path / "one.bag", Stores.ROS1_NOETIC, "serialize_ros1")
    (file,) = (tmp_path / "two").glob("*.db3")
    expected = [(BELTS, float(time), float(time)) for time in (1, 2, 3)]
    for path in (tmp_path / "two", file, tmp_path / "one.bag"):
        assert content(path) == expected
        with (
            opened(path) as reader,
            pytest.raises(RequestError, match=r"a_msgs/msg/A: its definition has the digest"),
        ):
            list(messages(reader, ["/strange"]))
    base = sqlite3.connect(file)  # as rosbag2 writes a type whose definition it does not find
    base.execute(
        "UPDATE message_definitions SET encoding = 'unknown', encoded_message_definition = '' "
        "WHERE topic_type = 'a_msgs/msg/A'"
    )
    base.commit()
    base.close()
    assert content(file) == expected
