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
    from flipperctl.evaluation.plan import NamedPolicy
    from flipperctl.evaluation.rewards import Rewards, RewardScene
    from flipperctl.requests.request import Requests

_REWARD_KEY = re.compile(r"[+~]*(rewards(?=[.=]|$)|reward@)")
_DEFAULT = "paper"
"""Preset of ``configs/eval.yaml``."""
_FIELD = "controller."


def reward(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="[POLICY...] [SETTING...]", help="Policies, else okada; key=value."),
    ] = None,
    regret: Annotated[
        bool, typer.Option("--regret", help="The return that a policy lacks.")
    ] = False,
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

    Several policies (controllers, checkpoints, generalist) play the same episodes, and are ranked
    by reward and by pitch variation. A warning says if a rougher policy earns more than a smoother
    one: both paired t-tests are significant at 5 %, corrected for all comparisons (Holm). Fields of
    a controller (controller.<field>) apply to each policy that has them, and eval.seed and
    eval.jobs set the seed and the number of processes.

    --regret compares the reward of the first policy with those of the others, by default level,
    geometric and mpc, on the same episodes. It says if the policy earns less than holding the
    flippers still (level). Regret is what it lacks to the highest reward of each episode. All
    episodes count, failed ones too. controller.<field> applies to the first policy, if it is a
    controller, else to the others.

    [bold]Examples[/]

      flipperctl inspect reward terrain=stair

      flipperctl inspect reward runs/first rewards.swing.weight=4

      flipperctl inspect reward level okada rewards=paper,tuned

      flipperctl inspect reward okada planner controller.width=8

      flipperctl inspect reward generalist --regret terrain=ramp
    """
    from flipperctl.config.words import with_default, with_flags
    from flipperctl.evaluation.plan import split_names, split_policies

    named, settings = split_policies(words)
    names = [name for text in named for name in split_names(text)]
    settings = with_default(with_flags(settings, episodes=episodes), "eval.episodes", 20)
    if regret:
        _regret(names, settings, output, as_json=as_json)
        return
    if len(names) > 1:
        _compare(names, settings, as_json=as_json)
        return
    from flipperctl.cli.plan import one_scene
    from flipperctl.evaluation.conditions import Conditions
    from flipperctl.evaluation.rewards import audit
    from flipperctl.terminal.progress import episodes_progress
    from flipperctl.text.show import console, print_table
    from flipperctl.views.rewards import audit_table

    entry = one_scene([*(names or ["okada"]), *settings], "inspect reward")
    config, source = entry.config, entry.source
    count = config.eval.episodes
    with episodes_progress(f"{config.terrain.title}, {source.label()}", count) as report:
        judgement = audit(config, source, episodes=count, report=report)
    conditions = Conditions.of(config)
    notes = [f"conditions {conditions.name}: {text}"] if (text := conditions.line()) else []
    show(judgement, lambda: print_table(audit_table(judgement, notes), console()), as_json=as_json)


def _compare(names: Sequence[str], words: Sequence[str], *, as_json: bool) -> None:
    """Rank policies on each combination of the lists of settings other than rewards.

    Lists of rewards, as in ``rewards=paper,tuned``, give the sets of each scene. A trained policy
    brings its robot and its rewards, the first one of several.
    """
    from flipperctl.cli.plan import player
    from flipperctl.evaluation.plan import entrants, policies
    from flipperctl.evaluation.rewards import rank_policies
    from flipperctl.requests.plan import scenes as composed
    from flipperctl.requests.text import from_words
    from flipperctl.text.show import console, print_lines, print_table
    from flipperctl.views import rewards

    fields, requests = controller_fields(from_words(words))
    sources = policies(names, fields, print_note)
    players = entrants(names, print_note)
    host = next((policy for policy in players if policy.run), players[0])
    scenes: dict[tuple[str, ...], RewardScene] = {}
    for combination in requests.combinations():
        scene, label = _split(combination)
        ((config, _),) = composed(combination, host.run, host.controller, lambda text: None)
        if not config.rewards:
            raise ConfigError(f"rewards: {label!r} leaves no term to rank policies by")
        sets: dict[str, Rewards] = {**scenes[scene][1]} if scene in scenes else {}
        scenes[scene] = config, sets | {label or _default(host): config.rewards}
    with player(None, "reward") as (plays, _):
        ranking = rank_policies(list(scenes.values()), sources, plays)

    def printed() -> None:
        out = console()
        print_table(rewards.table(ranking), out)
        print_lines(out, rewards.verdict_lines(ranking))

    show({"scenes": ranking}, printed, as_json=as_json)


def _regret(
    names: Sequence[str], words: Sequence[str], output: Path | None, *, as_json: bool
) -> None:
    """Compare a policy with references on each combination of the lists, rewards included.

    The first of the ``names`` is the policy's, the others are those of the references.
    """
    from flipperctl.cli.plan import player
    from flipperctl.evaluation.plan import RULES, entrants, policies
    from flipperctl.evaluation.regret import RegretScene, measure
    from flipperctl.requests.plan import scenes
    from flipperctl.requests.text import from_words
    from flipperctl.text.show import console, print_lines, print_table
    from flipperctl.views import regret

    if not names or len(measured := entrants(names[:1], print_note)) != 1:
        raise RequestError(
            "--regret: name a policy, and perhaps its references, as in: flipperctl inspect reward "
            "generalist level okada --regret"
        )
    (policy,) = measured
    requests, fields = from_words(words), dict[str, Any]()
    if policy.run is not None:
        fields, requests = controller_fields(requests)
    others = policies(names[1:] or (*RULES, "mpc"), fields, print_note)
    labels = [_split(combination)[1] for combination in requests.combinations()]
    chosen = [
        RegretScene(config, label or _default(policy), names[0], source, others)
        for (config, source), label in zip(
            scenes(requests, policy.run, policy.controller), labels, strict=True
        )
    ]
    with player(output, "regret") as (plays, _):
        regrets = [row for scene in chosen if (row := measure(scene, plays)) is not None]
    if not regrets:
        raise InterruptedRunError("interrupted: no scene is finished")

    def printed() -> None:
        out = console()
        print_table(regret.table(regrets), out)
        for text, alarm in regret.sentences(regrets):
            print_lines(out, [text], "bold red" if alarm else "")

    show({"scenes": regrets}, printed, as_json=as_json)


def _default(policy: NamedPolicy) -> str:
    """Return the label of the rewards of an evaluation of a policy, unless others are chosen."""
    return "own" if policy.run else _DEFAULT


def _split(combination: Requests) -> tuple[tuple[str, ...], str]:
    """Return the overrides of all but the rewards, and a label of those of the rewards."""
    rewards = [word for word in combination.words if _REWARD_KEY.match(word)]
    others = tuple(word for word in combination.words if word not in rewards)
    return others, " ".join(word.removeprefix("rewards=") for word in rewards)


def controller_fields(requests: Requests) -> tuple[dict[str, Any], Requests]:
    """Return the values of ``controller.<field>`` by field, and the others.

    Each field applies to the controllers among the policies that have it.
    """
    from flipperctl.requests.compose import with_preset

    if "controller" in requests.typed:
        raise RequestError(
            "controller: the policies are named by words, as in level okada; leave the override out"
        )
    term_fields = requests.where(lambda key: key.startswith(_FIELD)).values()
    others = requests.where(lambda key: not key.startswith(_FIELD))
    fields = {key.removeprefix(_FIELD): value for key, value in term_fields.items()}
    return with_preset(fields, "controller"), others
