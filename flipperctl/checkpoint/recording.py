"""Files of recorded episodes: observation, action, reward and label of every decision.

In: episodes of a controller, a policy or a training. Out: a sealed file (see ``document``). Its
document describes the environments; its tensors hold the episodes of T decisions one after the
other:

- ``observation``, float32: the T + 1 observations of each episode, each (n,) in SI units and of
  one instant, so that any network can stack them; the last one follows the last decision;
- ``action``, int64: the indices of the T actions;
- ``reward``, float64: the T sums of the weighted reward terms;
- ``label``, float32: the T target distributions (3^J,) over actions for a student, each with the
  sum 1, or zeros without a teacher;
- ``command``, float64, of episodes that an operator drove: ``numbers`` of the K commands, (K, 5),
  of four flippers (K, 9).
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from flipperctl import __version__
from flipperctl.api import ObservationLayout, Outcome, RecordedEpisode
from flipperctl.checkpoint import document as sealed
from flipperctl.checkpoint.document import (
    EPISODES,
    Count,
    Label,
    Partial,
    PartialReward,
    Record,
    decode,
    naming_document,
    require_equal_layout,
    validated,
)
from flipperctl.config import EnvConfig, to_dict
from flipperctl.config.policy_file import drive_files
from flipperctl.core.targets import Flippers
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.sim.versions import engine_versions
from flipperctl.text.files import OutputKind, write_bytes

if TYPE_CHECKING:
    import torch

FORMAT: Final = 2
"""Format number of these files."""
NOUN = "file of recorded episodes"
KIND = OutputKind(f"a {NOUN}", (".safetensors",), re.compile(rb'\\"kind\\": ?\\"episodes\\"'))
_SUM = 1e-3  # largest error of a label's sum
_ENTERED = ("number", "seed", "terrain", "outcome")  # fields of an episode in the document


class PartialPerception(Partial):
    """The observation layout, with further settings of the sensor."""

    bins: Annotated[int, Field(ge=3, le=101)]
    bin_width: Annotated[float, Field(gt=0, le=1)]
    highest: bool
    sides: bool = False
    flippers: Flippers = "pairs"

    @property
    def layout(self) -> ObservationLayout:
        """The layout alone."""
        return ObservationLayout(**{n: getattr(self, n) for n in ObservationLayout.model_fields})


class PartialEnvironment(Partial):
    """The configuration of an environment."""

    perception: PartialPerception
    robot: dict[Label, float | str | None]
    rewards: dict[Label, PartialReward]


class EpisodeEntry(Record):
    """The entry of an episode in the document."""

    number: Count
    seed: Count
    terrain: str
    outcome: Outcome
    decisions: Annotated[int, Field(ge=1, lt=2**31)]
    commands: Count = 0
    """Number of an operator's commands."""
    environment: Count
    """Index of its environment in the document."""


class RecordingDocument(Record):
    """The document of a file of recorded episodes."""

    format: Literal[2]
    kind: Literal["episodes"]
    driver: str
    """Source of the actions: a controller's name, a policy's file, or a training's terrain."""
    versions: dict[Label, Label]
    command_period: Annotated[float, Field(gt=0, le=1)] | None = None
    """Time between two commands of an operator [s]; None of policies that choose actions."""
    environments: tuple[PartialEnvironment, ...]
    episodes: tuple[EpisodeEntry, ...]

    @model_validator(mode="after")
    def _environments_fit(self) -> Self:
        if len({e.perception.layout for e in self.environments}) > 1:
            raise ValueError("its environments have different observation layouts")
        count = len(self.environments)
        for at, episode in enumerate(self.episodes):
            if episode.environment >= count:
                raise ValueError(
                    f"episodes.{at}.environment is {episode.environment}; there are {count}"
                )
        return self


@dataclass(frozen=True)
class Recording:
    """A file of recorded episodes that was read and checked."""

    path: Path
    document: RecordingDocument
    episodes: tuple[RecordedEpisode, ...]
    """The episodes in the order of the document."""

    @property
    def decisions(self) -> int:
        """Number of decisions of all episodes [-]."""
        return sum(len(episode.actions) for episode in self.episodes)


def write(
    path: Path,
    driver: str,
    parts: Sequence[tuple[EnvConfig | PartialEnvironment, Sequence[RecordedEpisode]]],
    command_period: float | None = None,
) -> None:
    """Write episodes with their environments, completely or not at all.

    A ``PartialEnvironment`` is one that no simulation had.
    """
    require_one_layout(path, [config for config, _ in parts])
    # The document lists the episodes, and refers to each environment by its index.
    placed = [(at, episode) for at, (_, episodes) in enumerate(parts) for episode in episodes]
    versions = {"flipperctl": __version__}
    for config, _ in parts:
        versions |= engine_versions(config.sim) if isinstance(config, EnvConfig) else {}
    document = RecordingDocument(
        format=FORMAT,
        kind=EPISODES,
        driver=driver,
        versions=versions,
        command_period=command_period,
        environments=tuple(
            PartialEnvironment.model_validate(to_dict(config.environment()))
            if isinstance(config, EnvConfig)
            else config
            for config, _ in parts
        ),
        episodes=tuple(
            EpisodeEntry(
                **{name: getattr(episode, name) for name in _ENTERED},
                decisions=len(episode.actions),
                commands=0 if episode.commands is None else len(episode.commands),
                environment=at,
            )
            for at, episode in placed
        ),
    )
    # The tensors hold all episodes one after the other; the document has their lengths.
    tensors = {
        name: _joined([getattr(episode, f"{name}s") for _, episode in placed], shape, kind)
        for name, (shape, kind) in _rows(document).items()
    }
    text = json.dumps(document.model_dump(mode="json"), allow_nan=False)
    write_bytes(path, sealed.serialize(text, tensors))


def require_one_layout(path: Path, configs: Sequence[EnvConfig | PartialEnvironment]) -> None:
    """Check that episodes in these environments fit into one file."""
    layouts = {config.perception.layout.words for config in configs}
    if len(layouts) > 1:
        raise ConfigError(
            f"{path}: a {NOUN} has one observation layout; the environments have {len(layouts)}: "
            f"{'; '.join(sorted(layouts))}"
        )


def _rows(document: RecordingDocument) -> dict[str, tuple[tuple[int, ...], type[np.generic]]]:
    """Return shape and type of a row of each tensor."""
    layouts = [environment.perception.layout for environment in document.environments]
    size, joints = (layouts[0].size, len(layouts[0].joints)) if layouts else (0, 2)
    rows: dict[str, tuple[tuple[int, ...], type[np.generic]]] = {
        "observation": ((size,), np.float32),
        "action": ((), np.int64),
        "reward": ((), np.float64),
        "label": ((3**joints,), np.float32),
    }
    if document.command_period is not None:
        rows["command"] = ((5 if joints == 2 else 5 + joints,), np.float64)  # ``Command.numbers``
    return rows


def _joined(
    arrays: Sequence[NDArray[Any]], shape: tuple[int, ...], kind: type[np.generic]
) -> torch.Tensor:
    import torch

    return torch.from_numpy(np.concatenate([np.empty((0, *shape), kind), *arrays], dtype=kind))


def read(path: Path) -> Recording:
    """Read and check a file of recorded episodes, or a folder of drives as one recording.

    Nothing in the file is executed.
    """
    if path.is_dir() and (files := drive_files(path)):
        return _together(path, [read(file) for file in files])
    text, tensors = sealed.read(path, NOUN)
    with naming_document(path):
        document = _parse(text)
    try:
        _check(document, tensors)
    except ValueError as error:
        raise CheckpointError(f"{path}: its tensors are not valid: {error}") from error
    arrays = {name: tensor.numpy() for name, tensor in tensors.items()}
    return Recording(path, document, tuple(_episodes(document, arrays)))


def _together(path: Path, recordings: Sequence[Recording]) -> Recording:
    """Return several recordings as one."""
    environments: list[PartialEnvironment] = []
    entries: list[EpisodeEntry] = []
    for recording in recordings:
        for entry in recording.document.episodes:
            # Indices of environments go on after those of the recordings before.
            place = {"environment": len(environments) + entry.environment}
            entries.append(entry.model_copy(update=place))
        environments += recording.document.environments
    update = {"environments": tuple(environments), "episodes": tuple(entries)}
    # Recordings that are valid alone may not fit together.
    with naming_document(path):
        document = RecordingDocument.model_validate(
            recordings[0].document.model_copy(update=update).model_dump()
        )
    return Recording(
        path, document, tuple(e for recording in recordings for e in recording.episodes)
    )


def _parse(text: str) -> RecordingDocument:
    raw = decode(text)
    if (kind := raw.get("kind")) != EPISODES:
        raise ValueError(f"its kind is {kind!r:.40}, not {EPISODES!r}; is it a checkpoint?")
    return validated(RecordingDocument, raw, FORMAT)


def _check(document: RecordingDocument, tensors: Mapping[str, torch.Tensor]) -> None:
    """Check the tensors against the document, and their values."""
    import torch

    # An episode has one observation more than it has decisions.
    count = sum(episode.decisions for episode in document.episodes)
    counts = {
        "observation": count + len(document.episodes),
        "command": sum(episode.commands for episode in document.episodes),
    }
    # Views of one number: the document may be of any origin, and its shapes of any size.
    expected = {
        name: torch.from_numpy(np.zeros((), kind)).expand(counts.get(name, count), *shape)
        for name, (shape, kind) in _rows(document).items()
    }
    require_equal_layout(tensors, expected)
    # Numbers: indices within the actions, labels that are distributions or zeros.
    action, label = tensors["action"], tensors["label"]
    if bool(((action < 0) | (action >= label.shape[1])).any()):
        raise ValueError(f"action lies outside of 0 to {label.shape[1] - 1}")
    total = label.sum(dim=1)
    labelled = (total - 1).abs() < _SUM
    if bool((label < 0).any()) or not bool((labelled | (label == 0).all(dim=1)).all()):
        raise ValueError("label has a row that is neither a distribution nor zeros")
    if "command" in tensors and not bool(tensors["command"].isfinite().all()):
        raise ValueError("command has a number that is not finite")


def _episodes(
    document: RecordingDocument, arrays: Mapping[str, NDArray[Any]]
) -> Iterator[RecordedEpisode]:
    end = command_end = 0
    for at, entry in enumerate(document.episodes):
        # Each episode before this one has had one more observation, ``at`` in all.
        begin, end = end, end + entry.decisions
        first, command_end = command_end, command_end + entry.commands
        yield RecordedEpisode(
            **{name: getattr(entry, name) for name in _ENTERED},
            observations=arrays["observation"][begin + at : end + at + 1],
            actions=arrays["action"][begin:end],
            rewards=arrays["reward"][begin:end],
            labels=arrays["label"][begin:end],
            commands=arrays["command"][first:command_end] if "command" in arrays else None,
        )
