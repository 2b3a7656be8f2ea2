"""The fields of ``mpc``: the settings of the receding-horizon controller."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import Field

from flipperctl.api import Settings

if TYPE_CHECKING:
    from flipperctl.lookahead.search import Prices

STEEP_FROM, STEEP = 0.9, 30.0
"""Pitch from which steepness costs, short of overturning [rad], and its price [s/rad]."""


class MpcSettings(Settings):
    """Size of the search, prices of a plan, and the simulation in which plans are compared."""

    beam: int = Field(12, ge=1, le=64, description="nodes kept at each depth of the search [-]")
    horizon: int = Field(9, ge=1, le=20, description="depth of the search in decisions [-]")
    of_each: int = Field(
        0,
        ge=0,
        le=64,
        description="nodes kept at each depth for each first action besides ``beam``; above 0 the "
        "costs of all actions are known, from which a student learns more [-]",
    )
    wider: float = Field(
        3.0, ge=1, le=8, description="width of the second search as a multiple of ``beam`` [-]"
    )
    stuck_from: float = Field(
        2.5, gt=0, le=100, description="lost time of a plan from which a second search is made [s]"
    )
    swing: float = Field(10.0, ge=0, le=1000, description="price of pitch variation [s/rad]")
    pitch: float = Field(
        10.0, ge=0, le=1000, description="price of the absolute pitch at the horizon [s/rad]"
    )
    lean: float = Field(
        0.1, ge=0, le=100, description="price of the absolute pitch after each decision [s/rad]"
    )
    flippers: float = Field(
        0.04, ge=0, le=100, description="price of flipper angles after each decision [s/rad]"
    )
    turn: float = Field(
        0.02, ge=0, le=10, description="price of turning a flipper pair in a decision [s]"
    )
    standstill: float = Field(
        3.0, ge=0, le=100, description="further price of time lost beyond ``standstill_from`` [s/s]"
    )
    standstill_from: float = Field(
        2.0, ge=0, le=100, description="lost time from which a plan counts as standing [s]"
    )
    steep: float = Field(
        STEEP, ge=0, le=1000, description="price of pitch beyond ``steep_from`` [s/rad]"
    )
    steep_from: float = Field(
        STEEP_FROM, gt=0, le=math.pi / 2, description="pitch from which steepness costs [rad]"
    )
    overturn: float = Field(
        math.pi / 3, gt=0.1, le=math.pi / 2, description="pitch that no plan may reach [rad]"
    )
    friction: float = Field(
        0.8,
        gt=0,
        le=10,
        description="friction between track and ground in the simulation, unless a privileged "
        "teacher is told it; too low costs some smoothness, too high gets stuck on stairs that "
        "slip [-]",
    )
    step: float = Field(0.02, ge=0.005, le=0.04, description="time step of the prediction [s]")
    iterations: int = Field(8, ge=1, le=40, description="solver iterations per step [-]")
    memory: int = Field(10, ge=1, le=100, description="scans that are averaged under noise [-]")
    latency: float = Field(
        0.0,
        ge=0,
        le=1,
        description="time from a perception to the flippers' turn: sensing, computing, actuation; "
        "the search begins after it [s]",
    )
    time_limit: float | None = Field(
        None,
        gt=0,
        le=60,
        description="time after which a search ends early; without it, a decision can be repeated "
        "exactly [s]",
    )

    def prices(self, hurry: int = 0) -> Prices:
        """Return the prices; swing and final pitch are divided ``hurry`` times by ``HURRY``."""
        from flipperctl.lookahead.search import HURRY, Prices

        calm = HURRY**-hurry
        return Prices(
            swing=calm * self.swing,
            pitch=calm * self.pitch,
            lean=self.lean,
            flippers=self.flippers,
            turn=self.turn,
            standstill=self.standstill,
            standstill_from=self.standstill_from,
            steep=self.steep,
            steep_from=self.steep_from,
        )
