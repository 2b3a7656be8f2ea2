"""Policy files: what is written reads back, and anything else is refused."""

from pathlib import Path

import pytest

from flipperctl.config import policy_file
from flipperctl.config.policy_file import PolicyFile, Score, Tuning
from flipperctl.errors import CheckpointError, ConfigError
from flipperctl.policies.source import load_policy
from flipperctl.requests.compose import compose_train, only_one
from flipperctl.requests.text import from_words

FOUND = PolicyFile(
    controller="okada",
    settings={"near": 0.12345678, "far": 0.6, "rear_gain": -0.5, "margin": None},
    tuning=Tuning(
        words=["terrain=stair"],
        objective="pitch",
        seed=0,
        budget=1000,
        before=Score(mean=1.3, low=1.2, high=1.4),
        after=Score(mean=1.1),
        difference=Score(mean=-0.2),
        version="0.2.0",
    ),
)


def test_a_file_reads_back_and_is_a_policy_of_its_name(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(FOUND.text())
    assert policy_file.read(str(file)) == FOUND
    source = load_policy(file)
    assert (source.label(), source.controller_name) == (str(file), "okada")
    assert source.settings == {"name": "okada", **FOUND.settings}
    assert load_policy(file, takes="controller", fields={"far": 1.0}).settings == {
        **source.settings,
        "far": 1.0,
    }


def test_a_file_teaches(tmp_path: Path) -> None:
    (file := tmp_path / "mine.yaml").write_text(FOUND.text())
    words = [f"teacher={file}", "teacher.controller.far=0.9"]
    teacher = only_one(compose_train(from_words(words))).teacher.controller
    assert (teacher.plugin_name, teacher.near, teacher.far) == ("okada", 0.12345678, 0.9)


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("rear_gain", "rear_gian", r"mine.yaml: settings.rear_gian: .* mean 'rear_gain'"),
        ("far: 0.6", "far: 6", r"mine.yaml: settings.far: 6 is not allowed .*≤ 3"),
        ("far: 0.6", "far: 0.1", r"mine.yaml: settings: near=0.123457 must be below far=0.1"),
        ("okada", "okda", r"settings: there is no controller plugin 'okda' .did you mean 'okada'"),
        ("seed: 0", "seed: -1", r"mine.yaml.tuning.seed: -1 is not allowed .*≥ 0"),
        ("  seed: 0\n", "", r"mine.yaml.tuning.seed: Field required"),
        ("tuning:", "more: 1\ntuning:", r"mine.yaml.more: there is no such key"),
        ("format: flipperctl policy 1", "a: 1", r"mine.yaml: a policy file of flipperctl tune is"),
        ("controller: okada", "controller: [", r"mine.yaml, line \d: no YAML"),
    ],
)
def test_what_no_search_wrote_is_refused(tmp_path: Path, old: str, new: str, error: str) -> None:
    (file := tmp_path / "mine.yaml").write_text(FOUND.text().replace(old, new, 1))
    with pytest.raises(ConfigError, match=error):
        load_policy(file)
    with pytest.raises(CheckpointError, match=r"greedy.policy: .* sets a controller; a trained"):
        load_policy(file, "greedy.policy", "file")
    with pytest.raises(ConfigError, match=r"absent.yaml cannot be read: No such file"):
        load_policy("absent.yaml")
