"""Settings of the double DQN and of the policy gradient, and what both say of a policy."""

from __future__ import annotations

from typing import Any, ClassVar, Self

from pydantic import Field, model_validator

from flipperctl.api import FailureRisk, Learner, Outcome
from flipperctl.config import TrainConfig
from flipperctl.config.teacher import PositiveShare, Share, Temperature, Weight
from flipperctl.core.risk import EscapeRule
from flipperctl.errors import ConfigError


def linear(start: float, end: float, fraction: float) -> float:
    """Interpolate from ``start`` at fraction 0 to ``end`` at fraction 1, constant outside."""
    return start + (end - start) * min(1.0, max(0.0, fraction))


class PairSettings(Learner):
    """Settings of a learner with an online and a target network, a replay and perhaps a risk."""

    drives_by_outputs: ClassVar[bool] = True

    start_from: str | None = Field(
        None,
        description="a run, a checkpoint or a shipped policy whose weights the networks start "
        "with; its network must be the same; null: random weights [-]",
    )
    learning_rate: float = Field(1e-3, gt=0, le=1, description="Adam step at the start [-]")
    learning_rate_end: float = Field(
        2e-5, ge=0, le=1, description="Adam step at the end, reached linearly [-]"
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
    risk_false_alarms: Share = Field(
        0.1,
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
        description="decisions from a warning on that are drawn with agent.escape_temperature [-]",
    )
    batch_size: int = Field(128, ge=2, le=65536, description="transitions per update [-]")
    replay_size: int = Field(
        100_000, ge=100, le=10_000_000, description="capacity of the replay [-]"
    )
    target_rate: PositiveShare = Field(
        0.005,
        description="fraction of the online weights mixed into the target per update [-]",
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

    @property
    def failure_risk(self) -> FailureRisk | None:
        """Horizon, false alarms and escape of the risk; None if none is learnt."""
        if not self.risk:
            return None
        drawn = EscapeRule(self.escape_temperature, self.escape_decisions)
        escape = drawn if self.escape_temperature else None
        return FailureRisk(self.risk_horizon, self.risk_false_alarms, escape)

    @model_validator(mode="after")
    def _escapes_by_warnings(self) -> Self:
        if self.escape_temperature and not self.risk:
            raise ConfigError(
                f"agent.escape_temperature: {self.escape_temperature:g} needs warnings; set "
                "agent.risk=true, or leave it at 0"
            )
        return self


class D3qnSettings(PairSettings):
    """Settings of the double dueling DQN. The paper gives none of these numbers."""

    takes_teacher: ClassVar[bool] = True

    n_step: int = Field(3, ge=1, le=50, description="decisions summed before bootstrapping [-]")
    double: bool = Field(
        True,
        description="let the online network choose the next action and the target network value it "
        "(double Q-learning); false: the target network does both, which overestimates [-]",
    )
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
    curiosity: float = Field(
        0.0,
        ge=0,
        le=1e3,
        description="weight of a reward for transitions that networks beside the policy cannot "
        "predict yet (ICM, Pathak et al. 2017); 0: none. It needs agent.n_step=1 [-]",
    )
    priority: Share = Field(
        0.0,
        description="exponent of a transition's last error in the probability that an update "
        "learns from it (prioritised replay); 0, or a teacher: all are alike [-]",
    )
    priority_correction: Share = Field(
        0.5,
        description="exponent of that probability in the weight of the loss: 1 takes the whole "
        "preference back in the mean [-]",
    )
    priority_floor: float = Field(
        0.1,
        gt=0,
        le=1e6,
        description="added to each error, so that no transition is never learnt from, in scaled "
        "rewards [-]",
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
    epsilon_start: Share = Field(
        1.0,
        description="fraction of random actions at the start; 0, with epsilon_end=0, suits "
        "networks that explore with their own noise [-]",
    )
    epsilon_end: Share = Field(0.05, description="fraction of random actions at the end [-]")
    epsilon_decisions: int = Field(
        15_000, ge=1, le=100_000_000, description="decisions over which ε falls linearly [-]"
    )
    exploring_share: Share = Field(
        1.0,
        description="share of the episodes that have random actions; the others show where the "
        "policy gets stuck without them [-]",
    )
    bootstrap_outcomes: tuple[Outcome, ...] = Field(
        (), description="outcomes after which the target bootstraps [-]"
    )

    @property
    def value_scale(self) -> float:
        """Factor from returns to Q-values."""
        return self.reward_scale

    def epsilon(self, decision: int) -> float:
        """Return the probability of a random action at a decision of the run."""
        return linear(self.epsilon_start, self.epsilon_end, decision / self.epsilon_decisions)

    @model_validator(mode="after")
    def _curious_of_single_transitions(self) -> Self:
        if self.curiosity and self.n_step != 1:
            raise ConfigError(
                f"agent.curiosity: {self.curiosity:g} is about single transitions; set "
                "agent.n_step=1, or leave it at 0"
            )
        return self

    def privileged(self, config: TrainConfig) -> bool:
        """Return whether the training needs privileged states; labels alone need no baseline."""
        teacher = config.teacher
        return self.privileged_value and not (teacher.teaches and not teacher.td_weight)


class GradientSettings(PairSettings):
    """Settings of the policy gradient. The paper has none."""

    decisions: int | None = Field(
        None,
        ge=2,
        le=10_000_000,
        description="decisions of whole episodes that are driven before the policy is improved by "
        "them, half of agent.replay_size at most; null: a fortieth of train.decisions, from 2,048 "
        "to 24,576 [-]",
    )
    passes: int = Field(3, ge=1, le=100, description="passes over these decisions [-]")
    temperature: Temperature = Field(
        0.05,
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
    trace: Share = Field(
        0.95,
        description="λ of the generalised advantage estimation: 0 trusts the value after one "
        "decision, 1 the return of the episode alone [-]",
    )
    clip: PositiveShare = Field(
        0.15,
        description="change of an action's probability, as a share, past which no update gains [-]",
    )
    divergence: float = Field(
        0.02,
        gt=0,
        le=10,
        description="Kullback-Leibler divergence from what drove at which the policy stops to "
        "change until new episodes are driven [-]",
    )
    anchor: Weight = Field(
        0.0,
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
        "be one of agent=policy_gradient; false: random weights [-]",
    )
    warm_up: int = Field(
        3, ge=0, le=1000, description="first rounds, in which the values alone learn [-]"
    )

    def round_size(self, budget: int) -> int:
        """Return the decisions of a round in a training of ``budget`` decisions."""
        if self.decisions is not None:
            return self.decisions
        # Noisy rounds that are many teach more than a few exact ones.
        return min(max(budget // 40, 2048), 24576, self.replay_size // 2)

    def temperature_at(self, fraction: float) -> float:
        """Return the temperature after a ``fraction`` of the run, 0 to 1."""
        end = self.temperature if self.temperature_end is None else self.temperature_end
        return linear(self.temperature, end, fraction)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.start_values and self.start_from is None:
            raise ConfigError(
                "agent.start_values: true needs a run whose values to start with; "
                "name it in agent.start_from, or leave it at false"
            )
        # A round ends with a whole episode.
        if self.decisions is not None and self.replay_size < (needed := 2 * self.decisions):
            raise ConfigError(
                f"agent.replay_size: {self.replay_size} is too small; {needed} (twice "
                "agent.decisions) or more is allowed"
            )
        return self

    def privileged(self, config: Any) -> bool:
        """Return that the values see the true state."""
        return True
