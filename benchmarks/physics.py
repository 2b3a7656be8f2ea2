"""Speed of the environment compared with its upper limit, Chipmunk alone on the same states.

Episodes are recorded once. Then, in turn, the environment replays their actions, and a bare world
is set to the state at the start of each decision and stepped as often as in that decision, where
only these steps are timed. The parts of a decision are timed in the same way.

Without the engine's callback the belts would stand still, so the tracks of a bare world get
Chipmunk's own constant surface velocity instead. That velocity fails at risers, hence the states.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymunk import GearJoint

from benchmarks.settings import Benchmark, planar, quantity, ratio
from flipperctl.api import SAMPLE_PERIOD, Profile, Start, Transition
from flipperctl.config import EnvConfig
from flipperctl.config.reward_sum import RewardSum
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.policies.source import load_policy
from flipperctl.rollout.episode import EvaluationSeeds, decisions
from flipperctl.sim.planar.compiled import TRACK, step_alone
from flipperctl.sim.planar.world import PlanarWorld

ABOUT = (
    "decisions of the environment against the same substeps by Chipmunk's step alone "
    "(same states, one process, in turn), and the parts of a decision's time"
)
_NO_HANDLER = 0
"""A collision type without a callback."""
_PARTS = ("reset", "decision", "bare", "world", "sensing", "rewards")


class Snapshot:
    """State of each body and target of each servo, in the engine's units and order."""

    def __init__(self, world: PlanarWorld) -> None:
        bodies = world.space.bodies
        self.bodies = [(b.position, b.angle, b.velocity, b.angular_velocity) for b in bodies]
        self.phases = [gear.phase for gear in _gears(world)]

    def restore(self, world: PlanarWorld, phases: list[float]) -> None:
        """Put the bodies of a world into this state, and set other servo targets."""
        for body, state in zip(world.space.bodies, self.bodies, strict=True):
            body.position, body.angle, body.velocity, body.angular_velocity = state
        for gear, phase in zip(_gears(world), phases, strict=True):
            gear.phase = phase


def _gears(world: PlanarWorld) -> list[GearJoint]:
    return [c for c in world.space.constraints if isinstance(c, GearJoint)]


def strip(world: PlanarWorld) -> None:
    """Remove the belts' callback and give the tracks Chipmunk's own surface velocity."""
    for body in world.space.bodies:
        for shape in body.shapes:
            if shape.collision_type == TRACK:
                shape.collision_type = _NO_HANDLER
                shape.surface_velocity = (-world.robot.track_speed, 0.0)


def contacts(world: PlanarWorld) -> int:
    """Return the number of points at which the robot touches the ground."""
    counts: list[int] = []
    for body in world.space.bodies:
        body.each_arbiter(lambda arbiter: counts.append(len(arbiter.contact_point_set.points)))
    return sum(counts)


@dataclass
class Recording:
    """One episode, decision by decision."""

    seed: int
    profile: Profile
    start: Start
    snapshots: list[Snapshot]
    """State of the world at the start and after each decision."""
    actions: list[int] = field(default_factory=list)
    targets: list[tuple[float, float]] = field(default_factory=list)
    """Angles commanded to the front and the rear flippers at each decision [rad]."""
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
    policy = load_policy(controller, "bench.controller").build(config)
    env.reset(seed=seed)
    start = Start(float(env.state.position[0]), env.state.front, env.state.rear)
    recording = Recording(seed, env.profile, start, [Snapshot(_world(env))])
    for decision in decisions(env, policy, seed):
        recording.actions.append(decision.action)
        front, rear = env.drive.targets
        recording.targets.append((front, rear))
        recording.snapshots.append(Snapshot(_world(env)))
        recording.contacts.append(contacts(_world(env)))
        recording.transitions.append(decision.transition)
    return recording


def _world(env: FlipperEnv) -> PlanarWorld:
    world = env.drive.world.of_engine
    assert isinstance(world, PlanarWorld)  # planar() has refused other engines
    return world


class Clocks:
    """Time each part of an episode's decisions; every public method returns a time [s]."""

    def __init__(self, config: EnvConfig) -> None:
        self.config, self.env = config, FlipperEnv(config=config)
        self.reward = RewardSum(config.rewards)
        self.bare_contacts: list[int] = []

    def reset(self, r: Recording) -> float:
        """Time the environment's reset."""
        begun = time.process_time()
        self.env.reset(seed=r.seed)
        return time.process_time() - begun

    def decision(self, r: Recording) -> float:
        """Time the environment's steps, after ``reset``."""
        step = self.env.step
        begun = time.process_time()
        for action in r.actions:
            step(action)
        return time.process_time() - begun

    def bare(self, r: Recording) -> float:
        """Time Chipmunk's step alone."""
        world, spent = self._world(r), 0.0
        strip(world)
        substeps = round(SAMPLE_PERIOD / world.sim.substep)
        self.bare_contacts = []
        for index in range(len(r.actions)):
            r.snapshots[index].restore(world, r.snapshots[index + 1].phases)
            begun = time.process_time()
            step_alone(world.space, world.sim.substep, substeps * r.samples(index))
            spent += time.process_time() - begun
            self.bare_contacts.append(contacts(world))
        return spent

    def world(self, r: Recording) -> float:
        """Time the world with its belts, commanded and sampled as in the environment."""
        world, spent = self._world(r), 0.0
        for index, target in enumerate(r.targets):
            begun = time.process_time()
            world.command(*target)
            world.advance(r.samples(index))
            spent += time.process_time() - begun
        return spent

    def sensing(self, r: Recording) -> float:
        """Time the sensing of terrain points, bin heights and angles."""
        perception, episode = self.config.perception, self.config.episode
        margin = episode.run_up + episode.run_out + perception.reach + 2.0
        sensor, rng = perception.over(r.profile, margin), np.random.default_rng(0)
        begun = time.process_time()
        for t in r.transitions:
            sensor.sense(t.after, rng)
        return time.process_time() - begun

    def rewards(self, r: Recording) -> float:
        """Time all reward terms."""
        begun = time.process_time()
        for t in r.transitions:
            self.reward(t)
        return time.process_time() - begun

    def _world(self, r: Recording) -> PlanarWorld:
        return PlanarWorld(r.profile, self.config.robot, planar(self.config.sim), r.start)


def measure(bench: Benchmark) -> dict[str, Any]:
    """Measure rates [1/s], their ratio, and the time of each part of a decision [µs].

    The parts are ``physics`` (Chipmunk alone), ``contacts`` (the additional time of belts, commands
    and samples), ``sensing``, ``reward`` and ``rest`` (the remainder of the environment's step).
    """
    s, config = bench.settings, bench.config.environment()
    substeps = round(SAMPLE_PERIOD / planar(config.sim).substep)
    clocks, recordings = Clocks(config), []
    for seed in EvaluationSeeds.of(s.seed, config.terrain).first(s.episodes):
        bench.report_progress("recording episodes", 0.0)
        recordings.append(record(config, s.controller, seed))
    rounds: list[Mapping[str, float]] = []
    bare_contacts: list[int] = []
    for index in range(-1, s.repeats):  # the first round is the warm-up
        spent: Counter[str] = Counter()
        for r in recordings:
            for name in _PARTS:
                spent[name] += getattr(clocks, name)(r)
            bare_contacts += clocks.bare_contacts if index < 0 else []
        rounds += [spent] if index >= 0 else []
        bench.report_progress("episodes in turn", (index + 1) / s.repeats)
    made = sum(len(r.actions) for r in recordings)
    steps = substeps * sum(r.samples(i) for r in recordings for i in range(len(r.actions)))
    bare = [made / t["bare"] for t in rounds]
    environment = [made / t["decision"] for t in rounds]
    with_reset = [made / (t["decision"] + t["reset"]) for t in rounds]
    seconds = {
        "physics": [t["bare"] for t in rounds],
        "contacts": [t["world"] - t["bare"] for t in rounds],
        "sensing": [t["sensing"] for t in rounds],
        "reward": [t["rewards"] for t in rounds],
        "rest": [t["decision"] - t["world"] - t["sensing"] - t["rewards"] for t in rounds],
        "whole": [t["decision"] for t in rounds],
    }
    parts = {name: [1e6 / made * value for value in part] for name, part in seconds.items()}
    return {
        "about": ABOUT,
        "decisions_a_round": made,
        "substeps_a_round": steps,
        "contacts_at_decision_ends": {
            "unit": "-",
            "environment": sum(sum(r.contacts) for r in recordings) / made,
            "bare": sum(bare_contacts) / made,
        },
        "quantities": {
            "bare_substeps": quantity([steps / t["bare"] for t in rounds], "1/s"),
            "bare_decisions": quantity(bare, "1/s"),
            "environment_decisions": quantity(environment, "1/s"),
            "environment_decisions_with_reset": quantity(with_reset, "1/s"),
            **{f"decision.{name}": quantity(part, "µs") for name, part in parts.items()},
        },
        "ratios": {
            "environment_decisions / bare_decisions": ratio(environment, bare),
            **{
                f"decision.{name} / decision.whole": ratio(part, parts["whole"])
                for name, part in parts.items()
                if name != "whole"
            },
        },
    }
