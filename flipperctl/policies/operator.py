"""``operator``: drives of a person or a script, played again command by command.

In: files of ``flipperctl drive``. Out: a policy that gives the recorded commands on the recorded
draws, so that people stand in tables, films and reports like any controller.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from flipperctl.api import (
    Command,
    Controller,
    Perception,
    Policy,
    RecordedEpisode,
    Simulator,
    Task,
    World,
    controller,
)
from flipperctl.api import action_index as index_of
from flipperctl.checkpoint import recording
from flipperctl.checkpoint.recording import PartialEnvironment
from flipperctl.config import EnvConfig, to_dict
from flipperctl.config.identity import ABSENT, differences
from flipperctl.config.policy_file import drive_files
from flipperctl.errors import ConfigError, PolicyError

HOLD = index_of(0, 0)
_SECTIONS = ("sim", "robot", "perception", "episode")
"""Sections of an environment on which it depends what commands lead to."""
_MOST = 3
"""Settings that an error names [-]."""


class _Drive(NamedTuple):
    file: Path
    episode: RecordedEpisode
    environment: PartialEnvironment
    period: float


@controller("operator")
class Operator(Controller):
    """Repeat the recorded drives of a person or a script, each on its own draw.

    Only draws that were driven can be played: with equal settings, ``eval`` has the episodes of
    ``flipperctl drive``. Where the robot perceives something else than when it was driven, the
    episode is refused, as its commands would mean another drive.
    """

    drives: str = Field(
        "", description="a folder of flipperctl drive, or one of its drive_….safetensors [-]"
    )

    @property
    def files(self) -> list[Path]:
        """The files of drives, in the order of their names."""
        return drive_files(Path(self.drives)) if self.drives else []

    @property
    def drivers(self) -> list[str]:
        """Who drove, such as ``person: anna`` or ``script: slow``."""
        return list(dict.fromkeys(recording.read(file).document.driver for file in self.files))

    def uses(self) -> Mapping[str, str]:
        """Return the file of each drive."""
        return {f"drives[{at}]": str(file) for at, file in enumerate(self.files)}

    def using(self, task: Task) -> Operator:
        """Return these settings for the environment in which the drives were driven."""
        self.check(task.config)
        return self

    def remarks(self, task: Task) -> Iterator[str]:
        """Yield who drove."""
        yield f"{self.drives}: driven by {', '.join(self.drivers)}"

    def build(self) -> Policy:
        """Return a policy that plays the recorded drive of each draw."""
        if not (files := self.files):
            raise ConfigError(
                f"operator needs drives, and {self.drives!r} holds none; name a folder of "
                "flipperctl drive in its place, such as drives/me"
            )
        return _Recorded(self.drives, list(_drives(files)))

    def check(self, config: EnvConfig) -> None:
        """Check that an environment is the one in which the drives were driven."""
        current = to_dict(config.environment())
        # Commands lead elsewhere under other settings, unless those have no effect on the engine.
        for drive in _drives(self.files):
            driven = drive.environment.model_dump(mode="json")
            differences = [
                f"{path}={_text(there)} (here {_text(here)})"
                for section in _SECTIONS
                for path, here, there in _differing(current[section], driven[section], section)
                if path.rpartition(".")[2] not in config.sim.without_effect
            ]
            if differences:
                more = f" and {len(differences) - _MOST} more" if len(differences) > _MOST else ""
                raise ConfigError(
                    f"{drive.file}: it was driven with {', '.join(differences[:_MOST])}{more}; "
                    "drives are played under the settings under which they were driven"
                )


class _Recorded:
    """Gives the commands of the drive whose seed the episode has."""

    def __init__(self, name: str, drives: list[_Drive]) -> None:
        self._name = name
        self._drives = {drive.episode.seed: drive for drive in drives}
        self.command_period = drives[0].period
        """Time between two commands [s]."""
        if {drive.period for drive in drives} != {self.command_period}:
            raise ConfigError(f"drives: those of {name} have different rates; put them apart")
        self._drive = drives[0]
        self._decision = self._commanded = 0

    def reset(self, simulator: Simulator) -> None:
        """Begin the drive of the episode's seed."""
        # Each draw has a seed; there is no drive with another one.
        recorded_drive = None if simulator.seed is None else self._drives.get(simulator.seed)
        if recorded_drive is None:
            labels = [drive.episode.terrain for drive in self._drives.values()]
            counted = ", ".join(f"{n} on {t}" for t, n in _counts(labels))
            raise PolicyError(
                f"{self._name} holds no drive of this draw on {simulator.profile.label} (seed "
                f"{simulator.seed}); it holds {counted}: --episodes and the settings of the drive "
                "choose its draws"
            )
        self._drive, self._decision, self._commanded = recorded_drive, 0, 0

    def act(self, p: Perception) -> int:
        """Check what is perceived; the action has no effect."""
        # Bit for bit: a smallest difference shows that the commands would be of another drive.
        recorded = self._drive.episode.observations
        if self._decision >= len(recorded) or not np.array_equal(
            recorded[self._decision], p.observation
        ):
            raise self._departs()
        self._decision += 1
        return HOLD

    def command(self, world: World) -> Command:
        """Return the next recorded command."""
        commands = self._drive.episode.commands
        if commands is None or self._commanded >= len(commands):
            raise self._departs()
        self._commanded += 1
        return Command.of(commands[self._commanded - 1].tolist())

    def _departs(self) -> PolicyError:
        return PolicyError(
            f"{self._drive.file}: the episode departs from the drive at decision {self._decision}; "
            "it was driven with another version or on another machine"
        )


def _drives(files: list[Path]) -> Iterator[_Drive]:
    for file in files:
        drives = recording.read(file)
        period = drives.document.command_period
        if period is None:
            raise ConfigError(
                f"{file}: it holds no commands that can be played: of a field drive nobody knows "
                "the ground. Learn from it by teacher.episodes, and try policies on the ground of "
                "its bag (flipperctl robot ground)"
            )
        for entry, episode in zip(drives.document.episodes, drives.episodes, strict=True):
            yield _Drive(file, episode, drives.document.environments[entry.environment], period)


def _differing(
    current: Mapping[str, Any], driven: Mapping[str, Any], section: str
) -> list[tuple[str, Any, Any]]:
    """Return what differs in a section; for another engine or sensor, its name alone."""
    if (here := current.get("name")) != (there := driven.get("name")):
        return [(section, here, there)]
    return list(differences(current, driven, section))


def _counts(labels: list[str]) -> list[tuple[str, int]]:
    return [(label, labels.count(label)) for label in dict.fromkeys(labels)]


def _text(value: Any) -> str:
    return "none" if value is ABSENT or value is None else f"{value}"
