"""The draws of a policy that warns."""

import math

import numpy as np
import pytest

from flipperctl.core.risk import Escape, EscapeRule

VALUES = [0.0, 0.1, -math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_actions_are_drawn_from_the_warning_on_for_as_many_decisions() -> None:
    escape = Escape(EscapeRule(0.1, 3))
    warnings = [False, True, False, False, False, True, True, False, False, False]
    due = [escape.due(warns=warns) for warns in warnings]
    assert due == [False, True, True, True, False, True, True, True, True, False]


def test_the_probabilities_follow_the_values() -> None:
    escape = Escape(EscapeRule(0.1, 1))
    counts = np.bincount([escape.draw(VALUES) for _ in range(8000)], minlength=9)
    weights = np.exp(np.array(VALUES) / 0.1)
    assert counts / 8000 == pytest.approx(weights / weights.sum(), abs=0.02)
    assert counts[2] == 0


def test_equal_episodes_have_equal_draws() -> None:
    escape = Escape(EscapeRule(1.0, 4))
    first = [escape.draw(VALUES) for _ in range(50)]
    escape.reset()
    assert [escape.draw(VALUES) for _ in range(50)] == first
    assert len(set(first)) > 3


def test_a_reset_ends_an_escape() -> None:
    escape = Escape(EscapeRule(1.0, 4))
    assert escape.due(warns=True)
    escape.reset()
    assert not escape.due(warns=False)
