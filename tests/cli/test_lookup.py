"""``flipperctl list`` and ``explain``: names by kind, settings, words, and a search."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len

from flipperctl.api import registry
from flipperctl.cli.catalogue import KINDS, keys_named
from flipperctl.config import TrainConfig
from flipperctl.text.elsewhere import WORDS
from tests.cli.call import COMMANDS, call, refused


def document(*words: str, cwd: Path) -> Any:
    done = call(*words, "--json", cwd=cwd)
    assert done.code == 0, done.err
    return json.loads(done.out)


@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"runs"}))
def test_every_name_has_a_line_of_its_own(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = document("list", kind, cwd=tmp_path)["names"]
    listed = {(one["group"], one["name"]) for one in found}
    assert {key for key in registry if key[0] in KINDS[kind]} <= listed
    files = {(p.parent.name, p.stem) for p in Path("configs").rglob("*/*.yaml")}
    assert {key for key in files if key[0] in KINDS[kind]} <= listed
    monkeypatch.setenv("COLUMNS", "100")
    lines = call("list", kind, cwd=tmp_path).out.splitlines()
    assert max(map(cell_len, lines)) <= 100
    for one in found:
        starts = [line for line in lines if line.split()[:1] == [one["name"]]]
        assert starts, one["name"]
        if kind != "policies":  # the sentences of their cards
            assert any(one["summary"] in line for line in starts), one["summary"]


def test_a_run_is_listed_with_its_best_validation(short_run: Path, tmp_path: Path) -> None:
    first, killed = tmp_path / "runs/compared/first", tmp_path / "runs/killed"
    shutil.copytree(short_run, first)
    for run in (first, killed):
        run.mkdir(exist_ok=True)
        (run / "config.yaml").write_text("terrain: {name: step}")
    best = json.loads((first / "summary.json").read_text())["best"]
    rows = {row["name"]: row for row in document("list", "runs", cwd=tmp_path)["names"]}
    assert {row["terrain"] for row in rows.values()} == {"step"}
    assert rows["runs/compared/first"]["success_rate"] == best["success_rate"]
    assert rows["runs/killed"]["decisions"] is None
    assert document("list", "runs", "runs/killed", cwd=tmp_path)["names"] == [rows["runs/killed"]]
    assert "runs: 2 runs" in call("list", "runs", cwd=tmp_path).out


def test_a_setting_says_what_changes_it_and_how_it_is_typed(tmp_path: Path) -> None:
    (found,) = document("explain", "agent.epsilon_decisions", cwd=tmp_path)["settings"]
    assert found["set_by"]["experiment=quick"] == "4800"
    assert (found["default"], found["bounds"], found["of"]) == (15000, "≥ 1, ≤ 1e+08", "agent d3qn")
    assert found["command"] == "flipperctl train agent.epsilon_decisions=15000"
    (found,) = document("explain", "stair.rise", cwd=tmp_path)["settings"]
    assert (found["key"], found["train"], found["unit"]) == ("terrain.rise", 0.2, "m")
    (found,) = document("explain", "lambda_2", cwd=tmp_path)["settings"]
    assert found["train"] is None  # its rewards have no such term
    assert found["command"] == "flipperctl train rewards.pitch=pitch rewards.pitch.lambda_2=8"
    found = document("explain", "sim.friction", cwd=tmp_path)["settings"]
    assert {one["of"] for one in found} == {"sim planar", "sim mujoco"}


def test_every_top_level_setting_and_argument_is_explained(tmp_path: Path) -> None:
    assert [name for name in TrainConfig.model_fields if not keys_named(name)] == []
    (found,) = document("explain", "network", cwd=tmp_path)["settings"]
    assert (found["default"], found["command"]) == ("at_d3qn", "flipperctl train network=conv")
    (found,) = document("explain", "rewards", cwd=tmp_path)["settings"]
    assert "swing" in found["default"]
    found = document("explain", "agent.settings.tau", cwd=tmp_path)["settings"]
    assert {one["bounds"] for one in found} == {"≥ 0, ≤ 1"}
    assert found[0]["command"].endswith(
        "agent=sb3 agent.algorithm=dqn agent.settings.tau=0.01"  # ours, not the library's
    )


def test_names_words_and_anything_else(tmp_path: Path) -> None:
    (found,) = document("explain", "wide_stair", cwd=tmp_path)["names"]
    assert found["settings"]["terrain"] == "stair"
    assert found["settings"]["terrain.steps"] == "[3,6]"
    (found,) = document("explain", "ramp", cwd=tmp_path)["names"]
    assert {field["name"] for field in found["plugin"]["fields"]} >= {"slope"}
    said = call("explain", "pitch", "variation", cwd=tmp_path).out
    assert said.startswith("pitch variation: How much the robot rocks")
    hits = document("explain", "learning", "rate", cwd=tmp_path)["found"]
    assert hits[0]["name"] == "agent.learning_rate"
    assert len(hits) == 10
    assert (
        document("explain", "discount", "per", "decision", cwd=tmp_path)["found"][0]["name"]
        == "agent.gamma"
    )
    assert "flipperctl map" in call("explain", "map", cwd=tmp_path).out


@pytest.mark.long
def test_a_contact_sheet_of_the_terrains(tmp_path: Path) -> None:
    done = call("list", "terrains", "--pictures", "sheet.svg", cwd=tmp_path)
    assert done.code == 0, done.err
    text = (tmp_path / "sheet.svg").read_text()
    names = [name for kind, name in registry if kind == "terrain"]
    drawn = re.findall(r"<!-- (\w+) -->", text)
    assert set(drawn) >= {*names} - {"profile_file"}  # which needs a file
    assert drawn.index("wave") < drawn.index("all_courses")  # those made of others come last
    assert text.count("<!-- 1 m -->") == -(-(len(names) - 1) // 4)  # in each row
    assert text.count("<!-- goes on → -->") == 4  # rough, stairwell, course and midway


def test_a_word_of_another_tool_leads_to_ours_below_a_section_too(tmp_path: Path) -> None:
    assert "(here it is agent.learning_rate)" in refused("explain", "agent.lr", cwd=tmp_path)


def test_lines_for_words_of_other_tools_have_commands_and_settings() -> None:
    for line in {line for word in WORDS.values() if word.meaning for line in word.lines}:
        program, command, *words = line.split()
        keys = [word.partition("=")[0] for word in words if re.match(r"[a-z.]+=", word)]
        assert program != "flipperctl" or command in COMMANDS
        assert [key for key in keys if not keys_named(key)] == []


def test_a_word_of_another_tool_is_explained_with_what_to_type(tmp_path: Path) -> None:
    sac = document("explain", "sac", cwd=tmp_path)
    assert sac["meaning"].startswith("Soft actor-critic")
    assert sac["lines"] == ["flipperctl train agent=sb3 agent.algorithm=sac actions=rates"]
    (found,) = document("explain", "γ", cwd=tmp_path)["settings"][:1]
    assert found["key"] == "agent.gamma"
    assert document("explain", "theta_R", cwd=tmp_path)["meaning"].startswith("How much the robot")
    hits = document("explain", "onnx", cwd=tmp_path)["found"]  # of a command's help
    assert hits[0]["summary"].startswith("Write a policy for the robot, onnx;")


def test_a_name_of_several_kinds_is_brief_and_one_kind_tells_all(tmp_path: Path) -> None:
    said = call("explain", "generalist", cwd=tmp_path).out
    assert said.startswith("generalist: The shipped policy")
    assert "More about one: flipperctl explain suite=generalist" in said
    assert "teacher.final_updates" not in said
    assert "teacher.final_updates" in call("explain", "experiment=generalist", cwd=tmp_path).out
