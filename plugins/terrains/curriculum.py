"""A terrain that becomes harder as the robot succeeds."""

from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import AnyTerrain, Plugin, Profile, Terrain, terrain

from .step import Step


@terrain("curriculum")
class Curriculum(Terrain):
    """In training, move from an easy to a hard version of a terrain with each success.

    Every number is interpolated linearly between its easy and its hard value by the difficulty;
    validation and evaluation use the hard version. The difficulty settles where the success rate
    is down / (up + down), 75 % at the defaults. ``metrics.csv`` has each episode's difficulty.
    """

    easy: AnyTerrain = Field(
        Step(low=-0.1, high=0.1), description="the terrain at difficulty 0, with its fields [-]"
    )
    hard: AnyTerrain = Field(
        Step(), description="the same terrain at difficulty 1; only numbers may differ [-]"
    )
    start: float = Field(0.0, ge=0, le=1, description="difficulty of the first episode [-]")
    up: float = Field(0.01, ge=0, le=1, description="increase of difficulty after a success [-]")
    down: float = Field(0.03, ge=0, le=1, description="decrease of difficulty after a failure [-]")

    @model_validator(mode="after")
    def _check_interpolable(self) -> Self:
        self.at(0.5)
        return self

    @property
    def first_difficulty(self) -> float:
        """Difficulty of the first episode [-]."""
        return self.start

    def next_difficulty(self, difficulty: float, reached: bool) -> float:
        """Return the difficulty, raised after a success or else lowered, within 0 and 1."""
        return min(1.0, max(0.0, difficulty + (self.up if reached else -self.down)))

    def at(self, difficulty: float) -> Terrain:
        """Return the terrain between easy and hard.

        Raises:
            ValueError: the difficulty is not within 0 and 1.
        """
        if not 0 <= difficulty <= 1:
            raise ValueError(f"difficulty {difficulty:g} is not within 0 and 1")
        between: Terrain = _between(self.easy, self.hard, difficulty, self.easy.plugin_name)
        return between

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return a profile of the hard version."""
        return self.hard.labelled(rng)


def _between(easy: Any, hard: Any, fraction: float, where: str) -> Any:
    """Interpolate from ``easy`` (fraction 0) to ``hard`` (fraction 1); integers stay integers."""
    if easy == hard:
        return hard
    if type(easy) is type(hard) and isinstance(easy, Plugin):
        fields = type(easy).model_fields
        values = {
            f: _between(getattr(easy, f), getattr(hard, f), fraction, f"{where}.{f}")
            for f in fields
        }
        return type(easy)(**values)
    if isinstance(easy, tuple) and isinstance(hard, tuple) and len(easy) == len(hard):
        pairs = enumerate(zip(easy, hard, strict=True))
        return tuple(_between(a, b, fraction, f"{where}.{i}") for i, (a, b) in pairs)
    if type(easy) is type(hard) and isinstance(easy, int | float) and not isinstance(easy, bool):
        value = easy * (1 - fraction) + hard * fraction
        return round(value) if isinstance(easy, int) else value
    raise ValueError(
        f"only numbers may differ between easy and hard; {where} is {_shown(easy)} and "
        f"{_shown(hard)}"
    )


def _shown(value: object) -> str:
    return value.plugin_name if isinstance(value, Plugin) else repr(value)
