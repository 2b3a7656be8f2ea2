"""The section ``agent``: the double dueling DQN."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from flipperctl.api import Outcome, Settings
from flipperctl.config.policy_gradient import PolicyGradient
from flipperctl.core.escape import EscapeRule
from flipperctl.errors import ConfigError


class Agent(Settings):
    """The double dueling DQN. The paper gives none of these numbers."""

    learner: Literal["d3qn", "policy_gradient"] = Field(
        "d3qn",
        description="d3qn: the double dueling DQN, by temporal differences and a teacher's labels; "
        "policy_gradient: draws its actions and makes more probable what earned more than was "
        "expected; best from the weights of a trained policy (agent.start_from) [-]",
    )
    policy_gradient: PolicyGradient = Field(
        PolicyGradient(), description="settings of agent.learner=policy_gradient; see there [-]"
    )
    start_from: str | None = Field(
        None,
        description="a run, a checkpoint or a shipped policy whose weights the networks start "
        "with; its network must be the same; null: random weights [-]",
    )
    learning_rate: float = Field(1e-3, gt=0, le=1, description="Adam step at the start [-]")
    learning_rate_end: float = Field(
        2e-5, ge=0, le=1, description="Adam step at the end, reached linearly [-]"
    )
    gamma: float = Field(0.99, ge=0, lt=1, description="discount per decision [-]")
    n_step: int = Field(3, ge=1, le=50, description="decisions summed before bootstrapping [-]")
    cut_at_random: bool = Field(
        False,
        description="end a sum of n_step rewards before the next random action, so that it rates "
        "the policy instead of its exploration [-]",
    )
    privileged_value: bool = Field(
        False,
        description="let a second network, which sees the ground ahead and the distance to the "
        "finish, learn what they change in all actions' values alike; policies do without it [-]",
    )
    risk: bool = Field(
        False,
        description="let a small network beside the policy learn the probability that the episode "
        "fails within the next risk_horizon decisions; it changes nothing that the policy learns, "
        "and comes with its checkpoints and exports [-]",
    )
    risk_horizon: int = Field(
        10,
        ge=5,
        le=200,
        description="decisions before the end of a failed episode that count as about to fail [-]",
    )
    risk_false_alarms: float = Field(
        0.1,
        ge=0,
        le=1,
        description="largest share of the validation episodes that reach the finish in which the "
        "policy may warn; it chooses the threshold of the warnings [-]",
    )
    escape_temperature: float = Field(
        0.0,
        ge=0,
        le=1000,
        description="difference of Q-values by which an action becomes e times less probable while "
        "the trained policy warns, when it draws its actions instead of repeating what did not "
        "help; 0: it never draws them. It needs agent.risk [-]",
    )
    escape_decisions: int = Field(
        4,
        ge=1,
        le=1000,
        description="decisions from a warning on whose actions are drawn with "
        "agent.escape_temperature above 0 [-]",
    )
    batch_size: int = Field(128, ge=2, le=65536, description="transitions per update [-]")
    replay_size: int = Field(
        100_000, ge=100, le=10_000_000, description="capacity of the replay [-]"
    )
    learning_starts: int = Field(
        1000,
        ge=1,
        le=10_000_000,
        description="decisions before the first update, including those of teacher.episodes [-]",
    )
    update_every: int = Field(2, ge=1, le=1000, description="decisions per update [-]")
    updates_together: int = Field(
        4,
        ge=1,
        le=64,
        description="updates in a row whose targets are computed in one pass before the first; "
        "1 is the textbook algorithm [-]",
    )
    target_rate: float = Field(
        0.005,
        gt=0,
        le=1,
        description="fraction of the online weights mixed into the target per update [-]",
    )
    epsilon_start: float = Field(
        1.0,
        ge=0,
        le=1,
        description="fraction of random actions at the start; 0, with epsilon_end=0, suits "
        "networks that explore with their own noise [-]",
    )
    epsilon_end: float = Field(
        0.05, ge=0, le=1, description="fraction of random actions at the end [-]"
    )
    epsilon_decisions: int = Field(
        15_000, ge=1, le=100_000_000, description="decisions over which ε falls linearly [-]"
    )
    exploring_share: float = Field(
        1.0,
        ge=0,
        le=1,
        description="share of the episodes that have random actions; the others show where the "
        "policy gets stuck without them [-]",
    )
    gradient_norm: float = Field(
        10.0, gt=0, le=1e6, description="gradients are clipped to this norm [-]"
    )
    reward_scale: float = Field(
        0.1,
        gt=0,
        le=1e6,
        description="rewards are multiplied by this factor inside the learner [-]",
    )
    act_with: Literal["target", "online"] = Field(
        "target",
        description="weights that are validated and exported: the slowly following target "
        "or the online network [-]",
    )
    bootstrap_outcomes: tuple[Outcome, ...] = Field(
        (), description="outcomes after which the target bootstraps [-]"
    )

    @property
    def escape(self) -> EscapeRule | None:
        """How the trained policy draws its actions while it warns; None if it never does."""
        if not self.escape_temperature:
            return None
        return EscapeRule(self.escape_temperature, self.escape_decisions)

    @property
    def draws(self) -> bool:
        """Whether the training's episodes have drawn actions, from which the learner learns."""
        return self.learner == "policy_gradient"

    @model_validator(mode="after")
    def _fits_policy_gradient(self) -> Self:
        if not self.draws:
            return self
        if self.policy_gradient.start_values and self.start_from is None:
            raise ConfigError(
                "agent.policy_gradient.start_values: true needs a run whose values to start with; "
                "name it in agent.start_from, or leave it at false"
            )
        needed = 2 * self.policy_gradient.decisions  # a round ends with a whole episode
        for name, wrong, allowed in (
            ("n_step", self.n_step != 1, "1"),
            ("bootstrap_outcomes", bool(self.bootstrap_outcomes), "[]"),
            ("replay_size", self.replay_size < needed, f"{needed} (twice its decisions) or more"),
        ):
            if wrong:
                raise ConfigError(
                    f"agent.{name}: {getattr(self, name)} does not go with "
                    f"agent.learner=policy_gradient; {allowed} is allowed"
                )
        return self

    @model_validator(mode="after")
    def _escapes_on_warnings(self) -> Self:
        if self.escape_temperature and not self.risk:
            raise ConfigError(
                f"agent.escape_temperature: {self.escape_temperature:g} needs warnings; set "
                "agent.risk=true, or leave it at 0"
            )
        return self
