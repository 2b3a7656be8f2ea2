"""``flipperctl eval --replay``."""

import json
from pathlib import Path

from tests.cli.call import call

LEVEL = ("eval", "--controller", "level", "terrain=step", "terrain.low=0.4", "terrain.high=0.4")


def test_a_failure_is_recorded_and_played_again(tmp_path: Path) -> None:
    done = call(*LEVEL, "--episodes", "1", "--output", "found", cwd=tmp_path)
    assert done.code == 0
    assert "recorded 1 failures; to play one again: flipperctl eval --replay found/" in done.err
    file = "found/failure_step_0.json"
    done = call("eval", "--replay", file, "--output", "again", cwd=tmp_path)
    assert done.code == 0, done.err
    assert "bit-identical to the recorded episode" in done.out
    assert (tmp_path / "again/replay.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "again/replay.json").read_text())["identical"] is True

    record = json.loads((tmp_path / file).read_text())
    (tmp_path / "wrong.json").write_text(json.dumps(record | {"digest": "0"}))
    done = call("eval", "--replay", "wrong.json", cwd=tmp_path)
    assert done.code == 1
    assert "wrong.json: the episode differs from the recorded one: digest" in done.err
    done = call("eval", "--replay", file, "sim.friction=2", cwd=tmp_path)
    assert done.code == 2
    assert "overrides: no meaning beside --replay" in done.err
