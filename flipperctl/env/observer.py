"""Observers of an episode while it runs, such as films, recordings and live pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from flipperctl.api import FloatArray, Measured, Perception, Profile, Robot, Transition, World
from flipperctl.env.drive import Drive


class Observer:
    """Observes an episode while it runs; a method that is not overridden does nothing.

    An observer must not change the values that it receives.
    """

    every: int | None = None
    """Samples between two calls of ``stopped`` [-]; None: ``stopped`` is never called."""

    def begin(self, profile: Profile, robot: Robot) -> None:
        """Receive the ground and the robot of a new episode."""

    def moved(self, time: float, poses: FloatArray) -> None:
        """Receive the poses (S, 5) of consecutive samples, the first at ``time`` [s].

        Columns: x [m], z [m], pitch, front and rear flipper angle [rad]. The samples are
        ``SAMPLE_PERIOD`` apart; each is received once, beginning with the start.
        """

    def stopped(self, world: World) -> None:
        """Receive the world at the start and after every ``every`` samples, for pictures.

        The engine then simulates fewer samples per call. States stay bit-identical, except for the
        last digit of the time in an engine that accumulates it.
        """

    def measured(self, measured: Measured) -> None:
        """Receive a measurement of an instrument."""

    def decided(self, t: Transition, p: Perception, rewards: Mapping[str, float]) -> None:
        """Receive a simulated decision.

        ``p``: the perception on which the policy decided; ``rewards``: the weighted value of each
        reward term.
        """


def attach(observers: Iterable[Observer], drive: Drive, profile: Profile) -> None:
    """Connect observers to an episode that begins."""
    for observer in observers:
        observer.begin(profile, drive.robot)
        drive.report_poses(observer.moved)
        if observer.every is not None:
            drive.sample_every(observer.every, observer.stopped)
