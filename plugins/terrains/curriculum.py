"""A terrain that grows harder as the robot succeeds."""

from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import AnyTerrain, Plugin, Profile, Terrain, terrain

from .step import Step


@terrain("curriculum")
class Curriculum(Terrain):
    """In training, goes from an easy to a hard version of a terrain with each success.

    Every number lies between its two values, at the share that the difficulty says; validation
    and evaluation meet the hard version. The steps settle where the success rate is
    down / (up + down): 75 % at the defaults. ``metrics.csv`` has each episode's difficulty.
    """

    easy: AnyTerrain = Field(
        Step(low=-0.1, high=0.1), description="the terrain at difficulty 0, with its fields [-]"
    )
    hard: AnyTerrain = Field(
        Step(), description="the same terrain at difficulty 1; only numbers may differ [-]"
    )
    start: float = Field(0.0, ge=0, le=1, description="difficulty of the first episode [-]")
    up: float = Field(0.01, ge=0, le=1, description="added after an episode that succeeds [-]")
    down: float = Field(0.03, ge=0, le=1, description="taken off after one that fails [-]")

    @model_validator(mode="after")
    def _alike(self) -> Self:
        self.at(0.5)
        return self

    @property
    def first_difficulty(self) -> float:
        """The start."""
        return self.start

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Up or down a step, within 0 and 1."""
        return min(1.0, max(0.0, difficulty + (self.up if reached else -self.down)))

    def at(self, difficulty: float) -> Terrain:
        """The terrain between easy and hard.

        Raises:
            ValueError: the difficulty is not within 0 and 1.
        """
        if not 0 <= difficulty <= 1:
            raise ValueError(f"difficulty {difficulty:g} is not within 0 and 1")
        between: Terrain = _between(self.easy, self.hard, difficulty, self.easy.plugin_name)
        return between

    def generate(self, rng: np.random.Generator) -> Profile:
        """The hard version's."""
        return self.hard.labelled(rng)


def _between(easy: Any, hard: Any, share: float, where: str) -> Any:
    """``easy`` at a share of 0 and ``hard`` at 1; whole numbers stay whole."""
    if easy == hard:
        return hard
    if type(easy) is type(hard) and isinstance(easy, Plugin):
        fields = type(easy).model_fields
        values = {
            f: _between(getattr(easy, f), getattr(hard, f), share, f"{where}.{f}") for f in fields
        }
        return type(easy)(**values)
    if isinstance(easy, tuple) and isinstance(hard, tuple) and len(easy) == len(hard):
        pairs = enumerate(zip(easy, hard, strict=True))
        return tuple(_between(a, b, share, f"{where}.{i}") for i, (a, b) in pairs)
    if type(easy) is type(hard) and isinstance(easy, int | float) and not isinstance(easy, bool):
        value = easy * (1 - share) + hard * share
        return round(value) if isinstance(easy, int) else value
    raise ValueError(
        f"only numbers may differ between easy and hard; {where} is {_shown(easy)} and "
        f"{_shown(hard)}"
    )


def _shown(value: object) -> str:
    return value.plugin_name if isinstance(value, Plugin) else repr(value)
