"""The paper's measures of one episode, gathered while it runs."""

from __future__ import annotations

import numpy as np

from flipperctl.api import FloatArray, RobotState


class EpisodeMetrics:
    """Sums up pitch, flipper travel and reward; see ``summary`` for names and units."""

    def __init__(self, state: RobotState) -> None:
        self._last = state
        self._variation = 0.0
        self._variation_100hz = 0.0
        self._max_pitch = abs(state.pitch)
        self._travel = 0.0
        self._decisions = 0
        self._parts: dict[str, float] = {}

    def samples(self, pitches: FloatArray) -> None:
        """Note the pitch at a decision's 10 ms samples, the one before included, (S + 1,) [rad]."""
        self._variation_100hz += float(np.abs(np.diff(pitches)).sum())
        self._max_pitch = max(self._max_pitch, float(np.abs(pitches).max()))

    def decision(self, state: RobotState, parts: dict[str, float]) -> None:
        """Note the state after one decision and the reward's parts."""
        last, self._last = self._last, state
        self._variation += abs(state.pitch - last.pitch)
        self._travel += abs(state.front - last.front) + abs(state.rear - last.rear)
        self._decisions += 1
        for name, value in parts.items():
            self._parts[name] = self._parts.get(name, 0.0) + value

    def summary(self) -> dict[str, float]:
        """Plain numbers: times [s], angles [rad], rewards [-]."""
        return {
            "decisions": self._decisions,
            "t_cost": self._last.time,
            "pitch_variation": self._variation,  # paper Eq. 8, at decisions
            "pitch_variation_100hz": self._variation_100hz,
            "max_pitch": self._max_pitch,
            "flipper_travel": self._travel,
            "return": sum(self._parts.values()),
            **{f"reward_{name}": value for name, value in self._parts.items()},
        }
