"""The regret of a policy: how much more than its own return is known to be possible.

In: the episodes of a policy and of references with equal seeds. Out: a plain document. All episodes
count, also those that did not reach the finish, since their returns include what the reward charges
for that. Potential-based shaping is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from flipperctl import checkpoint
from flipperctl.api import FloatArray
from flipperctl.api.controllers import is_rule
from flipperctl.config import EnvConfig, Eval, EvalConfig, TrainConfig, to_dict
from flipperctl.config.reward_sum import paying_terms
from flipperctl.errors import ConfigError, FlipperctlError, InterruptedRunError
from flipperctl.evaluation.conditions import TRAINED, Conditions
from flipperctl.evaluation.plan import RULES
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.rows import REWARD, Episodes, reached
from flipperctl.evaluation.statistics import interval
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.process.session import command

LEVEL = "level"  # the controller that holds the flippers still
_ROUNDING = 1e-9  # gain over ``LEVEL`` that rounding alone explains [-]
PITCH = "pitch_variation_100hz"


class Verdict(StrEnum):
    """How a policy's return compares with holding the flippers still, paired by seed."""

    LESS = "less"
    """The 95 % interval of the difference lies below 0."""
    MORE = "more"
    """The 95 % interval of the difference lies above 0."""
    UNDECIDED = "undecided"
    """The interval contains 0, or there are too few episodes for one."""


@dataclass(frozen=True)
class RegretScene:
    """A scene on which a policy is compared with references by its reward."""

    config: EvalConfig
    """``config.eval`` holds the number of episodes and the seed; its rewards make the return."""
    rewards: str
    """Label of the reward terms."""
    name: str
    """Name of the policy in the result."""
    policy: PolicySource
    references: Mapping[str, PolicySource]
    """By name; ``LEVEL`` is added if it is missing, and the policy itself is left out."""


def returns(episodes: Episodes, terms: Sequence[str], prefix: str = "") -> FloatArray:
    """Return the sum of the terms over each episode, (K,) [-]."""
    return np.array([sum(row[f"{REWARD}{prefix}{name}"] for name in terms) for row in episodes])


def measure(scene: RegretScene, player: Player) -> dict[str, Any] | None:
    """Play the scene's episodes with every policy; return the regret as plain data.

    Return None if a stop was asked for, since the episodes are then not the same.
    """
    config, terrain = scene.config, scene.config.terrain.title
    if not (terms := paying_terms(config.rewards)):
        raise ConfigError(f"rewards: {scene.rewards!r} leaves no term to judge a policy by")
    # Wrong layouts and robots are refused before anything is played.
    for source in scene.references.values():
        source.build(config)
    sources = {LEVEL: load_policy(LEVEL, "controller"), **scene.references}
    players = [(scene.name, scene.policy)]
    players += [
        (n, policy) for n, policy in sources.items() if n == LEVEL or policy != scene.policy
    ]
    episodes, *others = (
        player.play(config, policy, f"{terrain}, {name}") for name, policy in players
    )
    if player.interrupted:
        return None

    # Every policy has played the same episodes.
    played = dict(zip([name for name, _ in players[1:]], others, strict=True))
    return {
        "terrain": terrain,
        "rewards": scene.rewards,
        "seed": config.eval.seed,
        "conditions": Conditions.of(config).to_dict(),
        **regret(scene.name, episodes, played, terms),
    }


def regret(
    name: str, episodes: Episodes, others: Mapping[str, Episodes], terms: Sequence[str]
) -> dict[str, Any]:
    """Compare the returns of a policy and of references on the same episodes."""
    # On equal episodes, the best known return is the best of each episode.
    policy_returns = returns(episodes, terms)  # (K,) [-]
    reference_returns = {label: returns(played, terms) for label, played in others.items()}
    best = np.max([policy_returns, *reference_returns.values()], axis=0)  # (K,) [-]
    level = reference_returns[LEVEL]

    def measured(values: FloatArray, episodes: Episodes) -> dict[str, Any]:
        pitches = [row[PITCH] for row in episodes.reached]
        pairs = zip(episodes, others[LEVEL], strict=True)
        above = [a[PITCH] - b[PITCH] for a, b in pairs if reached(a) and reached(b)]
        return {
            "success_rate": len(episodes.reached) / len(episodes),
            PITCH: float(np.mean(pitches)) if pitches else None,
            "pitch_above_level": _interval(np.array(above)) if above else None,
            "return": _interval(values),
            "regret": _interval(best - values),
            "above_level": _interval(values - level),
            "fraction": _fraction(values, best, level),
            "returns": values.tolist(),
        }

    # The best reference first, and the verdict against holding the flippers still
    ordered = sorted(reference_returns, key=lambda label: -float(reference_returns[label].mean()))
    top, policy = ordered[0], measured(policy_returns, episodes)
    low, high = (policy["above_level"][end] for end in ("low", "high"))
    more = Verdict.MORE if low is not None and low > 0 else Verdict.UNDECIDED
    verdict = Verdict.LESS if high is not None and high < 0 else more
    return {
        "episodes": len(policy_returns),
        "verdict": str(verdict),
        "name": name,
        "policy": policy,
        "references": {
            label: measured(reference_returns[label], others[label]) for label in ordered
        },
        "best_known": {"return": _interval(best)},
        "best_reference": {
            "name": top,
            "regret": _interval(reference_returns[top] - policy_returns),
            "fraction": _fraction(policy_returns, reference_returns[top], level),
        },
    }


def _interval(values: FloatArray) -> dict[str, Any]:
    return interval(values.tolist()).to_dict()


def _fraction(values: FloatArray, best: FloatArray, level: FloatArray) -> float | None:
    """Return the part of the mean gain of ``best`` over ``level`` that ``values`` have.

    None if the gain is not positive, or no larger than noise: its 95 % interval contains 0. Divided
    by such a gain, one lucky episode of a reference would make any number.
    """
    gain = interval((best - level).tolist())
    if gain.mean <= _ROUNDING or (gain.low is not None and gain.low <= 0):
        return None
    return float((values - level).mean()) / gain.mean


SEED = 2_718_281_828
"""Seed of the evaluation, unlike the default one of ``eval``: a run that is chosen by this measure
can then be evaluated on other episodes."""


def final_regret(
    config: TrainConfig, directory: Path, stop: Callable[[], bool], tell: Callable[[str], None]
) -> dict[str, Any] | None:
    """Compare the best policy of a finished run with simple rules; None if turned off or failed.

    ``tell`` is called with a line if a policy or the environment fails. Raises InterruptedRunError
    if ``stop``, called between episodes, returned True.
    """
    if not config.train.regret_episodes or not paying_terms(config.rewards):
        return None
    regret = None
    try:
        with Player(stop=stop) as player:
            regret = measure(regret_scene(config, directory), player)
    except KeyboardInterrupt:  # a second Ctrl-C; the summary is still to be written
        pass
    except FlipperctlError as error:
        tell(f"the return of the best policy is not measured: {error}")
        return None
    if regret is None:
        raise InterruptedRunError(
            "interrupted while the best policy was compared with simple rules; the training is "
            "finished and saved. "
            f"Compare with: {command('inspect', 'reward', directory, '--regret')}"
        )
    # Terrain, rewards and conditions are the training's.
    results = {k: v for k, v in regret.items() if k not in ("terrain", "rewards", "conditions")}
    return {"seed": SEED, **results}


def regret_scene(config: TrainConfig, directory: Path) -> RegretScene:
    """Return the episodes in the conditions of the training, with its own reward terms.

    The references are rules, and the teacher if it is another rule; a search takes too long.
    """
    best = PolicySource(checkpoint=directory / checkpoint.BEST)
    sections = {name: getattr(config, name) for name in EnvConfig.model_fields}
    settings = Eval(episodes=config.train.regret_episodes, seed=SEED)
    evaluation = EvalConfig(**sections, conditions=TRAINED, eval=settings)
    # The references: rules that need no training.
    references = {name: load_policy(name, "controller") for name in RULES}
    teacher = config.teacher.controller
    if teacher is not None and is_rule(teacher):
        source = PolicySource(settings=to_dict(teacher))
        if source not in references.values():
            references["teacher"] = source
    return RegretScene(evaluation, "own", "best policy", best, references)
