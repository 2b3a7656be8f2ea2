"""What differs between the trainings of one method, in a sentence."""

import pytest

from flipperctl.policies.identity import unlike_trainings


@pytest.mark.parametrize(
    ("one", "other", "told"),
    [
        ({"rewards": {"a": {"name": "a"}}}, {"rewards": {}}, "rewards.a ({'name': 'a'}, none)"),
        ({"rewards": {"a": {"n": 1}}}, {"rewards": {"a": {"n": 1, "new": 2}}}, ""),
        ({"teacher": {"episodes": "a"}}, {"teacher": {"episodes": "b"}}, ""),
        ({"t": {"p": [{"n": 1}, {"n": 2}]}}, {"t": {"p": [{"n": 1}, {"n": 3}]}}, "t.p[1].n (2, 3)"),
        ({"t": {"p": [1]}}, {"t": {"p": [1] * 50}}, f"t.p ([1], {str([1] * 50)[:40]}…)"),
        (dict.fromkeys("abcde", 1), dict.fromkeys("abcde", 2), "c (1, 2) and 2 more"),
    ],
)
def test_what_differs_between_trainings_fits_a_line(one: dict, other: dict, told: str) -> None:
    found = unlike_trainings([one, other])
    assert told in found
    assert bool(found) == bool(told)
    assert unlike_trainings([one, one]) == ""
