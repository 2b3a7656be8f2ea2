"""What an exported policy would have done on a robot's recording, as a log.

In: an exported policy and a bag. Out: a file of JSON lines, and how often each fault came.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from flipperctl.api import Sensor
from flipperctl.core.lidar.body import Mount
from flipperctl.errors import RequestError
from flipperctl.files import OutputKind, check_output, write_bytes
from flipperctl.ros.devices import Recording, read_recording
from flipperctl.ros.topics import Names
from flipperctl.runtime.messages import RobotSetup
from flipperctl.runtime.recordings import Shadow
from flipperctl.sim.lidar import LidarSensor

LOG = OutputKind(
    "a log", (".jsonl",), re.compile(rb'\A\{"time": [^\n]*"setpoints": [^\n]*"measured": ')
)
USED = (
    *("near", "filter_margin", "chassis_width", "overall_width"),
    *("pose", "range_bias", "tilt_wander", "tilt_noise"),
)
"""Settings of ``perception=lidar`` that the setup of a robot has too."""


def check_used(keys: Iterable[str]) -> None:
    """Check that the settings are those of a robot's setup, not of the policy's file.

    Raises:
        RequestError: a key is that of another setting.
    """
    allowed = [f"perception.{name}" for name in USED]
    for key in keys:
        if key not in allowed:
            raise RequestError(
                f"{key}: the policy's file states the robot and, after a training with a LiDAR, "
                f"the settings of its map, which are the default ones otherwise; "
                f"{', '.join(allowed)} are allowed"
            )


def shadow(
    policy: Path, source: Path, sensor: Sensor, pose: str | None, names: Names, log: Path
) -> dict[str, Any]:
    """Write what a policy would have done on a bag; return the numbers.

    ``sensor`` has the widths and errors of the robot, see ``USED``; ``pose`` is ``belts`` or
    ``matched``; None: ``belts``.

    Raises:
        MissingExtraError: rosbags is not installed, or small_gicp for matched scans.
        PolicyError: the file is no exported policy.
        RequestError: the bag cannot be used.
        OutputError: the log cannot be written, see ``check_output``.
    """
    assert isinstance(sensor, LidarSensor)
    check_output(log, LOG)
    if pose == "true":
        raise RequestError("perception.pose=true: no robot knows this; belts or matched is allowed")
    recording = read_recording(source, names)
    lines: list[str] = []
    decided = Shadow(policy, setup_of(recording, sensor, pose), lines.append)
    for step in recording.steps():
        decided.take(step.now, step.messages)
    write_bytes(log, "".join(f"{line}\n" for line in lines).encode())
    return {
        "policy": str(policy),
        "source": str(source),
        "output": str(log),
        "topics": recording.topics,
        **decided.summary(),
        "remarks": recording.remarks,
    }


def setup_of(recording: Recording, sensor: LidarSensor, pose: str | None) -> RobotSetup:
    """Return the devices of a recorded robot, with the widths and errors of ``sensor``."""
    x, _, z = recording.mount.place.tolist()
    return replace(
        recording.setup,
        mount=Mount(x, z, recording.axis, sensor.near, sensor.filter_margin),
        chassis_width=sensor.chassis_width,
        overall_width=sensor.overall_width,
        pose="matched" if pose == "matched" else "belts",
        range_bias=sensor.range_bias,
        tilt_error=math.hypot(sensor.tilt_wander, sensor.tilt_noise),
    )
