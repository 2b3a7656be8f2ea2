"""A random choice among several terrains."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import AnyTerrain, Profile, terrain

from .combinator import Combinator
from .stair import Stair
from .step import Step


@terrain("mix")
class Mix(Combinator):
    """Draw one of several terrains each episode; the episode's row names it."""

    parts: tuple[AnyTerrain, ...] = Field(
        (Step(), Stair()),
        min_length=1,
        description="the terrains: names, or mappings with a name and fields [-]",
    )
    weights: tuple[float, ...] = Field(
        (), description="relative frequency of each part; equal for all if empty [-]"
    )

    @model_validator(mode="after")
    def _check_weights(self) -> Self:
        if self.weights and len(self.weights) != len(self.parts):
            raise ValueError(
                f"{len(self.weights)} weights for {len(self.parts)} parts; give one each, or none"
            )
        if self.weights and (min(self.weights) < 0 or sum(self.weights) <= 0):
            raise ValueError(f"weights {self.weights} must not be negative, nor all 0")
        return self

    def generate(self, rng: np.random.Generator) -> Profile:
        """Return the profile of the drawn part, with that part's label."""
        return self.parts[self.draw_part(rng)].labelled(rng)

    def draw_part(self, rng: np.random.Generator) -> int:
        """Draw the index of a part by the weights."""
        weights = np.array(self.weights or [1.0] * len(self.parts))
        return int(rng.choice(len(self.parts), p=weights / weights.sum()))
