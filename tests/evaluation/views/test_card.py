"""A policy's card: its front matter, its tables and its limits."""

from dataclasses import replace

import yaml

from flipperctl.evaluation.views.card import CardFacts, card_text
from flipperctl.evaluation.views.markdown import MEASURES, StoredRow

ENDS = (1.25, 1.0, 1.5)
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
FACTS = CardFacts(
    name="mine",
    content="ab" * 32,
    version="0.3.0",
    network="at_d3qn",
    terrain="stair",
    seed=1,
    decisions=60_000,
    seconds=61.4,
    robot="chassis 0.76 m",
    training="flipperctl train terrain=stair",
    settings={"agent.gamma": "0.98"},
    rows=(POLICY, LEVEL, OKADA),
    commands=("flipperctl eval --checkpoint mine terrain=stair",),
)


def test_the_front_matter_is_a_model_index_of_the_policy_alone() -> None:
    empty, front, _ = card_text(FACTS).split("---\n", 2)
    assert empty == ""
    head = yaml.safe_load(front)
    assert set(head) == {"library_name", "tags", "model-index"}
    (model,) = head["model-index"]
    assert model["name"] == "mine"
    (result,) = model["results"]
    # The keys that huggingface_hub reads and requires.
    assert set(result) == {"task", "dataset", "metrics"}
    assert set(result["task"]) == {"type", "name"}
    assert result["dataset"] == {
        "name": "stair, conditions nominal 01234567",
        "type": "flipperctl/stair",
        "args": {"episodes": 100, "seed": 7, "engine": "planar"},
    }
    assert result["metrics"][0] == {"type": "success_rate", "value": 0.97, "name": "success rate"}
    assert all({"type", "value"} <= set(metric) for metric in result["metrics"])


def test_the_text_has_training_results_limits_and_commands() -> None:
    text = card_text(FACTS)
    assert "seed 1, 60,000 decisions in 61 s, with flipperctl 0.3.0." in text
    assert "| `agent.gamma` | 0.98 |" in text
    assert (
        "| `stair` | nominal 01234567 | `mine` | 100 | 97 | 0.970 [0.915, 0.990] | 1.25 [1.0"
        in text
    )
    assert "| `stair` | nominal 01234567 | `okada` | -0.20 [-0.30, -0.10] |" in text
    assert "- `stair` (01234567): 3 of 100 not reached: 1 overturned, 2 stuck." in text
    assert "a larger θ̂_R than `level`, by 0.20 [0.10, 0.30] rad." in text
    assert "a larger θ̂_R than `okada`" not in text
    assert text.rstrip().endswith("flipperctl eval --checkpoint mine terrain=stair\n```")


def test_a_card_without_results_says_so() -> None:
    text = card_text(replace(FACTS, rows=(), commands=(), training=None, seconds=None))
    assert "model-index" not in text
    assert "None yet:" in text
    assert "seed 1, 60,000 decisions, with" in text
