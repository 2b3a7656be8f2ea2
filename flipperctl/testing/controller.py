"""What a controller must keep to while it drives."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from statistics import median
from time import perf_counter

from flipperctl.api import ACTIONS, Controller, Perception, Plugin, Simulator
from flipperctl.rollout.episode import decisions
from flipperctl.testing.check import require
from flipperctl.testing.recorded import SCENES, SHORT, Scene

DECISIONS = 20
"""On each scene, or fewer where the episode ends before."""


def actions(controller: Controller) -> None:
    """Every answer is an index into ``ACTIONS``."""
    for index in range(len(_scenes(controller))):
        _drive(controller, index)


def repeats(controller: Controller) -> None:
    """Equal episodes give equal actions; what is drawn at random is drawn from ``p.rng``."""
    for index in range(len(_scenes(controller))):
        (one, _), (other, _) = (_drive(controller, index) for _ in range(2))
        require(
            one == other,
            f"two equal episodes on scene {index} get unequal actions; "
            "it may depend on nothing but what it perceives, and draw only from p.rng",
        )


def in_time(controller: Controller) -> None:
    """A decision is made before the next one is due, at the median; a search before it is free."""
    period = SCENES[0].environment().robot.decision_period
    taken = [t for index in range(len(_scenes(controller))) for t in _drive(controller, index)[1]]
    require(
        median(taken) <= period,
        f"a decision takes it {median(taken):.2f} s at the median; "
        f"the next one is due after {period:g} s",
    )


def looks_ahead(cls: type[Plugin]) -> bool:
    """Whether it searches the scene before an episode, which may take it long."""
    return issubclass(cls, Controller) and cls.searches_first


def _scenes(controller: Controller) -> Sequence[Scene]:
    return (SHORT,) if looks_ahead(type(controller)) else SCENES


def _drive(controller: Controller, scene: int) -> tuple[list[int], list[float]]:
    """What it answers, and the time that each answer took [s]."""
    env = _scenes(controller)[scene].environment()
    watched = _Watched(controller, scene)
    for _ in islice(decisions(env, watched, scene), DECISIONS):
        pass
    return watched.answers, watched.taken


class _Watched:
    """A controller's policy whose answers are checked and timed."""

    def __init__(self, controller: Controller, scene: int) -> None:
        self._policy, self._scene = controller.build(), scene
        self.answers: list[int] = []
        self.taken: list[float] = []  # [s]

    def reset(self, simulator: Simulator) -> None:
        """Begin the policy's episode."""
        self._policy.reset(simulator)

    def act(self, p: Perception) -> int:
        """Return the policy's answer."""
        begun = perf_counter()
        action = self._policy.act(p)
        self.taken.append(perf_counter() - begun)
        require(
            isinstance(action, int) and action in range(len(ACTIONS)),
            f"act returned {action!r} at decision {len(self.answers)} of scene {self._scene}; "
            f"an int from 0 to {len(ACTIONS) - 1} is allowed",
        )
        self.answers.append(action)
        return action
