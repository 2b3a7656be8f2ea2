"""What a checkpoint says of itself: one JSON document, written and read by the same models.

In: JSON text, of any origin. Out: a ``Document``, every value of which has its type and bounds.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError, model_validator

from flipperctl.messages import explain

FORMAT: Final = 2
"""1 held the state of a run in another form; its policies can still be read."""
RECENT = 100
"""Episodes over which the running success rate is taken."""

Count = Annotated[int, Field(ge=0, lt=2**63)]
Share = Annotated[float, Field(ge=0, le=1)]
Label = Annotated[str, Field(pattern=r"^\P{C}*$")]  # fits on one line of an error
Word128 = Annotated[int, Field(ge=0, lt=2**128)]


class _Record(BaseModel):
    """Frozen; nothing is converted, unknown keys, NaN and infinity are errors."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class PluginOutline(_Record):
    """A plugin's settings, of which only the name is known when it is not installed."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]
    name: Label


class RewardOutline(PluginOutline):
    """The settings of a reward term."""

    weight: float


class ConfigOutline(_Record):
    """A training configuration, as far as it can be read without its plugins."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]
    terrain: PluginOutline
    rewards: dict[Label, RewardOutline]
    network: PluginOutline
    seed: Count


class PluginReference(_Record):
    """A plugin that the configuration names."""

    kind: Label
    name: Label
    module: Label


class Validation(_Record):
    """Means over the episodes of a validation; further metrics stand beside these."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, float]
    decision: Count
    success_rate: Share
    t_cost: Annotated[float, Field(ge=0)]
    pitch_variation: Annotated[float, Field(ge=0)]


class OrderState(_Record):
    """An episode that was ordered and has not come back."""

    episode: Count
    seed: Count
    epsilon: Share
    decision: Count
    version: Count
    difficulty: Share


class Pcg64Words(_Record):
    """The two words of a PCG64 generator."""

    state: Word128
    inc: Word128


class GeneratorState(_Record):
    """A random generator, as ``numpy`` gives and takes it."""

    bit_generator: Literal["PCG64"]
    state: Pcg64Words
    has_uint32: Annotated[int, Field(ge=0, le=1)]
    uinteger: Annotated[int, Field(ge=0, lt=2**32)]


class Generators(_Record):
    """The random generators of a run."""

    explore: GeneratorState
    sample: GeneratorState
    noise: GeneratorState


class State(_Record):
    """All that a run needs to go on, beside the tensors; nothing in it depends on the clock."""

    decision: Count
    episode: Count
    loss: float
    recent: Annotated[tuple[bool, ...], Field(max_length=RECENT)]
    validations: tuple[Validation, ...]
    started: Count
    lost: Count
    updates: Count
    difficulty: Share
    orders: tuple[OrderState, ...]
    replay_added: Count
    generators: Generators

    @model_validator(mode="after")
    def _counts_agree(self) -> State:
        limits = {
            "episode": (self.episode, "decision", self.decision),
            "replay_added": (self.replay_added, "decision", self.decision),
            "lost": (self.lost, "started", self.started),
        }
        for at, order in enumerate(self.orders):
            limits[f"orders.{at}.version"] = (order.version, "updates", self.updates)
            limits[f"orders.{at}.decision"] = (order.decision, "decision", self.decision)
            limits[f"orders.{at}.episode"] = (order.episode, "started - 1", self.started - 1)
        for name, (value, bound, limit) in limits.items():
            if value > limit:
                raise ValueError(f"{name} is {value}, above {bound}, which is {limit}")
        return self


class Document(_Record):
    """The metadata of a checkpoint."""

    format: Literal[1, 2]
    kind: Literal["best", "last"]
    config: ConfigOutline
    versions: dict[Label, Label]
    plugins: tuple[PluginReference, ...]
    decision: Count | None = None
    validation: Validation | None = None
    """With ``decision``: where the best policy was found, and what it reached."""
    state: State | None = None
    """Of a whole run; None for a run of format 1, which cannot go on."""

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Document:
        best = self.kind == "best"
        if best != (self.validation is not None) or (best and self.decision is None):
            raise ValueError("decision and validation belong to the kind 'best', and to no other")
        if best and self.state is not None:
            raise ValueError("a state belongs to the kind 'last'")
        if not best and self.format == FORMAT and self.state is None:
            raise ValueError("the kind 'last' needs a state")
        return self

    def plain(self) -> dict[str, Any]:
        """The document as JSON types, without what it does not have."""
        return {k: v for k, v in self.model_dump(mode="json").items() if v is not None}

    def text(self) -> str:
        """The document as JSON; equal documents give equal text, and orders are kept."""
        return json.dumps(self.plain(), allow_nan=False)


def parse(text: str) -> Document:
    """The document that a text holds.

    Raises:
        ValueError: it is none; the text names the path within it.
    """
    try:
        raw = json.loads(
            text, object_pairs_hook=_unique, parse_constant=_refuse, parse_float=_finite
        )
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    if not isinstance(raw, dict):
        raise ValueError(f"it must be a mapping; it is a {type(raw).__name__}")
    number = raw.get("format")
    if type(number) is not int or number not in (1, FORMAT):
        raise ValueError(f"its format is {number!r:.40}; this version reads 1 and {FORMAT}")
    if number == 1 and isinstance(state := raw.pop("state", None), Mapping):
        raw["decision"] = state.get("decision")
    try:
        return Document.model_validate_json(json.dumps(raw))
    except ValidationError as error:
        raise ValueError(explain(error, "document", Document)) from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"it holds the key {twice!r:.40} twice")
    return found


def _refuse(constant: str) -> float:
    raise ValueError(f"it holds {constant}; finite numbers are allowed")


def _finite(number: str) -> float:
    value = float(number)
    return value if math.isfinite(value) else _refuse(number[:40])
