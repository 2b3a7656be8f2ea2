"""``flipperctl card``."""

import json
from pathlib import Path

import pytest
import yaml

from flipperctl.config import TrainConfig
from flipperctl.evaluation.views.card import CARD, _changed
from flipperctl.files import check_output
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


def test_a_card_from_results_with_the_commands_that_make_them(tmp_path: Path) -> None:
    asked = ("perception.noise=0.01", "--episodes", "1", "--output", "found")
    passable = ("--passable", "generalist,level")
    assert call(*EVAL, *passable, *asked, cwd=tmp_path).code == 0
    done = call("card", "generalist", "found", "--output", "card.md", cwd=tmp_path)
    check_output(tmp_path / "card.md", CARD)  # a card of before is replaced
    assert done.code == 0, done.err
    assert done.out == ""
    text = (tmp_path / "card.md").read_text()
    (model,) = yaml.safe_load(text.split("---\n")[1])["model-index"]
    assert model["results"][0]["metrics"][0]["value"] == 1.0
    command = (
        "flipperctl eval generalist --episodes 1 --seed 0 --baseline level "
        "--passable generalist,level conditions=nominal perception.noise=0.01 terrain=flat\n"
    )
    assert command in text  # without the note that the hash differs
    assert '| `agent.learner` | "policy_gradient" |' in text
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


def test_a_training_at_its_defaults_changes_nothing() -> None:
    assert _changed(TrainConfig(terrain="step", network="mlp")) == {}
