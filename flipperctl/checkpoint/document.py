"""The JSON document in a checkpoint, written and read by the same models.

In: JSON text of any origin. Out: a ``Document`` whose values have valid types and bounds.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Final, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from flipperctl.checkpoint.sealed import decode
from flipperctl.core.targets import ACTIONS, JOINTS
from flipperctl.errors import OldVersionError
from flipperctl.messages import explain

FORMAT: Final = 2
"""Format number of version 0.3. Version 0.1 had 1; the documents of 0.2 lack ``actions``."""
EPISODES: Final = "episodes"
"""Document kind of recorded episodes, which are sealed like checkpoints."""
RECENT = 100
"""Number of episodes over which the running success rate is computed."""

BestBy = Literal["pitch_variation_100hz", "return", "decision"]
"""What ranks validations: success and θ̂_R at 100 Hz; the mean return; or how late they are."""
Count = Annotated[int, Field(ge=0, lt=2**63)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Label = Annotated[str, Field(pattern=r"^\P{C}*$")]  # fits on one line of an error
NonNegative = Annotated[float, Field(ge=0)]
Word128 = Annotated[int, Field(ge=0, lt=2**128)]


class Record(BaseModel):
    """A frozen model that converts nothing and refuses unknown keys, NaN and infinity."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class PartialPlugin(Record):
    """The settings of a plugin; all but the name stay unchecked, as the plugin may be missing."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]
    name: Label


class PartialReward(PartialPlugin):
    """The settings of a reward term."""

    weight: float


class PartialConfig(Record):
    """The part of a training configuration that can be read without its plugins."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]
    terrain: PartialPlugin
    rewards: dict[Label, PartialReward]
    network: PartialPlugin
    seed: Count


class Actions(Record):
    """The turn of each joint of the robot by each action, in angle steps."""

    joints: tuple[Label, ...]
    """Names of the J joints."""
    steps: tuple[tuple[int, ...], ...]
    """(A, J) in multiples of the robot's ``angle_step``, in the order of the Q-values."""

    @model_validator(mode="after")
    def _are_those_of_pairs(self) -> Self:
        if (self.joints, self.steps) != (JOINTS, ACTIONS):
            raise ValueError(
                f"the actions turn {', '.join(self.joints) or 'nothing'} in {len(self.steps)} ways;"
                f" this version turns {', '.join(JOINTS)} in {len(ACTIONS)}"
            )
        return self


class PluginReference(Record):
    """A plugin that the configuration names."""

    kind: Label
    name: Label
    module: Label
    file: Label | None = None
    """Name of its file; None if it was installed."""

    @model_serializer(mode="wrap")
    def _without_none(self, serialize: SerializerFunctionWrapHandler) -> dict[str, str]:
        """Omit ``file`` for an installed plugin."""
        return {name: text for name, text in serialize(self).items() if text is not None}


class Validation(Record):
    """The result of a validation: means of these and further metrics over its episodes."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]
    decision: Count
    success_rate: Fraction
    t_cost: NonNegative
    pitch_variation: NonNegative
    """θ̂_R at decisions [rad]."""
    pitch_variation_100hz: NonNegative
    """θ̂_R at 100 Hz [rad]."""
    mean_return: float | None = None
    """Mean return of all episodes without shaping [-]; the shipped ``mpc_value`` has none."""

    def score(self, best_by: BestBy) -> tuple[float, float]:
        """Return the key that the best validation maximises: success rate, then negated θ̂_R.

        With ``return`` it is the mean return, then the success rate; with ``decision``, the newest
        is the best.
        """
        if best_by == "decision":
            return float(self.decision), self.success_rate
        if best_by == "return" and self.mean_return is not None:
            return self.mean_return, self.success_rate
        return self.success_rate, -self.pitch_variation_100hz


class RequestState(Record):
    """A rollout request that was outstanding; its weights are among the tensors."""

    episode: Count
    seed: Count
    epsilon: Fraction
    decision: Count
    version: Count
    difficulty: Fraction


class Pcg64Words(Record):
    """The state of a PCG64 generator: two words of 128 bits."""

    state: Word128
    inc: Word128


class GeneratorState(Record):
    """The state of a random generator, as ``BitGenerator.state`` of numpy."""

    bit_generator: Literal["PCG64"]
    state: Pcg64Words
    has_uint32: Annotated[int, Field(ge=0, le=1)]
    uinteger: Annotated[int, Field(ge=0, lt=2**32)]


class Generators(Record):
    """The states of the random generators of a run."""

    explore: GeneratorState
    sample: GeneratorState
    noise: GeneratorState


class State(Record):
    """All that a run needs to be resumed, besides the tensors; nothing depends on the clock."""

    decision: Count
    episode: Count
    loss: float
    recent: Annotated[tuple[bool, ...], Field(max_length=RECENT)]
    validations: tuple[Validation, ...]
    best_by: BestBy
    """What the run chooses its best policy by."""
    started: Count
    lost: Count
    updates: Count
    difficulty: Fraction
    orders: tuple[RequestState, ...]
    """Outstanding requests, oldest first; the key's name is part of the format."""
    replay_added: Count
    replay_kept: Count
    """Number of recorded transitions in the replay."""
    groups_added: Count
    """Number of groups of valued states so far."""
    files: tuple[Label | None, ...]
    """SHA-256 of each file that the plugins read, such as recorded ground."""
    generators: Generators

    @property
    def best(self) -> Validation | None:
        """Best validation so far."""
        return max(self.validations, key=lambda v: v.score(self.best_by), default=None)

    @model_validator(mode="after")
    def _counts_agree(self) -> State:
        limits = {
            "episode": (self.episode, "decision", self.decision),
            "replay_added": (
                *(self.replay_added, "decision + replay_kept"),
                self.decision + self.replay_kept,
            ),
            "replay_kept": (self.replay_kept, "replay_added", self.replay_added),
            "lost": (self.lost, "started", self.started),
        }
        for at, request in enumerate(self.orders):
            limits[f"orders.{at}.version"] = (request.version, "updates", self.updates)
            limits[f"orders.{at}.decision"] = (request.decision, "decision", self.decision)
            limits[f"orders.{at}.episode"] = (request.episode, "started - 1", self.started - 1)
        for name, (value, bound, limit) in limits.items():
            if value > limit:
                raise ValueError(f"{name} is {value}, above {bound}, which is {limit}")
        return self


class Document(Record):
    """The document of a checkpoint of kind ``best`` (a policy) or ``last`` (a whole run)."""

    format: Literal[2]
    kind: Literal["best", "last"]
    config: PartialConfig
    versions: dict[Label, Label]
    plugins: tuple[PluginReference, ...]
    actions: Actions
    """Actions of the Q-values."""
    decision: Count | None = None
    """Decision of the run at which the best policy was validated."""
    validation: Validation | None = None
    """Result of that validation."""
    state: State | None = None
    """State of a whole run."""

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Document:
        best = self.kind == "best"
        if best != (self.validation is not None) or (best and self.decision is None):
            raise ValueError("decision and validation belong to the kind 'best', and to no other")
        if best == (self.state is not None):
            raise ValueError("a state belongs to the kind 'last', and to no other")
        return self

    def plain(self) -> dict[str, Any]:
        """Return the document as JSON types, without fields that are None."""
        return {k: v for k, v in self.model_dump(mode="json").items() if v is not None}

    def text(self) -> str:
        """Return the document as JSON text; equal documents give equal text."""
        return json.dumps(self.plain(), allow_nan=False)


def parse(text: str) -> Document:
    """Parse the JSON text of a document."""
    raw = decode(text)
    if raw.get("kind") == EPISODES:
        raise ValueError("it describes recorded episodes, which hold no policy")
    number = raw.get("format")
    old = type(number) is int and "config" in raw and (number == 1 or "actions" not in raw)
    if old and number in (1, FORMAT):
        version = "0.1" if number == 1 else "0.2"
        raise OldVersionError(version, f"train again, or use it with flipperctl {version}")
    if type(number) is not int or number != FORMAT:
        raise ValueError(f"its format is {number!r:.40}; this version reads {FORMAT}")
    try:
        return Document.model_validate_json(json.dumps(raw))
    except ValidationError as error:
        raise ValueError(explain(error, "document", Document)) from error
