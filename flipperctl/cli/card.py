"""``flipperctl card``, with the commands that make stored results again.

In: a policy, and folders of ``eval --output``. Out: a command for each group of scenes with equal
conditions, seed, episodes and baselines, checked by the hash of its conditions.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli import options
from flipperctl.errors import FlipperctlError

if TYPE_CHECKING:
    from flipperctl.evaluation.conditions import Conditions

HELP = """Write a policy's card: what it is, how it was trained, what it reached and where it fails.

The card is Markdown with the front matter of the Hugging Face Hub, whose model-index has the
results. RESULTS are folders of [bold]eval --output[/] with this policy; their baselines stand
beside it. Each command in the card gives the same hash of conditions, which is checked.

[bold]Examples[/]

  flipperctl eval generalist --baseline okada,level --output evaluated

  flipperctl card generalist evaluated --output card.md
"""


def run(
    policy: Annotated[
        Path, typer.Argument(metavar="RUN_OR_POLICY", help="A run, a checkpoint or a shipped one.")
    ],
    results: Annotated[
        list[Path] | None, typer.Argument(metavar="RESULTS", help="Folders of eval --output.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The card, else standard output.")
    ] = None,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.evaluation.views.card import CARD, card_text, policy_rows
    from flipperctl.files import check_output, write_bytes
    from flipperctl.policies.source import load_policy
    from flipperctl.terminal.streams import print_note

    file = load_policy(policy, takes="checkpoint", tell=print_note).file
    if output is not None:
        check_output(output, CARD)
    folders = results or []
    rows = policy_rows(file, folders)  # raises for wrong results, before anything is composed
    text = card_text(policy, file, rows, evaluation_commands(policy, file, folders))
    if output is None:
        print(text, end="")
    else:
        write_bytes(output, text.encode())
        print_note(f"wrote {output}")


_KINDS = ("sim", "perception")
"""Sections with a plugin."""


def evaluation_commands(policy: Path, file: Path, results: Sequence[Path]) -> list[str]:
    """Return the commands; a comment follows where no command gives the stored conditions.

    ``policy`` is the name or path that the commands show, ``file`` its checkpoint.
    """
    from flipperctl.cli.hydra import config_store
    from flipperctl.evaluation.conditions import read_config
    from flipperctl.evaluation.views.card import read_document
    from flipperctl.policies.source import PolicySource

    trained = read_config(PolicySource(file), ["flat"], lambda line: None)
    primary = config_store.register_trained(trained)
    groups: dict[tuple[tuple[str, ...], bool], list[str]] = {}
    for folder in results:
        for scene in read_document(folder)["scenes"]:
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
    from flipperctl.config import DEFAULT_ENGINE
    from flipperctl.evaluation.views.summary import compared

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
    from flipperctl.cli.hydra import compose
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.evaluation.conditions import Conditions

    ((config, _),) = compose.compose_eval(Overrides.parse(words), primary)
    return Conditions.of(config)


def _changes(base: Mapping[str, Any], stored: Mapping[str, Any]) -> Iterator[str]:
    """Yield an override for each setting that differs."""
    for section, values in base.items():
        if isinstance(values, Mapping):
            for name, value in stored[section].items():
                if name != "name" and value != values.get(name):
                    yield f"{section}.{name}={json.dumps(value, separators=(',', ':'))}"
