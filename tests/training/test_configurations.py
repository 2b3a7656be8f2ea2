"""Random configurations over every section: each trains 60 decisions or is refused by name."""

import tempfile
from datetime import timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from tests.configurations import Overrides, attempt, left_out, overrides

pytestmark = pytest.mark.slow


@pytest.mark.long
@pytest.mark.filterwarnings("ignore", "error::RuntimeWarning")  # numpy's of overflows
def test_a_configuration_trains_or_is_refused_by_name() -> None:
    @settings(
        max_examples=60,
        phases=[Phase.generate],  # a smaller case of a fault takes minutes to find
        derandomize=True,
        database=None,
        deadline=timedelta(minutes=1),
        suppress_health_check=list(HealthCheck),
    )
    @given(drawn=overrides())
    def draw(drawn: Overrides) -> None:
        with tempfile.TemporaryDirectory() as folder:
            attempt(drawn, Path(folder) / "run")

    draw()


def test_settings_of_every_type_are_drawn() -> None:
    assert left_out() == []
