"""Ranges of sampled settings: their combinations are validated once for equal sections."""

from typing import Any

import pytest

from flipperctl.api import Robot
from flipperctl.config import EnvConfig, sampled
from flipperctl.config.randomise import Randomise
from flipperctl.errors import ConfigError


def test_equal_ranges_of_an_equal_robot_are_validated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    validated = []
    build = sampled._with_values

    def counted(*given: Any) -> Any:
        validated.append(given)
        return build(*given)

    monkeypatch.setattr(sampled, "_with_values", counted)
    monkeypatch.setattr(sampled, "_possible", type(sampled._possible)(maxlen=8))
    sections = {**EnvConfig(terrain="flat")._sampled_sections}

    def check(robot: Robot, **ranges: Any) -> int:
        """Return how many combinations are validated."""
        validated.clear()
        nothing = dict.fromkeys(("friction", "track_speed"))
        sampled.check_ranges({**sections, "robot": robot}, Randomise(**{**nothing, **ranges}))
        return len(validated)

    masses = {"chassis_mass": (21.0, 27.0), "flipper_mass": (2.5, 3.5)}
    assert check(Robot(), **masses) == 4
    assert check(Robot(), **masses) == 0
    assert check(Robot(), **{**masses, "flipper_mass": (2.5, 3.6)}) == 4
    assert check(Robot(chassis_mass=25.0), **masses) == 4
    for _ in range(2):  # what is refused is refused again
        with pytest.raises(ConfigError, match=r"^randomise\.track_radius"):
            check(Robot(), track_radius=(0.05, 0.5))
