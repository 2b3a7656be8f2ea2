"""Make the plan of an evaluation, for every command that evaluates and for the Python interface.

In: overrides, policies, baselines and a suite. Out: an entry for each policy on each scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

from flipperctl.checkpoint.results import ResultFolder
from flipperctl.cli.hydra.compose import compose_eval, register_trained
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import DEFAULT_ENGINE, EvalConfig, resolver
from flipperctl.config.policy_file import is_policy_file
from flipperctl.config.words import key_of
from flipperctl.errors import RequestError
from flipperctl.evaluation.conditions import Inherited, policy_notes, read_config
from flipperctl.evaluation.engines import steps
from flipperctl.evaluation.plan import (
    Entry,
    NamedPolicy,
    Plan,
    SuiteScene,
    controllers,
    entrants,
    split_policies,
    split_suite,
    standing,
)
from flipperctl.evaluation.play import Player
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.terminal.streams import print_note
from flipperctl.views.summary import short

Tell = Callable[[str], None]
Scene = tuple[EvalConfig, PolicySource]
"""``config.eval`` holds the number of episodes and the seed."""


def scenes(
    words: Sequence[str], checkpoint: Path | None, controller: str | None, tell: Tell = print_note
) -> list[Scene]:
    """Return a configuration and the policy's source for each scene.

    ``words`` are overrides; ``controller`` is the policy if there is no ``checkpoint``. ``tell`` is
    called with lines on how the evaluation of a checkpoint differs from its training.

    Raises:
        CheckpointError: there is no such policy, its observation layout differs, or the plugin of
            its training terrain is missing and no other terrain is chosen.
        ConfigError: an override is wrong.
    """
    if checkpoint is None:
        file = controller if controller and is_policy_file(controller) else ""
        if not file:
            resolver.get("controller", controller, "--controller")
        overrides = Overrides.parse([f"controller={controller}", *words])
        found = compose_eval(overrides)
        made = [(config, PolicySource(settings=own, name=file)) for config, own in found]
        for note in dict.fromkeys(note for config, source in made for note in source.notes(config)):
            tell(note)
        return made
    source = load_policy(checkpoint, takes="file", tell=tell)
    overrides = Overrides.parse(words)
    terrains = [c.choice("terrain") for c in overrides.combinations()]
    trained = read_config(source, terrains, tell)
    primary = register_trained(trained)
    configs = [config for config, _ in compose_eval(overrides, primary)]
    # This raises for a wrong layout or robot, before the first episode.
    for config in configs:
        source.build(config)
    for note in policy_notes(checkpoint, trained, configs, overrides.typed):
        tell(note)
    return [(config, source) for config in configs]


def one_scene(words: Sequence[str] | None, command: str) -> Entry:
    """Return the policy that the words name, on the only scene."""
    names, settings = split_policies(words)
    policies = entrants(names, print_note)
    if len(policies) != 1:
        given = ", ".join(names) or "none"
        raise RequestError(
            f"{command} takes one policy, as in: flipperctl {command} generalist terrain=stair; "
            f"{given} is given"
            if len(policies) < 2
            else f"{command} takes one policy; {given} are given"
        )
    (policy,) = policies
    if any(key_of(word) == "suite" for word in settings):
        raise RequestError(f"suite=…: {command} takes one scene; leave it out")
    found = scenes(settings, policy.run, policy.controller)
    if len(found) != 1:
        raise RequestError(f"{command} takes one scene; the settings give {len(found)}")
    return Entry(*found[0])


@contextmanager
def player(
    output: Path | None, command: str, names: Sequence[str] = ()
) -> Iterator[tuple[Player, ResultFolder | None]]:
    """Yield a player whose episodes are kept below ``output``, and that folder, if it is given.

    ``names`` are those of the files that ``command`` writes. Ctrl-C ends the running episode first.
    """
    from flipperctl.checkpoint.results import result_folder
    from flipperctl.evaluation.store import FOLDER, EpisodeStore, FolderStore
    from flipperctl.process.session import interrupts
    from flipperctl.terminal.progress import episodes_progress

    with ExitStack() as stack:
        store, folder = EpisodeStore(), None
        if output is not None:
            folder = stack.enter_context(result_folder(output, command, names))
            store = FolderStore(output / FOLDER, print_note)
        stop = stack.enter_context(interrupts("finishing the episode; Ctrl-C again stops at once"))
        yield stack.enter_context(Player(store, episodes_progress, stop)), folder


def make_plan(
    words: Sequence[str],
    entrants: Sequence[NamedPolicy],
    baseline: str | None,
    tell: Tell,
    *,
    returns: bool = True,
) -> Plan:
    """Return the plan; the policies of several entrants play equal scenes one after the other.

    ``words`` are overrides, with ``suite=NAME`` if there is one. ``baseline``: names of controllers
    that play the same episodes; None stands for the policy's own, or for ``level,okada`` beside
    several policies. ``tell`` is called with lines on what a reader might not expect, of returns if
    these are shown.

    Raises:
        CheckpointError: there is no such policy, or its observation layout differs.
        ConfigError: an override, a suite or a controller is wrong.
        RequestError: a name of a baseline is wrong, or an engine is compared with itself.
    """
    suite, arguments = split_suite(list(words))
    arguments, engines = _split_engines(arguments)
    if suite is None and len(entrants) == 1:
        (policy,) = entrants
        found = scenes(arguments, policy.run, policy.controller, tell)
        source = found[0][1]
        against = controllers(baseline, "--baseline", source.baselines())
        entries = [Entry(*scene) for scene in found]
        typed = policy.run is not None and policy.run.is_dir()
        title = str(policy.run) if typed else short(source.label())
        return Plan.of_one(_steps(entries) if engines else entries, against, title)
    parts = suite.scenes if suite else (SuiteScene("", ()),)
    beside = standing(baseline, entrants)
    entries = _entries(arguments, entrants, beside, parts, tell, engines=engines, returns=returns)
    title = ", ".join(map(short, dict.fromkeys(entrant.method for entrant in entrants)))
    title = f"suite {suite.name}: {title}" if suite else title
    return Plan(tuple(entries), title, with_best_known=baseline != "none")


def _split_engines(words: Sequence[str]) -> tuple[list[str], bool]:
    """Return the words without the default engine among several, and whether it was there."""
    found, several = [], False
    for word in words:
        key, _, value = word.partition("=")
        names = value.split(",")
        if key == "sim" and len(names) > 1 and DEFAULT_ENGINE in names:
            several = True
            others = [name for name in names if name not in (DEFAULT_ENGINE, "")]
            if not others:
                raise RequestError(
                    f"{word}: another engine is compared with {DEFAULT_ENGINE}, as in "
                    f"sim={DEFAULT_ENGINE},mujoco"
                )
            word = f"sim={','.join(others)}"
        found.append(word)
    return found, several


def _steps(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries, each preceded by the steps that lead to it from the default engine."""
    return [
        replace(entry, config=config, comparison=number)
        for number, entry in enumerate(entries)
        for config in steps(entry.config)
    ]


def _entries(
    words: Sequence[str],
    entrants: Sequence[NamedPolicy],
    beside: Sequence[NamedPolicy],
    parts: Sequence[SuiteScene],
    tell: Tell,
    *,
    engines: bool,
    returns: bool,
) -> list[Entry]:
    """Return the entries of several methods or of a suite, scene by scene.

    The controllers ``beside`` are played once under each policy's conditions.
    """
    sections = [(part.name_with(list(words)), part.with_words(list(words))) for part in parts]
    found: dict[tuple[str, str, int, int], list[Entry]] = {}
    several = {e.method for e in entrants if sum(o.method == e.method for o in entrants) > 1}

    def add(entry: Entry) -> None:
        rows = found.setdefault(entry.ground, [])
        # What results on equal episodes depend on.
        ours = entry.source, entry.config.rewards, entry.config.perception.layout
        others = ((o.source, o.config.rewards, o.config.perception.layout) for o in rows)
        if ours not in others:
            rows.append(entry)

    made = [
        Entry(
            *(config, source, scene, entrant.method),
            entrant.training_seed if entrant.method in several else None,
        )
        for entrant, own in zip(entrants, _composed(entrants, sections, tell), strict=True)
        for scene, config, source in own
    ]
    for entry in _steps(made) if engines else made:
        add(entry)
    _tell_unlike([entry for rows in found.values() for entry in rows], tell)
    keys = [key_of(word).rpartition("@")[2] for _, part in sections for word in part]
    chosen = any(key.startswith("rewards") for key in keys)
    controllers = [(e, load_policy(e.controller, "--baseline")) for e in beside]
    for rows in list(found.values()):
        configs = _of_each_reward(rows)
        if not chosen:  # as when they are asked for by name, so that the same blocks serve
            own = EvalConfig(terrain=configs[0].terrain).rewards
            configs = [configs[0].model_copy(update={"rewards": own})]
        for (entrant, source), config in product(controllers, configs):
            add(Entry(config, source, rows[0].scene, entrant.method, is_baseline=True))
    if returns and not chosen and any(len(_of_each_reward(rows)) > 1 for rows in found.values()):
        tell("return does not compare: the policies have different rewards; rewards=… sets one")
    return [entry for rows in found.values() for entry in rows]


def _of_each_reward(entries: Sequence[Entry]) -> list[EvalConfig]:
    """Return the first configuration with each of the different rewards of a scene."""
    found: list[EvalConfig] = []
    for entry in entries:
        if all(entry.config.rewards != other.rewards for other in found):
            found.append(entry.config)
    return found


def _tell_unlike(entries: Sequence[Entry], tell: Tell) -> None:
    """Tell if methods play different scenes, as policies that bring their own ground."""
    played: dict[str, dict[str, None]] = {}
    for entry in entries:
        scene = f"{entry.terrain} {entry.conditions.hash}"
        played.setdefault(entry.method, {})[scene] = None
    if len({frozenset(scenes) for scenes in played.values()}) > 1:
        each = "; ".join(
            f"{method}: {next(iter(scenes))}{' …' if len(scenes) > 1 else ''}"
            for method, scenes in played.items()
        )
        tell(
            f"these policies play different scenes, so they do not compare ({each}); terrain=… and "
            "conditions=… set the same for all"
        )


def _composed(
    entrants: Sequence[NamedPolicy], sections: Sequence[tuple[str, Sequence[str]]], tell: Tell
) -> Iterator[list[tuple[str, EvalConfig, PolicySource]]]:
    """Yield the scenes of each policy, composed once for those that inherit equal settings.

    ``sections`` are the names and words of the scenes; ``tell`` is called once with each line. A
    controller with settings among the words has scenes of its own. Without a terrain among them,
    controllers play the scenes of the policies beside them, if these inherit equal settings.
    """
    told: set[str] = set()
    known: list[tuple[Inherited | None, list[tuple[str, EvalConfig]]]] = []

    def once(line: str) -> None:
        if line not in told:
            told.add(line)
            tell(line)

    sources = {e: load_policy(e.run, takes="file", tell=once) for e in entrants if e.run}
    brought = {e: Inherited.of(read_config(sources[e], [], lambda text: None)) for e in sources}
    keys = [key_of(word).partition(".")[0] for _, part in sections for word in part]
    own = "controller" in keys
    alike = all(one == other for one, other in pairwise(brought.values()))
    host = next(iter(brought), None) if alike and not {"controller", "terrain"} & {*keys} else None
    for entrant in entrants:
        maker = entrant if entrant.run or host is None else host
        inherited = brought.get(maker)
        source = sources.get(entrant) or load_policy(
            entrant.controller, "--controller", "controller", fields={}
        )
        equal = next((configs for who, configs in known if who == inherited), None)
        if equal is None or (own and not entrant.run):
            composed = [
                (name, *scene)
                for name, words in sections
                for scene in scenes(words, maker.run, maker.controller, once)
            ]
            if entrant.run or not own:
                known.append((inherited, [(name, config) for name, config, _ in composed]))
            if maker is entrant:
                yield composed
                continue
            equal = known[-1][1]
        for _, config in equal:
            if entrant.run is not None:
                source.build(config)  # it raises before the first episode
                continue
            for note in source.notes(config):
                once(note)
        yield [(name, config, source) for name, config in equal]
