"""What every training does, whoever learns: listeners, validations, checkpoints, the summary.

In: a validated configuration and the directory of a new or resumed run. Out: checkpoints and
summary.json. The first checkpoint is written before the first decision, so that a killed run can
always be resumed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import torch

from flipperctl import checkpoint
from flipperctl.agent.learner import join
from flipperctl.api import Listener, Logger, Outcome
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import Document, State
from flipperctl.config import TrainConfig
from flipperctl.config.defaults import first_update
from flipperctl.config.identity import all_files_read, content_digest
from flipperctl.env import ground
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.env.metrics import DRAWN
from flipperctl.errors import CheckpointError
from flipperctl.files import write_json
from flipperctl.rollout.collect import Collector
from flipperctl.rollout.episode import Row
from flipperctl.training.episodes import Progress
from flipperctl.training.listeners import Companion
from flipperctl.training.validation import PolicyArrays, Validator

COUNTERS = ("decision", "episode", "started", "lost", "updates", "loss", "difficulty")
"""Numbers of ``Progress`` that a checkpoint holds."""
Stop = Callable[[], bool]


def closer(opened: Listener | Collector) -> Callable[..., None]:
    """Return an ``ExitStack`` callback that closes; of several errors, the first is raised."""

    def close(kind: object, error: BaseException | None, trace: object) -> None:
        try:
            opened.close()
        except BaseException:
            if error is None:
                raise

    return close


class BaseTrainer(ABC):
    """One training run."""

    def __init__(
        self, config: TrainConfig, directory: Path, listeners: Sequence[Listener] = ()
    ) -> None:
        torch.set_num_threads(config.train.threads)
        self.config, self.directory = config, directory
        self.listeners = list(listeners)
        self.env = FlipperEnv(config=config.environment(), actions=config.actions)
        self.progress = Progress(ground.first_difficulty(config.terrain))
        plugged = checkpoint.plugged(config)
        self._files = all_files_read(p for p in plugged if p.kind != Logger.kind)
        self._digests = tuple(map(content_digest, self._files))
        self.companion = Companion(directory)
        self._restored = False

    def _validating(self, agent: PolicyArrays) -> None:
        """Validate the policy of ``agent`` from now on."""
        self.validator = Validator(self.config, agent, self.env)

    def run(
        self,
        stop: Stop = lambda: False,
        regret: Callable[[], dict[str, Any] | None] = lambda: None,
    ) -> dict[str, Any]:
        """Train until the budget is spent or ``stop`` returns True.

        ``stop`` is called between episodes, in validations, and while waiting for workers.
        ``regret`` is called once if the budget is spent, after the last checkpoint; its result
        is part of the summary. Returns the summary, which is also written to ``summary.json``. The
        listeners are closed even after an error.
        """
        with ExitStack() as opened:
            for listener in self.listeners:
                opened.push(closer(listener))
            self.companion.start()
            budget, first = self.config.train.decisions, self._first_update()
            if first is not None and budget < first[0] and not self.progress.updates:
                self._report(f"train.decisions={budget} leaves the policy as it begins: {first[1]}")
            finished = self._run(stop, opened)
            summary = self.summary(finished)
            summary["regret"] = regret() if finished else None
            write_json(self.directory / "summary.json", summary)
            return summary

    @abstractmethod
    def _run(self, stop: Stop, opened: ExitStack) -> bool:
        """Train; return whether the budget is spent. ``opened`` closes what is put into it."""

    def _first_update(self) -> tuple[int, str] | None:
        """Return the decisions before the policy first changes, and a clause that says why.

        None: it may change from the start.
        """
        return first_update(self.config)

    @abstractmethod
    def _exploring(self) -> tuple[float | None, int]:
        """Return the probability of a random action now, and the age of the last weights.

        The first is None of a learner without it; the second is the number of decisions of the run
        between the request of the last episode, with its weights, and its arrival.
        """

    @abstractmethod
    def _policy(self) -> Mapping[str, Mapping[str, torch.Tensor]]:
        """Return the parts of a checkpoint of the policy."""

    def _validation_due(self) -> bool:
        """Return whether a validation is due since the last one, or at the end of the budget."""
        decision, settings, last = self.progress.decision, self.config.train, self.validator.last
        if decision >= settings.decisions:
            return last is None or last.decision != decision
        before = 0 if last is None else last.decision
        return decision // settings.validate_every > before // settings.validate_every

    def _end_episode(self, ending: Row) -> None:
        reached = ending["outcome"] == Outcome.REACHED
        progress, terrain = self.progress, self.config.terrain
        progress.episode += 1
        progress.recent.append(reached)
        progress.difficulty = ground.next_difficulty(terrain, progress.difficulty, reached)
        row = {**self._common_columns(), "success_rate": progress.success_rate}
        own = {name: value for name, value in ending.items() if not name.startswith(DRAWN)}
        for listener in self.listeners:
            listener.episode({**row, "lag": self._exploring()[1], **own})

    def _validate(self, collector: Collector) -> bool:
        """Validate the policy; return False if the run is to stop before the result is known."""
        found = self.validator.validate(collector, self.progress.decision)
        if found is None:
            return False
        means = found.model_dump(exclude={"decision"})
        for listener in self.listeners:
            listener.validation({**self._common_columns(), **means})
        return True

    def _report(self, text: str) -> None:
        for listener in self.listeners:
            listener.note(text)

    def _common_columns(self) -> dict[str, Any]:
        """Return the columns of ``metrics.csv`` that all rows share."""
        progress = self.progress
        return {
            "decision": progress.decision,
            "episode": progress.episode,
            "epsilon": self._exploring()[0],
            "loss": progress.loss if progress.updates else None,
            "seconds": round(self.companion.seconds, 3),
        }

    def _state(self, **own: Any) -> State:
        """Return the state of the run; ``own``: fields that a subclass adds."""
        return State(
            **{name: getattr(self.progress, name) for name in COUNTERS},
            recent=tuple(self.progress.recent),
            validations=tuple(self.validator.history),
            best_by=self.validator.best_by,
            files=self._digests,
            **own,
        )

    @property
    def rows(self) -> int:
        """Number of rows that the run has written: one for each episode and each validation."""
        return self.progress.episode + len(self.validator.history)

    def _write_last(self, document: Document, tensors: Mapping[str, torch.Tensor]) -> None:
        """Write ``last.safetensors``, and before it what it states of the clock."""
        self.companion.write(self.rows)
        checkpoint.write(self.directory / checkpoint.LAST, document, tensors)

    def _save_best(self) -> None:
        """Write ``best.safetensors`` if the policy is the best so far.

        After the last checkpoint: so a killed run never leaves a best policy from after it; a
        resumed run writes a best policy that was not written before.
        """
        best = self.validator.best
        if best is None or best.decision != self.progress.decision:
            return
        document = checkpoint.describe(
            self.config, "best", decision=best.decision, validation=best.model_dump()
        )
        checkpoint.write(self.directory / checkpoint.BEST, document, join(self._policy()))

    def restore(self, saved: Checkpoint) -> None:
        """Restore the run from its last checkpoint."""
        state = saved.document.state
        if state is None:
            raise CheckpointError(f"{saved.path} holds a policy alone, not a run")
        for file, now, then in zip(self._files, self._digests, state.files, strict=False):
            if None not in (now, then) and now != then:
                raise CheckpointError(
                    f"{file} has changed since the run began, and a resumed run keeps it; "
                    "restore the file, or start a new run from this one's policy: "
                    f"agent.start_from={self.directory}"
                )
        self._restore(saved, state)
        for name in COUNTERS:
            setattr(self.progress, name, getattr(state, name))
        self.progress.recent.extend(state.recent)
        self.validator.history[:] = state.validations
        self._restored = True
        self.companion.read()

    @abstractmethod
    def _restore(self, saved: Checkpoint, state: State) -> None:
        """Restore what the learner has."""

    def summary(self, finished: bool) -> dict[str, Any]:
        """Return the results of the run, as JSON types."""
        config, progress = self.config, self.progress
        validations = {"best": self.validator.best, "last": self.validator.last}
        return {
            "finished": finished,
            "terrain": config.terrain.plugin_name,
            "network": config.network.plugin_name,
            "seed": config.seed,
            "decisions": progress.decision,
            "episodes": progress.episode,
            "lost_episodes": progress.lost,
            "seconds": round(self.companion.seconds, 1),
            "success_rate": progress.success_rate,
            **{name: found and found.model_dump() for name, found in validations.items()},
        }
