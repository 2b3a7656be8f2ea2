"""Make the plan of an evaluation, for ``eval`` and for the Python interface.

In: overrides, policies, baselines and a suite. Out: an entry for each policy on each scene.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from flipperctl.cli.scenes import scenes
from flipperctl.config import DEFAULT_ENGINE, EvalConfig
from flipperctl.config.words import key_of
from flipperctl.errors import RequestError
from flipperctl.evaluation.inherited import Inherited, read_config
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.policies import Entrant, controllers, standing
from flipperctl.evaluation.suites import SuiteScene, split_suite
from flipperctl.evaluation.views.engines import steps
from flipperctl.evaluation.views.summary import short
from flipperctl.policies.source import PolicySource, load_policy

Tell = Callable[[str], None]


def make_plan(
    words: Sequence[str], entrants: Sequence[Entrant], baseline: str | None, tell: Tell
) -> Plan:
    """Return the plan; the policies of several entrants play equal scenes one after the other.

    ``words`` are overrides, with ``suite=NAME`` if there is one. ``baseline``: names of controllers
    that play the same episodes; None stands for the policy's own, or for ``level,okada`` beside
    several policies. ``tell`` is called with lines on what a reader might not expect.

    Raises:
        CheckpointError: there is no such policy, or its observation layout differs.
        ConfigError: an override, a suite or a controller is wrong.
        RequestError: a name of a baseline is wrong, or an engine is compared with itself.
    """
    suite, arguments = split_suite(list(words))
    arguments, engines = _split_engines(arguments)
    names = dict.fromkeys(entrant.method for entrant in entrants)
    title = ", ".join(map(short, names))
    if suite is None and len(entrants) == 1:
        (policy,) = entrants
        found = scenes(arguments, policy.run, None if policy.run else policy.method, tell)
        source = found[0][1]
        against = controllers(baseline, "--baseline", source.baselines())
        entries = [Entry(*scene) for scene in found]
        typed = policy.run is not None and policy.run.is_dir()
        title = str(policy.run) if typed else short(source.label())
        return Plan.of_one(_steps(entries) if engines else entries, against, title)
    parts = suite.scenes if suite else (SuiteScene("", ()),)
    beside = standing(baseline, entrants)
    entries = _entries(arguments, entrants, beside, parts, tell, engines=engines)
    title = f"suite {suite.name}: {title}" if suite else title
    return Plan(tuple(entries), title, with_best_known=baseline != "none")


def _split_engines(words: Sequence[str]) -> tuple[list[str], bool]:
    """Return the words without the default engine among several, and whether it was there.

    Raises:
        RequestError: no other engine is named beside it.
    """
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
    entrants: Sequence[Entrant],
    beside: Sequence[Entrant],
    parts: Sequence[SuiteScene],
    tell: Tell,
    *,
    engines: bool,
) -> list[Entry]:
    """Return the entries of several methods or of a suite, scene by scene.

    The controllers ``beside`` are played once under each policy's conditions.
    """
    sections = [part.with_words(list(words)) for part in parts]
    composer = _Composer([part.name_with(list(words)) for part in parts], sections, tell)
    found: dict[tuple[str, str, int, int], list[Entry]] = {}
    several = {e.method for e in entrants if sum(o.method == e.method for o in entrants) > 1}

    def add(entry: Entry) -> None:
        rows = found.setdefault(entry.ground, [])
        ours = entry.source, _scoring(entry.config)
        if all(ours != (other.source, _scoring(other.config)) for other in rows):
            rows.append(entry)

    made = [
        Entry(
            *(config, source, scene, entrant.method),
            entrant.training_seed if entrant.method in several else None,
        )
        for entrant in entrants
        for scene, config, source in composer.of(entrant)
    ]
    for entry in _steps(made) if engines else made:
        add(entry)
    _tell_unlike([entry for rows in found.values() for entry in rows], tell)
    keys = [key_of(word).rpartition("@")[2] for part in sections for word in part]
    chosen = any(key.startswith("rewards") for key in keys)
    controllers = [(e, load_policy(e.method, "--baseline")) for e in beside]
    for rows in list(found.values()):
        configs = _of_each_reward(rows)
        if not chosen:  # as when they are asked for by name, so that the same blocks serve
            own = EvalConfig(terrain=configs[0].terrain).rewards
            configs = [configs[0].model_copy(update={"rewards": own})]
        scene = rows[0].scene
        for entrant, source in controllers:
            for config in configs:
                add(Entry(config, source, scene, entrant.method, is_baseline=True))
    if not chosen and any(len(_of_each_reward(rows)) > 1 for rows in found.values()):
        tell(
            "return: these policies have different rewards, so their returns do not compare; "
            "rewards=… sets the same for all"
        )
    return [entry for rows in found.values() for entry in rows]


def _tell_unlike(entries: Sequence[Entry], tell: Tell) -> None:
    """Tell if methods play different scenes, as policies that bring their own ground."""
    played: dict[str, dict[str, None]] = {}
    for entry in entries:
        scene = f"{entry.terrain} {entry.conditions.hash}"
        played.setdefault(entry.method, {})[scene] = None
    if len({frozenset(scenes) for scenes in played.values()}) > 1:
        each = "; ".join(_first(method, scenes) for method, scenes in played.items())
        tell(
            f"these policies play different scenes, so they do not compare ({each}); terrain=… and "
            "conditions=… set the same for all"
        )


def _first(method: str, scenes: Collection[str]) -> str:
    return f"{method}: {next(iter(scenes))}{' …' if len(scenes) > 1 else ''}"


def _scoring(config: EvalConfig) -> tuple[object, object]:
    """Return what results on equal episodes depend on beside the policy."""
    return config.rewards, config.perception.layout


def _of_each_reward(entries: Sequence[Entry]) -> list[EvalConfig]:
    """Return the first configuration with each of the different rewards of a scene."""
    found: list[EvalConfig] = []
    for entry in entries:
        if all(entry.config.rewards != other.rewards for other in found):
            found.append(entry.config)
    return found


class _Composer:
    """Composes the scenes of policies, once for those that inherit equal settings."""

    def __init__(self, names: Sequence[str], sections: Sequence[Sequence[str]], tell: Tell) -> None:
        self._names, self._sections = names, sections
        self._known: list[tuple[Inherited | None, list[tuple[str, EvalConfig]]]] = []
        self._told: set[str] = set()
        self._tell_user = tell

    def _tell(self, line: str) -> None:
        """Tell a line once, however many scenes it is about."""
        if line not in self._told:
            self._told.add(line)
            self._tell_user(line)

    def of(self, entrant: Entrant) -> list[tuple[str, EvalConfig, PolicySource]]:
        """Return the name, configuration and policy of each scene of an entrant."""
        if entrant.run is None:
            return self._of_controller(entrant.method)
        source = load_policy(entrant.run, takes="file", tell=self._tell)
        inherited = Inherited.of(read_config(source, [], lambda text: None))
        known = self._find(inherited)
        if known is None:
            known = [(name, c) for name, c, _ in self._scenes(entrant.run, None)]
            self._known.append((inherited, known))
        else:
            for _, config in known:
                source.build(config)  # it raises before the first episode
        return [(name, config, source) for name, config in known]

    def _find(self, inherited: Inherited | None) -> list[tuple[str, EvalConfig]] | None:
        return next((found for who, found in self._known if who == inherited), None)

    def _of_controller(self, controller: str) -> list[tuple[str, EvalConfig, PolicySource]]:
        """Return the scenes of a controller; those without its own settings are composed once."""
        keys = [key_of(word) for part in self._sections for word in part]
        own = any(key.startswith("controller.") for key in keys)
        known = self._find(None)
        if own or known is None:
            made = list(self._scenes(None, controller))
            if not own:
                self._known.append((None, [(name, config) for name, config, _ in made]))
            return made
        source = load_policy(controller, "--controller", "controller", fields={})
        for _, config in known:
            for note in source.notes(config):
                self._tell(note)
        return [(name, config, source) for name, config in known]

    def _scenes(
        self, run: Path | None, controller: str | None
    ) -> Iterator[tuple[str, EvalConfig, PolicySource]]:
        for name, words in zip(self._names, self._sections, strict=True):
            for config, source in scenes(words, run, controller, self._tell):
                yield name, config, source
