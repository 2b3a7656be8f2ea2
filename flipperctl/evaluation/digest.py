"""The digest of an episode: equal for episodes that are equal bit for bit.

In: decisions of the episode loop. Out: 64 hexadecimal digits.
"""

from __future__ import annotations

import hashlib

import numpy as np

from flipperctl.rollout.episode import Decision


class EpisodeDigest:
    """SHA-256 of each decision's action and of the poses at 100 Hz."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def add(self, decision: Decision) -> None:
        """Add the action and the poses (S + 1, 5) of a decision, as little-endian numbers."""
        self._hash.update(int(decision.action).to_bytes(1, "little"))
        self._hash.update(np.ascontiguousarray(decision.poses, dtype="<f8").tobytes())

    def hexdigest(self) -> str:
        """Return the digest of the decisions so far."""
        return self._hash.hexdigest()
