"""The commands that make stored results again, each checked by the hash of its conditions.

In: a policy, and folders of ``eval --output``. Out: a command for each group of scenes with equal
conditions, seed, episodes and baselines.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import DEFAULT_ENGINE
from flipperctl.errors import FlipperctlError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.views.markdown import summary_file
from flipperctl.evaluation.views.summary import compared
from flipperctl.runs.inherited import read_config

_KINDS = ("sim", "perception")
"""Sections with a plugin."""


def evaluation_commands(policy: Path, file: Path, results: Sequence[Path]) -> list[str]:
    """Return the commands; a comment follows where no command gives the stored conditions.

    ``policy`` is the name or path that the commands show, ``file`` its checkpoint.
    """
    primary = config_store.register_trained(read_config(file, ["flat"], lambda line: None))
    groups: dict[tuple[tuple[str, ...], bool], list[str]] = {}
    for folder in results:
        document = json.loads(summary_file(folder).read_text(encoding="utf-8"))
        for scene in document["scenes"]:
            words, exact = _words(primary, scene)
            groups.setdefault((tuple(words), exact), []).append(scene["terrain"])
    commands = []
    for (found, exact), terrains in groups.items():
        terrain = f"terrain={','.join(dict.fromkeys(terrains))}"
        command = ["flipperctl", "eval", str(policy), *found, terrain]
        note = "" if exact else "  # and further settings: the hash of conditions differs"
        commands.append(shlex.join(command) + note)
    return commands


def _words(primary: str, scene: Mapping[str, Any]) -> tuple[list[str], bool]:
    """Return the options and overrides of a scene, and whether they give its conditions."""
    stored = scene["conditions"]
    options = ["--episodes", str(scene["episodes"]), "--seed", str(scene["seed"])]
    if names := [other["controller"] for other in compared(scene)]:
        options += ["--baseline", ",".join(names)]
    words = [f"conditions={stored['name']}"]
    words += [
        f"{kind}={stored[kind]['name']}"
        for kind in _KINDS
        if stored[kind]["name"] != DEFAULT_ENGINE
    ]
    terrain = [f"terrain={scene['terrain']}"]
    try:
        base = _conditions(primary, [*words, *terrain])
        changes = list(_changes(base.settings, stored))
        exact = _conditions(primary, [*words, *changes, *terrain]).hash == stored["hash"]
    except FlipperctlError:
        return [*options, *words], False
    return [*options, *words, *changes], exact


def _conditions(primary: str, words: Sequence[str]) -> Conditions:
    ((config, _),) = compose.compose_eval(Overrides.parse(words), primary)
    return Conditions.of(config)


def _changes(base: Mapping[str, Any], stored: Mapping[str, Any]) -> Iterator[str]:
    """Yield an override for each setting that differs."""
    for section, values in base.items():
        if isinstance(values, Mapping):
            for name, value in stored[section].items():
                if name != "name" and value != values.get(name):
                    yield f"{section}.{name}={json.dumps(value, separators=(',', ':'))}"
