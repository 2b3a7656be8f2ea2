"""Make the plan of an evaluation, for every command that evaluates and for the Python interface.

In: requests, policies and baselines. Out: an entry for each policy on each scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

from flipperctl.config import DEFAULT_ENGINE, EvalConfig, resolver
from flipperctl.config.policy_file import is_policy_file
from flipperctl.errors import RequestError
from flipperctl.evaluation.conditions import Inherited, policy_notes, read_config
from flipperctl.evaluation.engines import steps
from flipperctl.evaluation.names import names as short_names
from flipperctl.evaluation.plan import (
    Entry,
    NamedPolicy,
    Plan,
    controllers,
    find_suite,
    standing,
)
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.requests.compose import compose_eval, register_trained
from flipperctl.requests.request import Request, Requests, Several
from flipperctl.requests.text import from_words
from flipperctl.terminal.streams import print_note

Tell = Callable[[str], None]
Scene = tuple[EvalConfig, PolicySource]
"""``config.eval`` holds the number of episodes and the seed."""
Section = tuple[str, Requests]
"""Name and requests of a scene of a suite, or of the only scene, whose name is empty."""


def scenes(
    requests: Requests,
    checkpoint: Path | None,
    controller: str | None,
    tell: Tell = print_note,
) -> list[Scene]:
    """Return a configuration and the policy's source for each scene.

    ``controller`` is the policy if there is no ``checkpoint``. ``tell`` is called with lines on how
    the evaluation of a checkpoint differs from its training.

    Raises:
        CheckpointError: there is no such policy, its observation layout differs, or the plugin of
            its training terrain is missing and no other terrain is chosen.
        ConfigError: a request is wrong.
    """
    # A controller takes any scene.
    if checkpoint is None:
        file = controller if controller and is_policy_file(controller) else ""
        if not file:
            resolver.get("controller", controller, "--controller")
        composed = compose_eval(Requests.of([Request("controller", controller)], requests))
        played = [
            (config, PolicySource(settings=settings, name=file)) for config, settings in composed
        ]
        notes = (note for config, source in played for note in source.notes(config))
        for note in dict.fromkeys(notes):
            tell(note)
        return played

    # A trained policy has scenes of its own, on which it must fit.
    source = load_policy(checkpoint, takes="file", tell=tell)
    terrains = [combination.choice("terrain") for combination in requests.combinations()]
    trained = read_config(source, terrains, tell)
    configs = [config for config, _ in compose_eval(requests, register_trained(trained))]
    # This raises for a wrong layout or robot, before the first episode.
    for config in configs:
        source.build(config)
    for note in policy_notes(checkpoint, trained, configs, requests.typed):
        tell(note)
    return [(config, source) for config in configs]


def make_plan(
    requests: Requests,
    entrants: Sequence[NamedPolicy],
    baseline: str | None,
    tell: Tell,
    *,
    returns: bool = True,
) -> Plan:
    """Return the plan; the policies of several entrants play equal scenes one after the other.

    ``suite`` among the requests names a suite. ``baseline``: names of controllers that play the
    same episodes; None stands for the policy's own, or for ``level,geometric`` beside several
    policies.
    ``tell`` is called with lines on what a reader might not expect, on returns with ``returns``.

    Raises:
        CheckpointError: there is no such policy, or its observation layout differs.
        ConfigError: a request, a suite or a controller is wrong.
        RequestError: a name of a baseline is wrong, or an engine is compared with itself.
    """
    # Words that are no settings of an evaluation
    named = [request.value for request in requests if request.path == "suite"]
    suite = find_suite(str(named[0])) if named else None
    settings = Requests(tuple(request for request in requests if request.path != "suite"))
    settings, compares_engines = _split_engines(settings)

    # One policy, with its own baselines
    if suite is None and len(entrants) == 1:
        (policy,) = entrants
        played = scenes(settings, policy.run, policy.controller, tell)
        source = played[0][1]
        against = controllers(baseline, "--baseline", source.baselines())
        entries = [Entry(*scene) for scene in played]
        (title,) = short_names([source.label()]).values()
        return Plan.of_one(_steps(entries) if compares_engines else entries, against, title)

    # Several policies, or a suite: all play all scenes
    sections = [("", settings)]
    if suite is not None:
        sections = [
            _section(scene.name, from_words(scene.words), settings) for scene in suite.scenes
        ]
    references = standing(baseline, entrants)
    entries = _entries(
        entrants, references, sections, tell, engines=compares_engines, returns=returns
    )
    title = ", ".join(short_names([entrant.method for entrant in entrants]).values())
    title = f"suite {suite.name}: {title}" if suite else title
    return Plan(tuple(entries), title, has_baselines=baseline != "none")


def entries_of(
    entrants: Sequence[NamedPolicy], sections: Sequence[Section], tell: Tell
) -> list[Entry]:
    """Return an entry for each policy on each of the sections; see ``make_plan``."""
    return _entries(entrants, (), sections, tell, engines=False, returns=False)


def _section(name: str, scene: Requests, settings: Requests) -> Section:
    """Return a scene of a suite with the user's settings, which replace its own of the same keys.

    They are in its name, but for the terrain, which tables name by themselves.
    """
    replaced = {request.path: request.text for request in scene if request.path != "terrain"}
    changed = [r.text for r in settings if replaced.get(r.path, r.text) != r.text]
    paths = {request.path for request in settings}
    remaining = [request for request in scene if request.path not in paths]
    return " ".join([f"{name},", *changed]) if changed else name, Requests.of(remaining, settings)


def _split_engines(requests: Requests) -> tuple[Requests, bool]:
    """Return the requests without the default engine among several, and whether it was there."""
    for index, request in enumerate(requests.items):
        engines = request.value.requests if isinstance(request.value, Several) else ()
        if request.path != "sim" or not any(r.value == DEFAULT_ENGINE for r in engines):
            continue
        others = tuple(engine for engine in engines if engine.value != DEFAULT_ENGINE)
        if not others:
            raise RequestError(
                f"{request.text}: another engine is compared with {DEFAULT_ENGINE}, as in "
                f"sim={DEFAULT_ENGINE},mujoco"
            )
        changed = others[0] if len(others) == 1 else Request("sim", Several(others))
        return Requests((*requests.items[:index], changed, *requests.items[index + 1 :])), True
    return requests, False


def _steps(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries, each preceded by the steps that lead to it from the default engine."""
    return [
        replace(entry, config=config, comparison=number)
        for number, entry in enumerate(entries)
        for config in steps(entry.config)
    ]


def _entries(
    entrants: Sequence[NamedPolicy],
    references: Sequence[NamedPolicy],
    sections: Sequence[Section],
    tell: Tell,
    *,
    engines: bool,
    returns: bool,
) -> list[Entry]:
    """Return the entries of several methods or of a suite, scene by scene, each once.

    The ``references`` are played once under each policy's conditions.
    """
    rows: dict[tuple[str, str, int, int], list[Entry]] = {}

    def add(entry: Entry) -> None:
        equal = rows.setdefault(entry.ground, [])
        # What results on equal episodes depend on.
        plays = entry.source, entry.config.rewards, entry.config.perception.layout
        others = ((o.source, o.config.rewards, o.config.perception.layout) for o in equal)
        if plays not in others:
            equal.append(entry)

    # The policies by short names, with their training seeds where these tell them apart.
    called = short_names([entrant.method for entrant in (*entrants, *references)])
    methods = [entrant.method for entrant in entrants]
    planned = [
        Entry(
            config,
            source,
            scene,
            called[entrant.method],
            entrant.training_seed if methods.count(entrant.method) > 1 else None,
        )
        for entrant, played in zip(entrants, _played(entrants, sections, tell), strict=True)
        for scene, config, source in played
    ]
    for entry in _steps(planned) if engines else planned:
        add(entry)
    _tell_unlike([entry for equal in rows.values() for entry in equal], tell)

    # The references beside them.
    keys = [request.package or request.key for _, part in sections for request in part]
    sets_rewards = any(key.startswith("rewards") for key in keys)
    sources = [(entrant, load_policy(entrant.controller, "--baseline")) for entrant in references]
    for equal in list(rows.values()):
        configs = _of_each_reward(equal)
        if not sets_rewards:  # as when they are asked for by name, so that the same blocks serve
            rewards = EvalConfig(terrain=configs[0].terrain).rewards
            configs = [configs[0].model_copy(update={"rewards": rewards})]
        for (entrant, source), config in product(sources, configs):
            add(Entry(config, source, equal[0].scene, called[entrant.method], is_baseline=True))
    if (
        returns
        and not sets_rewards
        and any(len(_of_each_reward(equal)) > 1 for equal in rows.values())
    ):
        tell("return does not compare: the policies have different rewards; rewards=… sets one")
    return [entry for equal in rows.values() for entry in equal]


def _of_each_reward(entries: Sequence[Entry]) -> list[EvalConfig]:
    """Return the first configuration with each of the different rewards of a scene."""
    configs: list[EvalConfig] = []
    for entry in entries:
        if all(entry.config.rewards != other.rewards for other in configs):
            configs.append(entry.config)
    return configs


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


def _played(
    entrants: Sequence[NamedPolicy], sections: Sequence[Section], tell: Tell
) -> Iterator[list[tuple[str, EvalConfig, PolicySource]]]:
    """Yield the scenes of each policy, composed once for all that inherit equal settings.

    ``tell`` is called once with each line. A controller with settings among the requests has scenes
    of its own. Without a terrain among them, controllers play the scenes of the policies beside
    them, if these inherit equal settings.
    """
    printed: set[str] = set()
    known: list[tuple[Inherited | None, list[tuple[str, EvalConfig]]]] = []

    def once(line: str) -> None:
        if line not in printed:
            printed.add(line)
            tell(line)

    # What each policy brings from its training, and whose scenes controllers play
    sources = {e: load_policy(e.run, takes="file", tell=once) for e in entrants if e.run}
    brought = {e: Inherited.of(read_config(sources[e], [], lambda text: None)) for e in sources}
    keys = {request.path.partition(".")[0] for _, part in sections for request in part}
    alike = all(former == later for former, later in pairwise(brought.values()))
    host = next(iter(brought), None) if alike and not {"controller", "terrain"} & keys else None

    # Scenes that were composed for an equal policy are used again.
    for entrant in entrants:
        maker = entrant if entrant.run or host is None else host
        source = sources.get(entrant) or load_policy(
            entrant.controller, "--controller", "controller", fields={}
        )
        equal = next((configs for who, configs in known if who == brought.get(maker)), None)
        is_equal = entrant.run or "controller" not in keys
        if equal is None or not is_equal:
            composed = [
                (name, *scene)
                for name, part in sections
                for scene in scenes(part, maker.run, maker.controller, once)
            ]
            if is_equal:
                equal = [(name, config) for name, config, _ in composed]
                known.append((brought.get(maker), equal))
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
