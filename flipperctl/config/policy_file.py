"""Paths that stand for a controller: files of ``flipperctl tune``, folders of drives.

In: a YAML file. Out: a checked ``PolicyFile``, with the settings that were found and how they did;
its text, which reads back as the same. In: a folder. Out: the files of drives that it holds.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field

from flipperctl.config import strict_yaml
from flipperctl.config.resolver import create, parse
from flipperctl.errors import ConfigError
from flipperctl.text.files import OutputKind

FORMAT: Literal["flipperctl policy 1"] = "flipperctl policy 1"
_SUFFIXES = (".yaml", ".yml")
POLICY_FILE = OutputKind(
    "a policy file", _SUFFIXES, re.compile(rb"^format: " + FORMAT.encode(), re.MULTILINE)
)


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class Score(_Part):
    """A mean over episodes that the search did not meet, with its 95 % interval."""

    mean: float = Field(description="mean score, less is better [rad], or minus the reward [-]")
    low: float | None = Field(None, description="lower end of the interval [rad or -]")
    high: float | None = Field(None, description="upper end of the interval [rad or -]")


class Tuning(_Part):
    """What the settings were tuned on."""

    words: list[str] = Field(description="words of the command, such as terrain=stair [-]")
    objective: Literal["pitch", "reward"] = Field(description="what was searched for [-]")
    seed: int = Field(ge=0, description="seed of the search and of its training episodes [-]")
    budget: int = Field(ge=1, description="episodes of the search, at most [-]")
    before: Score = Field(description="score of the settings that the search began with")
    after: Score = Field(description="score of the settings of this file, on equal episodes")
    difference: Score = Field(description="score after minus before")
    version: str = Field(description="version of flipperctl [-]")


class PolicyFile(_Part):
    """A controller, its settings and their origin."""

    format: Literal["flipperctl policy 1"] = Field(FORMAT, description="version of the file [-]")
    controller: str = Field(description="name of the controller plugin [-]")
    settings: dict[str, Any] = Field(description="all fields of the controller [-]")
    tuning: Tuning = Field(description="what they were tuned on")

    def text(self) -> str:
        """Return the content of the file."""
        plain = self.model_dump(mode="json")
        text: str = yaml.safe_dump(plain, sort_keys=False, default_flow_style=None, width=90)
        return text


DRIVES = "drive_*.safetensors"
"""Names of files that each hold one drive of an operator."""


def drive_files(path: Path) -> list[Path]:
    """Return the files of drives in a folder, or the file itself; none of another path."""
    if os.path.isdir(path):  # noqa: PTH112  # false for any text, however long
        return sorted(path.glob(DRIVES))
    return [path] if path.match(DRIVES) and os.path.isfile(path) else []  # noqa: PTH113


def drives_in(path: Path) -> list[Path]:
    """Return the folders of people's drives in a study's folder; none of another path."""
    if not os.path.isdir(path):  # noqa: PTH112  # false for any text, however long
        return []
    return sorted(folder for folder in path.iterdir() if drive_files(folder))


def is_policy_file(name: str) -> bool:
    """Return whether a word names a controller's settings: a file by its suffix, or drives."""
    return name.lower().endswith(_SUFFIXES) or bool(name and drive_files(Path(name)))


def settings_of(path: str, where: str = "") -> dict[str, Any]:
    """Return the name and the fields of the controller that a path stands for; see ``read``."""
    if not path.lower().endswith(_SUFFIXES):
        return {"name": "operator", "drives": path}
    file = read(path, where)
    return {**file.settings, "name": file.controller}


def read(path: str, where: str = "") -> PolicyFile:
    """Return a policy file, whose controller takes its settings.

    Raises:
        ConfigError: it cannot be read, is no policy file, or has a key, a setting or a value that
            is not allowed. The text begins with ``where``, the option or setting that names it.
    """
    name = f"{where}: {path}" if where else path
    document = strict_yaml.read(Path(path), name)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise ConfigError(
            f"{name}: a policy file of flipperctl tune is allowed, whose first line is "
            f"format: {FORMAT}"
        )
    file = parse(PolicyFile, document, name)
    # The controller is made once to check its settings.
    create("controller", {**file.settings, "name": file.controller}, f"{name}: settings")
    return file
