"""Decisions per second of each collector."""

import pytest

from flipperctl.bench import scaling
from flipperctl.config import TrainConfig
from flipperctl.errors import MissingExtraError
from tests.bench.small import check, check_ratio, small_bench


class Counting:
    """A collector that counts decisions without playing them."""

    def __init__(self, config: object, workers: int) -> None:
        self.collected = self.closed = 0

    def collect(self, decisions: int) -> int:
        self.collected += decisions
        return decisions

    def close(self) -> None:
        self.closed += 1


def test_the_reference_plays_what_is_asked() -> None:
    # tests/rollout/test_ray.py plays on a cluster; a lone worker would import torch anew.
    bench, counts = small_bench(), {"in_process": (1,), "processes": (2,)}
    made = scaling.factories(bench.config, (1, 2))
    found = {name: (made[name][0], workers) for name, workers in counts.items()}
    check(scaling.measure(bench, found))


def test_what_a_teacher_labels_is_collected_by_workers_alone() -> None:
    config = TrainConfig(terrain="step", network="at_d3qn", teacher={"controller": "okada"})
    found = scaling.factories(config, (1, 8))
    assert {name: counts for name, (_, counts) in found.items()} == {
        "processes": (1, 8),
        "ray": (1, 8),
    }


def test_drawn_actions_are_not_compared_with_an_exploring_policy() -> None:
    agent = {"learner": "policy_gradient", "n_step": 1}
    config = TrainConfig(terrain="step", network="mlp", agent=agent)
    assert "in_process" not in scaling.factories(config, (1, 2))


def test_every_collector_is_measured_and_closed() -> None:
    made: list[Counting] = []

    def factory(config: object, workers: int) -> Counting:
        made.append(Counting(config, workers))
        return made[-1]

    def absent(config: object, workers: int) -> Counting:
        raise MissingExtraError("ray is not installed; install flipperctl[ray]")

    bench = small_bench(repeats=3)
    found = scaling.measure(bench, {"processes": (factory, (1, 2)), "ray": (absent, (1,))})
    check(found)
    check_ratio(found, "processes.2 / processes.1", "processes.2", "processes.1")
    assert found["missing"] == ["ray is not installed; install flipperctl[ray]"]
    wanted = bench.settings.decisions * (bench.settings.repeats + 1)  # once to warm up
    assert [(c.collected, c.closed) for c in made] == [(wanted, 1), (2 * wanted, 1)]


@pytest.mark.parametrize(
    ("cores", "counts"), [(1, (1,)), (2, (1, 2)), (6, (1, 2, 4, 6)), (8, (1, 2, 4, 8))]
)
def test_the_numbers_of_workers(cores: int, counts: tuple[int, ...]) -> None:
    assert scaling.worker_counts(cores) == counts
