"""Updates of the learner."""

from flipperctl.bench import learner
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
