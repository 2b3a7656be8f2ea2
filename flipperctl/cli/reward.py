"""``flipperctl inspect reward``: audit reward terms, rank policies by rewards, and find regret."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flipperctl.cli import options
from flipperctl.errors import ConfigError, InterruptedRunError, RequestError
from flipperctl.terminal.streams import print_note, show

if TYPE_CHECKING:
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.evaluation.rewards import Rewards, RewardScene

_REWARD_KEY = re.compile(r"[+~]*(rewards(?=[.=]|$)|reward@)")
_DEFAULT = "paper"
"""Preset of ``configs/eval.yaml``."""
_FIELD = "controller."


def reward(
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
    """Audit the reward: the share of each term in the return, and how often it saturates.

    A term with a small share of the return has no effect; one that saturates at most steps carries
    no information. The episodes are those of an evaluation, with conditions=… as for eval.

    --compare plays the same episodes with several policies (controllers, checkpoints, generalist)
    and ranks them by reward and by pitch variation. It warns if a rougher policy earns more than a
    smoother one: both paired t-tests are significant at 5 %, corrected for all comparisons (Holm).
    Fields of a controller (controller.<field>) apply to each compared controller that has them, and
    eval.seed and eval.jobs set the seed and the number of processes.

    --regret compares the reward of a policy with those of --against on the same episodes, and says
    if it earns less than holding the flippers still (level). Regret is what the policy lacks to the
    highest reward of each episode. All episodes count, failed ones too. With --checkpoint,
    controller.<field> applies to the controllers of --against.

    [bold]Examples[/]

      flipperctl inspect reward terrain=stair

      flipperctl inspect reward --checkpoint runs/first rewards.swing.weight=4

      flipperctl inspect reward --compare level,okada rewards=paper,tuned

      flipperctl inspect reward --compare okada,planner controller.width=8

      flipperctl inspect reward --regret --checkpoint generalist terrain=ramp
    """
    from flipperctl.config.words import with_default, with_flags
    from flipperctl.evaluation.plan import controller_or_okada, require_one_policy

    chosen = controller_or_okada(checkpoint, controller)
    words = with_default(with_flags(overrides, episodes=episodes), "eval.episodes", 20)
    if against is not None and not regret:
        raise RequestError("--against names the references of --regret; add --regret")
    if compare is not None:
        if checkpoint is not None or controller is not None or regret:
            other = "--regret" if regret else "--checkpoint and --controller"
            raise RequestError(f"--compare names all policies; omit {other}")
        _compare(compare, words, as_json=as_json)
        return
    if regret:
        require_one_policy(checkpoint, controller, overrides)
        references = against or "level,okada,mpc"
        _regret(words, checkpoint, controller, references, output, as_json=as_json)
        return
    from flipperctl.cli.hydra.compose import only_one
    from flipperctl.cli.plan import scenes
    from flipperctl.evaluation.conditions import Conditions
    from flipperctl.evaluation.rewards import audit
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.text.show import console, print_table
    from flipperctl.views.rewards import audit_table

    config, source = only_one(scenes(words, checkpoint, chosen))
    count = config.eval.episodes
    with episodes_progress(f"{config.terrain.plugin_name}, {source.label()}", count) as report:
        found = audit(config, source, episodes=count, report=report)
    conditions = Conditions.of(config)
    notes = [f"conditions {conditions.name}: {text}"] if (text := conditions.line()) else []
    show(found, lambda: print_table(audit_table(found, notes), console()), as_json=as_json)


def _compare(names: str, words: Sequence[str], *, as_json: bool) -> None:
    """Rank policies on each combination of the lists of settings other than rewards.

    Lists of rewards, as in ``rewards=paper,tuned``, give the sets of each scene. The robot is that
    of the files among the policies.
    """
    from flipperctl.cli.hydra.compose import compose_eval, register_robot
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.cli.plan import player
    from flipperctl.evaluation.plan import common_robot, policies
    from flipperctl.evaluation.rewards import rank_policies
    from flipperctl.text.show import console, print_lines, print_table
    from flipperctl.views import rewards

    fields, overrides = controller_fields(Overrides.parse(words), "--compare")
    sources = policies(names, fields, print_note)
    primary = register_robot(common_robot(sources, overrides.typed))
    scenes: dict[tuple[str, ...], RewardScene] = {}
    for combination in overrides.combinations():
        scene, label = _split(combination)
        ((config, _),) = compose_eval(combination, primary)
        if not config.rewards:
            raise ConfigError(f"rewards: {label!r} leaves no term to rank policies by")
        sets: dict[str, Rewards] = {**scenes[scene][1]} if scene in scenes else {}
        scenes[scene] = config, sets | {label or _DEFAULT: config.rewards}
    with player(None, "reward") as (plays, _):
        found = rank_policies(list(scenes.values()), sources, plays)

    def printed() -> None:
        out = console()
        print_table(rewards.table(found), out)
        print_lines(out, rewards.verdict_lines(found))

    show({"scenes": found}, printed, as_json=as_json)


def _regret(
    words: Sequence[str],
    checkpoint: Path | None,
    controller: str | None,
    against: str,
    output: Path | None,
    *,
    as_json: bool,
) -> None:
    """Compare a policy with references on each combination of the lists, rewards included."""
    from flipperctl.cli.hydra.overrides import Overrides
    from flipperctl.cli.plan import player, scenes
    from flipperctl.evaluation.plan import policies
    from flipperctl.evaluation.regret import RegretScene, measure
    from flipperctl.text.show import console, print_lines, print_table
    from flipperctl.views import regret

    overrides, fields = Overrides.parse(words), dict[str, Any]()
    if checkpoint is not None:
        fields, overrides = controller_fields(overrides, "--against")
    others = policies(against, fields, print_note, "--against", fewest=1)
    labels = [_split(combination)[1] for combination in overrides.combinations()]
    default, name = "own" if checkpoint else _DEFAULT, str(checkpoint or controller)
    chosen = [
        RegretScene(config, label or default, name, source, others)
        for (config, source), label in zip(
            scenes(overrides.words, checkpoint, controller), labels, strict=True
        )
    ]
    with player(output, "regret") as (plays, _):
        found = [one for scene in chosen if (one := measure(scene, plays)) is not None]
    if not found:
        raise InterruptedRunError("interrupted: no scene is finished")

    def printed() -> None:
        out = console()
        print_table(regret.table(found), out)
        for text, alarm in regret.sentences(found):
            print_lines(out, [text], "bold red" if alarm else "")

    show({"scenes": found}, printed, as_json=as_json)


def _split(combination: Overrides) -> tuple[tuple[str, ...], str]:
    """Return the overrides of all but the rewards, and a label of those of the rewards."""
    rewards = [word for word in combination.words if _REWARD_KEY.match(word)]
    others = tuple(word for word in combination.words if word not in rewards)
    return others, " ".join(word.removeprefix("rewards=") for word in rewards)


def controller_fields(overrides: Overrides, option: str) -> tuple[dict[str, Any], Overrides]:
    """Return the overrides of ``controller.<field>`` by field, and the others.

    Each field applies to the controllers of ``option`` that have it.
    """
    from flipperctl.cli.hydra.compose import with_preset

    if "controller" in overrides.typed:
        raise RequestError(f"controller: {option} names the controllers; leave the override out")
    own = overrides.where(lambda key: key.startswith(_FIELD)).values()
    others = overrides.where(lambda key: not key.startswith(_FIELD))
    fields = {key.removeprefix(_FIELD): value for key, value in own.items()}
    return with_preset(fields, "controller"), others
