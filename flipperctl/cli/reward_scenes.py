"""The scenes, rewards and policies that ``inspect reward --compare`` compares.

In: overrides and names of policies. Out: scenes, each with one or several sets of reward terms,
and the policies' sources.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from flipperctl.cli.hydra import compose, config_store
from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.config.defaults import CHOICES
from flipperctl.errors import ConfigError, RequestError
from flipperctl.policies.source import PolicySource
from flipperctl.runs import named_policies
from flipperctl.studies.reward_comparison import Rewards, RewardScene
from flipperctl.terminal.streams import print_note

_REWARD_KEY = re.compile(r"[+~]*(rewards(?=[.=]|$)|reward@)")
_DEFAULT = "paper"
"""Preset of ``configs/eval.yaml``."""
_FIELD = "controller."


def reward_scenes(overrides: Overrides, sources: Mapping[str, PolicySource]) -> list[RewardScene]:
    """Return a scene for each combination of the lists of settings other than rewards.

    Lists of rewards, as in ``rewards=paper,tuned``, give the sets of each scene. The robot is that
    of the files among the ``sources``, whose names appear in errors.

    Raises:
        ConfigError: an override is wrong or drops every reward term, or the files are for
            different robots and no override chooses one.
    """
    robot = named_policies.common_robot(sources, overrides.typed)
    primary = config_store.register_robot(robot)
    found: dict[tuple[str, ...], dict[str, Rewards]] = {}
    configs = {}
    for combination in overrides.combinations(CHOICES):
        parts = [(word, _REWARD_KEY.match(word) is not None) for word in combination.words]
        scene = tuple(word for word, rewards in parts if not rewards)
        label = " ".join(word.removeprefix("rewards=") for word, rewards in parts if rewards)
        ((config, _),) = compose.compose_eval(combination, primary)
        if not config.rewards:
            raise ConfigError(f"rewards: {label!r} leaves no term to rank policies by")
        configs[scene] = config
        found.setdefault(scene, {})[label or _DEFAULT] = config.rewards
    return [RewardScene(configs[scene], rewards) for scene, rewards in found.items()]


def policies(names: str, words: Sequence[str]) -> tuple[dict[str, PolicySource], Overrides]:
    """Return the named policies, and the overrides without those of the controllers.

    An override of ``controller.<field>`` applies to each controller with that field.

    Raises:
        RequestError: there are fewer than two policies, or one is named twice.
        ConfigError: there is no such policy, or no controller has an overridden field.
        CheckpointError: a checkpoint cannot be read.
    """
    labels = named_policies.policy_labels(names)
    overrides = Overrides.parse(words)
    own = overrides.where(lambda key: key.startswith(_FIELD)).values()
    if "controller" in overrides.typed:
        raise RequestError("controller: --compare names the controllers; leave the override out")
    fields = {key.removeprefix(_FIELD): value for key, value in own.items()}
    others = overrides.where(lambda key: not key.startswith(_FIELD))
    return named_policies.policies(labels, fields, print_note), others
