"""The last part of a training by labels (``teacher.final_updates``): it learns them all anew.

In: a replay with the labels of the whole training. Out: the weights of a network that began with
those of the training's start. One that learns while the labels come meets the first ones most often
and the last ones, which its own best driving leads to, least.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from flipperctl.agent.d3qn import D3qn
from flipperctl.agent.learner import Learner
from flipperctl.agent.replay import Replay
from flipperctl.api import ACTIONS, ObservationLayout
from flipperctl.config import TrainConfig
from flipperctl.training.starting import give, read_start

_REPORTS = 4
"""Number of messages about the progress."""


class Relearning:
    """Gives an agent the weights of a network that learns all labels of the replay anew."""

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
        relearns = config.teacher.final_updates and config.teacher.teaches
        self._start = read_start(config) if relearns else None  # the file may change until then

    def run(self, agent: Learner, stop: Callable[[], bool]) -> bool:
        """Do all updates and give the agent the weights; do nothing if none are configured.

        ``stop`` is called between updates. Return False, without a change, if it returns True; the
        next call begins anew and finds the same weights for the same labels.

        Raises:
            NonFiniteError: a loss is not finite.
            PluginFailedError: the network's code failed.
        """
        count = self._config.teacher.final_updates
        if not (count and self._config.teacher.teaches):
            return True
        rows = self._replay.labelled()
        self._report(f"learns the {len(rows):,} labels anew in {count:,} updates")
        learner = self._learner()
        together, size = learner.settings.updates_together, learner.settings.batch_size
        rng, begun, told = np.random.default_rng(self._seeds[1]), time.monotonic(), 1
        for done in range(0, count if len(rows) else 0, together):
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
            *(config.network, self._layout, len(ACTIONS)),
            config.agent.model_copy(update={"risk": False}),
            seed=self._seeds[0],
            device=config.device,
            teacher=config.teacher,
        )
        if self._start is not None:
            give(self._start, learner)
        return learner
