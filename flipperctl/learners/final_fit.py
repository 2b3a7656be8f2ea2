"""The end of a training that learns all labels anew (``teacher.final_updates``)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np
import torch

from flipperctl.agent.networks import build_policy
from flipperctl.agent.replay import Replay
from flipperctl.api import Training
from flipperctl.config import TrainConfig
from flipperctl.learners.double_q import DoubleQ
from flipperctl.learners.pair import NetworkPair, require_equal_parts
from flipperctl.learners.settings import D3qnSettings
from flipperctl.learners.starting import Start, load_start_weights

_PART = "start"
"""Part of a checkpoint that holds the weights to begin with."""
_REPORTS = 4
"""Number of messages about the progress."""


class FinalFit:
    """Learns all labels of a training anew at its end (``teacher.final_updates``).

    A network that learns while the labels come meets the first ones most often, and the last ones,
    which its own best driving leads to, least.
    """

    def __init__(
        self,
        settings: D3qnSettings,
        training: Training,
        replay: Replay,
    ) -> None:
        """``replay`` holds the labels."""
        config: TrainConfig = training.config
        self._settings, self._config, self._layout = settings, config, training.layout
        self._replay, self._report, self._seed = replay, training.report, training.seed
        self._on = bool(config.teacher.final_updates and config.teacher.teaches)
        self._start: Start | None = None

    def begin(self, start: Start | None) -> None:
        """Remember the weights that a new training starts with; their file may change later."""
        self._start = start if self._on else None

    def tensors(self) -> dict[str, Mapping[str, torch.Tensor]]:
        """Return the weights to begin with, for the checkpoint of the run."""
        return {} if self._start is None else {_PART: self._start[0].state_dict()}

    def restore(self, tensors: Mapping[str, Mapping[str, torch.Tensor]]) -> None:
        """Restore the weights to begin with."""
        # Random weights come from the seed again; those of start_from were saved with the run.
        if not (self._on and self._settings.start_from):
            return
        module = build_policy(self._config.network, self._layout)
        require_equal_parts(tensors, {_PART: module.state_dict()})
        module.load_state_dict(tensors[_PART])
        self._start = module, None

    def run(self, agent: NetworkPair, stop: Callable[[], bool]) -> bool:
        """Do all updates and give the agent the weights; do nothing if none are configured.

        ``stop`` is called between updates. Return False, without a change, if it returns True; the
        next call begins anew and finds the same weights for the same labels.
        """
        config, count = self._config, self._config.teacher.final_updates
        if not self._on:
            return True
        # A run without labels, such as one that stopped early, keeps its policy.
        rows = self._replay.labelled()
        if not len(rows):
            self._report("keeps what it has learnt: there are no labels to learn anew")
            return True
        self._report(f"learns the {len(rows):,} labels anew in {count:,} updates")
        # A new learner from the start of the training; the risk keeps what it has learnt.
        without_risk = self._settings.model_copy(update={"risk": False})
        learner = DoubleQ(
            config.network,
            self._layout,
            without_risk,
            seed=self._seed,
            device=config.device,
            teacher=config.teacher,
        )
        if self._start is not None:
            load_start_weights(self._start, learner)
        together, size = learner.settings.updates_together, learner.settings.batch_size
        # The fourth stream of the seed serves this fit alone: a repeated call draws the same.
        *_, again = np.random.SeedSequence(config.seed).spawn(4)
        rng, begun, reports = np.random.default_rng(again), time.monotonic(), 1
        for done in range(0, count, together):
            if stop():
                return False
            # A few messages, spread evenly over the updates.
            if done * _REPORTS >= reports * count:
                left = (time.monotonic() - begun) * (count - done) / done
                self._report(f"{done:,} of {count:,} updates, {left:.0f} s left")
                reports += 1
            batch = self._replay.sample(min(together, count - done) * size, rng, rows)
            learner.update(batch, done / count)
        # Only a fit that was completed replaces the policy.
        agent.online.load_state_dict(learner.online.state_dict())
        agent.target.load_state_dict(learner.target.state_dict())
        return True
