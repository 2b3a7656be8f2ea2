"""Film an episode in an engine that draws its own pictures.

In: an evaluation's configuration, a policy, a seed. Out: an animated file. The pictures are taken
between samples, so that the episode equals that of an evaluation bit for bit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import SAMPLE_PERIOD, DrawingWorld, World
from flipperctl.config import EvalConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.observer import Observer
from flipperctl.errors import RequestError
from flipperctl.policies.source import PolicySource
from flipperctl.report.film import check_film, write_frames
from flipperctl.rollout.episode import play
from flipperctl.rollout.seeds import EvaluationSeeds

SIZE = 640, 480
"""Width and height [pixels]."""

_EVERY = 20
"""Samples between two pictures: 5 per second [-]."""


def film(config: EvalConfig, source: PolicySource, seed: int, path: Path) -> None:
    """Play the episode with this ``seed`` and write its film.

    Raises:
        OutputError: ``path`` cannot be the path of a film.
        RequestError: the engine draws no pictures, or the machine cannot.
        FlipperctlError: the policy failed, or the file cannot be written.
    """
    check_film(path)
    shots = Shots(config.sim.plugin_name)
    play(FlipperEnv(config=config), source.build(config), seed, observers=[shots])
    from PIL.Image import fromarray

    pictures = [fromarray(frame) for frame in shots.frames]
    write_frames(path, pictures, [_EVERY * SAMPLE_PERIOD] * len(pictures))


def film_episode(config: EvalConfig, source: PolicySource, episode: int, path: Path) -> None:
    """Film the episode with this index of an evaluation; see ``film``."""
    film(config, source, EvaluationSeeds.of(config.eval.seed, config.terrain)(episode), path)


class Shots(Observer):
    """Take pictures of a world that can draw itself, at the start and at equal intervals."""

    every = _EVERY

    def __init__(self, engine: str) -> None:
        """``engine``: its registered name, for errors."""
        self._engine = engine
        self.frames: list[NDArray[np.uint8]] = []
        """The pictures, (H, W, 3) each."""

    def stopped(self, world: World) -> None:
        """Take a picture.

        Raises:
            RequestError: the engine draws no pictures, or the machine cannot.
        """
        if not isinstance(world, DrawingWorld):
            raise RequestError(f"sim={self._engine} draws no pictures for a film")
        self.frames.append(world.draw(*SIZE))
