"""A few clouds with invalid points; ``python -m tests.long.clouds`` runs hundreds."""

from flipperctl import plugins
from tests.long.clouds import run


def test_points_that_no_ray_measured_change_no_profile() -> None:
    plugins.load()
    assert list(run(12, seed=0)) == []
