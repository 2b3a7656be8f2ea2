"""How a risk announces failures on kinds of ground that it was never trained on.

    python -m benchmarks.left_out [--policy NAME] [--episodes N] [--conditions NAME] [--alarms A]
                                  [--output FILE]

A policy with a risk plays every kind of ground, without escapes. For each group of kinds, a risk
network is trained on the episodes of all other groups. It is calibrated on further episodes of each
of these, by networks that have not seen that group, either. The table shows how many failures on
the group left out it announces three decisions ahead, and in how many of the episodes that reached
the finish it warned. ``known`` counts the same with a risk that has learnt all kinds, and whose
threshold was chosen on the very episodes; the last row is the sign of a standing robot, without a
network.

``--output`` writes the policy with a new risk, which has learnt all kinds. It is calibrated by what
the networks told of the group that each had left out.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

import flipperctl
from flipperctl.agent.risk import RiskNetwork, risk_loss
from flipperctl.api import FailureRisk, FloatArray
from flipperctl.checkpoint import Checkpoint, read_policy, shipped_policies, write
from flipperctl.core.risk import (
    LAGS,
    EpisodeRisk,
    Place,
    RiskCalibration,
    RiskSign,
    resemblances,
)
from flipperctl.evaluation.statistics import proportion
from flipperctl.plugging import plugins
from flipperctl.policies.acting import TrainedPolicy
from flipperctl.policies.trained import policy_module
from flipperctl.process import entry
from flipperctl.rollout.episode import play
from flipperctl.rollout.risks import EpisodeRisks
from flipperctl.text.files import OutputKind, check_output
from flipperctl.training.validation import calibrated, sigmoid
from flipperctl.views.summary import summarise

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
_KIND = OutputKind(
    "a checkpoint", (".safetensors",), re.compile(rb'\\"kind\\": ?\\"(best|last)\\"')
)
_ROW = "{:16}  {:>8}  {:23}  {:>5}  {:>7}  {:23}  {:>5}"
_COUNTS = "failures", "announced", "reached", "false_alarms"
_STEPS, _BATCH, _RATE = 1500, 512, 2e-3


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

    def odds(self, network: RiskNetwork) -> FloatArray:
        """Return the log-odds that a network tells of each decision, (T,)."""
        alike = torch.from_numpy(resemblances(self.inputs[:, -self.size :]))
        return network.log_odds(torch.from_numpy(self.inputs), alike).numpy().astype(np.float64)

    def risks(self, told: Sequence[float], sign: RiskSign, stride: float) -> EpisodeRisks:
        """Return the risks that a network told, (T,), with the sign that a robot stands."""
        episode, nothing = EpisodeRisk(self.size, sign, stride), np.zeros(len(LAGS), "f4")
        rows = zip(told, self.inputs, self.places, strict=True)
        return EpisodeRisks.of(sign, [episode.update(r, nothing, *at) for r, *at in rows])


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
    risk = config.agent.failure_risk
    assert risk is not None  # of a checkpoint with a risk
    assert risk.escape is not None
    rule = replace(risk.escape, decisions=1)
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


def calibration(
    told: Sequence[tuple[RiskNetwork, Sequence[Seen]]], agent: FailureRisk
) -> tuple[RiskCalibration, dict[str, float]]:
    """Return the calibration of networks on episodes that each of them has not learnt from.

    Its metrics come with it, as a validation holds them.
    """
    sign = RiskSign(agent.horizon, 1.0)
    rows = [
        {
            "outcome": "stuck" if episode.failed else "reached",
            **EpisodeRisks.of(sign, sigmoid(episode.odds(network)).tolist()).to_row(),
        }
        for network, episodes in told
        for episode in episodes
    ]
    found = calibrated(rows, agent)
    assert found is not None  # there are episodes
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table of announcements by group of kinds."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.left_out")
    parser.add_argument("--policy", default="generalist", help="a checkpoint with a risk")
    parser.add_argument("--episodes", type=int, default=300, help="of each kind, to learn and test")
    parser.add_argument("--conditions", default="widest")
    parser.add_argument("--alarms", type=float, default=0.015, help="agent.risk_false_alarms")
    parser.add_argument("--output", type=Path, metavar="FILE", help="policy with the new risk")
    options = parser.parse_args(arguments)
    if options.output:
        check_output(options.output, _KIND)
    plugins.load([])
    checkpoint = read_policy(shipped_policies().get(options.policy, Path(options.policy)))
    config = checkpoint.policy_config()
    risk = config.agent.failure_risk
    assert risk is not None  # of a checkpoint with a risk
    agent = replace(risk, false_alarms=options.alarms)
    learning, testing = list[Seen](), list[Seen]()
    for kind in (kind for kinds in GROUPS.values() for kind in kinds):
        for part, into in enumerate((testing, learning, learning)):
            seeds = range(part * 10**6, part * 10**6 + options.episodes)
            into += seen(checkpoint, kind, options.conditions, seeds, draws=part == 2)
        print(kind, file=sys.stderr)
    stride = config.robot.track_speed * config.robot.decision_period
    network, metrics = show(learning, testing, agent, stride)
    if options.output:
        save(checkpoint, network, metrics, options.output)
    return 0


def save(
    checkpoint: Checkpoint, network: RiskNetwork, metrics: Mapping[str, float], path: Path
) -> None:
    """Write the policy with a network of its risk, and its calibration among the ``metrics``."""
    document = checkpoint.document
    assert document.validation is not None  # a checkpoint with a risk has one
    validation = document.validation.model_copy(update=metrics)
    risk = {f"risk.{name}": weights for name, weights in network.state_dict().items()}
    tensors = dict(checkpoint.tensors) | risk
    write(path, document.model_copy(update={"validation": validation}), tensors)


def show(
    learning: Sequence[Seen], testing: Sequence[Seen], agent: FailureRisk, stride: float
) -> tuple[RiskNetwork, dict[str, float]]:
    """Train the networks and print the table; ``stride``: way of the belts in a decision [m].

    Returns the network that has learnt all kinds, and the metrics of its calibration by the others.
    """
    tested = {group: [e for e in testing if e.kind in kinds] for group, kinds in GROUPS.items()}

    @cache
    def without(groups: frozenset[str]) -> RiskNetwork:
        left = [kind for group in groups for kind in GROUPS[group]]
        return learnt([e for e in learning if e.kind not in left], agent.horizon, 0)

    known = without(frozenset())
    usual, _ = calibration([(known, testing)], agent)
    sums = np.zeros((2, 4), int)
    print(_ROW.format("left out", "failures", "announced", "known", "reached", "warned", "known"))
    for group, mine in tested.items():
        # Its calibration has not seen the kinds, either, and knows how risks of unknown kinds are.
        others = [
            (without(frozenset((group, other))), episodes)
            for other, episodes in tested.items()
            if other != group
        ]
        new = without(frozenset((group,))), calibration(others, agent)[0]
        counts = []
        for network, found in (new, (known, usual)):
            odds = [found.slope * e.odds(network) + found.shift for e in mine]
            told = [sigmoid(each).tolist() for each in odds]
            counts.append(_counts(mine, told, found.sign, stride))
        sums += counts
        print(_line(group, *counts), f"  threshold {new[1].sign.threshold:.2f}", flush=True)
    print(_line("all", *sums.tolist()))
    silent = [[0.0] * len(e.inputs) for e in testing]
    alone = _counts(testing, silent, usual.sign, stride)
    print(_line("standing alone", alone, alone))
    unseen = [(without(frozenset((group,))), mine) for group, mine in tested.items()]
    return known, calibration(unseen, agent)[1]


def _counts(
    episodes: Sequence[Seen], told: Sequence[Sequence[float]], sign: RiskSign, stride: float
) -> list[int]:
    """Return the numbers of ``_COUNTS`` of episodes with what a network told."""
    pairs = zip(episodes, told, strict=True)
    found = summarise([(e.risks(each, sign, stride), e.failed) for e, each in pairs])
    assert found is not None  # there are episodes
    return [int(found[key]) for key in _COUNTS]


def _line(group: str, new: Sequence[int], old: Sequence[int]) -> str:
    def share(part: int, whole: int) -> str:
        if not whole:
            return "–"
        found = proportion(part, whole)
        return f"{part} ({found.mean:.2f} [{found.low:.2f}, {found.high:.2f}])"

    failures, announced, reached, warned = new
    told = share(announced, failures), share(warned, reached)
    return _ROW.format(group, failures, told[0], old[1], reached, told[1], old[3])


if __name__ == "__main__":
    entry.run(main)
