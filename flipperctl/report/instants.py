"""The robot's states during an episode at equal intervals, for films and curves.

In: the transitions of an episode in order. Out: states between those of its decisions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from flipperctl.api import RobotState, Transition


def instants(transitions: Sequence[Transition], period: float) -> Iterator[RobotState]:
    """Yield the robot's state at the start, every ``period`` [s], and at the end.

    Velocities are those at the start of the decision, since poses have none. Of a decision without
    poses, only its start is known.

    Raises:
        ValueError: there are no transitions.
    """
    if not transitions:
        raise ValueError("an episode has at least one transition")
    due = transitions[0].before.time
    for t in transitions:
        if not len(t.path):
            yield t.before
            due = t.after.time
        for index, (x, z, pitch) in enumerate(t.path[:-1].tolist()):
            time = t.before.time + index * t.sample_period
            if time < due - t.sample_period / 2:
                continue
            front, rear = t.flippers[index].tolist()
            due += period
            place = np.array([x, z])
            yield replace(t.before, position=place, pitch=pitch, front=front, rear=rear, time=time)
    yield transitions[-1].after


def samples(transitions: Sequence[Transition]) -> list[RobotState]:
    """Return every state whose pose is known, at which θ̂_R at 100 Hz is measured."""
    return list(instants(transitions, transitions[0].sample_period))
