"""Speed of the environment compared with its upper limit, Chipmunk alone on the same states.

Episodes are recorded once. Then, in turn, the environment replays their actions, and a bare world
is set to the state at the start of each decision and stepped as often as in that decision, where
only these steps are timed. The parts of a decision are timed in the same way.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks import bare
from benchmarks.planar import planar
from benchmarks.settings import Benchmark
from flipperctl.api import SAMPLE_PERIOD, Profile, Start, Transition
from flipperctl.bench.settings import quantity, ratio
from flipperctl.config import EnvConfig
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.guarded_world import GuardedWorld
from flipperctl.policies.source import PolicySource
from flipperctl.reward_sum import RewardSum
from flipperctl.rollout.episode import decisions
from flipperctl.rollout.seeds import EvaluationSeeds
from flipperctl.sim.planar.world import PlanarWorld

ABOUT = (
    "decisions of the environment against the same substeps by Chipmunk's step alone "
    "(same states, one process, in turn), and the parts of a decision's time"
)


@dataclass
class Recording:
    """One episode, decision by decision."""

    seed: int
    profile: Profile
    start: Start
    actions: list[int] = field(default_factory=list)
    targets: list[tuple[float, float]] = field(default_factory=list)
    """Angles commanded to the front and the rear flippers at each decision [rad]."""
    snapshots: list[bare.Snapshot] = field(default_factory=list)
    """State of the world at the start and after each decision."""
    transitions: list[Transition] = field(default_factory=list)
    contacts: list[int] = field(default_factory=list)
    """Contact points at the end of each decision."""

    def samples(self, index: int) -> int:
        """Return the number of samples of the state during decision ``index`` [-]."""
        t = self.transitions[index]
        return round((t.after.time - t.before.time) / SAMPLE_PERIOD)


def record(config: EnvConfig, controller: str, seed: int) -> Recording:
    """Play an episode with a controller plugin and record it."""
    env = FlipperEnv(config=config)
    policy = PolicySource.of_plugin(controller, "bench.controller").build(config)
    env.reset(seed=seed)
    state = env.state
    start = Start(float(state.position[0]), state.front, state.rear)
    recording = Recording(seed, env.profile, start)
    recording.snapshots.append(bare.snapshot(_world(env)))
    for decision in decisions(env, policy, seed):
        world = _world(env)
        recording.actions.append(decision.action)
        recording.targets.append(env.drive.targets)
        recording.snapshots.append(bare.snapshot(world))
        recording.contacts.append(bare.contacts(world))
        recording.transitions.append(decision.transition)
    return recording


def _world(env: FlipperEnv) -> PlanarWorld:
    """Return the environment's planar world.

    Raises:
        TypeError: the environment has another engine.
    """
    world = env.drive.world
    if isinstance(world, GuardedWorld):
        world = world.unguarded
    if not isinstance(world, PlanarWorld):
        raise TypeError(f"bench physics needs a planar world; got {type(world).__name__}")
    return world


class Clocks:
    """Time each part of an episode's decisions; every public method returns a time [s]."""

    def __init__(self, config: EnvConfig) -> None:
        self.config = config
        self.env = FlipperEnv(config=config)
        self.reward = RewardSum(config.rewards)
        self.bare_contacts: list[int] = []

    def reset(self, r: Recording) -> float:
        """Time the environment's reset."""
        begun = time.perf_counter()
        self.env.reset(seed=r.seed)
        return time.perf_counter() - begun

    def decision(self, r: Recording) -> float:
        """Time the environment's steps, after ``reset``."""
        step = self.env.step
        begun = time.perf_counter()
        for action in r.actions:
            step(action)
        return time.perf_counter() - begun

    def bare(self, r: Recording) -> float:
        """Time Chipmunk's step alone."""
        world, spent = self._world(r), 0.0
        bare.strip(world)
        substeps = round(SAMPLE_PERIOD / planar(self.config.sim).substep)
        self.bare_contacts = []
        for index in range(len(r.actions)):
            bare.put(world, r.snapshots[index], r.snapshots[index + 1].phases)
            count = substeps * r.samples(index)
            begun = time.perf_counter()
            bare.step(world, count)
            spent += time.perf_counter() - begun
            self.bare_contacts.append(bare.contacts(world))
        return spent

    def world(self, r: Recording) -> float:
        """Time the world with its belts, sampled as in the environment."""
        world, spent = self._world(r), 0.0
        for index, target in enumerate(r.targets):
            count = r.samples(index)
            begun = time.perf_counter()
            run(world, target, count)
            spent += time.perf_counter() - begun
        return spent

    def sensing(self, r: Recording) -> float:
        """Time the sensing of terrain points, bin heights and angles."""
        perception, episode = self.config.perception, self.config.episode
        margin = episode.run_up + episode.run_out + perception.reach + 2.0
        sensor, rng = perception.over(r.profile, margin), np.random.default_rng(0)
        begun = time.perf_counter()
        for t in r.transitions:
            sensor.sense(t.after, rng)
        return time.perf_counter() - begun

    def rewards(self, r: Recording) -> float:
        """Time all reward terms."""
        begun = time.perf_counter()
        for t in r.transitions:
            self.reward(t)
        return time.perf_counter() - begun

    def _world(self, r: Recording) -> PlanarWorld:
        return PlanarWorld(r.profile, self.config.robot, planar(self.config.sim), r.start)


def run(world: PlanarWorld, target: tuple[float, float], samples: int) -> None:
    """Advance a world by one decision, as the environment does."""
    world.command(*target)
    world.advance(samples)


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure rates [1/s], their ratio, and the time of each part of a decision [µs].

    The parts are ``physics`` (Chipmunk alone), ``contacts`` (the additional time of belts, commands
    and samples), ``sensing``, ``reward`` and ``rest`` (the remainder of the environment's step).
    """
    s, config = bench.settings, bench.config.environment()
    clocks = Clocks(config)
    names = ("reset", "decision", "bare", "world", "sensing", "rewards")
    recordings = []
    for seed in EvaluationSeeds.of(s.seed, config.terrain).first(s.episodes):
        bench.report_progress("recording episodes", 0.0)
        recordings.append(record(config, s.controller, seed))
    rounds: list[dict[str, float]] = []
    contacts: list[int] = []
    for index in range(-1, s.repeats):  # the first round is the warm-up
        spent: Counter[str] = Counter()
        for r in recordings:
            for name in names:
                spent[name] += getattr(clocks, name)(r)
            contacts += clocks.bare_contacts if index < 0 else []
        if index >= 0:
            rounds.append(dict(spent))
        bench.report_progress("episodes in turn", (index + 1) / s.repeats)
    samples = sum(r.samples(i) for r in recordings for i in range(len(r.actions)))
    work = Work(
        sum(len(r.actions) for r in recordings),
        samples * round(SAMPLE_PERIOD / planar(config.sim).substep),
    )
    return {
        "about": ABOUT,
        **work.rates(rounds),
        "decisions_a_round": work.decisions,
        "substeps_a_round": work.substeps,
        "contacts_at_decision_ends": {
            "unit": "-",
            "environment": sum(sum(r.contacts) for r in recordings) / work.decisions,
            "bare": sum(contacts) / work.decisions,
        },
    }


@dataclass(frozen=True)
class Work:
    """Numbers of decisions and of substeps in each round [-]."""

    decisions: int
    substeps: int

    def rates(self, rounds: list[dict[str, float]]) -> dict[str, Any]:
        """Return quantities and ratios from the times of each round's parts [s]."""
        count, micro = self.decisions, 1e6 / self.decisions
        bare_rate = [count / t["bare"] for t in rounds]
        env_rate = [count / t["decision"] for t in rounds]
        parts = {
            "physics": [micro * t["bare"] for t in rounds],
            "contacts": [micro * (t["world"] - t["bare"]) for t in rounds],
            "sensing": [micro * t["sensing"] for t in rounds],
            "reward": [micro * t["rewards"] for t in rounds],
            "rest": [
                micro * (t["decision"] - t["world"] - t["sensing"] - t["rewards"]) for t in rounds
            ],
            "whole": [micro * t["decision"] for t in rounds],
        }
        return {
            "quantities": {
                "bare_substeps": quantity([self.substeps / t["bare"] for t in rounds], "1/s"),
                "bare_decisions": quantity(bare_rate, "1/s"),
                "environment_decisions": quantity(env_rate, "1/s"),
                "environment_decisions_with_reset": quantity(
                    [count / (t["decision"] + t["reset"]) for t in rounds], "1/s"
                ),
                **{f"decision.{name}": quantity(v, "µs") for name, v in parts.items()},
            },
            "ratios": {
                "environment_decisions / bare_decisions": ratio(env_rate, bare_rate),
                **{
                    f"decision.{name} / decision.whole": ratio(values, parts["whole"])
                    for name, values in parts.items()
                    if name != "whole"
                },
            },
        }
