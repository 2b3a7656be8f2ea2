"""The commands that show robots while they drive: ``watch``, ``demo`` and ``drive``."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError
from flipperctl.terminal.streams import print_note

if TYPE_CHECKING:
    from flipperctl.config import EvalConfig
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
) -> None:
    """Watch policies drive, in a browser.

    Several policies drive side by side on the same draw. The page shows the robot in 3-D, what the
    policy perceives, its angles, each reward term, its Q-values and its risk. Keys: p pauses, s
    steps, n goes to the next episode, b back, r restarts.

    Episode 0 is the first one of eval with the same settings. A folder of eval --output shows its
    recorded failures, one after another. A run that is still training shows its newest checkpoint.

    [bold]Examples[/]

      flipperctl watch generalist terrain=pallet

      flipperctl watch runs/first level geometric terrain=uplift

      flipperctl watch generalist terrain=stair sim=mujoco

      flipperctl watch judged
    """
    from flipperctl.config.words import with_flags
    from flipperctl.evaluation.plan import split_policies

    names, settings = split_policies(words)
    if not names:
        raise RequestError("name a policy, as in: flipperctl watch generalist terrain=stair")

    # Recorded failures by themselves, or policies side by side on the same draw
    folders = [name for name in names if any(Path(name).glob("failure_*.json"))]
    if folders:
        if len(names) > 1 or settings:
            raise RequestError(f"{folders[0]}: failures are shown alone, under their own settings")
        entrants, find = [_failures(Path(folders[0]))], None
    elif judged := [name for name in names if Path(name, "cells.csv").is_file()]:
        raise RequestError(f"{judged[0]}: none of its episodes failed; name a policy to watch")
    else:
        flagged = with_flags(settings, seed=seed)
        entrants, find = _entrants(names, flagged), _finder(flagged)
    _show(entrants, (episode, episodes), port, speed, find, terminal=terminal, browser=browser)


def demo(
    episodes: Last = None,
    port: Port = 8080,
    speed: Speed = 1.0,
    terminal: InTerminal = False,
    browser: Opens = True,
) -> None:
    """Watch the shipped policy and a rule on a course of obstacles, in a browser.

    [bold]Examples[/]

      flipperctl demo

      flipperctl demo --terminal
    """
    scene = ["terrain=course"]
    entrants, find = _entrants(["generalist", "geometric"], scene), _finder(scene)
    span = 0, episodes
    _show(entrants, span, port, speed, find, marks=False, terminal=terminal, browser=browser)


def drive(
    settings: options.Overrides = None,
    person: Annotated[
        str, typer.Option("--as", metavar="NAME", help="Name or code of who drives.")
    ] = "me",
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder of the drives, by default drives/NAME.", show_default=False
        ),
    ] = None,
    helper: Annotated[
        str | None,
        typer.Option("--with", metavar="POLICY", help="A policy that turns what you do not turn."),
    ] = None,
    study: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A study: who drives what how often.")
    ] = None,
    episode: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, help="First episode; by default the next one."),
    ] = None,
    episodes: Annotated[int, typer.Option(metavar="N", min=1, help="Episodes per scene.")] = 1,
    seed: options.Seed = None,
    bag: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Also write the last drive as a bag, MCAP.")
    ] = None,
    script: Annotated[
        bool, typer.Option("--script", help="A script drives the page; the files say so.")
    ] = False,
    port: Port = 8080,
    browser: Opens = True,
) -> None:
    """Drive the robot yourself, in a browser.

    The page shows the robot in 3-D, what it perceives, its cameras in 3-D, and its gauges. Arrow
    keys drive; Q and A turn the front flippers, E and D the rear ones; ? shows all keys. A gamepad
    and buttons on the page do the same. If the browser is gone, the robot stops.

    Each drive is an episode that eval and replay play again, and from which a policy learns.
    Episode 0 is the first one of eval with the same settings. With --with, a policy turns the
    flippers until you take them; P gives them back.

    [bold]Examples[/]

      flipperctl drive terrain=step

      flipperctl drive terrain=stair sim=mujoco perception=lidar --as anna

      flipperctl drive terrain=stair --with generalist

      flipperctl drive --study study.yaml --as anna

      flipperctl eval drives/me generalist level terrain=step --episodes 1
    """
    from flipperctl.config.policy_file import drive_files
    from flipperctl.config.words import with_flags
    from flipperctl.live import drives
    from flipperctl.live import study as studies
    from flipperctl.live.drive import DrivePage
    from flipperctl.policies.source import load_policy
    from flipperctl.text.messages import percent

    if not re.fullmatch(r"[\w-][\w.-]{0,39}", person):
        raise RequestError(
            f"--as {person!r}: a name of up to 40 letters, digits, -, _ and . is allowed"
        )
    if bag is not None:
        from flipperctl.ros.episode import check_bag, export_bag

        check_bag(bag)

    # Drives of one person's choice, or of a study
    driver = f"{'script' if script else 'person'}: {person}"
    words = with_flags(settings or [], seed=seed)
    if study is None:
        root = output or Path("drives")
        drive_folder = drives.DriveFolder(output or root / person, driver)
        source = None if helper is None else load_policy(helper, "--with", tell=print_note)
        tasks = [
            drives.Task(config.terrain.title, config, index, drive_folder, source)
            for config in _configs(words)
            for index in drive_folder.next(config, episode, episodes)
        ]
        for task in tasks:
            drive_folder.check(task.config)
            if source is not None:
                source.build(task.config)
    else:
        if words or helper is not None:
            raise RequestError("--study: its file has the scenes and helpers; leave others out")
        read = studies.read_study(study, person)
        root = output or study.with_suffix("")

        def folder(name: str) -> drives.DriveFolder:
            return drives.DriveFolder(
                root / (person if name == "none" else f"{person}+{name}"),
                driver if name == "none" else f"{driver}, with {name}",
            )

        def compose(text: str) -> EvalConfig:
            return _configs(text.split())[0]

        tasks = list(
            studies.tasks_of(read, person, compose, lambda n: load_policy(n, "helpers"), folder)
        )
        if not tasks:
            print_note(f"{person} has driven everything of {study}")
            return

    # What is told after each drive, and what is asked
    def driven(task: drives.Task, row: dict[str, Any], late: float) -> None:
        kind = "practice" if task.practice else "episode"
        variation = row["pitch_variation_100hz"]
        print_note(
            f"{task.title}, {kind} {task.number}: {row['outcome']} after {row['t_cost']:.1f} s, "
            f"pitch variation {variation:.2f} rad; {percent(late)} of ticks late"
        )

    def answered(task: drives.Task, answers: tuple[int, ...]) -> None:
        name = "none" if task.helper is None else task.helper.label()
        studies.add_answers(root, person, name, task.asks, answers)

    # The page, until all drives are done
    page = DrivePage(port, person)
    with page.gate as gate:
        _announce(gate.address, browser)
        drives.drive(page, tasks, driven, answered)
    where = ", ".join(
        dict.fromkeys(str(t.folder.path) for t in tasks if drive_files(t.folder.path))
    )
    print_note(f"drives: {where}; flipperctl eval takes them as policies")
    if bag is not None:
        # The bag is of the drive as it is played again.
        last = tasks[-1]
        source = load_policy(last.folder.path)
        export_bag(last.config, source, bag, last.index)
        print_note(f"wrote {bag}")


def _configs(words: list[str]) -> list[EvalConfig]:
    """Return the scenes that the words name."""
    from flipperctl.evaluation.plan import entrants
    from flipperctl.requests.plan import make_plan
    from flipperctl.requests.text import from_words

    plan = make_plan(from_words(words), entrants(["level"], print_note), "none", lambda line: None)
    return [entry.config for entry in plan.entries]


def _announce(address: str, browser: bool) -> None:
    """Tell the address of a page, and open it."""
    import webbrowser

    print_note(f"open {address} in a browser; Ctrl-C ends")
    if browser:
        webbrowser.open(address)


def _entrants(names: list[str], settings: list[str]) -> list[Entrant]:
    """Return each policy on its scene."""
    from flipperctl.evaluation.names import names as short_names
    from flipperctl.evaluation.plan import entrants
    from flipperctl.live.lanes import Entrant
    from flipperctl.requests.plan import make_plan
    from flipperctl.requests.text import from_words

    plan = make_plan(from_words(settings), entrants(names, print_note), "none", lambda line: None)
    called = short_names([entry.named for entry in plan.entries])
    several = len({entry.terrain for entry in plan.entries}) > 1
    return [
        Entrant(
            called[entry.named] + (f" on {entry.terrain}" if several else ""),
            _drawn(entry),
        )
        for entry in plan.entries
    ]


def _finder(settings: list[str]) -> Callable[[str], Entrant]:
    """Return a function of a policy's name: the policy on the same scene."""
    scene = [word for word in settings if not word.startswith("controller.")]

    def find(name: str) -> Entrant:
        if not name:
            raise RequestError("name a policy, such as okada")
        return _entrants([name], scene)[0]

    return find


def _drawn(entry: Entry) -> Callable[[int], Episode]:
    from flipperctl.live.lanes import Episode
    from flipperctl.policies.source import load_policy
    from flipperctl.rollout.episode import EvaluationSeeds

    seeds = EvaluationSeeds.of(entry.config.eval.seed, entry.config.terrain)

    def episode(index: int) -> Episode:
        source = entry.source
        if source.checkpoint is not None and not source.is_exported:
            # A run that is still training shows its newest weights.
            run = source.checkpoint.parent.parent
            newest = run / "checkpoints" / "last.safetensors"
            if newest.is_file() and source.checkpoint.stat().st_mtime < newest.stat().st_mtime:
                source = load_policy(newest, takes="checkpoint")
        return Episode(entry.config, source.build(entry.config), seeds(index))

    return episode


def _failures(folder: Path) -> Entrant:
    """Return the recorded failures of a folder, over and over."""
    from flipperctl.evaluation.names import names
    from flipperctl.evaluation.replay import read_record
    from flipperctl.live.lanes import Entrant, Episode

    records = [(file, read_record(file)) for file in sorted(folder.glob("failure_*.json"))]
    records.sort(key=lambda item: (item[0].stem.rpartition("_")[0], item[1].episode))
    called = names(list(dict.fromkeys(record.policy.label for _, record in records)))

    def episode(index: int) -> Episode:
        file, record = records[index % len(records)]
        config = record.evaluation(file)
        policy = record.policy.find(file, None).build(config)
        return Episode(config, policy, record.seed, called[record.policy.label], record.episode)

    episode(0)  # errors now, not in the page
    return Entrant(", ".join(called.values()), episode, recorded=True)


def _show(
    entrants: list[Entrant],
    span: tuple[int, int | None],
    port: int,
    speed: float,
    find: Callable[[str], Entrant] | None,
    *,
    marks: bool = True,
    terminal: bool,
    browser: bool,
) -> None:
    """Show episodes from the first on; ``span``: the first, and how many.

    ``marks``: whether the page shows what is perceived before it is asked to.
    """
    import sys

    if terminal:
        from flipperctl.live import terminal as text

        if len(entrants) > 1:
            print_note(f"--terminal shows one policy: {entrants[0].label}")
        text.watch(entrants[0], sys.stdout, speed=speed, first=span[0], episodes=span[1])
        return
    from flipperctl.live.page import watch as serve

    def ready(address: str) -> None:
        _announce(address, browser)

    serve(entrants, port=port, speed=speed, span=span, marks=marks, find=find, ready=ready)
