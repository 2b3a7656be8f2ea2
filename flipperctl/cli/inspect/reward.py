"""``flipperctl inspect reward``: audit reward terms, rank policies by rewards, and find regret."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flipperctl.cli import options
from flipperctl.errors import RequestError

HELP = """Audit the reward: the share of each term in the return, and how often it saturates.

A term with a small share of the return has no effect; one that saturates at most steps carries no
information. The episodes are those of an evaluation, with conditions=… as for eval.

--compare plays the same episodes with several policies (controllers, checkpoints, generalist) and
ranks them by return and by θ̂_R at 100 Hz. A reward contradicts θ̂_R if a policy has a higher return
than another although its θ̂_R is larger, and both paired differences are significant (t-tests at
5 %, corrected by Holm for the number of comparisons). controller.<field> applies to each compared
controller with that field; eval.seed and eval.jobs set the seed and the number of processes.

--regret compares the return of a policy on its own reward with those of --against on the same
episodes, and says if it earns less than holding the flippers still (level). The best known return
is the highest of each episode; regret is what the policy lacks. All episodes count, also those
that did not reach the finish (--compare leaves them out), since their returns include the penalty
at their end. With --checkpoint, controller.<field> applies to the controllers of --against.

[bold]Examples[/]

  flipperctl inspect reward terrain=stair

  flipperctl inspect reward --checkpoint runs/first rewards.pitch.lambda_2=8

  flipperctl inspect reward --compare level,okada rewards=paper,tuned

  flipperctl inspect reward --compare okada,planner controller.width=8

  flipperctl inspect reward --regret --checkpoint generalist terrain=ramp
"""

REFERENCES = "level,okada,mpc"


def run(
    overrides: options.Overrides = None,
    checkpoint: options.CheckpointFile = None,
    controller: options.DefaultOkada = None,
    compare: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="Policies to rank, such as level,okada,planner."),
    ] = None,
    regret: Annotated[
        bool, typer.Option("--regret", help="The return that a policy lacks.")
    ] = False,
    against: Annotated[
        str | None,
        typer.Option(metavar="NAMES", help="References of --regret, by default level,okada,mpc."),
    ] = None,
    episodes: Annotated[
        str | None, typer.Option(metavar="N", help="Episodes to play [20].")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder that keeps the episodes of --regret.")
    ] = None,
    as_json: options.AsJson = False,
    plugins: options.PluginPaths = None,
) -> None:
    """See HELP."""
    from flipperctl.config.words import with_default, with_flags
    from flipperctl.evaluation.policies import controller_or_okada, require_one_policy

    chosen = controller_or_okada(checkpoint, controller)
    arguments = with_default(with_flags(overrides, episodes=episodes), "eval.episodes", 20)
    if against is not None and not regret:
        raise RequestError("--against names the references of --regret; add --regret")
    if compare is not None:
        if checkpoint is not None or controller is not None or regret:
            other = "--regret" if regret else "--checkpoint and --controller"
            raise RequestError(f"--compare names all policies; omit {other}")
        _compare(compare, arguments, as_json)
        return
    if regret:
        require_one_policy(checkpoint, controller, overrides)
        _regret(arguments, checkpoint, controller, against or REFERENCES, output, as_json)
        return
    from flipperctl.cli.hydra.compose import only_one
    from flipperctl.cli.plan import scenes
    from flipperctl.evaluation.conditions import Conditions
    from flipperctl.evaluation.views.audit import audit, table
    from flipperctl.show import console, print_table
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.terminal.streams import show

    config, source = only_one(scenes(arguments, checkpoint, chosen))
    label = f"{config.terrain.plugin_name}, {source.label()}"
    count = config.eval.episodes
    with episodes_progress(label, count) as report:
        found = audit(config, source, episodes=count, report=report)
    conditions = Conditions.of(config)
    notes = [f"conditions {conditions.name}: {text}"] if (text := conditions.line()) else []
    show(found, lambda: print_table(table(found, notes), console()), as_json=as_json)


def _compare(names: str, overrides: list[str], as_json: bool) -> None:
    from flipperctl.cli.plan import player
    from flipperctl.cli.reward_scenes import policies, reward_scenes
    from flipperctl.evaluation.views import ranking
    from flipperctl.show import console, print_lines, print_table
    from flipperctl.terminal.streams import show

    sources, others = policies(names, overrides)
    with player(None, "reward") as (plays, _):
        found = ranking.rank_policies(reward_scenes(others, sources), sources, plays)

    def printed() -> None:
        out = console()
        print_table(ranking.table(found), out)
        print_lines(out, ranking.verdict_lines(found))

    show({"scenes": found}, printed, as_json=as_json)


def _regret(
    words: list[str],
    checkpoint: Path | None,
    controller: str | None,
    against: str,
    output: Path | None,
    as_json: bool,
) -> None:
    from flipperctl.cli.plan import player
    from flipperctl.cli.reward_scenes import regret_scenes
    from flipperctl.errors import InterruptedRunError
    from flipperctl.evaluation.views import regret
    from flipperctl.show import console, print_lines, print_table
    from flipperctl.terminal.streams import show

    scenes = regret_scenes(words, checkpoint, controller, against)
    with player(output, "regret") as (plays, _):
        found = [one for scene in scenes if (one := regret.measure(scene, plays)) is not None]
    if not found:
        raise InterruptedRunError("interrupted: no scene is finished")

    def printed() -> None:
        out = console()
        print_table(regret.table(found), out)
        for text, alarm in regret.sentences(found):
            print_lines(out, [text], "bold red" if alarm else "")

    show({"scenes": found}, printed, as_json=as_json)
