"""Records of failures, and episodes that are played again from them."""

import json
from pathlib import Path

import pytest

from flipperctl import checkpoint
from flipperctl.commands.live import _failures
from flipperctl.config import EvalConfig
from flipperctl.errors import CheckpointError, RequestError
from flipperctl.evaluation.evaluate import evaluate
from flipperctl.evaluation.plan import Entry, Plan
from flipperctl.evaluation.replay import EpisodeRecord, read_record, replay
from flipperctl.evaluation.rows import DIGEST
from flipperctl.live.lanes import Lane
from flipperctl.policies.source import PolicySource, load_policy
from flipperctl.requests import evaluation
from flipperctl.requests.evaluation import failure_records

LEVEL = load_policy("level", "here")
STEP = EvalConfig(
    terrain={"name": "step", "height": 0.4},
    randomise={"sim": {"friction": [0.8, 1.0]}},
    conditions="varied",
    eval={"episodes": 3, "seed": 4},
)
"""Flippers held level stop at it."""


def write_failures(folder: Path, *scenes: tuple[EvalConfig, PolicySource]) -> int:
    result = evaluate(Plan.of_one([Entry(*scene) for scene in scenes]))
    records = list(failure_records(result))
    for name, record in records:
        (folder / name).write_text(json.dumps(record.model_dump(mode="json")))
    return len(records)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("failures")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "MOST_FAILURES", 2)
        assert write_failures(folder, (STEP, LEVEL)) == 2
    return folder


def changed(folder: Path, **fields: object) -> Path:
    """Return the file of a record with other fields."""
    record = json.loads((folder / "failure_step_0.json").read_text())
    file = folder / "changed.json"
    file.write_text(json.dumps(record | fields))
    return file


def test_a_replay_is_bit_identical_and_another_episode_is_not(folder: Path) -> None:
    found = replay(folder / "failure_step_1.json")
    assert found.differences == []
    assert found.episode["outcome"] == found.record.outcome == "stuck"
    assert found.episode[DIGEST] == found.record.digest
    assert len(found.transitions) == found.episode["decisions"]
    other = read_record(folder / "failure_step_0.json")
    assert other.digest != found.record.digest
    differs = replay(changed(folder, digest=found.record.digest, outcome="reached"))
    assert [words.split()[0] for words in differs.differences] == ["outcome", "digest"]


def test_a_record_without_a_digest_compares_every_measure(folder: Path) -> None:
    recorded = read_record(folder / "failure_step_0.json").measures
    larger = {**recorded, "max_pitch": recorded["max_pitch"] * (1 + 2**-52)}
    (difference,) = replay(changed(folder, digest=None, measures=larger)).differences
    assert difference.startswith("max_pitch ")


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"versions": {"flipperctl": "0.1.0"}}, "recorded with flipperctl 0.1.0; here is"),
        (  # another version's policies and settings are not looked for
            {"versions": {"flipperctl": "0.1.0"}, "config": {"terrain": "moon"}},
            "recorded with flipperctl 0.1.0; here is",
        ),
        ({"format": 2}, "its format is 2, of another version .*; this one reads 1"),
        ({"conditions": {"name": "varied", "hash": "0"}}, "its conditions have the hash 0, here"),
        ({"config": {"terrain": "moon"}}, "its configuration is not valid here: terrain"),
    ],
)
def test_records_that_cannot_be_played_here(
    fields: dict[str, object], words: str, folder: Path
) -> None:
    with pytest.raises(RequestError, match=words):
        replay(changed(folder, **fields))


def test_the_policy_of_a_record_is_found_by_its_content(folder: Path, tmp_path: Path) -> None:
    generalist = checkpoint.shipped_policies()["generalist"]
    source = PolicySource(checkpoint=generalist)
    episode = evaluate(Plan.of_one([Entry(STEP, LEVEL)])).played[0].episodes[0]
    policy = EpisodeRecord.of(STEP, source, episode).policy
    assert policy.find(tmp_path, None) == source
    copy = tmp_path / "copy.safetensors"
    copy.write_bytes(generalist.read_bytes())
    assert policy.find(tmp_path, copy) == PolicySource(checkpoint=copy)
    copy.write_bytes(b"another")
    with pytest.raises(CheckpointError, match="its policy has the SHA-256"):
        policy.find(tmp_path, copy)
    gone = policy.model_copy(update={"label": "gone.safetensors"})
    with pytest.raises(CheckpointError, match=r"its policy is missing.*with --checkpoint"):
        gone.find(tmp_path, None)


def test_scenes_that_differ_in_the_policys_settings_alone_keep_their_own_failures(
    tmp_path: Path,
) -> None:
    wall = {"terrain": {"name": "step", "height": 0.9}, "eval": {"episodes": 1}}
    scenes = [
        (EvalConfig(**wall), PolicySource(settings={"name": "okada", "far": far}))
        for far in (0.45, 0.15)
    ]
    assert write_failures(tmp_path, *scenes) == 2
    files = sorted(tmp_path.glob("failure_*"))
    records = [read_record(file) for file in files]
    assert [(record.policy.controller or {})["far"] for record in records] == [0.45, 0.15]
    assert records[0].digest != records[1].digest
    for file in files:
        assert replay(file).differences == []


def test_what_is_no_record_is_refused(tmp_path: Path) -> None:
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(RequestError, match="no record of an episode: it must be a mapping"):
        read_record(tmp_path / "list.json")


def test_a_recorded_failure_is_watched_as_its_policy_and_episode(folder: Path) -> None:
    records = [read_record(file) for file in sorted(folder.glob("failure_*.json"))]
    lane = Lane(_failures(folder))
    assert lane.entrant.recorded
    for index, record in enumerate([*records, records[0]]):
        lane.begin(index)
        assert (lane.label, lane.title) == ("level", f"step, episode {record.episode}")
