"""The whole state of a run, written as a checkpoint and restored from one.

Checkpoints are taken between episodes, when the simulator holds no state, so a resumed run repeats
the uninterrupted run bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from flipperctl import checkpoint
from flipperctl.agent.groups import GroupMemory
from flipperctl.agent.learner import Learner
from flipperctl.agent.replay import Replay
from flipperctl.checkpoint.document import Generators, RequestState, State, Validation
from flipperctl.config import TrainConfig
from flipperctl.config.identity import all_files_read, content_digest
from flipperctl.errors import CheckpointError
from flipperctl.rollout.values import RolloutRequest
from flipperctl.training.progress import Progress
from flipperctl.training.relearning import Relearning
from flipperctl.training.tensors import arrays, run_arrays
from flipperctl.training.validation import Validator

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
        """Restore the run from a checkpoint; return the requests that were outstanding.

        Raises:
            CheckpointError: the checkpoint is of an earlier version, its tensors are not those of
                this run, or a file that a plugin reads has changed.
        """
        state = saved.document.state
        if state is None:
            raise CheckpointError(
                f"{saved.path} is of an earlier version: its policy can be evaluated and exported, "
                "but the run cannot be resumed"
            )
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
        self._validator.restore(state.validations, state.best_by)
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
