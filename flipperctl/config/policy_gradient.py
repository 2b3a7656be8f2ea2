"""The section ``agent.policy_gradient``: settings of the learner that improves what it drives."""

from __future__ import annotations

from pydantic import Field

from flipperctl.api import Settings
from flipperctl.core.schedules import linear


class PolicyGradient(Settings):
    """The policy gradient, with agent.learner=policy_gradient. The paper has none."""

    decisions: int = Field(
        8192,
        ge=2,
        le=10_000_000,
        description="decisions of whole episodes that are driven before the policy is improved by "
        "them; they must fit into agent.replay_size [-]",
    )
    passes: int = Field(3, ge=1, le=100, description="passes over these decisions [-]")
    temperature: float = Field(
        0.05,
        ge=1e-6,
        le=1000,
        description="difference of Q-values by which an action becomes e times less probable in "
        "the training's episodes, where all actions are drawn [-]",
    )
    temperature_end: float | None = Field(
        None,
        ge=1e-6,
        le=1000,
        description="temperature at the end, reached linearly: the lower, the less the policy can "
        "rely on draws, which it does without once trained; null: that of the start [-]",
    )
    trace: float = Field(
        0.95,
        ge=0,
        le=1,
        description="λ of the generalised advantage estimation: 0 trusts the value after one "
        "decision, 1 the return of the episode alone [-]",
    )
    clip: float = Field(
        0.15,
        gt=0,
        le=1,
        description="change of an action's probability, as a share of it, beyond which an update "
        "gains nothing more [-]",
    )
    divergence: float = Field(
        0.02,
        gt=0,
        le=10,
        description="Kullback-Leibler divergence from what drove at which the policy stops to "
        "change until new episodes are driven [-]",
    )
    anchor: float = Field(
        0.0,
        ge=0,
        le=1000,
        description="weight of the divergence from the policy that the training starts with, which "
        "keeps what the advantages do not clearly change [-]",
    )
    advantage_clip: float | None = Field(
        None,
        gt=0,
        le=1000,
        description="standard deviations of a round's advantages beyond which an advantage counts "
        "as that much: rare failures outweigh all small differences else; null: unlimited [-]",
    )
    start_values: bool = Field(
        False,
        description="start with the values of the run that agent.start_from names, too, which must "
        "be one of agent.learner=policy_gradient; false: random weights [-]",
    )
    value_rate: float = Field(1e-3, gt=0, le=1, description="Adam step of the values [-]")
    value_passes: int = Field(
        8,
        ge=1,
        le=100,
        description="passes over the decisions of each of the first rounds, in which the values "
        "alone learn [-]",
    )
    warm_up: int = Field(
        3, ge=0, le=1000, description="first rounds, in which the values alone learn [-]"
    )

    def temperature_at(self, fraction: float) -> float:
        """Return the temperature after a ``fraction`` of the run, 0 to 1."""
        end = self.temperature if self.temperature_end is None else self.temperature_end
        return linear(self.temperature, end, fraction)
