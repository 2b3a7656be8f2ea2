"""The whole state of a run, written as a checkpoint and restored from one.

Checkpoints are taken between episodes, when the simulator holds no state, so a resumed run repeats
the uninterrupted run bit for bit. Its tensors are checked against its network, optimiser and
replay.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from flipperctl import checkpoint
from flipperctl.agent.descent import part
from flipperctl.agent.frames import input_size
from flipperctl.agent.learner import Learner
from flipperctl.agent.replay import UNKNOWN, GroupBatch, GroupMemory, Replay
from flipperctl.api import ACTIONS, ObservationLayout, Outcome
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import RECENT, Generators, RequestState, State, Validation
from flipperctl.checkpoint.sealed import require_equal_layout
from flipperctl.config import Teacher, TrainConfig
from flipperctl.config.identity import all_files_read, content_digest
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.guard import refusal
from flipperctl.rollout.steps import RolloutRequest, Step
from flipperctl.training.relearning import Relearning
from flipperctl.training.validation import Validator


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


_COUNTERS = ("decision", "episode", "started", "lost", "updates", "loss", "difficulty")


class RunSaver:
    """Writes and restores all that a run needs to be resumed."""

    def __init__(
        self,
        config: TrainConfig,
        directory: Path,
        agent: Learner,
        replay: Replay,
        groups: GroupMemory,
        relearning: Relearning,
        progress: Progress,
        generators: Mapping[str, np.random.Generator],
        validator: Validator,
    ) -> None:
        """``generators``: keyed by explore, sample and noise."""
        self._config, self._directory = config, directory
        self._agent, self._replay, self._progress = agent, replay, progress
        self._groups, self._relearning = groups, relearning
        self._generators, self._validator = generators, validator
        self._files = all_files_read(checkpoint.plugged(config))
        self._digests = tuple(map(content_digest, self._files))

    def save(self, outstanding: Sequence[RolloutRequest] = ()) -> None:
        """Write ``last.safetensors``; a resumed run resends the ``outstanding`` requests."""
        tensors = self._agent.tensors() | self._relearning.tensors()
        for name, array in self._replay.filled().items():
            tensors[f"replay.{name}"] = torch.from_numpy(array)
        for name, array in self._groups.filled().items():
            tensors[f"groups.{name}"] = torch.from_numpy(array)
        for version, weights in {r.version: r.weights for r in outstanding}.items():
            for name, array in weights.items():
                tensors[f"weights{version}.{name}"] = torch.from_numpy(array)
        document = checkpoint.describe(self._config, "last", state=self._state(outstanding))
        checkpoint.write(self._directory / checkpoint.LAST, document, tensors)

    def save_best(self, best: Validation) -> None:
        """Write ``best.safetensors``: the policy that was just validated."""
        document = checkpoint.describe(
            self._config, "best", decision=best.decision, validation=best.model_dump()
        )
        policy = self._agent.policy.state_dict()
        tensors = {f"policy.{name}": tensor for name, tensor in policy.items()}
        if self._agent.risk is not None:
            weights = self._agent.risk.network.state_dict()
            tensors |= {f"risk.{name}": tensor for name, tensor in weights.items()}
        checkpoint.write(self._directory / checkpoint.BEST, document, tensors)

    def restore(self, saved: checkpoint.Checkpoint) -> list[RolloutRequest]:
        """Restore the run from a checkpoint; return the requests that were outstanding."""
        state = saved.document.state
        if state is None:
            raise CheckpointError(f"{saved.path} holds a policy alone, not a run")
        self._require_files(state)
        replay, weights = run_arrays(saved, state, self._agent, self._replay)
        self._agent.restore(saved.tensors, state.updates)
        self._replay.restore(replay, state.replay_added, state.replay_kept)
        size = self._replay.arrays["observation"].shape[1]
        try:
            self._groups.restore(arrays(saved, "groups"), state.groups_added, size)
        except ValueError as error:
            raise CheckpointError(f"{saved.path}: its part groups is not valid: {error}") from error
        self._relearning.restore(saved)
        for name, generator in state.generators.model_dump().items():
            self._generators[name].bit_generator.state = generator
        for name in _COUNTERS:
            setattr(self._progress, name, getattr(state, name))
        self._progress.recent.extend(state.recent)
        self._validator.history[:] = state.validations
        return [
            RolloutRequest(**request.model_dump(), weights=weights[request.version])
            for request in state.orders
        ]

    def _require_files(self, state: State) -> None:
        """Refuse files, such as recorded ground, that are not those with which the run began."""
        for file, now, then in zip(self._files, self._digests, state.files, strict=False):
            if None not in (now, then) and now != then:
                raise CheckpointError(
                    f"{file} has changed since the run began, and a resumed run keeps its ground; "
                    "restore the file, or start a new run from this one's policy: "
                    f"agent.start_from={self._directory}"
                )

    def _state(self, outstanding: Sequence[RolloutRequest]) -> State:
        counters = {name: getattr(self._progress, name) for name in _COUNTERS}
        generators = {n: g.bit_generator.state for n, g in self._generators.items()}
        requests = [
            RequestState(**{name: getattr(request, name) for name in RequestState.model_fields})
            for request in outstanding
        ]
        return State(
            **counters,
            recent=tuple(self._progress.recent),
            validations=tuple(self._validator.history),
            best_by=self._validator.best_by,
            orders=tuple(requests),
            replay_added=self._replay.added,
            replay_kept=self._replay.kept,
            groups_added=self._groups.added,
            files=self._digests,
            generators=Generators.model_validate(generators),
        )
