"""What a training holds beside its learner: counters, replay and valued states.

The tensors of a checkpoint are checked against those of the run that is restored from it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl.agent.descent import part
from flipperctl.agent.frames import input_size
from flipperctl.agent.learner import Learner
from flipperctl.agent.replay import UNKNOWN, GroupBatch, GroupMemory, Replay
from flipperctl.api import ACTIONS, ObservationLayout, Outcome
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import RECENT, State, require_equal_layout
from flipperctl.config import Teacher, TrainConfig
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.guard import refusal
from flipperctl.rollout.steps import Step


@dataclass
class Progress:
    """The counters of a run."""

    difficulty: float
    """Difficulty of the terrain in the next new or requested episode, 0 to 1."""
    decision: int = 0
    """Number of decisions stored for learning so far."""
    episode: int = 0
    """Number of episodes that ended."""
    started: int = 0
    """Number of episodes begun or requested; each has its own seed."""
    lost: int = 0
    """Number of episodes lost because their worker died."""
    updates: int = 0
    """Number of updates of the network."""
    loss: float = 0.0
    """Loss of the last update."""
    recent: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT))
    """Whether the last episodes reached the finish."""

    @property
    def success_rate(self) -> float:
        """Fraction of the last episodes that reached the finish; 0 before the first."""
        return sum(self.recent) / max(1, len(self.recent))


def new_replay(config: TrainConfig, layout: ObservationLayout, privileged: int) -> Replay:
    """Return an empty replay; ``privileged``: length of a privileged state, 0 without them."""
    agent = config.agent
    return Replay(
        *(agent.replay_size, input_size(config.network, layout), agent.n_step, agent.gamma),
        labels=len(ACTIONS) if config.keeps_distributions else 0,
        privileged=privileged,
        risk_horizon=agent.risk_horizon if agent.risk else 0,
        newest=layout.size,
        cut_at_random=agent.cut_at_random,
    )


def store(replay: Replay, step: Step, config: TrainConfig) -> None:
    """Put a step into the replay."""
    ending, bootstrapped = step.ending, config.agent.bootstrap_outcomes
    replay.add(
        step.observation,
        step.action,
        step.reward,
        step.next_observation,
        over=ending is not None,
        bootstrap=ending is not None and ending["outcome"] in bootstrapped,
        explored=step.explored,
        failed=ending is not None and ending["outcome"] != Outcome.REACHED,
        label=step.label,
        privileged=step.privileged,
        next_privileged=step.next_privileged,
    )


class ValuedStates:
    """Groups of states with values, if the teacher's loss learns from them."""

    def __init__(self, teacher: Teacher) -> None:
        self._teacher = teacher
        self.memory = GroupMemory(teacher.kept_groups)

    def add(self, step: Step) -> None:
        """Store what the last step of an episode brings."""
        if self._teacher.loss != "values" or step.ending is None:
            return
        controller = self._teacher.controller
        assert controller is not None  # the configuration was checked
        if step.groups is None:
            raise ConfigError(
                f"teacher.loss=values: the controller {controller.plugin_name} values no states; "
                "teacher=searched does"
            )
        states, numbers = step.groups.observations.shape[1:]
        if numbers != len(step.observation) or states != (self.memory.states or states):
            text = (
                f"returned groups of {states} observations of {numbers} numbers; observations of "
                f"{len(step.observation)} numbers are allowed, equally many in each group and "
                "episode"
            )
            raise refusal(controller, "groups", text)
        self.memory.add(step.groups)

    def batches(self, count: int, rng: np.random.Generator) -> list[GroupBatch]:
        """Return a batch for each of ``count`` gradient steps; none without stored states."""
        if not len(self.memory):
            return []
        return [self.memory.sample(self._teacher.batch_groups, rng) for _ in range(count)]


Arrays = dict[str, NDArray[np.generic]]


def run_arrays(
    saved: Checkpoint, state: State, agent: Learner, replay: Replay
) -> tuple[Arrays, dict[int, Arrays]]:
    """Check all tensors; return the replay's arrays and the weights of the outstanding requests.

    The weights are keyed by their version.
    """
    if state.replay_kept >= replay.capacity:
        raise CheckpointError(
            f"{saved.path}: its part replay is not valid: {state.replay_kept} kept transitions "
            f"leave no room in a replay of {replay.capacity}"
        )
    network, own = agent.online.state_dict(), agent.tensors()
    blank = {n: torch.from_numpy(array) for n, array in replay.blank(state.replay_added).items()}
    versions = {request.version for request in state.orders}
    expected: dict[str, Mapping[str, torch.Tensor]] = {
        **{name: part(own, name) for name in dict.fromkeys(key.split(".")[0] for key in own)},
        **{"replay": blank},
        **{f"weights{version}": network for version in versions},
    }
    for name, tensors in expected.items():
        try:
            require_equal_layout(saved.part(name), tensors)
        except ValueError as error:
            raise CheckpointError(f"{saved.path}: its part {name} is not valid: {error}") from error
    found = arrays(saved, "replay")
    bounded = [("action", 0.0, len(ACTIONS) - 1), ("discount", 0.0, 1)]
    bounded += [("label", 0.0, 1)] if "label" in found else []
    if "failing" in found:
        bounded += [("failing", UNKNOWN, 1), ("resembles", 0.0, 1)]
    for name, least, most in bounded:
        values = np.asarray(found[name], np.float64)
        if ((values < least) | (values > most)).any():
            text = f"replay.{name} lies outside of {least:g} to {most}"
            raise CheckpointError(f"{saved.path}: {text}")
    return found, {version: arrays(saved, f"weights{version}") for version in versions}


def arrays(saved: Checkpoint, part: str) -> Arrays:
    """Return the tensors of a part of a checkpoint as arrays."""
    return {name: tensor.numpy() for name, tensor in saved.part(part).items()}
