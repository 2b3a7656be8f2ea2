"""The last part of a training by labels (``teacher.final_updates``): it learns them anew.

In: a replay with the labels of the training. Out: the weights of a network that began with
those of the training's start. One that learns while the labels come meets the first ones most often
and the last ones, which its own best driving leads to, least.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.learner import Learner
from flipperctl.agent.networks import build_network
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS, ObservationLayout
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import require_equal_layout
from flipperctl.config import TrainConfig
from flipperctl.errors import CheckpointError
from flipperctl.training.starting import Start, give

_PART = "start"
"""Part of a checkpoint that holds the weights to begin with."""
_REPORTS = 4
"""Number of messages about the progress."""


class Relearning:
    """Gives an agent the weights of a network that learns the labels of the replay anew."""

    def __init__(
        self,
        config: TrainConfig,
        layout: ObservationLayout,
        replay: Replay,
        seeds: tuple[int, np.random.SeedSequence],
        report: Callable[[str], None],
    ) -> None:
        """``seeds``: that of the training's first weights, and that of the batches.

        ``report`` receives messages with the time left.
        """
        self._config, self._layout, self._replay = config, layout, replay
        self._seeds, self._report = seeds, report
        self._relearns = bool(config.teacher.final_updates and config.teacher.teaches)
        self._start: Start | None = None

    def begin(self, found: Start | None) -> None:
        """Remember the weights that a new training starts with; their file may change later."""
        self._start = found if self._relearns else None

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return the weights to begin with, for the checkpoint of the run."""
        weights = {} if self._start is None else self._start[0].state_dict()
        return {f"{_PART}.{name}": tensor for name, tensor in weights.items()}

    def restore(self, saved: Checkpoint) -> None:
        """Restore the weights to begin with."""
        if not (self._relearns and self._config.agent.start_from):
            return
        weights = saved.part(_PART)
        module = build_network(self._config.network, self._layout, len(ACTIONS))
        try:
            require_equal_layout(weights, module.state_dict())
        except ValueError as error:
            raise CheckpointError(
                f"{saved.path}: its part {_PART} is not valid: {error}"
            ) from error
        module.load_state_dict(weights)
        self._start = module, None

    def run(self, agent: Learner, stop: Callable[[], bool]) -> bool:
        """Do all updates and give the agent the weights; do nothing if none are configured.

        ``stop`` is called between updates. Return False, without a change, if it returns True; the
        next call begins anew and finds the same weights for the same labels.
        """
        count = self._config.teacher.final_updates
        if not self._relearns:
            return True
        rows = self._replay.labelled()
        if not len(rows):
            self._report("keeps what it has learnt: there are no labels to learn anew")
            return True
        self._report(f"learns the {len(rows):,} labels anew in {count:,} updates")
        learner = self._learner()
        together, size = learner.settings.updates_together, learner.settings.batch_size
        rng, begun, told = np.random.default_rng(self._seeds[1]), time.monotonic(), 1
        for done in range(0, count, together):
            if stop():
                return False
            if done * _REPORTS >= told * count:
                left = (time.monotonic() - begun) * (count - done) / done
                self._report(f"{done:,} of {count:,} updates, {left:.0f} s left")
                told += 1
            batch = self._replay.sample(min(together, count - done) * size, rng, rows)
            learner.update(batch, done / count)
        agent.take_weights(learner)
        return True

    def _learner(self) -> D3qn:
        """Return a learner, without a risk, with the weights that the training began with."""
        config = self._config
        learner = D3qn(
            *(config.network, self._layout),
            config.agent.model_copy(update={"risk": False}),
            seed=self._seeds[0],
            device=config.device,
            teacher=config.teacher,
        )
        if self._start is not None:
            give(self._start, learner)
        return learner
