"""Drives of an operator on a real robot: from a bag, the record that ``flipperctl drive`` makes.

In: a bag with clouds, an inertial unit, joints and belts, and who commanded if our node told it.
Out: a file of recorded episodes whose observations are those of the robot's own map and whose
actions are the closest ones to how the flippers turned; what can be measured without the ground.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl.api import Outcome, RecordedEpisode
from flipperctl.checkpoint import recording
from flipperctl.checkpoint.recording import PartialEnvironment
from flipperctl.config import EvalConfig, to_dict
from flipperctl.config.policy_file import drive_files
from flipperctl.core import observation as layout
from flipperctl.core.targets import angles_of
from flipperctl.env.drive import closest_action
from flipperctl.errors import RequestError
from flipperctl.policies.controllers import from_action
from flipperctl.ros.perceiving import Instant, replay
from flipperctl.ros.reading import messages, opened
from flipperctl.ros.recording import read_recording
from flipperctl.ros.topics import Names
from flipperctl.runtime.messages import Odometry
from flipperctl.text.files import check_output

FIELD = "field"
"""Name of the terrain and of the engine in the record, which no simulation has."""
_DIAGNOSES, _KIND = "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
_STANDS = 0.02
"""Speed of the belts below which they stand [m/s]."""
_LATE = 1.5
"""Decision periods between two decisions of one drive, at most [-]."""


@dataclass(frozen=True)
class _Motion:
    """Who drove when; times since the first message [s]."""

    speeds: Sequence[tuple[float, float]]
    """Time and speed of the belts [m/s]."""
    commanded: Sequence[tuple[float, str]] | None
    """Time and who commands from then on; None: the bag does not say."""

    def by_operator(self, time: float) -> bool:
        """Return whether an operator drove at a time."""
        if self.commanded is None:
            return True
        return next((who for when, who in reversed(self.commanded) if when <= time), "") == (
            "operator"
        )

    def moved(self, first: float, last: float) -> bool:
        """Return whether the belts ran between two times."""
        return any(first <= when <= last and abs(v) >= _STANDS for when, v in self.speeds)


def field_drive(
    bag: Path, config: EvalConfig, names: Names, folder: Path, driver: str, outcome: Outcome
) -> dict[str, Any]:
    """Write the drives of a bag to a new file in ``folder``; return what was measured of each.

    ``config`` has the robot and its LiDAR, ``driver`` says who drove, as in ``person: anna``, and
    ``outcome`` how the last drive ended; those before it were interrupted.

    Raises:
        RequestError: no operator drove for two decisions, or ``folder`` has drives of another one.
    """
    file = folder / f"drive_{FIELD}_{bag.stem}.safetensors"
    if folder.exists():  # otherwise it is made
        check_output(file, recording.KIND)
    for other in drive_files(folder):
        if (who := recording.read(other).document.driver) != driver:
            raise RequestError(f"--output {folder}: it holds drives of {who!r}, not of {driver!r}")

    # What the robot knew at each decision, and who drove meanwhile
    played = replay(bag, config.perception, config.robot, None, names)
    motion = _motion(bag, names)
    stretches = list(_stretches(played.instants, motion, config.robot.decision_period))
    if not stretches:
        who = "an operator" if motion.commanded is not None else "anybody"
        raise RequestError(f"{bag}: the belts never ran for two decisions that {who} commanded")
    outcomes = [Outcome.TIMEOUT] * (len(stretches) - 1) + [outcome]
    episodes = [
        _episode(number, stretch, config, end)
        for number, (stretch, end) in enumerate(zip(stretches, outcomes, strict=True))
    ]

    # Neither the ground nor an engine are known, and no reward can be computed.
    plain = to_dict(config.environment()) | {"rewards": {}}
    plain |= {"terrain": {"name": FIELD, "bag": str(bag)}, "sim": {"name": FIELD}}
    folder.mkdir(parents=True, exist_ok=True)
    recording.write(file, driver, [(PartialEnvironment.model_validate(plain), episodes)])
    return {
        "source": str(bag),
        "output": str(file),
        "driver": driver,
        "topics": played.summary["topics"],
        "seconds": played.summary["seconds"],
        "drives": [
            _measures(stretch, motion) | {"outcome": str(end)}
            for stretch, end in zip(stretches, outcomes, strict=True)
        ],
        "checks": played.summary["checks"],
        "remarks": played.summary["remarks"],
    }


def _motion(bag: Path, names: Names) -> _Motion:
    recorded = read_recording(bag, names)
    speeds, begun = [], None
    for step in recorded.steps():
        begun = step.now if begun is None else begun
        belts = step.messages.get("odometry")
        if isinstance(belts, Odometry):
            speeds.append((step.now - begun, belts.speed))
    if not speeds:
        raise RequestError(f"{bag}: no speed of the belts tells when the robot drove")

    # Who commanded, by the diagnostics of our node
    sources = []
    with opened(bag) as reader:
        if any(c.topic == _DIAGNOSES and c.msgtype == _KIND for c in reader.connections):
            for _, received, message in messages(reader, [_DIAGNOSES]):
                stamp = message.header.stamp
                now = stamp.sec + 1e-9 * stamp.nanosec if recorded.checked.by_stamps else received
                for status in message.status:
                    values = {value.key: value.value for value in status.values}
                    if "commands" in values:
                        sources.append((now - (begun or 0.0), values["commands"]))
    return _Motion(speeds, sources or None)


def _stretches(
    instants: Sequence[Instant], motion: _Motion, period: float
) -> Iterator[Sequence[Instant]]:
    """Yield the decisions of each drive: from the first to the last motion by an operator."""
    drive: list[Instant] = []
    for instant in instants:
        by_operator = motion.by_operator(instant.time)
        late = bool(drive) and instant.time - drive[-1].time > _LATE * period
        if late or not by_operator:
            yield from _trimmed(drive, motion)
            drive = []
        if by_operator:
            drive.append(instant)
    yield from _trimmed(drive, motion)


def _trimmed(drive: Sequence[Instant], motion: _Motion) -> Iterator[Sequence[Instant]]:
    """Yield a drive without the time before and after the belts ran; none if it is too short."""
    ran = [motion.moved(a.time, b.time) for a, b in pairwise(drive)]
    if ran.count(True) > 1:
        yield drive[ran.index(True) : len(ran) + 1 - ran[::-1].index(True)]


def _episode(
    number: int, stretch: Sequence[Instant], config: EvalConfig, outcome: Outcome
) -> RecordedEpisode:
    robot, actions = config.robot, []
    followed = angles_of(stretch[0].angles)
    for instant in stretch[1:]:
        turned = angles_of(instant.angles)
        action, followed = closest_action(followed, turned, robot.angle_step, robot.angle_limit)
        actions.append(action)
    observations = [
        layout.assemble(
            instant.ground.heights,
            angles_of(instant.angles),
            pitch=instant.angles.pitch,
            roll=instant.angles.roll if config.perception.sides else None,
        )
        for instant in stretch
        if instant.ground.heights is not None  # of a map they always are
    ]
    return RecordedEpisode(
        number=number,
        seed=0,  # no ground was drawn
        terrain=FIELD,
        outcome=outcome,
        observations=np.array(observations, np.float32),
        actions=np.array(actions, np.int64),
        rewards=np.zeros(len(actions)),
        labels=np.array([from_action(action, len(followed)) for action in actions], np.float32),
    )


def _measures(stretch: Sequence[Instant], motion: _Motion) -> dict[str, Any]:
    """Return what can be told of a drive without its ground; see ``flipperctl list measures``."""
    first, last = stretch[0].time, stretch[-1].time
    pitches = np.array([instant.angles.pitch for instant in stretch])
    flippers = np.array([(instant.angles.front, instant.angles.rear) for instant in stretch])
    ran = [(when, speed) for when, speed in motion.speeds if first <= when <= last]
    spans = [(b[0] - a[0], a[1]) for a, b in pairwise(ran)]
    total = math.fsum(span for span, _ in spans) or math.nan
    stood = math.fsum(span for span, speed in spans if abs(speed) < _STANDS) / total
    seen = [instant.ground.seen for instant in stretch if instant.ground.seen is not None]
    return {
        "start": first,
        "t_cost": last - first,
        "decisions": len(stretch) - 1,
        "pitch_variation": float(np.abs(np.diff(pitches)).sum()),
        "max_pitch": float(np.abs(pitches).max()),
        "flipper_travel": float(np.abs(np.diff(flippers, axis=0)).sum()),
        "belts_stood": stood,
        "way_of_belts": math.fsum(span * speed for span, speed in spans),
        "seen": float(np.mean(seen)),
        "held": sum(bool(instant.held) for instant in stretch),
    }
