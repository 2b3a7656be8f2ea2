"""The scenes, rewards and policies of ``inspect reward --compare`` and ``--regret``.

In: overrides and names of policies. Out: scenes with their sets of reward terms, and the policies'
sources.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.cli.plan import scenes
from flipperctl.errors import ConfigError, RequestError
from flipperctl.evaluation import policies as named_policies
from flipperctl.evaluation.views.ranking import Rewards, RewardScene
from flipperctl.evaluation.views.regret import RegretScene
from flipperctl.policies.source import PolicySource
from flipperctl.terminal.streams import print_note

_REWARD_KEY = re.compile(r"[+~]*(rewards(?=[.=]|$)|reward@)")
_DEFAULT = "paper"
"""Preset of ``configs/eval.yaml``."""
_FIELD = "controller."


def reward_scenes(overrides: Overrides, sources: Mapping[str, PolicySource]) -> list[RewardScene]:
    """Return a scene for each combination of the lists of settings other than rewards.

    Lists of rewards, as in ``rewards=paper,tuned``, give the sets of each scene. The robot is that
    of the files among the ``sources``, whose names appear in errors.
    """
    robot = named_policies.common_robot(sources, overrides.typed)
    primary = config_store.register_robot(robot)
    found: dict[tuple[str, ...], dict[str, Rewards]] = {}
    configs = {}
    for combination in overrides.combinations():
        scene, label = _split(combination)
        ((config, _),) = compose.compose_eval(combination, primary)
        if not config.rewards:
            raise ConfigError(f"rewards: {label!r} leaves no term to rank policies by")
        configs[scene] = config
        found.setdefault(scene, {})[label or _DEFAULT] = config.rewards
    return [(configs[scene], rewards) for scene, rewards in found.items()]


def policies(names: str, words: Sequence[str]) -> tuple[dict[str, PolicySource], Overrides]:
    """Return the named policies, and the overrides without those of the controllers.

    An override of ``controller.<field>`` applies to each controller with that field.
    """
    fields, others = _controller_fields(Overrides.parse(words), "--compare")
    return named_policies.policies(names, fields, print_note), others


def regret_scenes(
    words: Sequence[str], checkpoint: Path | None, controller: str | None, against: str
) -> list[RegretScene]:
    """Return a scene for each combination of the lists of settings, rewards included.

    Exactly one of ``checkpoint`` and ``controller`` must be given. ``against`` names the
    references; with a checkpoint, ``controller.<field>`` applies to each that has the field.
    """
    overrides, fields = Overrides.parse(words), dict[str, Any]()
    if checkpoint is not None:
        fields, overrides = _controller_fields(overrides, "--against")
    others = named_policies.policies(against, fields, print_note, "--against", fewest=1)
    labels = [_split(combination)[1] for combination in overrides.combinations()]
    default, name = "own" if checkpoint else _DEFAULT, str(checkpoint or controller)
    found = zip(scenes(overrides.words, checkpoint, controller), labels, strict=True)
    return [RegretScene(c, label or default, name, source, others) for (c, source), label in found]


def _split(combination: Overrides) -> tuple[tuple[str, ...], str]:
    """Return the overrides of all but the rewards, and a label of those of the rewards."""
    parts = [(word, _REWARD_KEY.match(word) is not None) for word in combination.words]
    label = " ".join(word.removeprefix("rewards=") for word, rewards in parts if rewards)
    return tuple(word for word, rewards in parts if not rewards), label


def _controller_fields(overrides: Overrides, option: str) -> tuple[dict[str, Any], Overrides]:
    """Return the overrides of ``controller.<field>`` by field, and the others."""
    if "controller" in overrides.typed:
        raise RequestError(f"controller: {option} names the controllers; leave the override out")
    own = overrides.where(lambda key: key.startswith(_FIELD)).values()
    others = overrides.where(lambda key: not key.startswith(_FIELD))
    fields = {key.removeprefix(_FIELD): value for key, value in own.items()}
    return compose.with_preset(fields, "controller"), others
