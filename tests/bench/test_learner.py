"""Updates of the learner."""

from dataclasses import replace

import pytest

from flipperctl.bench import learner
from flipperctl.config import with_overrides
from flipperctl.errors import RequestError
from tests.bench.small import check, small_bench


def test_updates_and_transitions_of_each_batch_size() -> None:
    found = learner.measure(small_bench(batch_sizes=(16, 32)))
    check(found)
    for size in (16, 32):
        updates, moved = (
            found["quantities"][f"flipperctl.{what}.{size}"]["values"]
            for what in ("updates", "transitions")
        )
        assert moved == [size * rate for rate in updates]
    assert list(found["weights"]) == ["flipperctl"]


def test_the_updates_of_a_policy_gradient_are_not_those_timed() -> None:
    bench = small_bench()
    drawing = with_overrides(bench.config, {"agent.learner": "policy_gradient", "agent.n_step": 1})
    with pytest.raises(RequestError, match=r"learner: agent.learner=policy_gradient has updates"):
        learner.measure(replace(bench, config=drawing))
