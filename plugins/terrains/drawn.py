"""Base classes of terrains that draw new sizes each episode."""

from typing import Self

import numpy as np
from pydantic import Field, model_validator

from flipperctl.api import Terrain


class Drawn(Terrain):
    """Draw a quantity uniformly between its fields ``<quantity>_low`` and ``<quantity>_high``."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        fields = type(self).model_fields
        pairs = [(f, f.removesuffix("low") + "high") for f in fields if f.endswith("_low")]
        for low, high in [*pairs, ("fewest", "most")]:
            if low in fields and getattr(self, low) > getattr(self, high):
                raise ValueError(
                    f"{low} ({getattr(self, low):g}) must not exceed "
                    f"{high} ({getattr(self, high):g})"
                )
        return self

    def draw(self, rng: np.random.Generator, quantity: str) -> float:
        """Draw a value of the quantity, in the unit of its fields."""
        low, high = getattr(self, f"{quantity}_low"), getattr(self, f"{quantity}_high")
        return float(rng.uniform(low, high))


class DrawnRow(Drawn):
    """Also draw the number of parts in a row."""

    fewest: int = Field(2, ge=1, le=50, description="smallest number of parts [-]")
    most: int = Field(4, ge=1, le=50, description="largest number of parts [-]")

    def draw_count(self, rng: np.random.Generator) -> int:
        """Draw the number of parts, from ``fewest`` to ``most``."""
        return int(rng.integers(self.fewest, self.most + 1))
