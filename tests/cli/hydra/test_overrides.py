"""Overrides that compose nothing are read as Hydra reads all others."""

import pytest

from flipperctl.cli.hydra.overrides import Overrides
from flipperctl.errors import ConfigError


def test_values_have_the_types_that_hydra_gives_them() -> None:
    given = ["train.decisions=500", "device='cuda:0'", "batch_sizes=[1,2]", "x=1e-3", "y=null"]
    assert Overrides.parse(given).values() == {
        "train.decisions": 500,
        "device": "cuda:0",
        "batch_sizes": [1, 2],
        "x": 1e-3,
        "y": None,
    }


@pytest.mark.parametrize(
    "override", ["seed=1,2", "+seed=1", "++seed=1", "~seed", "x=interval(0,1)"]
)
def test_only_plain_values_are_allowed(override: str) -> None:
    with pytest.raises(ConfigError, match="one value is allowed here"):
        Overrides.parse([override]).values()
