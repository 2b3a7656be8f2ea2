"""The collector of workers: who plays the episodes of a validation, and what a stop ends."""

import pickle
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from flipperctl.agent.frames import input_size
from flipperctl.agent.plain import PlainNetworks
from flipperctl.agent.risk import policy_arrays, weights_of
from flipperctl.agent.translate import plain_networks
from flipperctl.api import Listener, Perception, Simulator, action_index
from flipperctl.config import to_dict
from flipperctl.env.flipper_env import FlipperEnv
from flipperctl.rollout import collect
from flipperctl.rollout.collect import (
    Actor,
    AsyncCollector,
    GreedyPlayer,
    RolloutWorkers,
    Stopwatch,
    Usage,
)
from flipperctl.rollout.episode import RolloutRequest, steps
from flipperctl.rollout.pool import WorkerDiedError
from flipperctl.training.trainer import Trainer
from tests.rollout.calls import torch_is_imported
from tests.short import few, short_config, trainer


class Workers:
    """Workers whose first ``begun`` episodes are under way."""

    capacity = 1
    outstanding = close = usage = None

    def __init__(self, begun: int) -> None:
        self.begun = begun
        self.futures: list[Future[Any]] = []

    def evaluate(self, weights: object, seeds: Sequence[int]) -> list[Future[Any]]:
        self.futures = [Future() for _ in seeds]
        for future in self.futures[: self.begun]:
            future.set_running_or_notify_cancel()
        return self.futures


def collector(workers: Any, stop: Any = lambda: False) -> AsyncCollector:
    return AsyncCollector(workers, lambda: None, lambda _: None, lambda _: True, stop)  # type: ignore[arg-type, return-value]


def row(seed: int) -> dict[str, int]:
    return {"seed": seed}


def test_the_learner_plays_what_no_worker_has_begun_and_the_order_is_that_of_the_seeds() -> None:
    workers = Workers(begun=2)
    played: list[int] = []

    def play_here(seed: int) -> dict[str, int]:
        played.append(seed)
        if seed == 3:  # the last but one: meanwhile the workers end theirs, and one dies
            workers.futures[0].set_result(row(10))
            workers.futures[1].set_exception(WorkerDiedError("died"))
        return row(seed)

    rows = collector(workers).evaluate({}, [10, 20, 3, 40], play_here)
    assert rows == [row(10), row(20), row(3), row(40)]
    assert played == [40, 3, 20]  # from the last, then that of the worker that died


def test_a_stop_ends_an_evaluation_that_waits_for_a_worker() -> None:
    workers = Workers(begun=1)
    played: list[int] = []
    stopped = collector(workers, lambda: len(played) == 2)

    def play_here(seed: int) -> dict[str, int]:
        played.append(seed)
        return row(seed)

    assert stopped.evaluate({}, [1, 2, 3, 4, 5], play_here) is None
    assert played == [5, 4]
    assert [future.cancelled() for future in workers.futures[1:]] == [True] * 4


def test_a_worker_measures_how_long_it_waits_between_its_calls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [10.0]
    watch = Stopwatch()
    monkeypatch.setattr(collect.time, "perf_counter", lambda: now[0])
    for begun, ended in ((20.0, 22.0), (25.0, 26.0)):
        now[0] = begun
        with watch.call():
            now[0] = ended
    assert (watch.waited, watch.elapsed) == (3.0, 6.0)


class Alternating:
    """Explores at every other decision."""

    def __init__(self) -> None:
        self.explored = True

    def reset(self, simulator: Simulator) -> None:
        pass

    def act(self, p: Perception) -> int:
        self.explored = not self.explored
        return action_index(0, 0)


def test_steps_say_which_actions_were_random() -> None:
    made = islice(steps(FlipperEnv("flat"), Alternating(), 1), 4)
    assert [step.explored for step in made] == [False, True, False, True]


def plain_of(run: Trainer) -> PlainNetworks:
    config = run.config
    layout = config.perception.layout
    plain = plain_networks(config.agent, run.learning, config.network, layout)
    assert plain is not None
    return plain


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
def test_a_worker_that_only_drives_imports_no_torch(count: int, tmp_path: Path) -> None:
    run = trainer(few(), tmp_path)
    weights = weights_of(run.learning.driving)
    with closing(RolloutWorkers(count, run.config, None, plain_of(run))) as workers:
        workers.send(RolloutRequest(0, 5, 300, 1, weights))
        taken = workers.take(lambda: False)
        assert taken is not None
        assert not workers._pool.submit(torch_is_imported).result()
    # Torch in this process plays the same episode.
    expected = Actor(to_dict(run.config)).play(taken[0], weights)
    assert taken[1] is not None
    assert [step.action for step in taken[1]] == [step.action for step in expected]
    assert all(
        np.array_equal(a.next_observation, b.next_observation) and a.reward == b.reward
        for a, b in zip(taken[1], expected, strict=True)
    )


@pytest.mark.slow
@pytest.mark.parametrize("by", ["numpy", "torch"])
@pytest.mark.parametrize("network", ["at_d3qn", "stacked"])
def test_it_does_not_matter_which_process_plays_a_validation(
    network: str, by: str, tmp_path: Path
) -> None:
    config = short_config(network={"name": network}, **{"agent.risk": True})
    run = trainer(config, tmp_path)
    before = torch.random.get_rng_state()
    plain = plain_of(run) if by == "numpy" else None
    here = GreedyPlayer(config, run.validator._greedy._env, plain)
    there = Actor(to_dict(config), None, pickle.loads(pickle.dumps(plain)))
    assert torch.equal(torch.random.get_rng_state(), before)  # it draws none of the training's
    weights = policy_arrays(run.learning.policy, run.learning.risk)
    here.load(weights)
    rows = [here.play(3), there.evaluate(weights, 3)]
    assert rows[0] == rows[1]
    if by == "numpy":  # and torch plays the same but for rounded risks
        run.validator._greedy.load(weights)
        played = run.validator._greedy.play(3)
        assert {k: v for k, v in rows[0].items() if v != played[k]}.keys() <= {"risks"}
    draws = torch.Generator().manual_seed(0)
    size = input_size(config.network, config.perception.layout)
    rows_in = torch.randn(200, size, generator=draws).numpy()
    ours, theirs = (
        [n.outputs(row) for row in rows_in] for n in (here.network, there._greedy.network)
    )
    assert ours == theirs


@pytest.mark.parametrize(
    ("usage", "enough", "words"),
    [
        (Usage(8, 0.02, 0.85), 2, ["more workers cannot help", "; 2 is enough"]),
        (Usage(1, 0.05, 0.7), 1, ["several trainings side by side can"]),
        (Usage(4, 0.6, 0.03), 4, ["more workers would help"]),
        (Usage(4, 0.3, 0.3), 3, []),  # requests that lag, say
    ],
)
def test_what_would_help_follows_from_who_waits(
    usage: Usage, enough: int, words: list[str]
) -> None:
    assert usage.enough == enough
    assert bool(usage.advice()) is bool(words)
    assert all(word in usage.advice() for word in words)
    assert ("enough" in usage.advice()) is (enough < usage.workers and usage.learner_idle < 0.15)


def test_a_training_says_how_busy_its_workers_were(tmp_path: Path) -> None:
    notes: list[str] = []

    class Notes(Listener):
        def note(self, text: str) -> None:
            notes.append(text)

    config = few(**{"train.mode": "fast", "train.workers": 3})
    training = trainer(config, tmp_path)
    training.listeners.append(Notes())
    usage = training.run()["usage"]
    assert usage["workers"] == 3
    assert 0 <= usage["learner_idle"] <= 1 >= usage["workers_idle"] >= 0
    assert sum("would play as much" in note for note in notes) <= 1
