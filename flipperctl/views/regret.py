"""The regret of a policy: how much more than its own return is known to be possible.

In: the episodes of a policy and of references with equal seeds. Out: a document, a table and
sentences. All episodes count, also those that did not reach the finish, since their returns include
what the reward charges for that. Potential-based shaping is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from flipperctl.config import EvalConfig
from flipperctl.config.reward_sum import paying_terms
from flipperctl.core import FloatArray
from flipperctl.errors import ConfigError
from flipperctl.evaluation.conditions import Conditions
from flipperctl.evaluation.play import Player
from flipperctl.evaluation.rows import REWARD, Episodes, reached
from flipperctl.evaluation.statistics import FEWEST, interval
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.text.show import Column, Table, interval_text
from flipperctl.views.summary import Document, named, short

LEVEL = "level"  # the controller that holds the flippers still
_ROUNDING = 1e-9  # gain over ``LEVEL`` that rounding alone explains [-]
_PITCH = "pitch_variation_100hz"
_STILL = "holding the flippers still"


class Verdict(StrEnum):
    """How a policy's return compares with that of holding the flippers still, paired by seed."""

    LESS = "less"
    """The 95 % interval of the difference lies below 0."""
    MORE = "more"
    """The 95 % interval of the difference lies above 0."""
    UNDECIDED = "undecided"
    """The interval contains 0, or there are too few episodes for one."""


_WORDS = {
    Verdict.LESS: f"EARNS LESS THAN {_STILL.upper()}",
    Verdict.MORE: f"earns more than {_STILL}",
    Verdict.UNDECIDED: f"not shown to earn more than {_STILL}",
}


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


def measure(scene: RegretScene, player: Player) -> Document | None:
    """Play the scene's episodes with every policy; return the regret as plain data.

    Return None if a stop was asked for, since the episodes are then not the same.
    """
    config, terrain = scene.config, scene.config.terrain.plugin_name
    if not (terms := paying_terms(config.rewards)):
        raise ConfigError(f"rewards: {scene.rewards!r} leaves no term to judge a policy by")
    for source in scene.references.values():
        source.build(config)  # raises for a wrong layout or robot
    sources = {LEVEL: load_policy(LEVEL, "controller"), **scene.references}
    every = [(scene.name, scene.policy)]
    every += [(n, policy) for n, policy in sources.items() if n == LEVEL or policy != scene.policy]
    own, *others = (player.play(config, policy, f"{terrain}, {name}") for name, policy in every)
    if player.interrupted:
        return None
    played = dict(zip([name for name, _ in every[1:]], others, strict=True))
    return {
        "terrain": terrain,
        "rewards": scene.rewards,
        "seed": config.eval.seed,
        "conditions": Conditions.of(config).to_dict(),
        **regret(scene.name, own, played, terms),
    }


def regret(
    name: str, own: Episodes, others: Mapping[str, Episodes], terms: Sequence[str]
) -> Document:
    """Compare the returns of a policy with those of references on the same episodes."""
    ours = returns(own, terms)  # (K,) [-]
    theirs = {label: returns(episodes, terms) for label, episodes in others.items()}
    best = np.max([ours, *theirs.values()], axis=0)  # (K,) [-]
    level = theirs[LEVEL]

    def measured(values: FloatArray, episodes: Episodes) -> Document:
        pitches = [row[_PITCH] for row in episodes.reached]
        pairs = zip(episodes, others[LEVEL], strict=True)
        above = [a[_PITCH] - b[_PITCH] for a, b in pairs if reached(a) and reached(b)]
        return {
            "success_rate": len(episodes.reached) / len(episodes),
            _PITCH: float(np.mean(pitches)) if pitches else None,
            "pitch_above_level": _interval(np.array(above)) if above else None,
            "return": _interval(values),
            "regret": _interval(best - values),
            "above_level": _interval(values - level),
            "fraction": _fraction(values, best, level),
            "returns": values.tolist(),
        }

    ordered = sorted(theirs, key=lambda label: -float(theirs[label].mean()))
    top, policy = ordered[0], measured(ours, own)
    low, high = (policy["above_level"][end] for end in ("low", "high"))
    more = Verdict.MORE if low is not None and low > 0 else Verdict.UNDECIDED
    verdict = Verdict.LESS if high is not None and high < 0 else more
    return {
        "episodes": len(ours),
        "verdict": str(verdict),
        "name": name,
        "policy": policy,
        "references": {label: measured(theirs[label], others[label]) for label in ordered},
        "best_known": {"return": _interval(best)},
        "best_reference": {
            "name": top,
            "regret": _interval(theirs[top] - ours),
            "fraction": _fraction(ours, theirs[top], level),
        },
    }


def _interval(values: FloatArray) -> Document:
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


_COLUMNS = (
    Column("scene", "scene", named=True),
    Column("policy", "policy", named=True),
    Column("success", "success"),
    Column("return", "return"),
    Column("above_level", f"return − {LEVEL}"),
    Column("regret", "regret"),
    Column("fraction", "share of the gain"),
)


def table(scenes: Sequence[Document]) -> Table:
    """Return a table with a row for each policy on each scene, the judged one first."""
    rows: list[dict[str, Any]] = []
    for name, scene in _named(scenes):
        every = [(scene["name"], scene["policy"]), *scene["references"].items()]
        for label, numbers in every:
            success = f"{100 * numbers['success_rate']:.3g} %"
            row = {**numbers, "policy": short(label), "success": success}
            rows.append({**row, "scene": name if numbers is scene["policy"] else ""})
        best = {"return": scene["best_known"]["return"], "policy": "best of each episode"}
        rows.append({"scene": "", "success": "", "above_level": "", "regret": "", **best})
        rows[-len(every) - 1]["line"] = True
    return Table(_COLUMNS, rows, "Rewards over all episodes, without shaping; paired by seed")


def sentences(scenes: Sequence[Document]) -> Iterator[tuple[str, bool]]:
    """Yield sentences that compare the policy with holding still, and whether each is an alarm."""
    for name, scene in _named(scenes):
        few = f" (fewer than {FEWEST} episodes)" if scene["episodes"] < FEWEST else ""
        above, best = scene["policy"]["above_level"], scene["best_reference"]
        lacks = best["regret"]
        low, high = (None if lacks[end] is None else -lacks[end] for end in ("high", "low"))
        gap = interval_text({"mean": -lacks["mean"], "low": low, "high": high}, sign="+")
        verdict = Verdict(scene["verdict"])
        yield (
            f"{scene['name']} on {name}: {_WORDS[verdict]}{few}, difference "
            f"{interval_text(above, sign='+')}; to the best reference, {best['name']}: {gap}",
            verdict is Verdict.LESS,
        )
    fractions = [f for s in scenes if (f := s["policy"]["fraction"]) is not None]
    if len(scenes) > 1 and fractions:
        mean = sum(fractions) / len(fractions)
        yield f"share of the gain, mean of {len(fractions)}: {mean:.2f}", False
    less = sum(scene["verdict"] == Verdict.LESS for scene in scenes)
    if len(scenes) > 1 and less:
        text = f"{scenes[0]['name']} {_WORDS[Verdict.LESS]} in {less} of {len(scenes)} comparisons"
        yield text, True


def _named(scenes: Sequence[Document]) -> Iterator[tuple[str, Document]]:
    """Yield each scene and its name, with its rewards if they are several."""
    several = len({scene["rewards"] for scene in scenes}) > 1
    for name, scene in named({"scenes": [{**scene, "method": ""} for scene in scenes]}):
        yield f"{name}, rewards {scene['rewards']}" if several else name, scene


def line(measured: Mapping[str, Any] | None) -> str:
    """Return lines on a training's best policy beside the rules, as in its ``summary.json``.

    The first two are on their rewards, the last two on what ``eval`` shows, which may differ in
    sign. Each ends with a line break; the text is empty if nothing was measured.
    """
    if measured is None:
        return ""
    own, above = measured["policy"]["return"], measured["policy"]["above_level"]
    rules = (
        f"{'flippers held still' if name == LEVEL else name} {reference['return']['mean']:.2f}"
        for name, reference in measured["references"].items()
    )
    rewards = "; ".join([f"reward {own['mean']:.2f}", *rules])
    verdict = Verdict(measured["verdict"])
    be = "is " if verdict is Verdict.UNDECIDED else ""
    return (
        f"Check on {measured['episodes']} new episodes: {rewards}.\n"
        f"The policy {be}{_WORDS[verdict]} ({interval_text(above, sign='+')}).\n"
        f"{_level_line(measured)}"
    )


def falls_short(measured: Mapping[str, Any] | None) -> bool:
    """Return whether a policy crosses less than holding the flippers still, or pitches more."""
    if measured is None or LEVEL not in measured["references"]:
        return False
    own, level = measured["policy"], measured["references"][LEVEL]
    above = own["pitch_above_level"] or {}
    return own["success_rate"] < level["success_rate"] or (above.get("low") or 0.0) > 0


def _level_line(scene: Mapping[str, Any]) -> str:
    """Return a line on success and pitch variation beside holding still, if they were measured."""
    own, level = scene["policy"], scene["references"].get(LEVEL)
    if level is None:
        return ""
    told = []
    for words, numbers in ((", pitch variation", own), (",", level)):
        variation = "" if numbers[_PITCH] is None else f"{words} {numbers[_PITCH]:.2f} rad"
        told.append(f"{numbers['success_rate']:.0%}{variation}")
    line = f"On the same episodes: success {told[0]} (flippers held still: {told[1]})"
    if (above := own["pitch_above_level"]) is not None:
        words = f"is not shown to pitch less than {_STILL}"
        if above["low"] is not None and round(above["low"], 2) > 0:  # as it is shown
            words = f"PITCHES MORE THAN {_STILL.upper()}"
        elif above["high"] is not None and round(above["high"], 2) < 0:
            words = f"pitches less than {_STILL}"
        line += f".\nIt {words} ({interval_text(above, sign='+')} rad where both reached)"
    return f"{line}.\n"
