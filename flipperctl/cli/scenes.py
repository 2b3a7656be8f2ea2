"""The scenes of one policy, for every command that evaluates.

In: overrides, and a checkpoint or a controller's name. Out: a configuration and the policy's source
for each scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config import EvalConfig, resolver
from flipperctl.config.defaults import CHOICES
from flipperctl.evaluation.inherited import policy_notes, read_config
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.terminal.streams import print_note

Scene = tuple[EvalConfig, PolicySource]
"""``config.eval`` holds the number of episodes and the seed."""


def scenes(
    words: Sequence[str],
    checkpoint: Path | None,
    controller: str | None,
    tell: Callable[[str], None] = print_note,
) -> list[Scene]:
    """Return a configuration and the policy's source for each scene.

    Exactly one of ``checkpoint`` and ``controller`` must be given; ``words`` are overrides.
    ``tell`` is called with lines on how the evaluation of a checkpoint differs from its training.

    Raises:
        CheckpointError: there is no such policy, its observation layout differs, or the plugin of
            its training terrain is missing and no other terrain is chosen.
        ConfigError: an override is wrong.
    """
    if checkpoint is None:
        resolver.get("controller", controller, "--controller")
        overrides = Overrides.parse([f"controller={controller}", *words])
        found = compose.compose_eval(overrides)
        made = [(config, PolicySource(settings=settings)) for config, settings in found]
        for note in dict.fromkeys(note for config, source in made for note in source.notes(config)):
            tell(note)
        return made
    return _scenes_of_file(checkpoint, words, tell)


def _scenes_of_file(
    checkpoint: Path, words: Sequence[str], tell: Callable[[str], None]
) -> list[Scene]:
    source = load_policy(checkpoint, takes="file", tell=tell)
    overrides = Overrides.parse(words)
    terrains = [c.choice("terrain") for c in overrides.combinations(CHOICES)]
    trained = read_config(source, terrains, tell)
    primary = config_store.register_trained(trained)
    configs = [config for config, _ in compose.compose_eval(overrides, primary)]
    # This raises for a wrong layout or robot, before the first episode.
    for config in configs:
        source.build(config)
    for note in policy_notes(checkpoint, trained, configs, overrides.typed):
        tell(note)
    return [(config, source) for config in configs]
