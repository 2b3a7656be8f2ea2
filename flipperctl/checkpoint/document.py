"""Sealed files: a JSON document and tensors in a safetensors file, with a SHA-256 of both.

Reading detects every flipped bit and executes no code; keys of the document are unique and its
numbers finite. Equal contents give equal files, byte for byte. Checkpoints and recorded episodes
are such files. The document of a checkpoint is written and read by the same models, which refuse
what is of the wrong type or out of bounds.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import (
    AliasChoices,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
    model_validator,
)

from flipperctl.checkpoint import former
from flipperctl.core.reading import read_whole
from flipperctl.core.targets import JOINTS, actions_of
from flipperctl.errors import CheckpointError, other_format
from flipperctl.text.messages import explain

if TYPE_CHECKING:
    import torch

FORMAT: Final = 3
"""Format number of version 0.3."""
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


class Partial(Record):
    """The part of settings that can be read without their plugins; further ones stay unchecked."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, JsonValue]


class PartialPlugin(Partial):
    """The settings of a plugin."""

    name: Label


class PartialReward(PartialPlugin):
    """The settings of a reward term."""

    weight: float


class PartialConfig(Partial):
    """The settings of a training."""

    terrain: PartialPlugin
    rewards: dict[Label, PartialReward]
    network: PartialPlugin
    seed: Count


class Actions(Record):
    """The turn of each joint of the robot by each action, in angle steps; no steps for rates."""

    joints: tuple[Label, ...]
    """Names of the J joints."""
    steps: tuple[tuple[int, ...], ...]
    """(A, J) in multiples of the robot's ``angle_step``, in the order of the Q-values."""

    @model_validator(mode="after")
    def _are_known(self) -> Self:
        if self.joints not in JOINTS.values() or (
            self.steps and self.steps != actions_of(len(self.joints))
        ):
            known = " or ".join(f"{', '.join(j)} in {3 ** len(j)}" for j in JOINTS.values())
            raise ValueError(
                f"the actions turn {', '.join(self.joints) or 'nothing'} in {len(self.steps)} ways;"
                f" this version turns {known}"
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
    pitch_variation_decisions: NonNegative = Field(
        validation_alias=AliasChoices("pitch_variation_decisions", "pitch_variation")
    )
    """θ̂_R at decisions [rad]; until version 0.3 it was called ``pitch_variation``."""
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
    parts: tuple[Label, ...]
    """Parts of the tensors that belong to the learner."""
    learner: dict[Label, JsonValue]
    """What the learner keeps beside its tensors."""
    files: tuple[Label | None, ...]
    """SHA-256 of each file that the plugins read, such as recorded ground."""
    generators: dict[Label, GeneratorState]

    @property
    def best(self) -> Validation | None:
        """Best validation so far."""
        return max(self.validations, key=lambda v: v.score(self.best_by), default=None)


class Document(Record):
    """The document of a checkpoint of kind ``best`` (a policy) or ``last`` (a whole run)."""

    format: Literal[3]
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


RecordT = TypeVar("RecordT", bound=Record)


def validated(model: type[RecordT], raw: Mapping[str, Any], number: int) -> RecordT:
    """Return a document of the format ``number`` as its model."""
    version = raw.get("format")
    if type(version) is not int or version != number:
        raise ValueError(other_format(version, number))
    try:
        return model.model_validate_json(json.dumps(raw))
    except ValidationError as error:
        raise ValueError(explain(error, "document", model)) from error


@contextmanager
def naming_document(path: Path) -> Iterator[None]:
    """Name the file whose document is not valid."""
    try:
        yield
    except ValueError as error:
        raise CheckpointError(f"{path}: its document is not valid: {error}") from error


def parse(text: str) -> Document:
    """Parse the JSON text of a checkpoint's document."""
    raw = decode(text)
    if raw.get("kind") == EPISODES:
        raise ValueError("it describes recorded episodes, which hold no policy")
    return validated(Document, former.document(raw), FORMAT)


def decode(text: str) -> dict[str, Any]:
    """Return the mapping of a JSON text whose keys are unique and whose numbers are finite."""
    try:
        raw = json.loads(
            text, object_pairs_hook=_unique_keys, parse_constant=_finite, parse_float=_finite
        )
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    if not isinstance(raw, dict):
        raise ValueError(f"it must be a mapping; it is a {type(raw).__name__}")
    return raw


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping: dict[str, Any] = {}
    for name, value in pairs:
        if name in mapping:
            raise ValueError(f"it holds the key {name!r:.40} twice")
        mapping[name] = value
    return mapping


def _finite(number: str) -> float:
    if not math.isfinite(value := float(number)):
        raise ValueError(f"it holds {number:.40}; finite numbers are allowed")
    return value


def require_equal_layout(
    tensors: Mapping[str, torch.Tensor], expected: Mapping[str, torch.Tensor]
) -> None:
    """Check that tensors have the expected names, shapes and types and hold finite numbers.

    A number may be infinite where the expected one is infinite, as in a mask.
    """
    if missing := sorted(expected.keys() - tensors.keys()):
        raise ValueError(f"{missing[0]} is missing")
    if unknown := sorted(tensors.keys() - expected.keys()):
        raise ValueError(f"there is no tensor {unknown[0]!r:.60}")
    for name, wanted in expected.items():  # safetensors lists a file's tensors in any order
        tensor = tensors[name]
        if tensor.shape != wanted.shape or tensor.dtype != wanted.dtype:
            raise ValueError(
                f"{name} is {_shape_and_type(tensor)}; {_shape_and_type(wanted)} is needed"
            )
        if not bool((tensor.isfinite() | ~wanted.cpu().isfinite()).all()):
            raise ValueError(f"{name} holds numbers that are not finite")


def _shape_and_type(tensor: torch.Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)}"


def serialize(text: str, tensors: Mapping[str, torch.Tensor]) -> bytes:
    """Return the bytes of a sealed file with its checksum; equal arguments give equal bytes.

    ``text``: the JSON text of the document.
    """
    from safetensors.torch import save

    stored = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    metadata = {"flipperctl": text, "sha256": digest(text, stored)}
    # A tensor with several names is written once; of memory that several share, each has a copy.
    written: dict[str, torch.Tensor] = {}
    names: dict[tuple[object, ...], str] = {}
    aliases: dict[str, str] = {}
    memory: set[int] = set()
    for name, tensor in stored.items():
        storage = tensor.untyped_storage().data_ptr()
        place = (storage, tensor.storage_offset(), tensor.shape, tensor.dtype)
        if tensor.numel() and (original := names.setdefault(place, name)) != name:
            aliases[name] = original
        else:
            written[name] = tensor.clone() if storage in memory else tensor
            memory.add(storage)
    if aliases:
        metadata["aliases"] = json.dumps(aliases)
    data = save(written, metadata)
    # safetensors writes its metadata in an order that differs between processes.
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    ordered = {"__metadata__": dict(sorted(header.pop("__metadata__").items())), **header}
    text = json.dumps(ordered, separators=(",", ":"))
    text += " " * (-len(text) % 8)  # tensors lie at multiples of 8 bytes
    return len(text).to_bytes(8, "little") + text.encode() + data[8 + length :]


def read(path: Path, noun: str) -> tuple[str, dict[str, torch.Tensor]]:
    """Return the text of the document and the tensors of a sealed file.

    ``noun``: kind of file for the errors, such as "checkpoint".
    """
    import safetensors.torch  # noqa: F401  # takes a second, before the file is opened

    if not path.is_file():
        raise CheckpointError(f"{path}: there is no such {noun}")
    try:
        return read_whole(path, lambda data: _contents(data, path, noun), CheckpointError)
    except FileNotFoundError as error:
        raise CheckpointError(f"{path}: there is no such {noun}") from error
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror}") from error


def _contents(data: bytes, path: Path, noun: str) -> tuple[str, dict[str, torch.Tensor]]:
    """Return the text and the tensors of the bytes of the file at ``path``."""
    from safetensors import SafetensorError
    from safetensors.torch import load

    start = data[:9]
    # A safetensors file begins with the length of its header, 8 bytes of any value, and "{"; a
    # pickle with 0x80 and the number of its protocol, 2 to 5.
    pickled = start[:1] == b"\x80" and start[1:2] in (b"\2", b"\3", b"\4", b"\5")
    if start[8:] != b"{" and (pickled or start[:4] == b"PK\x03\x04"):
        raise CheckpointError(
            f"{path} is a pickle or a zip archive, not a safetensors file; "
            "flipperctl never loads these, since they can run code. flipperctl.save writes the "
            "network of a model of your own (docs/own_method.md), and train agent=sb3 trains one"
        )
    try:
        tensors = load(data)
        length = int.from_bytes(data[:8], "little")
        metadata = json.loads(data[8 : 8 + length]).get("__metadata__", {})
        aliases = json.loads(metadata.get("aliases", "{}"))
        # Further names of a tensor lead to the same tensor again.
        tensors |= {name: tensors[original] for name, original in aliases.items()}
    except (SafetensorError, ValueError, TypeError, AttributeError, KeyError) as error:
        raise CheckpointError(f"{path} is damaged or not a safetensors file: {error}") from error
    # A file of another program is not called damaged.
    if "flipperctl" not in metadata:
        raise CheckpointError(f"{path} is a safetensors file, but not a {noun} of flipperctl")
    text = metadata["flipperctl"]
    if metadata.get("sha256") != digest(text, tensors):
        raise CheckpointError(f"{path} is damaged: its SHA-256 does not match its contents")
    return text, tensors


def digest(text: str, tensors: Mapping[str, torch.Tensor]) -> str:
    """Return the SHA-256 of a text and of the names, types, shapes and values of tensors."""
    import torch

    digest = hashlib.sha256(text.encode())
    # Sorted, since safetensors lists the tensors of a file in any order.
    for name in sorted(tensors):
        tensor = tensors[name].contiguous()
        digest.update(f"{name}:{tensor.dtype}:{tuple(tensor.shape)}".encode())
        if tensor.numel():  # torch refuses to view an empty tensor as bytes
            digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
