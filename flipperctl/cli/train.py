"""``flipperctl train``: start, resume or compose trainings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError


def train(
    overrides: options.Overrides = None,
    resume: Annotated[
        Path | None, typer.Option(metavar="RUN", help="Resume a stopped run.")
    ] = None,
    multirun: Annotated[
        bool, typer.Option("--multirun", "-m", help="One run for each combination of a,b lists.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the run, or of the runs with -m.")
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A film of the policy at each validation: .gif, .mp4."),
    ] = None,
    config_dir: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder with files of configuration.")
    ] = None,
    plugins: options.PluginPaths = None,
) -> None:
    """Train a policy. Progress goes to stderr, everything else to the run directory.

    OVERRIDES are Hydra's: key=value. [bold]flipperctl inspect config[/] shows every value.

    [bold]Examples[/]

      flipperctl train terrain=stair

      flipperctl train terrain=step seed=3 rewards.swing.weight=4

      flipperctl train -m terrain=step,stair seed=1,2 --output runs/compared

      flipperctl train terrain=uplift --film progress.gif

      flipperctl train --resume runs/stair/2026-01-31_12-00-00
    """
    from flipperctl.evaluation.plan import refuse_beside

    arguments = list(overrides or [])
    if resume is not None:
        others = {"multirun": multirun, "output": output, "film": film, "config-dir": config_dir}
        refuse_beside("--resume", others)
        _resume(resume, arguments)
        return
    if film is not None:
        refuse_beside("--film", {"multirun": multirun})
    if output is not None:
        from flipperctl.config.words import key_of, literal_override

        key = "hydra.sweep.dir" if multirun else "hydra.run.dir"
        refuse_beside("--output", {word: True for word in arguments if key_of(word) == key})
        # Hydra looks the name up twice, so that a quoted ${…} would still be replaced.
        if "${" in str(output):
            raise RequestError(f"--output {output}: Hydra would replace the ${{…}}; choose another")
        arguments.append(literal_override(key, str(output)))
    from flipperctl.cli.hydra.application import train

    train(arguments, multirun=multirun, config_dir=config_dir, film=film)


def _resume(run: Path, words: list[str]) -> None:
    from flipperctl.process import session
    from flipperctl.requests.text import from_words
    from flipperctl.terminal.training import check_resumed, print_best, reports
    from flipperctl.training.run import check_resumable, resume

    check_resumable(words)
    changes = from_words(words).values()
    try:
        print_best(resume(run, changes, reports(), check=check_resumed))
    except KeyboardInterrupt as error:  # outside the episodes, which stop by themselves
        raise session.interrupted_run(run) from error
