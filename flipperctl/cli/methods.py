"""The scenes of several methods, or of a suite, for ``eval``.

In: overrides, methods and a suite. Out: a configuration, a policy's source and names for each
method on each scene, scene by scene.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from flipperctl.cli.scenes import scenes
from flipperctl.config import EvalConfig, resolver
from flipperctl.config.words import key_of
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.naming import SceneName
from flipperctl.evaluation.scenes import Scene
from flipperctl.policies.source import PolicySource
from flipperctl.runs.inherited import Inherited, find_policy, read_config
from flipperctl.runs.methods import Entrant
from flipperctl.runs.suites import Suite, SuiteScene
from flipperctl.terminal.streams import print_note

_Composed = list[tuple[str, EvalConfig]]
"""The name within the suite, and the configuration, of each scene."""


@dataclass(frozen=True)
class MethodScenes:
    """What several methods play: scene by scene, with equal scenes of all methods together."""

    scenes: list[Scene]
    names: list[SceneName]


def method_scenes(
    words: Sequence[str],
    entrants: Sequence[Entrant],
    standing: Sequence[Entrant],
    suite: Suite | None,
) -> MethodScenes:
    """Return the scenes of each entrant, and those of the ``standing`` controllers beside them.

    A standing controller plays under the conditions of each entrant.

    Raises:
        CheckpointError: there is no such policy, or its observation layout differs.
        ConfigError: an override is wrong.
    """
    parts = suite.scenes if suite else (SuiteScene("", ()),)
    sections = [part.with_words(list(words)) for part in parts]
    composer = _Composer([part.name_with(list(words)) for part in parts], sections)
    found: dict[tuple[str, str, int, int], list[tuple[Scene, SceneName]]] = {}
    played: dict[str, dict[str, None]] = {}  # method → its scenes
    several = {e.method for e in entrants if sum(o.method == e.method for o in entrants) > 1}

    def add(entrant: Entrant, scene: str, config: EvalConfig, source: PolicySource) -> None:
        numbers = config.eval.seed, config.eval.episodes
        digest = Conditions.of(config).hash
        rows = found.setdefault((scene, digest, *numbers), [])
        played.setdefault(entrant.method, {})[f"{config.terrain.plugin_name} {digest}"] = None
        seed = entrant.training_seed if entrant.method in several else None
        ours = source, _scoring(config)
        if all(ours != (other, _scoring(theirs)) for (theirs, other), _ in rows):
            rows.append(((config, source), SceneName(scene, entrant.method, seed)))

    for entrant in entrants:
        for scene, config, source in composer.of(entrant):
            add(entrant, scene, config, source)
    _tell_unlike(played)
    beside = [(e, PolicySource.of_plugin(e.method, "--baseline")) for e in standing]
    keys = [key_of(word).rpartition("@")[2] for part in sections for word in part]
    chosen = any(key.startswith("rewards") for key in keys)
    for rows in list(found.values()):
        scene, configs = rows[0][1].scene, _of_each_reward(rows)
        if not chosen:  # as when they are asked for by name, so that the same cells serve
            own = EvalConfig(terrain=configs[0].terrain).rewards
            configs = [configs[0].model_copy(update={"rewards": own})]
        for entrant, source in beside:
            for config in configs:
                add(entrant, scene, config, source)
    if not chosen and any(len(_of_each_reward(rows)) > 1 for rows in found.values()):
        print_note(
            "return: these policies have different rewards, so their returns do not compare; "
            "rewards=… sets the same for all"
        )
    every = [row for rows in found.values() for row in rows]
    return MethodScenes([scene for scene, _ in every], [name for _, name in every])


def _tell_unlike(played: Mapping[str, Collection[str]]) -> None:
    """Print a note if methods play different scenes, as policies that bring their own ground."""
    if len({frozenset(scenes) for scenes in played.values()}) > 1:
        each = "; ".join(
            f"{method}: {next(iter(scenes))}{' …' if len(scenes) > 1 else ''}"
            for method, scenes in played.items()
        )
        print_note(
            f"these policies play different scenes, so they do not compare ({each}); terrain=… and "
            "conditions=… set the same for all"
        )


def _scoring(config: EvalConfig) -> tuple[object, object]:
    """Return what results on equal episodes depend on beside the policy."""
    return config.rewards, config.perception.layout


def _of_each_reward(rows: Sequence[tuple[Scene, SceneName]]) -> list[EvalConfig]:
    """Return the first configuration with each of the different rewards of a scene's rows."""
    found: list[EvalConfig] = []
    for (config, _), _ in rows:
        if all(config.rewards != other.rewards for other in found):
            found.append(config)
    return found


class _Composer:
    """Composes the scenes of policies, once for those that inherit equal settings."""

    def __init__(self, names: Sequence[str], sections: Sequence[Sequence[str]]) -> None:
        self._names, self._sections = names, sections
        self._known: list[tuple[Inherited | None, _Composed]] = []
        self._told: set[str] = set()

    def _tell(self, line: str) -> None:
        """Print a line once, however many scenes it is about."""
        if line not in self._told:
            self._told.add(line)
            print_note(line)

    def of(self, entrant: Entrant) -> list[tuple[str, EvalConfig, PolicySource]]:
        """Return the name, configuration and policy of each scene of an entrant."""
        if entrant.run is None:
            return self._of_controller(entrant.method)
        file = find_policy(entrant.run, self._tell)
        inherited = Inherited.of(read_config(file, [], lambda text: None))
        known = next((found for who, found in self._known if who == inherited), None)
        source = PolicySource(checkpoint=file)
        if known is None:
            known = [(name, config) for name, (config, _) in self._scenes(entrant.run, None)]
            self._known.append((inherited, known))
        else:
            for _, config in known:
                source.build(config)  # it raises before the first episode
        return [(name, config, source) for name, config in known]

    def _of_controller(self, controller: str) -> list[tuple[str, EvalConfig, PolicySource]]:
        """Return the scenes of a controller; those without its own settings are composed once."""
        own = any(
            key_of(word).startswith("controller.") for part in self._sections for word in part
        )
        known = next((found for who, found in self._known if who is None), None)
        if own or known is None:
            made = self._scenes(None, controller)
            if not own:
                self._known.append((None, [(name, config) for name, (config, _) in made]))
            return [(name, *scene) for name, scene in made]
        settings = resolver.to_dict(resolver.create("controller", controller, "--controller"))
        source = PolicySource(settings=settings)
        for _, config in known:
            for note in source.notes(config):
                self._tell(note)
        return [(name, config, source) for name, config in known]

    def _scenes(self, run: Path | None, controller: str | None) -> list[tuple[str, Scene]]:
        return [
            (name, scene)
            for name, words in zip(self._names, self._sections, strict=True)
            for scene in scenes(words, run, controller, self._tell)
        ]
