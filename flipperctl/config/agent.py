"""The sections ``agent`` and ``teacher``: settings of the learners and of a teacher."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from flipperctl.api import Controller, Outcome, Settings
from flipperctl.config.resolver import create, to_dict
from flipperctl.core.risk import EscapeRule
from flipperctl.errors import ConfigError

Share = Annotated[float, Field(ge=0, le=1)]
PositiveShare = Annotated[float, Field(gt=0, le=1)]
Weight = Annotated[float, Field(ge=0, le=1000)]
Temperature = Annotated[float, Field(ge=1e-6, le=1000)]


def linear(start: float, end: float, fraction: float) -> float:
    """Interpolate from ``start`` at fraction 0 to ``end`` at fraction 1, constant outside."""
    return start + (end - start) * min(1.0, max(0.0, fraction))


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
        "be one of agent.learner=policy_gradient; false: random weights [-]",
    )
    warm_up: int = Field(
        3, ge=0, le=1000, description="first rounds, in which the values alone learn [-]"
    )

    def temperature_at(self, fraction: float) -> float:
        """Return the temperature after a ``fraction`` of the run, 0 to 1."""
        end = self.temperature if self.temperature_end is None else self.temperature_end
        return linear(self.temperature, end, fraction)


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
    candidates: int = Field(
        1,
        ge=1,
        le=64,
        description="transitions drawn for each one that an update learns from; those with larger "
        "errors are chosen more often (prioritised replay); 1, or a teacher: none is preferred [-]",
    )
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
    target_rate: PositiveShare = Field(
        0.005,
        description="fraction of the online weights mixed into the target per update [-]",
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
    gradient_norm: float = Field(
        10.0, gt=0, le=1e6, description="gradients are clipped to this norm [-]"
    )
    reward_scale: float = Field(
        0.1,
        gt=0,
        le=1e6,
        description="rewards are multiplied by this factor inside the learner [-]",
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
    def is_policy_gradient(self) -> bool:
        """Whether the learner samples its actions and learns from what they earn."""
        return self.learner == "policy_gradient"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.escape_temperature and not self.risk:
            raise ConfigError(
                f"agent.escape_temperature: {self.escape_temperature:g} needs warnings; set "
                "agent.risk=true, or leave it at 0"
            )
        if self.curiosity and (self.n_step != 1 or self.is_policy_gradient):
            raise ConfigError(
                f"agent.curiosity: {self.curiosity:g} is about single transitions of "
                "agent.learner=d3qn; set agent.n_step=1, or leave it at 0"
            )
        if not self.is_policy_gradient:
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


def _controller(value: object) -> object:
    return None if value is None else create("controller", value, "teacher.controller")


def _plain(value: Controller | None) -> object:
    return None if value is None else to_dict(value)


AnyController = Annotated[Controller | None, BeforeValidator(_controller), PlainSerializer(_plain)]


class Teacher(Settings):
    """A controller that labels every visited state with the actions that it would take.

    Recorded episodes can teach in addition or alone. The network learns the labels by ``loss``,
    in addition to or instead of the temporal difference.
    """

    controller: AnyController = Field(
        None, description="controller that teaches; null for none, as teacher=none sets it [-]"
    )
    privileged: bool = Field(
        False,
        description="whether the teacher perceives ground and posture exactly, without delay, and "
        "knows the sampled robot and friction, while the student perceives as configured [-]",
    )
    episodes: str | None = Field(
        None,
        description="file of recorded episodes, as written by eval --record or train.record, to "
        "learn from as well; null for none [-]",
    )
    student_share: Share = Field(
        0.6,
        description="fraction of episodes in which, once it learns, the student acts [-]",
    )
    label_share: PositiveShare = Field(
        1.0,
        description="fraction of the decisions in the student's episodes that the teacher labels; "
        "fewer labels an episode let it learn from more episodes [-]",
    )
    random: Share = Field(0.1, description="fraction of random actions while the teacher acts [-]")
    temperature: Temperature = Field(
        0.3,
        description="difference of the teacher's costs by which an action becomes e times less "
        "probable [s]",
    )
    loss: Literal["cross_entropy", "margin", "values"] = Field(
        "cross_entropy",
        description="cross_entropy: between the labels and softmax(Q / q_temperature); margin: the "
        "most probable action's Q-value should exceed all others by margin (DQfD); values: the "
        "Q-values should differ as those that the teacher computes for many states of each "
        "episode's ground, as value_iteration does [-]",
    )
    weight: Weight = Field(1.0, description="weight of the labels' loss at the start [-]")
    weight_end: Weight = Field(
        1.0,
        description="weight of the labels' loss at the end, reached linearly [-]",
    )
    td_weight: Weight = Field(
        1.0,
        description="weight of the temporal-difference loss; 0 is pure imitation, whose Q-values "
        "order the actions but estimate no return [-]",
    )
    q_temperature: Temperature = Field(
        0.1,
        description="scale of the Q-values in the student's softmax, in scaled rewards [-]",
    )
    margin: float = Field(
        0.8,
        gt=0,
        le=1000,
        description="margin of the teacher's action over others in Q-values, scaled rewards [-]",
    )
    final_updates: int = Field(
        0,
        ge=0,
        le=100_000_000,
        description="updates after the last decision, in which a network that begins with the "
        "weights of the start learns all labels anew; it replaces the one that drove. 0: none; "
        "with teacher.td_weight=0 alone [-]",
    )
    clip: float = Field(
        5.0,
        gt=0,
        le=1000,
        description="loss=values: multiple of the mean difference to the best action beyond which "
        "an action only has to be worse [-]",
    )
    batch_groups: int = Field(
        64, ge=1, le=4096, description="loss=values: groups of states per update [-]"
    )
    kept_groups: int = Field(
        60_000,
        ge=1,
        le=10_000_000,
        description="loss=values: groups of states that are remembered [-]",
    )

    @property
    def teaches(self) -> bool:
        """Whether there are labels: a controller's, or those of recorded episodes."""
        return self.controller is not None or self.episodes is not None

    @model_validator(mode="after")
    def _check(self) -> Teacher:
        if self.episodes == "":
            raise ConfigError(
                "teacher.episodes: the name of a file is needed; flipperctl eval --record FILE and "
                "train.record=true write one"
            )
        if not self.teaches:
            return self
        controller = self.controller
        if (
            controller is not None
            and controller.searches_first
            and not controller.closed_loop
            and (self.student_share or self.random)
        ):
            raise ConfigError(
                f"teacher.controller: {controller.plugin_name} plans whole episodes before "
                "they begin and cannot label states that others reach; set teacher.student_share=0 "
                "and teacher.random=0"
            )
        if not self.td_weight and not (self.weight and self.weight_end):
            raise ConfigError(
                "teacher.td_weight: 0 needs teacher.weight and teacher.weight_end above 0, since "
                "there is no other loss"
            )
        if self.final_updates and (self.td_weight or self.loss == "values"):
            raise ConfigError(
                f"teacher.final_updates: {self.final_updates} updates learn from labels alone; 0, "
                "or teacher.td_weight=0 with teacher.loss=cross_entropy or margin, is allowed"
            )
        return self
