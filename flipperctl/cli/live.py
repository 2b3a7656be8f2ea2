"""The commands that show policies while they drive: ``watch`` and ``demo``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError
from flipperctl.terminal.streams import print_note

if TYPE_CHECKING:
    from flipperctl.evaluation.plan import Entry
    from flipperctl.live.lanes import Entrant, Episode

Port = Annotated[
    int, typer.Option(metavar="N", min=0, max=65535, help="Port of the page; 0 takes a free one.")
]
Speed = Annotated[float, typer.Option(metavar="X", min=0.1, max=10, help="Times real time.")]
InTerminal = Annotated[
    bool, typer.Option("--terminal", help="Show the first policy here, without a browser.")
]
Opens = Annotated[
    bool, typer.Option("--open/--no-open", help="Open the page in the default browser.")
]
Last = Annotated[
    int | None, typer.Option(metavar="N", min=1, help="Stop after this many episodes.")
]
First = Annotated[int, typer.Option(metavar="N", min=0, help="First episode.")]


def watch(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="POLICY... [SETTING...]",
            help="Policies, or a folder of eval --output with failures; key=value.",
        ),
    ] = None,
    episode: First = 0,
    episodes: Last = None,
    seed: options.Seed = None,
    port: Port = 8080,
    speed: Speed = 1.0,
    terminal: InTerminal = False,
    browser: Opens = True,
    plugins: options.PluginPaths = None,
) -> None:
    """Watch policies drive, in a browser.

    Several policies drive side by side on the same draw. The page shows the robot in 3-D, what the
    policy perceives, its angles, each reward term, its Q-values and its risk. Keys: p pauses, s
    steps, n goes to the next episode, b back, r restarts.

    Episode 0 is the first one of eval with the same settings. A folder of eval --output shows its
    recorded failures, one after another. A run that is still training shows its newest checkpoint.

    [bold]Examples[/]

      flipperctl watch generalist terrain=pallet

      flipperctl watch runs/first level okada terrain=uplift

      flipperctl watch generalist terrain=stair sim=mujoco

      flipperctl watch judged
    """
    from flipperctl.config.words import with_flags
    from flipperctl.evaluation.plan import split_policies

    names, settings = split_policies(words)
    if not names:
        raise RequestError("name a policy, as in: flipperctl watch generalist terrain=stair")
    folders = [name for name in names if any(Path(name).glob("failure_*.json"))]
    if folders:
        if len(names) > 1 or settings:
            raise RequestError(f"{folders[0]}: failures are shown alone, under their own settings")
        entrants = [_failures(Path(folders[0]))]
    else:
        entrants = _entrants(names, with_flags(settings, seed=seed))
    _show(entrants, (episode, episodes), port, speed, terminal=terminal, browser=browser)


def demo(
    episodes: Last = None,
    port: Port = 8080,
    speed: Speed = 1.0,
    terminal: InTerminal = False,
    browser: Opens = True,
    plugins: options.PluginPaths = None,
) -> None:
    """Watch the shipped policy and a rule on a course of obstacles, in a browser.

    [bold]Examples[/]

      flipperctl demo

      flipperctl demo --terminal
    """
    entrants = _entrants(["generalist", "okada"], ["terrain=course"])
    _show(entrants, (0, episodes), port, speed, terminal=terminal, browser=browser)


def _entrants(names: list[str], settings: list[str]) -> list[Entrant]:
    """Return each policy on its scene."""
    from flipperctl.cli.plan import make_plan
    from flipperctl.evaluation.plan import entrants
    from flipperctl.evaluation.views.summary import short
    from flipperctl.live.lanes import Entrant

    plan = make_plan(settings, entrants(names, print_note), "none", lambda line: None)
    several = len({entry.terrain for entry in plan.entries}) > 1
    return [
        Entrant(
            f"{short(entry.named)} on {entry.terrain}" if several else short(entry.named),
            _drawn(entry),
        )
        for entry in plan.entries
    ]


def _drawn(entry: Entry) -> Callable[[int], Episode]:
    from flipperctl.live.lanes import Episode
    from flipperctl.policies.source import load_policy
    from flipperctl.rollout.episode import EvaluationSeeds

    seeds = EvaluationSeeds.of(entry.config.eval.seed, entry.config.terrain)

    def episode(index: int) -> Episode:
        source = entry.source
        if source.checkpoint is not None and not source.is_exported:
            run = source.checkpoint.parent.parent
            newest = run / "checkpoints" / "last.safetensors"
            if newest.is_file() and source.checkpoint.stat().st_mtime < newest.stat().st_mtime:
                source = load_policy(newest, takes="checkpoint")
        return Episode(entry.config, source.build(entry.config), seeds(index))

    return episode


def _failures(folder: Path) -> Entrant:
    """Return the recorded failures of a folder, over and over."""
    from flipperctl.evaluation.replay import read_record
    from flipperctl.live.lanes import Entrant, Episode

    files = sorted(folder.glob("failure_*.json"))

    def episode(index: int) -> Episode:
        file = files[index % len(files)]
        record = read_record(file)
        config = record.evaluation(file)
        policy = record.policy.find(file, None).build(config)
        title = f"{record.policy.label}: {file.stem.removeprefix('failure_')}, {record.outcome}"
        return Episode(config, policy, record.seed, title)

    episode(0)  # errors now, not in the page
    return Entrant(f"{len(files)} failures of {folder}", episode)


def _show(
    entrants: list[Entrant],
    span: tuple[int, int | None],
    port: int,
    speed: float,
    *,
    terminal: bool,
    browser: bool,
) -> None:
    """Show episodes from the first on; ``span``: the first, and how many."""
    import sys
    import webbrowser

    if terminal:
        from flipperctl.live import terminal as text

        if len(entrants) > 1:
            print_note(f"--terminal shows one policy: {entrants[0].label}")
        text.watch(entrants[0], sys.stdout, speed=speed, first=span[0], episodes=span[1])
        return
    from flipperctl.live.page import watch as serve

    def ready(address: str) -> None:
        print_note(f"open {address} in a browser; Ctrl-C ends")
        if browser:
            webbrowser.open(address)

    serve(entrants, port=port, speed=speed, span=span, ready=ready)
