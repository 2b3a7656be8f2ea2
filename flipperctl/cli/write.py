"""The commands that write files for others: ``card``, ``report`` and ``new``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
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
    beside it. The commands in the card are those that made the results.

    [bold]Examples[/]

      flipperctl eval generalist --baseline geometric,level --output evaluated

      flipperctl card generalist evaluated --output card.md
    """
    from flipperctl.checkpoint import hub
    from flipperctl.policies.source import load_policy
    from flipperctl.text.files import check_output, write_bytes
    from flipperctl.views.card import CARD, card_text, commands_of, policy_rows

    file = load_policy(policy, takes="checkpoint", tell=print_note).file
    if output is not None:
        check_output(output, CARD)
    folders = results or []
    rows = policy_rows(file, folders)
    text = card_text(policy, file, rows, commands_of(folders))
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
        print(f"wrote {file}; next:\n  flipperctl eval okada robot={file}")
        return
    draft = Draft(kind, name)
    written = draft.write_package(output) if package else draft.write_file(output)
    print(f"wrote {written}; next:")
    for command in next_commands(draft, written, package=package):
        print(f"  {command}")
