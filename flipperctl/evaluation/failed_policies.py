"""Policies that could not play all episodes of a scene, and the error that says so at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from flipperctl.errors import FlipperctlError


@dataclass(frozen=True)
class Failure:
    """A policy that could not play all episodes of a scene."""

    controller: str
    """Label of the policy."""
    terrain: str
    """Name of the terrain plugin."""
    error: FlipperctlError

    def to_dict(self) -> dict[str, str]:
        """Return plain data."""
        return {"controller": self.controller, "terrain": self.terrain, "error": str(self.error)}


def error_of(failures: Sequence[Failure]) -> FlipperctlError:
    """Return the error of an evaluation in which policies failed: the first one, and their number.

    Raises:
        ValueError: there are no failures.
    """
    if not failures:
        raise ValueError("there are no failures")
    first = failures[0]
    text = f"{first.controller} failed on {first.terrain}: {first.error}"
    if len(failures) > 1:
        text += f"; {len(failures) - 1} more failed"
    return type(first.error)(f"{text}; all other results are complete")
