"""Budgets that end before the policy changes for the first time."""

from typing import Any

import pytest

from flipperctl.config.defaults import notes_on_budget
from tests.short import short_config

GRADIENT = {
    "agent.learner": "policy_gradient",
    "agent.n_step": 1,
    "agent.policy_gradient.decisions": 100,
    "agent.policy_gradient.warm_up": 2,
}
OKADA = {"teacher.controller": {"name": "okada"}, "teacher.td_weight": 0.0}


@pytest.mark.parametrize(
    ("settings", "decisions", "words"),
    [
        ({"agent.learning_starts": 500}, 499, "after agent.learning_starts=500 decisions"),
        ({"agent.learning_starts": 500}, 500, ""),
        ({"agent.learning_starts": 500, "teacher.final_updates": 5, **OKADA}, 499, ""),
        (GRADIENT, 299, "it learns from 300 decisions on"),
        (GRADIENT, 300, ""),
    ],
)
def test_a_training_that_learns_nothing_is_told(
    settings: dict[str, Any], decisions: int, words: str
) -> None:
    notes = list(notes_on_budget(short_config(**{**settings, "train.decisions": decisions})))
    assert len(notes) == bool(words)
    assert all(words in note and f"train.decisions={decisions} " in note for note in notes)
