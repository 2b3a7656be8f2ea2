"""The section ``teacher``: settings of a teacher, for learners that take one."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from flipperctl.api import Controller, Settings
from flipperctl.config.resolver import create, to_dict
from flipperctl.errors import ConfigError

Share = Annotated[float, Field(ge=0, le=1)]
PositiveShare = Annotated[float, Field(gt=0, le=1)]
Weight = Annotated[float, Field(ge=0, le=1000)]
Temperature = Annotated[float, Field(ge=1e-6, le=1000)]


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
        """Whether there are labels: a controller's, or labels of recorded episodes."""
        return self.controller is not None or self.episodes is not None

    @model_validator(mode="after")
    def _check(self) -> Teacher:
        # Words that stand for no file, and combinations in which nothing would be learned
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
