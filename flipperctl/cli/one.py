"""The only policy and the only scene of a command that takes one of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from flipperctl.cli.scenes import scenes
from flipperctl.config.words import key_of
from flipperctl.errors import RequestError
from flipperctl.evaluation.plan import Entry
from flipperctl.evaluation.policies import Entrant, entrants, split_policies
from flipperctl.terminal.streams import print_note


def one_policy(
    words: Sequence[str] | None, checkpoint: Path | None, controller: str | None, command: str
) -> tuple[Entrant, list[str]]:
    """Return the policy that the words or the options name, and the settings among the words.

    Raises:
        RequestError: there is none, or several.
        CheckpointError, ConfigError: there is no such policy.
    """
    names, settings = split_policies(words)
    names += [str(name) for name in (checkpoint, controller) if name is not None]
    found = entrants(names, print_note)
    if len(found) != 1:
        given = ", ".join(names) or "none"
        raise RequestError(
            f"{command} takes one policy, as in: flipperctl {command} generalist terrain=stair; "
            f"{given} is given"
            if len(found) < 2
            else f"{command} takes one policy; {given} are given"
        )
    return found[0], settings


def one_scene(
    words: Sequence[str] | None,
    checkpoint: Path | None,
    controller: str | None,
    command: str,
) -> Entry:
    """Return the policy that the words or the options name, on the only scene.

    Raises:
        RequestError: there are several policies or scenes.
        CheckpointError, ConfigError: a name or a setting is wrong.
    """
    policy, settings = one_policy(words, checkpoint, controller, command)
    if any(key_of(word) == "suite" for word in settings):
        raise RequestError(f"suite=…: {command} takes one scene; leave it out")
    name = None if policy.run else policy.method
    found = scenes(settings, policy.run, name, print_note)
    if len(found) != 1:
        raise RequestError(f"{command} takes one scene; the settings give {len(found)}")
    return Entry(*found[0])
