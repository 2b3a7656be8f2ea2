"""The parts of a card that its results make; ``tests/cli/test_card.py`` has the whole."""

from flipperctl.evaluation.views.card import MEASURES, StoredRow, limits, results

ENDS = (1.25, 1.0, 1.5)
RISK = {"horizon": 10, "threshold": 0.25, "failures": 3, "announced": 2, "reached": 97}
POLICY: StoredRow = {
    "terrain": "stair",
    "conditions": "nominal",
    "hash": "01234567",
    "engine": "planar",
    "seed": 7,
    "method": "mine",
    "is_policy": True,
    "episodes": 100,
    "outcomes": {"reached": 97, "overturned": 1, "stuck": 2, "timeout": 0},
    "success": (0.97, 0.915, 0.99),
    "measures": dict.fromkeys(MEASURES, ENDS),
    "difference": None,
}
LEVEL = POLICY | {"method": "level", "is_policy": False, "difference": (0.2, 0.1, 0.3)}
OKADA = POLICY | {"method": "okada", "is_policy": False, "difference": (-0.2, -0.3, -0.1)}
PASSABLE = {"passable": {"episodes": 98, "reached": 97, "references": ["mine", "planner"]}}
ROWS = (POLICY | {"risk": {**RISK, "false_alarms": 9, "false_warnings": 0.004}}, LEVEL, OKADA)


def test_results_and_limits_are_those_of_the_rows() -> None:
    text = "\n".join(results(ROWS))
    first = "| `stair` | nominal 01234567 | `mine` | 100 | 97 | 0.970 [0.915, 0.990] | 1.25 [1.00"
    assert first in text
    assert "| `stair` | nominal 01234567 | `okada` | -0.20 [-0.30, -0.10] |" in text
    assert "of passable" not in text
    text = "\n".join(results((POLICY | PASSABLE, LEVEL)))
    assert "the episodes that one of these crosses: mine, planner." in text
    assert "| 1 [1, 2] | 97 of 98 |" in text
    assert "| 1 [1, 2] | – |" in text
    assert "None yet:" in "\n".join(results(()))
    text = "\n".join(limits(ROWS))
    assert "- `stair` (01234567): 3 of 100 not reached: 1 overturned, 2 stuck." in text
    assert "a larger θ̂_R than `level`, by 0.20 [0.10, 0.30] rad." in text
    assert "a larger θ̂_R than `okada`" not in text
    assert (
        "- Its risk on `stair` (01234567): warned 3 or more decisions before 2 of 3 failures; "
        "false alarms in 9 of 97 successes (risk of 0.25 or more within 10 decisions)."
    ) in text
