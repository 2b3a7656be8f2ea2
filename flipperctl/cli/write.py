"""The commands that write files for others: ``card``, ``report`` and ``new``."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from flipperctl.cli import options
from flipperctl.errors import FlipperctlError
from flipperctl.terminal.streams import print_note


def card(
    policy: Annotated[
        Path, typer.Argument(metavar="RUN_OR_POLICY", help="A run, a checkpoint or a shipped one.")
    ],
    results: Annotated[
        list[Path] | None, typer.Argument(metavar="RESULTS", help="Folders of eval --output.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The card, else standard output.")
    ] = None,
    push: Annotated[
        str | None,
        typer.Option(metavar="USER/NAME", help="Upload policy and card to the Hugging Face Hub."),
    ] = None,
    plugins: options.PluginPaths = None,
) -> None:
    """Write a policy's card: what it is, how it was trained, what it reached and where it fails.

    The card is Markdown with the front matter of the Hugging Face Hub, whose model-index has the
    results. RESULTS are folders of [bold]eval --output[/] with this policy; their baselines stand
    beside it. Each command in the card gives the same hash of conditions, which is checked.

    [bold]Examples[/]

      flipperctl eval generalist --baseline okada,level --output evaluated

      flipperctl card generalist evaluated --output card.md
    """
    from flipperctl.checkpoint import hub
    from flipperctl.policies.source import load_policy
    from flipperctl.text.files import check_output, write_bytes
    from flipperctl.views.card import CARD, card_text, policy_rows

    file = load_policy(policy, takes="checkpoint", tell=print_note).file
    if output is not None:
        check_output(output, CARD)
    folders = results or []
    rows = policy_rows(file, folders)  # raises for wrong results, before anything is composed
    text = card_text(policy, file, rows, evaluation_commands(policy, file, folders))
    if push is not None:
        print_note(f"uploaded {hub.push(push, file, text)}")
    if output is not None:
        write_bytes(output, text.encode())
        print_note(f"wrote {output}")
    elif push is None:
        print(text, end="")


def report(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="A folder of eval --output.")],
    output: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="The report, else report.html in the folder."),
    ] = None,
    plugins: options.PluginPaths = None,
) -> None:
    """Write the report of an evaluation: words, tables, failures and a player, in one HTML file.

    The file needs no network and no other file. eval --output writes it, too; this command writes
    it again, or for results of an earlier evaluation.

    [bold]Examples[/]

      flipperctl eval generalist terrain=stair,ramp --output evaluated

      flipperctl report evaluated --output report.html
    """
    from flipperctl.text.files import check_output
    from flipperctl.views.report import FILE, REPORT, write

    path = output or results / FILE
    if output is not None or path.exists():
        check_output(path, REPORT)
    write(results, path)
    print_note(f"wrote {path}")


def evaluation_commands(policy: Path, file: Path, results: Sequence[Path]) -> list[str]:
    """Return a command for each group of stored scenes with equal conditions and options.

    A comment follows where no command gives the stored conditions. ``policy`` is the name or path
    that the commands show, ``file`` its checkpoint.
    """
    from flipperctl.evaluation.conditions import read_config
    from flipperctl.policies.source import PolicySource
    from flipperctl.requests.compose import register_trained
    from flipperctl.views.card import whole_document

    # One command for all terrains of equal words
    primary = register_trained(read_config(PolicySource(file), ["flat"], lambda line: None))
    groups: dict[tuple[tuple[str, ...], str], dict[str, None]] = {}
    for folder in results:
        for scene in whole_document(folder)["scenes"]:
            words, note = _words(primary, scene)
            groups.setdefault((tuple(words), note), {})[scene["terrain"]] = None
    eval_ = ("flipperctl", "eval", str(policy))
    return [
        shlex.join([*eval_, *words, f"terrain={','.join(terrains)}"]) + note
        for (words, note), terrains in groups.items()
    ]


def _words(primary: str, scene: Mapping[str, Any]) -> tuple[list[str], str]:
    """Return the options and overrides of a scene, and a note if they miss its conditions."""
    from flipperctl.config import DEFAULT_ENGINE
    from flipperctl.evaluation.conditions import Conditions
    from flipperctl.requests.compose import compose_eval
    from flipperctl.requests.text import from_words
    from flipperctl.views.summary import compared

    # The words that a user would have typed
    stored = scene["conditions"]
    options = ["--episodes", str(scene["episodes"]), "--seed", str(scene["seed"])]
    if names := [other["controller"] for other in compared(scene)]:
        options += ["--baseline", ",".join(names)]
    if names := scene.get("passable", {}).get("references"):
        options += ["--passable", ",".join(names)]
    plugins = {kind: stored[kind]["name"] for kind in ("sim", "perception")}
    words = [f"conditions={stored['name']}"]
    words += [f"{kind}={name}" for kind, name in plugins.items() if name != DEFAULT_ENGINE]

    def conditions(*changes: str) -> Conditions:
        requests = from_words([*words, *changes, f"terrain={scene['terrain']}"])
        ((config, _),) = compose_eval(requests, primary)
        return Conditions.of(config)

    try:
        # Settings that those words miss, as long as this version has them
        changes = [
            f"{section}.{name}={json.dumps(value, separators=(',', ':'))}"
            for section, values in conditions().settings.items()
            if isinstance(values, Mapping)
            for name, value in stored[section].items()
            if name != "name" and value != values.get(name)
        ]
        exact = conditions(*changes).hash == stored["hash"]
    except FlipperctlError:
        changes, exact = [], False
    note = "" if exact else "  # and further settings: the hash of conditions differs"
    return [*options, *words, *changes], note


def new(
    kind: Annotated[
        str,
        typer.Argument(
            metavar="KIND",
            help="terrain, reward, network, learner, controller, engine, sensor, measure, logger, "
            "command or robot.",
        ),
    ],
    name: Annotated[
        str,
        typer.Argument(
            help="Name of the plugin: lower-case letters, digits and _.", show_default=False
        ),
    ],
    package: Annotated[
        bool,
        typer.Option("--package", help="Write a project with pyproject, source, test and README."),
    ] = False,
    output: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder to write to.", show_default=False)
    ] = Path(),
    plugins: options.PluginPaths = None,
) -> None:
    """Write a plugin as a starting point: one file, or with --package an installable project.

    KIND is terrain, reward, network, learner, controller, engine, sensor, measure, logger or
    command. The plugin works as written and passes the conformance suite. A robot is a file of YAML
    with its body and its devices. Existing files are never overwritten.

    [bold]Examples[/]

      flipperctl new terrain mine

      flipperctl new reward calm --output plugins

      flipperctl new controller brave --package

      flipperctl new robot rover
    """
    from flipperctl.testing.scaffold import Draft, next_commands, write_robot

    if kind == "robot":
        file = write_robot(name, output)
        print(f"wrote {file}; next:\n  flipperctl eval okada robot={file} devices={file}")
        return
    draft = Draft(kind, name)
    written = draft.write_package(output) if package else draft.write_file(output)
    print(f"wrote {written}; next:")
    for command in next_commands(draft, written, package=package):
        print(f"  {command}")
