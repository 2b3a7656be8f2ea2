"""The training loop: act → step → store → learn, with validations, checkpoints and the summary.

In: a validated configuration and the directory of a new or resumed run. Out: checkpoints and
summary.json. The first checkpoint is written before the first decision, so that a killed run can
always be resumed. The learner is known by ``flipperctl.api.Learner`` alone. When the budget is
spent, the rest of the running episodes is not learnt from.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from flipperctl import checkpoint
from flipperctl.agent.translate import plain_networks
from flipperctl.api import Listener, Logger, Outcome
from flipperctl.checkpoint import Checkpoint
from flipperctl.checkpoint.document import (
    Document,
    GeneratorState,
    RequestState,
    State,
    require_equal_layout,
)
from flipperctl.config import TrainConfig
from flipperctl.config.identity import all_files_read, content_digest
from flipperctl.env import ground
from flipperctl.env.metrics import DRAWN, with_both_names
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.plugging.guard import naming
from flipperctl.rollout.collect import Collector, Usage
from flipperctl.rollout.episode import RolloutRequest, Row
from flipperctl.rollout.training import ConfiguredTraining
from flipperctl.text.files import write_json
from flipperctl.training.episodes import EpisodeSource, Progress, TrainingRecorder
from flipperctl.training.listeners import Companion
from flipperctl.training.validation import Validator

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


class Trainer:
    """One training run."""

    def __init__(
        self, config: TrainConfig, directory: Path, listeners: Sequence[Listener] = ()
    ) -> None:
        torch.set_num_threads(config.train.threads)
        self.config, self.directory = config, directory
        self.listeners = list(listeners)
        self.progress = Progress(ground.first_difficulty(config.terrain))
        # Files that plugins read, such as recorded ground, must stay as they are (``restore``).
        plugged = checkpoint.plugged(config)
        self._files = all_files_read(p for p in plugged if p.kind != Logger.kind)
        self._digests = tuple(map(content_digest, self._files))
        self.companion, self._restored = Companion(directory), False
        self._usage: Usage | None = None
        self._early_notes: list[str] | None = []
        self._outstanding: list[RolloutRequest] = []
        self._recorder = TrainingRecorder(config, directory)
        # Environment and learner may report something before there are listeners.
        self._training = ConfiguredTraining(config, report=self._report)
        self.env = self._training.environment()
        with naming(config.agent, "build", ConfigError):
            self.learning = config.agent.build(self._training)
        # Workers decide by numpy, and so does whoever else plays a validation with them.
        by_workers = config.train.mode == "fast" and not config.agent.own_loop
        learner = config.agent, self.learning, config.network, config.perception.layout
        plain = plain_networks(*learner) if by_workers else None
        self.episodes = EpisodeSource(self._training, self.learning, self.progress, plain)
        self.validator = Validator(config, self.learning, self.env, plain)

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
            # Listeners are ready for what was noted while the run was built.
            early, self._early_notes = self._early_notes or [], None
            budget, first = self.config.train.decisions, self.config.agent.first_update(self.config)
            if first is not None and budget < first[0] and not self.progress.updates:
                self._report(f"train.decisions={budget} leaves the policy as it begins: {first[1]}")
            for text in early:
                self._report(text)
            finished = self._run(stop, opened)
            summary = self.summary(finished)
            summary["regret"] = regret() if finished else None
            write_json(self.directory / "summary.json", summary)
            return summary

    def _run(self, stop: Stop, opened: ExitStack) -> bool:
        """Train; return whether the budget is spent. ``opened`` closes what is put into it."""
        if not self._restored:  # else the checkpoint has what follows
            self._recorder.restore(0)
            self.learning.begin()
        # A first checkpoint before the first decision: a killed run can always be resumed.
        self._save_all(self._outstanding)
        collector = self.episodes.start_collector(self._outstanding, stop)
        opened.push(closer(collector))
        train = self._train_itself if self.config.agent.own_loop else self._train
        finished = train(collector, stop)
        self._usage = collector.usage()
        self._save_all(collector.outstanding())
        self._recorder.finish()
        return finished

    def _train(self, collector: Collector, stop: Stop) -> bool:
        """Train and validate; return whether the budget is spent, False if the run was stopped.

        A run that was stopped in a validation, or in what the learner does after the last decision,
        repeats that first when it is resumed.
        """
        settings, progress = self.config.train, self.progress
        while True:
            over = progress.decision >= settings.decisions
            # At the end of the budget the learner completes its work, then it is validated.
            if self._validation_due():
                if over and not self.learning.finish(stop):
                    return False
                if not self._validate(collector):
                    return False
                self._save_all(collector.outstanding())
            if over:
                return True
            if stop():
                return False
            before = progress.decision
            self._train_episode(collector)
            # A validation that is due saves as well.
            if self._checkpoint_due(before) and not self._validation_due():
                self._save_all(collector.outstanding())

    def _train_itself(self, collector: Collector, stop: Stop) -> bool:
        """Let a learner train by its own loop; see ``_train``."""
        finished = self.progress.decision >= self.config.train.decisions or self.learning.train(
            OwnLoop(self, collector, stop)
        )
        self.follow()  # an update after the last decision counts
        return finished and (not self._validation_due() or self._validate(collector))

    def _train_episode(self, collector: Collector) -> None:
        """Collect, store and learn until the episode or the budget ends.

        Does nothing if the run is to stop before an episode arrives.
        """
        learning, progress = self.learning, self.progress
        ending: Row | None = None
        # Each decision is stored and counted before the learner may update from it.
        for step in collector.episode():
            ending = None if step.ending is None else dict(step.ending)
            self._recorder.add(step, progress.episode)
            progress.decision += 1
            learning.add(step, progress.decision)
            self.follow()
            if progress.decision >= self.config.train.decisions:
                break
        if ending is None:  # the budget ended first, or the run is to stop
            learning.drop_episode()
            self._recorder.drop()
        else:
            self.end_episode(ending)
            learning.end_episode(progress.decision)
            self.follow()

    def validate_and_save(self, collector: Collector, before: int) -> bool:
        """Do what is due since the decision ``before``; return False if the run is to stop."""
        due = self._validation_due()
        if due and not self._validate(collector):
            return False
        if due or self._checkpoint_due(before):
            self._save_all(collector.outstanding())
        return True

    def follow(self) -> None:
        """Take the number of updates and the loss from the learner."""
        self.progress.updates, self.progress.loss = self.learning.updates, self.learning.loss

    def _checkpoint_due(self, before: int) -> bool:
        """Return whether a checkpoint is due since the decision ``before``."""
        interval = self.config.train.checkpoint_every
        return self.progress.decision // interval > before // interval

    def _validation_due(self) -> bool:
        """Return whether a validation is due since the last one, or at the end of the budget."""
        decision, settings, last = self.progress.decision, self.config.train, self.validator.last
        if decision >= settings.decisions:
            return last is None or last.decision != decision
        before = 0 if last is None else last.decision
        return decision // settings.validate_every > before // settings.validate_every

    def end_episode(self, ending: Row) -> None:
        """Count an episode that has ended, and show its row."""
        # The difficulty of the next episode may follow from the outcome of this one.
        reached = ending["outcome"] == Outcome.REACHED
        progress, terrain = self.progress, self.config.terrain
        progress.episode += 1
        progress.recent.append(reached)
        progress.difficulty = ground.next_difficulty(terrain, progress.difficulty, reached)
        row = {**self._common_columns(), "success_rate": progress.success_rate}
        columns = {name: value for name, value in ending.items() if not name.startswith(DRAWN)}
        for listener in self.listeners:
            listener.episode({**row, "lag": self.episodes.lag, **columns})

    def _validate(self, collector: Collector) -> bool:
        """Validate the policy; return False if the run is to stop before the result is known."""
        validation = self.validator.validate(collector, self.progress.decision)
        if validation is None:
            return False
        # Said once, while the number of workers can still be changed
        usage = collector.usage() if len(self.validator.history) == 1 else None
        if usage is not None and usage.enough < usage.workers:
            self._report(
                f"the {usage.workers} workers are idle for {100 * usage.workers_idle:.0f} % of "
                f"their time; {usage.enough} would play as much"
            )
        means = validation.model_dump(exclude={"decision"})
        for listener in self.listeners:
            listener.validation({**self._common_columns(), **means})
        return True

    def _report(self, text: str) -> None:
        if self._early_notes is not None:  # before there are listeners
            self._early_notes.append(text)
        for listener in self.listeners if self._early_notes is None else ():
            listener.note(text)

    def _common_columns(self) -> dict[str, Any]:
        """Return the columns of ``metrics.csv`` that all rows share."""
        progress = self.progress
        return {
            "decision": progress.decision,
            "episode": progress.episode,
            "epsilon": self.learning.exploration(progress.decision),
            "loss": progress.loss if progress.updates else None,
            "seconds": round(self.companion.seconds, 3),
        }

    def save(self, outstanding: Sequence[RolloutRequest] = ()) -> None:
        """Write ``last.safetensors``: all that the run needs to be resumed.

        New recorded episodes are written first, so that the checkpoint counts no missing one. A
        resumed run resends the ``outstanding`` requests.
        """
        self._recorder.save()
        learnt = {"target": self.learning.policy.state_dict(), **self.learning.tensors()}
        # Outstanding requests keep the weights with which they were sent.
        weights = {
            f"weights{request.version}": {
                name: torch.from_numpy(array) for name, array in request.weights.items()
            }
            for request in outstanding
        }
        requests = [
            RequestState(**{name: getattr(request, name) for name in RequestState.model_fields})
            for request in outstanding
        ]
        # Generators go by name, in the learner's process alone.
        states = {n: g.bit_generator.state for n, g in self._training.generators.items()}
        state = State(
            **{name: getattr(self.progress, name) for name in COUNTERS},
            recent=tuple(self.progress.recent),
            validations=tuple(self.validator.history),
            best_by=self.validator.best_by,
            files=self._digests,
            orders=tuple(requests),
            parts=tuple(learnt),
            learner=dict(self.learning.counters()),
            generators={n: GeneratorState.model_validate(state) for n, state in states.items()},
        )
        document = checkpoint.describe(self.config, "last", state=state)
        tensors = checkpoint.join({**learnt, **weights})
        self._write_last(document, tensors)

    @property
    def rows(self) -> int:
        """Number of rows that the run has written: one for each episode and each validation."""
        return self.progress.episode + len(self.validator.history)

    def _write_last(self, document: Document, tensors: Mapping[str, torch.Tensor]) -> None:
        """Write ``last.safetensors``, and before it what it states of the clock."""
        self.companion.write(self.rows)
        checkpoint.write(self.directory / checkpoint.LAST, document, tensors)

    def _save_all(self, outstanding: Sequence[RolloutRequest]) -> None:
        """Write the last checkpoint, and the policy if it is the best so far or is to be kept.

        In this order, so that a killed run never leaves a best policy from after its last
        checkpoint; a resumed run writes a best policy that was not written before.
        """
        self.save(outstanding)
        # Only the policy that was validated just now can have become the best.
        last, best, learning = self.validator.last, self.validator.best, self.learning
        if last is None or last.decision != self.progress.decision:
            return
        numbered = Path(checkpoint.KEPT.format(last.decision))
        places = [numbered] if self.config.train.keep_policies else []
        places += [checkpoint.BEST] if last is best else []
        parts = {"policy": learning.policy.state_dict()}
        if learning.risk is not None:
            parts["risk"] = learning.risk.state_dict()
        document = checkpoint.describe(
            self.config, "best", decision=last.decision, validation=last.model_dump()
        )
        for place in places:
            checkpoint.write(self.directory / place, document, checkpoint.join(parts))

    def restore(self, saved: Checkpoint) -> None:
        """Restore the run from its last checkpoint."""
        state = saved.document.state
        if state is None:
            raise CheckpointError(f"{saved.path} holds a policy alone, not a run")
        # With changed files the rest of the run would be another training.
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

    def _restore(self, saved: Checkpoint, state: State) -> None:
        """Restore the learner, its generators, the outstanding requests and recorded episodes."""
        learning = self.learning
        learning.updates, learning.loss = state.updates, state.loss
        try:
            learning.restore({name: saved.part(name) for name in state.parts}, state.learner)
            for name, tensors in learning.tensors().items():  # all that it saves, and no more
                require_equal_layout(saved.part(name), tensors)
            for name, generator in self._training.generators.items():
                generator.bit_generator.state = state.generators[name].model_dump()
        except (ValueError, TypeError, LookupError, RuntimeError) as error:
            raise CheckpointError(f"{saved.path}: its state is not valid: {error}") from error
        # Weights of outstanding requests must fit the network that drives.
        expected = learning.driving.state_dict()
        weights = {}
        for version in {request.version for request in state.orders}:
            part = saved.part(f"weights{version}")
            try:
                require_equal_layout(part, expected)
            except ValueError as error:
                text = f"{saved.path}: its part weights{version} is not valid: {error}"
                raise CheckpointError(text) from error
            weights[version] = {name: tensor.numpy() for name, tensor in part.items()}
        self._outstanding = [
            RolloutRequest(**request.model_dump(), weights=weights[request.version])
            for request in state.orders
        ]
        self._recorder.restore(state.episode)

    def summary(self, finished: bool) -> dict[str, Any]:
        """Return the results of the run, as JSON types."""
        config, progress = self.config, self.progress
        # The best validation is that of the saved policy; the last one is where the run stands.
        validations = {"best": self.validator.best, "last": self.validator.last}
        return {
            "finished": finished,
            "terrain": config.terrain.title,
            "network": config.network.plugin_name,
            "seed": config.seed,
            "decisions": progress.decision,
            "episodes": progress.episode,
            "lost_episodes": progress.lost,
            "seconds": round(self.companion.seconds, 1),
            "success_rate": progress.success_rate,
            **{
                name: validation and with_both_names(validation.model_dump())
                for name, validation in validations.items()
            },
            "usage": self._usage and asdict(self._usage),
        }


class OwnLoop:
    """The run for a learner that plays its episodes itself, ``flipperctl.api.Loop``."""

    def __init__(self, trainer: Trainer, collector: Collector, stop: Stop) -> None:
        self._trainer, self._collector, self._stop = trainer, collector, stop
        self._before = trainer.progress.decision

    @property
    def decision(self) -> int:
        """Number of decisions of the run so far."""
        return self._trainer.progress.decision

    def begin_episode(self) -> tuple[int, float]:
        """Return seed and difficulty of the next episode."""
        difficulty = self._trainer.progress.difficulty
        return self._trainer.episodes.next_seed(), difficulty

    def count_decision(self) -> None:
        """Count a decision."""
        self._trainer.progress.decision += 1
        self._trainer.follow()

    def end_episode(self, ending: Mapping[str, Any]) -> None:
        """Take in the seed, the outcome and the metrics of an episode that has ended."""
        self._trainer.end_episode(dict(ending))

    def between_episodes(self) -> bool:
        """Validate and save what is due; return False if the run is to stop."""
        goes_on = self._trainer.validate_and_save(self._collector, self._before)
        self._before = self.decision
        return goes_on and not self._stop()
