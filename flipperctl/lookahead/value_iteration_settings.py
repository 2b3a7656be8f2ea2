"""The fields of ``value_iteration``: discount, prediction model, and groups for a student."""

from __future__ import annotations

from pydantic import Field

from flipperctl.api import Settings


class ValueIterationSettings(Settings):
    """Settings of the search of all states, and of the states that a student learns from."""

    gamma: float = Field(
        0.99, ge=0, lt=1, description="discount per decision, equal to agent.gamma [-]"
    )
    step: float = Field(0.02, ge=0.005, le=0.04, description="time step of the prediction [s]")
    iterations: int = Field(8, ge=1, le=40, description="solver iterations per step [-]")
    friction: float = Field(
        0.9,
        gt=0,
        le=10,
        description="friction in the prediction if the episode's own is not known [-]",
    )
    horizon: int = Field(
        4, ge=1, le=20, description="decisions that are searched before the values count [-]"
    )
    beam: int = Field(10, ge=1, le=64, description="nodes kept at each depth of that search [-]")
    groups: int = Field(
        96,
        ge=1,
        le=10_000,
        description="groups of states of each ground that a student learns from [-]",
    )
    off_path: float = Field(
        0.4,
        ge=0,
        le=1,
        description="fraction of the groups around states that any flipper setting may reach; the "
        "others lie around states near the best way [-]",
    )

    unseen: float = Field(
        0.0,
        ge=0,
        le=1,
        description="fraction of the groups whose ground is level from some bin ahead on, as a "
        "search on perceived ground takes it to be; for the values of controller.value [-]",
    )
