"""The cost of plans by hand-set weights, in seconds: the objective of ``mpc`` without rewards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flipperctl.api import FloatArray, Robot
from flipperctl.lookahead.model import TARGETS, Branch, Model
from flipperctl.lookahead.nodes import TURNS
from flipperctl.lookahead.search import Scores

HURRY = 5.0
"""Divisor of the cost weight of pitch variation in a hurry [-]."""


@dataclass(frozen=True)
class CostWeights:
    """Weights of the terms of a plan's cost, which is in seconds."""

    robot: Robot

    pitch_variation: float
    """Weight of the pitch variation [s/rad]."""
    pitch: float
    """Weight of the absolute pitch at the horizon [s/rad]."""
    lean: float
    """Weight of the absolute pitch after each decision [s/rad]."""
    flippers: float
    """Weight of each absolute flipper angle after each decision [s/rad]."""
    turn: float
    """Cost of turning a flipper pair in one decision [s]."""
    standstill: float
    """Additional weight of time lost beyond ``standstill_from`` [s/s]."""
    standstill_from: float
    """Lost time from which a plan counts as standing still [s]."""
    steep: float
    """Weight of the largest pitch of a plan beyond ``steep_from`` [s/rad]."""
    steep_from: float
    """Pitch above which a plan is charged for steepness, below overturning [rad]."""

    @property
    def poses(self) -> bool:
        """The costs need no poses between decisions."""
        return False

    def begin(self, model: Model, root: FloatArray) -> CostAccount:
        """Return the account of a search from the state ``root``."""
        zero = np.zeros(1)
        return CostAccount(self, model.chassis(root)[0], 0, zero, zero, zero)


@dataclass(frozen=True)
class CostAccount:
    """What the plans of M nodes have cost so far."""

    weights: CostWeights
    begin: float
    """x of the chassis centre at the root [m]."""
    depth: int
    """Number of decisions from the root."""
    variation: FloatArray
    """Pitch variation from the root, (M,) [rad]."""
    paid: FloatArray
    """Cost of postures and turns from the root, (M,) [s]."""
    steep: FloatArray
    """Largest absolute pitch from the root, (M,) [rad]."""

    def take(self, rows: NDArray[np.int64]) -> CostAccount:
        """Return the account of some of the nodes."""
        return CostAccount(
            *(self.weights, self.begin, self.depth),
            *(self.variation[rows], self.paid[rows], self.steep[rows]),
        )

    def extend(self, parent: NDArray[np.int64], action: NDArray[np.int64], found: Branch) -> Scores:
        """Return the scores of plans that are one decision longer."""
        weights, robot = self.weights, self.weights.robot
        variation = self.variation[parent] + found.pitch_variation
        paid = self.paid[parent] + _step_cost(found.states, action, weights)
        steep = np.maximum(self.steep[parent], found.steepest)
        distance = found.places[:, 0] - self.begin
        lost = robot.decision_period * (self.depth + 1) - distance / robot.track_speed
        lost = np.maximum(lost, 0.0)  # otherwise plans would push themselves along by flippers
        rest = paid + _final_cost(found.states, lost, steep, weights)
        account = CostAccount(weights, self.begin, self.depth + 1, variation, paid, steep)
        return Scores(
            cost=rest + weights.pitch_variation * variation,
            hurried=rest + weights.pitch_variation / HURRY * variation,
            ended=np.zeros(len(lost), np.bool_),
            lost_time=lost,
            account=account,
        )


def _step_cost(states: FloatArray, action: NDArray[np.int64], weights: CostWeights) -> FloatArray:
    """Return the cost of the turns in one decision and of the postures after it, (M,) [s]."""
    return np.asarray(
        weights.flippers * np.abs(states[:, TARGETS:]).sum(axis=1)
        + weights.lean * np.abs(states[:, 2])
        + weights.turn * np.abs(TURNS[action]).sum(axis=1)
    )


def _final_cost(
    states: FloatArray, lost: FloatArray, steep: FloatArray, weights: CostWeights
) -> FloatArray:
    """Return the cost of lost time, largest pitch and final pitch of plans, (M,) [s]."""
    return np.asarray(
        lost
        + weights.standstill * np.maximum(0.0, lost - weights.standstill_from)
        + weights.pitch * np.abs(states[:, 2])
        + weights.steep * np.maximum(0.0, steep - weights.steep_from)
    )
