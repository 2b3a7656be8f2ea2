"""How a scene and a policy are called in an evaluation of several methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class SceneName:
    """Names beyond those of the terrain and of the policy's file; each may be empty."""

    scene: str = ""
    """Name of the scene within its suite."""
    method: str = ""
    """Name of the method, whose policies differ in their training seeds."""
    training_seed: int | None = None
    """Seed of the policy's training; None for a controller, or if there is one seed alone."""

    @property
    def method_text(self) -> str:
        """Name of the method and the training seed, for tables."""
        seed = "" if self.training_seed is None else f", seed {self.training_seed}"
        return f"{self.method}{seed}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain data, without what is empty."""
        found = {"suite_scene": self.scene, "method": self.method}
        seed = {} if self.training_seed is None else {"training_seed": self.training_seed}
        return {**{name: text for name, text in found.items() if text}, **seed}


NAMELESS = SceneName()
"""The names of a scene of one policy."""
