"""Checks of a controller in episodes: valid, repeatable and timely actions."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from statistics import median
from time import perf_counter, process_time

from flipperctl.api import ACTIONS, Controller, Perception, Plugin, Simulator
from flipperctl.config import EnvConfig
from flipperctl.rollout.episode import decisions
from flipperctl.testing.check import require
from flipperctl.testing.recorded import SCENES, SHORT, Scene

DECISIONS = 20
"""Largest number of decisions on each scene; an episode may end earlier [-]."""
ENOUGH = 0.1
"""Computing time on a scene, or at one variant of the settings, after which it is left [s]."""


def actions(controller: Controller) -> None:
    """Check that every action is an index into ``ACTIONS``.

    A controller that is slow at its outermost settings plays fewer scenes; ``repeats`` plays all.
    """
    begun = process_time()
    for index in range(len(_scenes(controller))):
        _Player(controller, index).play(ENOUGH)
        if process_time() - begun > ENOUGH:
            break


def repeats(controller: Controller) -> None:
    """Check that equal episodes give equal actions, with random numbers from ``p.rng`` only.

    That holds for another policy of the controller, and for one that has played before.
    """
    for index in range(len(_scenes(controller))):
        one, other = (_Player(controller, index) for _ in range(2))
        actions, _ = one.play(ENOUGH)
        for player, text in (
            (other, "they may depend only on what it perceives and on random numbers from p.rng"),
            (one, "the second one by the same policy, whose reset must forget the first"),
        ):
            again, _ = player.play(ENOUGH)
            require(
                all(a == b for a, b in zip(actions, again, strict=False)),  # one may be slower
                f"equal episodes on scene {index} get unequal actions; {text}",
            )
            if looks_ahead(type(controller)):
                break  # its search is long, and each reset begins it anew


def in_time(controller: Controller) -> None:
    """Check that the median decision takes at most one period, without the search before it."""
    period = SCENES[0].environment().robot.decision_period
    count = len(_scenes(controller))
    times = [t for index in range(count) for t in _Player(controller, index).play(ENOUGH)[1]]
    require(
        median(times) <= period,
        f"its median decision takes {median(times):.2f} s; the next one is due after {period:g} s",
    )


def looks_ahead(cls: type[Plugin]) -> bool:
    """Return whether the controller searches before an episode, which may take long."""
    return issubclass(cls, Controller) and cls.searches_first


def _scenes(controller: Controller) -> Sequence[Scene]:
    return (SHORT,) if looks_ahead(type(controller)) else SCENES


class _Player:
    """A policy of a controller on one scene."""

    def __init__(self, controller: Controller, scene: int) -> None:
        self._env = _scenes(controller)[scene].environment()
        self._recorder = _ActionRecorder(_ready(controller, self._env.config), scene)
        self._scene = scene

    def play(self, enough: float) -> tuple[list[int], list[float]]:
        """Play the scene; return the actions and the computing time of each [s].

        The episode is left once these times exceed ``enough`` [s].
        """
        recorder = self._recorder
        recorder.actions, recorder.times = [], []
        for _ in islice(decisions(self._env, recorder, self._scene), DECISIONS):
            if sum(recorder.times) > enough:  # planners are slow at their outermost settings
                break
        return recorder.actions, recorder.times


def _ready(controller: Controller, config: EnvConfig) -> Controller:
    """Return the controller with the files that it names; torch is imported only for these."""
    from flipperctl.policies.source import with_files

    return with_files(controller, config)


class _ActionRecorder:
    """A policy that checks, times and records the actions of a controller's policy."""

    def __init__(self, controller: Controller, scene: int) -> None:
        self._policy, self._scene = controller.build(), scene
        self.actions: list[int] = []
        self.times: list[float] = []  # [s]

    def reset(self, simulator: Simulator) -> None:
        """Begin an episode of the controller's policy."""
        self._policy.reset(simulator)

    def act(self, p: Perception) -> int:
        """Return the action of the controller's policy."""
        begun = perf_counter()
        action = self._policy.act(p)
        self.times.append(perf_counter() - begun)
        require(
            isinstance(action, int) and action in range(len(ACTIONS)),
            f"act returned {action!r} at decision {len(self.actions)} of scene {self._scene}; "
            f"an int from 0 to {len(ACTIONS) - 1} is allowed",
        )
        self.actions.append(action)
        return action
