"""Types of the settings of the risk that a policy estimates beside its values (``agent.risk``)."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

RiskLearnt = Annotated[
    bool,
    Field(
        description="let a small network beside the policy learn the probability that the episode "
        "fails within the next risk_horizon decisions; it changes nothing that the policy learns, "
        "and comes with its checkpoints and exports [-]",
    ),
]
RiskHorizon = Annotated[
    int,
    Field(
        ge=5,
        le=200,
        description="decisions before the end of a failed episode that count as about to fail [-]",
    ),
]
RiskFalseAlarms = Annotated[
    float,
    Field(
        ge=0,
        le=1,
        description="largest share of the validation episodes that reach the finish in which the "
        "policy may warn; it chooses the threshold of the warnings [-]",
    ),
]
