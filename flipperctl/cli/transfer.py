"""``flipperctl transfer``: a policy in the side plane and in 3-D, on the same episodes."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flipperctl.cli.options import (
    AsJson,
    CheckpointFile,
    ControllerName,
    Episodes,
    Jobs,
    Overrides,
    PluginPaths,
    Seed,
    eval_overrides,
    require_one_policy,
)
from flipperctl.errors import RequestError

if TYPE_CHECKING:
    from rich.table import Table

    from flipperctl.evaluation.results import Interval, Summary
    from flipperctl.evaluation.scenes import Scene
    from flipperctl.evaluation.transfer import TransferResult

HELP = """Evaluate a policy in the side plane and in 3-D on the same episodes; explain its failures.

Each episode is played in the default engine and in sim=mujoco, or the engine that sim=… names, with
the same ground, start and sampled physics. The gaps are paired by seed, with 95 % bootstrap
intervals. Each failure in 3-D is played again for its cause: overturned (by pitch), roll, heading
(turned away or off the ground), traction (reached with twice the friction), or stuck.

Settings of sim are those of the 3-D engine; friction and gravity apply to both.

[bold]Examples[/]

  flipperctl transfer --controller okada terrain=stair,plum --episodes 50

  flipperctl transfer --checkpoint generalist terrain=ramp sim.yaw=0.087 sim.lateral_slope=0.087

  flipperctl transfer --controller okada terrain=plum --seed 3 --only 4 --film plum.gif
"""


def add_to(app: typer.Typer) -> None:
    """Register the subcommand."""
    app.command("transfer", help=HELP)(run)


def run(
    overrides: Overrides = None,
    checkpoint: CheckpointFile = None,
    controller: ControllerName = None,
    episodes: Episodes = None,
    only: Annotated[
        int | None, typer.Option(min=0, metavar="INDEX", help="Play this episode alone, from 0.")
    ] = None,
    seed: Seed = None,
    jobs: Jobs = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for transfer.json.")
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(metavar="FILE.gif", help="Film of the episode --only in 3-D."),
    ] = None,
    as_json: AsJson = False,
    plugins: PluginPaths = None,
) -> None:
    """See HELP; the function is as long as its list of options."""
    require_one_policy(checkpoint, controller)
    if film and only is None:
        raise RequestError("--film shows one episode; name it with --only INDEX")
    from flipperctl import plugins as loader
    from flipperctl.cli.compose import only_one
    from flipperctl.cli.progress import episodes_progress
    from flipperctl.cli.result_folder import result_folder
    from flipperctl.cli.scenes import scenes, with_engine
    from flipperctl.evaluation.engines import in_default_engine
    from flipperctl.evaluation.transfer import transfer
    from flipperctl.evaluation.workers import EpisodeWorkers
    from flipperctl.files import write_json
    from flipperctl.report.film import check_film

    loader.load(plugins or ())
    settings = eval_overrides(episodes=episodes, seed=seed, jobs=jobs)
    asked = scenes([*with_engine(overrides or []), *settings], checkpoint, controller)
    for config, _ in asked:
        in_default_engine(config)  # a wrong engine is found before the first episode
    if film:
        check_film(film)
        only_one(asked)
    chosen = None if only is None else [only]
    with ExitStack() as stack:
        folder = None
        if output:
            folder = stack.enter_context(result_folder(output, "transfer", ["transfer.json"]))
        workers = stack.enter_context(EpisodeWorkers(asked[0][0].eval.jobs))
        found = [transfer(c, s, workers, only=chosen, progress=episodes_progress) for c, s in asked]
        document = {"controller": found[0].controller, "scenes": [one.container() for one in found]}
        if as_json:
            print(json.dumps(document, indent=2))
        else:
            option = "--checkpoint" if checkpoint else "--controller"
            policy = [option, str(checkpoint or controller)]
            paths = [part for path in plugins or () for part in ("--plugins", str(path))]
            _print(found, [*policy, *paths], overrides or [])
        sys.stdout.flush()
        if folder:
            folder.replace(lambda part: write_json(part / "transfer.json", document))
        if film:
            _film(film, asked, only or 0)


def _film(path: Path, asked: Sequence[Scene], episode: int) -> None:
    from flipperctl.cli.compose import only_one
    from flipperctl.report.drawn_film import film
    from flipperctl.rollout.seeds import episode_seed

    config, source = only_one(asked)
    film(config, source, episode_seed("evaluation", config.eval.seed, episode), path)


def _print(found: list[TransferResult], policy: list[str], overrides: Sequence[str]) -> None:
    from flipperctl.cli.conditions import condition_lines
    from flipperctl.cli.console import console

    out = console()
    out.print(_table(found))
    lines = condition_lines((one.terrain, one.seed, one.conditions) for one in found)
    for line in (*lines, *_failures(found, policy, overrides)):
        out.print(line, highlight=False, markup=False, soft_wrap=True)


def _table(found: list[TransferResult]) -> Table:
    from rich.markup import escape
    from rich.table import Table

    from flipperctl.cli.swing import HEADING

    first, second = found[0].engines
    title = f"{found[0].controller} in {second} against {first}, the same episodes"
    table = Table(title=title, title_justify="left")
    for heading in (
        *("terrain", "episodes", f"success in {first}", f"in {second}", "Δ success", "kept"),
        *(HEADING, f"Δ {HEADING}", "Δ t_cost [s]", "failures"),
    ):
        table.add_column(escape(heading))
    for one in found:
        swing = one.gap.pitch_variation_100hz
        pairs = swing.episodes if swing else 0
        table.add_row(
            one.terrain,
            str(one.other.episodes),
            f"{one.default.success_rate:.3f}",
            f"{one.other.success_rate:.3f}",
            _interval(one.success_gap, one.other.episodes, 3),
            "–" if one.kept is None else f"{one.kept:.1%}",
            f"{_swing(one.default)} → {_swing(one.other)}",
            _interval(swing, pairs, 2),
            _interval(one.gap.t_cost, pairs, 1),
            ", ".join(f"{cause} {count}" for cause, count in one.causes.items()) or "none",
        )
    return table


def _failures(
    found: list[TransferResult], policy: list[str], overrides: Sequence[str]
) -> Iterator[str]:
    """Yield a line for each failure, and the command that plays it again."""
    others = [o for o in overrides if not o.startswith("terrain=")]
    for one in found:
        for f in one.failures:
            yield (
                f"{one.terrain}, episode {f.episode}: {f.cause} ({f.outcome} after {f.time:.1f} s "
                f"at x {f.x:.2f} m, pitch {f.pitch:.2f}, roll {f.roll:.2f}, yaw {f.yaw:.2f} rad, "
                f"{f.side:.2f} m aside; {f.default_outcome} in {one.engines[0]})"
            )
            again = [*policy, f"terrain={one.terrain}", *others]
            seed = ["--seed", str(one.seed), "--only", str(f.episode)]
            yield f"  {shlex.join(['flipperctl', 'transfer', *again, *seed])}"


def _interval(found: Interval | None, pairs: int, digits: int) -> str:
    from flipperctl.evaluation.tables import interval_text

    return interval_text(found, pairs, digits, sign="+")


def _swing(summary: Summary) -> str:
    found = summary.pitch_variation_100hz
    return "–" if found is None else f"{found.mean:.2f}"
