"""A simulator of an episode's scene, for policies that look ahead."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flipperctl.api import FloatArray, Outcome, Perception, Profile, RobotGeometry, RobotState
from flipperctl.env.drive import Drive
from flipperctl.env.perceiving import Perceiver


class SceneSimulator:
    """Implements ``flipperctl.api.Simulator``; the world is built on first use."""

    def __init__(
        self,
        make: Callable[[], Drive],
        perceiver: Callable[[Drive, bool], Perceiver],
        profile: Profile,
        report_progress: Callable[[float], None],
    ) -> None:
        """Simulate the ``Drive`` that ``make`` builds; pass progress to ``report_progress``.

        ``perceiver`` returns a new perceiver that measures at the samples of a ``Drive``: with the
        noise of the episode, or, if its second argument is true, without errors.
        """
        self._make, self._make_perceiver = make, perceiver
        self._profile, self._report_progress = profile, report_progress
        self._made: Drive | None = None
        self._perceiver: Perceiver | None = None
        self._exact: Perceiver | None = None
        self.results: dict[str, float | str] = {}
        """What the policy reported about its search."""

    @property
    def _drive(self) -> Drive:
        if self._made is None:
            self._made = self._make()
        return self._made

    @property
    def state(self) -> RobotState:
        """Current state of the robot."""
        return self._drive.state

    @property
    def robot(self) -> RobotGeometry:
        """Geometry of the robot."""
        return self._drive.robot

    @property
    def speed(self) -> float:
        """Speed of the belts [m/s]."""
        return self._drive.robot.track_speed

    @property
    def finish(self) -> float:
        """World x that the chassis centre must pass [m]."""
        return self._drive.termination.finish

    @property
    def profile(self) -> Profile:
        """True ground of the episode."""
        return self._profile

    @property
    def poses(self) -> FloatArray:
        """Poses of the last decision at 100 Hz, the pose before it first, (S + 1, 5)."""
        return self._drive.poses

    def perceive(self) -> Perception:
        """Return the policy's current perception; see ``flipperctl.api.Simulator``."""
        if self._perceiver is None:
            self._perceiver = self._make_perceiver(self._drive, False)
        return self._perceiver.perceive(self._drive.delayed_state)

    def perceive_exactly(self) -> Perception:
        """Return the perception of a sensor without errors; see ``flipperctl.api.Simulator``."""
        if self._exact is None:
            self._exact = self._make_perceiver(self._drive, True)
        return self._exact.perceive(self._drive.state)

    def step(self, action: int) -> Outcome | None:
        """Simulate one decision; return the outcome, or None while the episode runs."""
        return self._drive.decide(action)

    def save(self) -> Any:
        """Return a snapshot of the scene for ``load``."""
        return self._drive.save(), _saved(self._perceiver), _saved(self._exact)

    def load(self, saved: Any) -> None:
        """Restore a snapshot."""
        drive, perceiver, exact = saved
        self._drive.load(drive)
        self._perceiver, self._exact = _loaded(perceiver), _loaded(exact)

    def restart(self) -> None:
        """Return to the start in a new world, which reproduces the episode bit for bit."""
        self._made = self._perceiver = self._exact = None

    def report_progress(self, fraction: float) -> None:
        """Report the completed fraction of a long search, in [0, 1]."""
        self._report_progress(fraction)

    def report_result(self, **values: float | str) -> None:
        """Report numbers and texts about the search, to be added to the episode's result."""
        self.results.update(values)


def _saved(perceiver: Perceiver | None) -> tuple[Perceiver, Any] | None:
    """Return a perceiver with its snapshot; None before the first perception."""
    return None if perceiver is None else (perceiver, perceiver.save())


def _loaded(saved: tuple[Perceiver, Any] | None) -> Perceiver | None:
    """Return the perceiver after restoring its snapshot."""
    if saved is None:
        return None
    perceiver, memory = saved
    perceiver.load(memory)
    return perceiver
