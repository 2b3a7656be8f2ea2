"""``flipperctl card``, and the parts of a card that its results make."""

import json
from pathlib import Path

import pytest
import yaml

from flipperctl.text.files import check_output
from flipperctl.views.card import CARD, MEASURES, StoredRow, limits, results
from tests.cli.call import call

EVAL = ("eval", "generalist", "--baseline", "level", "terrain=flat")


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"interrupted": True}, "was interrupted; eval with the same words and --output goes on"),
        (
            {"failed": [{"controller": "okada", "terrain": "step", "error": "no"}]},
            "okada failed on step",
        ),
    ],
)
def test_a_card_has_all_results_or_none(
    part: dict[str, object], words: str, tmp_path: Path
) -> None:
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / "summary.json").write_text(json.dumps({"scenes": [], **part}))
    done = call("card", "generalist", "found", cwd=tmp_path)
    assert (done.code, done.out) == (2, "")
    assert words in done.err


def test_a_card_from_results_with_the_commands_that_make_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ("perception.noise=0.01", "--episodes", "1", "--output", "found")
    passable = ("--passable", "generalist,level")
    monkeypatch.setattr("sys.argv", ["flipperctl", *EVAL, *passable, *asked])
    assert call(*EVAL, *passable, *asked, cwd=tmp_path).code == 0
    done = call("card", "generalist", "found", "--output", "card.md", cwd=tmp_path)
    check_output(tmp_path / "card.md", CARD)  # a card of before is replaced
    assert done.code == 0, done.err
    assert done.out == ""
    text = (tmp_path / "card.md").read_text()
    (model,) = yaml.safe_load(text.split("---\n")[1])["model-index"]
    assert model["results"][0]["metrics"][0]["value"] == 1.0
    assert f"\nflipperctl {' '.join((*EVAL, *passable, *asked))}\n" in text
    assert '| `agent` | "policy_gradient" |' in text
    assert "| flipper energy [J] | of passable |" in text
    assert "| 1 of 1 |" in text
    assert "| terrain | conditions | policy |" in text  # of which one table may have several

    # The folder remembers which weights they were.
    other = call("eval", "mpc_value", *asked[:3], "--baseline", "none",
                 "terrain=flat", "--output", "other", cwd=tmp_path)  # fmt: skip
    assert other.code == 0, other.err
    for name in (
        "summary.json",
        *(f"cells/{f.name}" for f in (tmp_path / "other/cells").iterdir()),
    ):
        file = tmp_path / "other" / name
        file.write_text(file.read_text().replace("mpc_value", "generalist"))
    done = call("card", "generalist", "other", cwd=tmp_path)
    assert done.code == 2, done.out
    assert "other: generalist had other weights there than" in done.err

    done = call("card", "mpc_value", "found", cwd=tmp_path)
    assert done.code == 2
    assert "found: it holds results of generalist, not of" in done.err


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
