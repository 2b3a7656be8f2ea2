"""Films of an episode in an engine that draws pictures of itself.

In: an evaluation's configuration, a policy, a seed. Out: an animated file. The pictures are taken
between samples, so that the episode is the one that an evaluation plays, bit for bit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import (
    NO_LIMITS,
    SAMPLE_PERIOD,
    DrawingWorld,
    EndingWorld,
    FloatArray,
    Limits,
    Outcome,
    RobotState,
    World,
)
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.errors import RequestError
from flipperctl.policies.source import PolicySource
from flipperctl.report.film import check_film, write_frames
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import EvaluationSeeds

SIZE = 640, 480
"""Width and height [pixels]."""

_EVERY = 20
"""Samples between two pictures, so that 5 are shown a second [-]."""


def film(config: EvalConfig, source: PolicySource, seed: int, path: Path) -> None:
    """Play the episode with this ``seed`` and write its film.

    Raises:
        OutputError: ``path`` is not a possible film.
        RequestError: the engine draws no pictures, or the machine cannot.
        FlipperctlError: the policy failed, or the file cannot be written.
    """
    check_film(path)
    env = FlipperEnv(config=config)
    frames: list[NDArray[np.uint8]] = []

    def begin(time: float) -> None:
        """Wrap the world, once the episode has one."""
        world = env.drive.world
        if isinstance(world, FilmedWorld):
            return
        if not isinstance(world, DrawingWorld):
            raise RequestError(f"sim={config.sim.plugin_name} draws no pictures for a film")
        env.drive.world = FilmedWorld(world, frames)

    for _ in decisions(env, source.build(config), seed, pace=begin):
        pass
    from PIL.Image import fromarray

    pictures = [fromarray(frame) for frame in frames]
    write_frames(path, pictures, [_EVERY * SAMPLE_PERIOD] * len(pictures))


def film_episode(config: EvalConfig, source: PolicySource, episode: int, path: Path) -> None:
    """Film the episode with this index of an evaluation; see ``film``."""
    film(config, source, EvaluationSeeds.of(config.eval.seed, config.terrain)(episode), path)


class FilmedWorld:
    """A world that is drawn while it runs; see ``flipperctl.api.World``."""

    def __init__(self, world: Any, frames: list[NDArray[np.uint8]]) -> None:
        """Add the pictures of ``world``, a ``World`` and ``DrawingWorld``, to ``frames``."""
        self._world: World = world
        self._draw = world.draw
        self._frames = frames
        self._samples = 0
        frames.append(self._draw(*SIZE))

    @property
    def position(self) -> tuple[float, float]:
        """World coordinates (x, z) of the chassis centre [m]."""
        return self._world.position

    @property
    def pitch(self) -> float:
        """Pitch of the chassis, nose up positive [rad]."""
        return self._world.pitch

    def command(self, front: float, rear: float) -> None:
        """Set the target angles of the flippers in frame R [rad]."""
        self._world.command(front, rear)

    def advance(self, samples: int, limits: Limits = NO_LIMITS) -> FloatArray:
        """Simulate up to ``samples`` sample periods and draw a picture every ``_EVERY``."""
        parts: list[FloatArray] = []
        left = samples
        while left:
            asked = min(left, _EVERY - self._samples % _EVERY)
            parts.append(self._world.advance(asked, limits))
            self._samples += len(parts[-1])
            left -= asked
            if self._samples % _EVERY == 0:
                self._frames.append(self._draw(*SIZE))
            if len(parts[-1]) < asked or limits.reached(*self.position, self.pitch):
                break
            if self.ended() is not None:
                break
        return np.concatenate(parts)

    def ended(self) -> Outcome | None:
        """Return the world's own end, if it has one."""
        return self._world.ended() if isinstance(self._world, EndingWorld) else None

    def state(self) -> RobotState:
        """Return the current state."""
        return self._world.state()

    def penetration(self) -> float:
        """Return the largest depth by which the robot overlaps the ground [m]."""
        return self._world.penetration()

    def save(self) -> Any:
        """Return a snapshot of the changing state for ``load``."""
        return self._world.save()

    def load(self, saved: Any) -> None:
        """Return to a snapshot."""
        self._world.load(saved)
