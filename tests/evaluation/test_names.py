"""Short names of methods."""

import pytest

from flipperctl.evaluation.names import names


@pytest.mark.parametrize(
    ("labels", "short"),
    [
        (("runs/cmp/network=at_d3qn", "runs/cmp/network=mlp", "level"),
         ("at_d3qn", "mlp", "level")),
        (("s/network=mlp,agent.gamma=0.9", "s/network=mlp,agent.gamma=1"),
         ("mlp, gamma=0.9", "mlp, gamma=1")),
        (("s/0_network=mlp,seed=1", "s/1_network=conv,seed=1"), ("mlp", "conv")),
        (("s/0_network=mlp,seed=1", "s/1_network=mlp,seed=2"), ("mlp, seed=1", "mlp, seed=2")),
        (("s/0_seed=1",), ("seed=1",)),
        (("runs/first/checkpoints/best.safetensors", "b.onnx"), ("first", "b.onnx")),
        (("a/run", "b/run"), ("a/run", "b/run")),
        (("runs/1/best", "runs/1/last"), ("best", "last")),
    ],
)  # fmt: skip
def test_the_last_parts_that_differ(labels: tuple[str, ...], short: tuple[str, ...]) -> None:
    assert tuple(names(labels).values()) == short
