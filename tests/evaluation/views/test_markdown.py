"""Markdown tables of stored results."""

import pytest

from flipperctl.errors import RequestError
from flipperctl.evaluation.views.markdown import markdown_table
from tests.evaluation.views.test_card import LEVEL, OKADA, POLICY

ROWS = [POLICY, LEVEL, OKADA]


def test_a_row_for_each_method() -> None:
    assert markdown_table(ROWS, ["method", "stuck", "swing", "time+"]) == [
        "| policy | stuck | θ̂_R [rad] | t_cost [s] |",
        "|---|---|---|---|",
        "| `mine` | 2 | 1.25 | 1.2 [1.0, 1.5] |",
        "| `level` | 2 | 1.25 | 1.2 [1.0, 1.5] |",
        "| `okada` | 2 | 1.25 | 1.2 [1.0, 1.5] |",
    ]


def test_a_row_for_each_scene_with_its_baselines_in_columns() -> None:
    found = markdown_table(ROWS, ["terrain", "reached", "reached:okada", "difference:level"])
    assert found == [
        "| terrain | reached | `okada`: reached | θ̂_R minus `level`'s |",
        "|---|---|---|---|",
        "| `stair` | 97 | 97 | 0.20 [0.10, 0.30] |",
    ]


@pytest.mark.parametrize(
    ("column", "words"), [("swinge", "did you mean 'swing'"), ("swing:mpc", "known: mine, level")]
)
def test_columns_that_are_refused(column: str, words: str) -> None:
    with pytest.raises(RequestError, match=words):
        markdown_table(ROWS, [column])
