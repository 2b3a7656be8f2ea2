"""How a risk announces failures on kinds of ground that it was never trained on.

    python -m benchmarks.left_out [--policy NAME] [--episodes N] [--conditions NAME] [--kinds K,…]

A policy with a risk plays every kind of ground, without escapes. For each group of kinds, a risk
network is trained on the episodes of all other groups and calibrated on further ones; the table
shows how many failures on the group left out it announces three decisions ahead, and in how many
of the episodes that reached the finish it warned. ``known`` are the same kinds with a risk that was
trained on all of them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import flipperctl
from flipperctl import entry, plugins
from flipperctl.agent.risk import Risk, RiskNetwork, plain_risk, risk_loss
from flipperctl.checkpoint import Checkpoint, read_policy, shipped_policies
from flipperctl.config import TrainConfig
from flipperctl.core.risk import EpisodeRisk, EscapeRule, Place, RiskSign, resemblances
from flipperctl.evaluation.statistics import proportion
from flipperctl.evaluation.views.summary import summarise
from flipperctl.policies.trained import TrainedPolicy, policy_module
from flipperctl.rollout.episode import EpisodeRisks, play
from flipperctl.training.validation import calibrated

GROUPS: Mapping[str, tuple[str, ...]] = {
    "stairs": ("stair", "building_stair", "stairwell", "paper_stair"),
    "steps": ("step", "paper_step"),
    "ramps": ("ramp", "uplift"),
    "gaps": ("gap",),
    "waves, rubble": ("wave", "rubble"),
    "pallets, hurdles": ("pallet", "plum"),
    "plates": ("plates",),
    "natural": ("rough",),
}
"""Kinds of ground by what is alike in them, and is therefore left out together."""
_ROW = "{:16}  {:>8}  {:23}  {:>5}  {:>7}  {:23}  {:>5}"
_STEPS, _BATCH, _RATE = 4000, 1024, 1e-3


@dataclass(frozen=True)
class Seen:
    """What a policy saw in one episode of T decisions."""

    kind: str
    failed: bool
    inputs: NDArray[np.float32]
    """Input rows of the policy, (T, F · n)."""
    places: tuple[Place | None, ...]
    size: int
    """Length n of an observation."""

    def labels(self, horizon: int) -> NDArray[np.float32]:
        """Return 1 where the episode failed within the horizon, else 0, (T,)."""
        found = np.zeros(len(self.inputs), np.float32)
        if self.failed:
            found[-horizon:] = 1.0
        return found

    def risks(self, risk: Risk, *, places: bool = True) -> EpisodeRisks:
        """Return what a risk tells of each decision, with the sign that a robot stands or not."""
        episode = risk.begin(self.size)
        at = self.places if places else (None,) * len(self.inputs)
        rows = zip(self.inputs, at, strict=True)
        return EpisodeRisks.of(risk.sign, [risk.of_one(row, episode, place) for row, place in rows])


class _Watch:
    """Stands in for a policy's risk; keeps its inputs and warns always, or never."""

    sign = RiskSign(10, 0.5)

    def __init__(self, risk: float) -> None:
        self._risk = risk
        self.inputs: list[NDArray[np.float32]] = []
        self.places: list[Place | None] = []
        self.size = 0

    def begin(self, size: int) -> EpisodeRisk:
        self.inputs, self.places, self.size = [], [], size
        return EpisodeRisk(size, self.sign)

    def of_one(
        self, observation: NDArray[np.float32], episode: EpisodeRisk, place: Place | None = None
    ) -> float:
        self.inputs.append(np.array(observation))
        self.places.append(place)
        return self._risk


def seen(
    checkpoint: Checkpoint, kind: str, conditions: str, seeds: range, *, draws: bool
) -> Iterator[Seen]:
    """Play and yield episodes of a kind; ``draws``: the policy draws its actions throughout."""
    config = checkpoint.policy_config()
    env: Any = flipperctl.environment(terrain=kind, conditions=conditions).unwrapped
    watch: Any = _Watch(float(draws))
    rule = EscapeRule(config.agent.escape_temperature, 1)
    policy = TrainedPolicy(policy_module(checkpoint), config.network.frames, watch, rule)
    for seed in seeds:
        row = play(env, policy, seed)
        inputs = np.array(watch.inputs, np.float32)
        yield Seen(kind, row["outcome"] != "reached", inputs, tuple(watch.places), watch.size)


def learnt(episodes: Sequence[Seen], horizon: int, seed: int) -> RiskNetwork:
    """Return a network that has learnt the labels of the episodes."""
    torch.manual_seed(seed)
    inputs = torch.from_numpy(np.concatenate([e.inputs for e in episodes]))
    alike = np.concatenate([resemblances(e.inputs[:, -e.size :]) for e in episodes])
    labels = torch.from_numpy(np.concatenate([e.labels(horizon) for e in episodes]))
    network = RiskNetwork(inputs.shape[1])
    optimiser = torch.optim.Adam(network.parameters(), _RATE)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.01, _STEPS)
    for _ in range(_STEPS):
        chosen = torch.randint(len(inputs), (_BATCH,))
        odds = network.log_odds(inputs[chosen], torch.from_numpy(alike)[chosen])
        optimiser.zero_grad()
        torch.autograd.backward(risk_loss(odds, labels[chosen]))
        optimiser.step()
        schedule.step()
    return network.eval().requires_grad_(False)


def announced(
    risk: RiskNetwork, config: TrainConfig, calibrating: Sequence[Seen], episodes: Sequence[Seen]
) -> dict[str, Any]:
    """Return how a network fits the ends of episodes, calibrated on those of other kinds."""
    plain = plain_risk(risk, config.agent.risk_horizon)
    rows = [
        {"outcome": "stuck" if e.failed else "reached", **e.risks(plain, places=False).to_row()}
        for e in calibrating
    ]
    found = calibrated(rows, config.agent)
    assert found is not None  # there are episodes
    final = Risk(risk, found[0], config.robot.track_speed * config.robot.decision_period)
    told = summarise([(e.risks(final), e.failed) for e in episodes])
    assert told is not None
    return told


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table of announcements by group of kinds."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.left_out")
    parser.add_argument("--policy", default="generalist", help="a checkpoint with a risk")
    parser.add_argument("--episodes", type=int, default=300, help="of each kind, to learn and test")
    parser.add_argument("--conditions", default="widest")
    parser.add_argument("--alarms", type=float, default=0.03, help="agent.risk_false_alarms")
    options = parser.parse_args(arguments)
    plugins.load([])
    checkpoint = read_policy(shipped_policies().get(options.policy, Path(options.policy)))
    config = checkpoint.policy_config()
    agent = config.agent.model_copy(update={"risk_false_alarms": options.alarms})
    config = config.model_copy(update={"agent": agent})
    learning, testing = list[Seen](), list[Seen]()
    for kind in (kind for kinds in GROUPS.values() for kind in kinds):
        for part, into in enumerate((testing, learning, learning)):
            seeds = range(part * 10**6, part * 10**6 + options.episodes)
            into += seen(checkpoint, kind, options.conditions, seeds, draws=part == 2)
        print(kind, file=sys.stderr)
    known = learnt(learning, agent.risk_horizon, 0)
    sums: dict[str, list[int]] = {}
    print(_ROW.format("left out", "failures", "announced", "known", "reached", "warned", "known"))
    for group, kinds in GROUPS.items():
        mine = [e for e in testing if e.kind in kinds]
        others = [e for e in testing if e.kind not in kinds]
        risk = learnt([e for e in learning if e.kind not in kinds], agent.risk_horizon, 0)
        new, old = announced(risk, config, others, mine), announced(known, config, testing, mine)
        print(_line(group, new, old))
        for name, told in (("new", new), ("old", old)):
            parts = [int(told[key]) for key in ("failures", "announced", "reached", "false_alarms")]
            sums[name] = [a + b for a, b in zip(sums.get(name, [0] * 4), parts, strict=True)]
    names = ("failures", "announced", "reached", "false_alarms")
    print(_line("all", *(dict(zip(names, sums[n], strict=True)) for n in ("new", "old"))))
    return 0


def _line(group: str, new: Mapping[str, Any], old: Mapping[str, Any]) -> str:
    def share(told: Mapping[str, Any], part: str, whole: str) -> str:
        if not told[whole]:
            return "–"
        found = proportion(int(told[part]), int(told[whole]))
        return f"{int(told[part])} ({found.mean:.2f} [{found.low:.2f}, {found.high:.2f}])"

    failures, warned = share(new, "announced", "failures"), share(new, "false_alarms", "reached")
    known = int(old["announced"]), int(old["false_alarms"])
    counts = int(new["failures"]), int(new["reached"])
    return _ROW.format(group, counts[0], failures, known[0], counts[1], warned, known[1])


if __name__ == "__main__":
    entry.run(main)
